"""A ball robot that balances on a bus: what the tests of its node share."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import pytest
from needs import private

from wbmpc.model.robot import load_robot
from wbmpc.ros2.network import Network

ROBOT = load_robot("rezero")
NETWORK = Network.of({**private(), "ROS_DOMAIN_ID": "48"})


def balancing(s: Any) -> None:
    """Bring a robot to balance."""
    s.ready()
    s.end_effector()
    assert s.until(lambda: s.control.state.startswith("running:")), s.control.state
    s.run(0.2)


def standing(s: Any) -> None:
    """It stands, 1.2 s later too: without torques it falls within 1 s."""
    s.run(1.2)
    assert not s.why and s.truth().tilt < 0.25 and s.control.running


class Deaf:
    """In place of a publisher: nothing is sent, or what a function does."""

    def __init__(self, publish: Callable[[Any], None] = lambda message: None) -> None:
        self.publish = publish


def errors(caplog: pytest.LogCaptureFixture, text: str) -> int:
    return sum(text in r.getMessage() and r.levelno == logging.ERROR for r in caplog.records)
