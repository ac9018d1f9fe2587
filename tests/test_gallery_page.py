"""The gallery's page names every experiment and robot that is built in: the registries decide which these are."""

import re
from pathlib import Path

from wbmpc.registry import REGISTRY
from wbmpc.robots import available_robots

PAGE = (Path(__file__).parents[1] / "docs" / "gallery.md").read_text()


def test_every_experiment_and_robot_is_in_the_gallery() -> None:
    shown = set(re.findall(r"`([a-z0-9-]+)`", PAGE))
    assert {*REGISTRY, *available_robots()} <= shown
