"""Pictures inside notebooks. Truth: the robot's own kinematics; the pictures of a run; pixels of a real browser."""

from __future__ import annotations

import html
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import wbmpc as wb
from fake_experiment import FakeSettings, run
from test_report_replay import data_of, driving, unpacked
from view.browser import CHROMIUM, FLAGS
from wbmpc.simulation.inline import Picture3D
from wbmpc.solver.solution import Status


def part_of(picture: Picture3D) -> dict[str, Any]:
    found = re.fullmatch(r'<iframe srcdoc="([^"]*)" title="[^"]*" style="[^"]*"></iframe>', picture._repr_html_())
    assert found
    (part,) = data_of(html.unescape(found[1]))
    return part


@pytest.mark.parametrize("name", ["panda", "rezero", "fetch"])
def test_bodies_are_where_the_model_has_them(name: str) -> None:
    """The end effector is the first point; the body that carries the arm is the robot's."""
    robot, rng = wb.load_robot(name), np.random.default_rng(1)
    states = robot.home + rng.uniform(-0.2, 0.2, (4, robot.state.size))
    times = [0.0, 0.5, 0.7, 2.0]
    part = part_of(wb.show(robot, states, times))
    np.testing.assert_allclose(unpacked(part, "times", "<f8"), times)
    points = unpacked(part, "points", "<i2").reshape(4, -1, 3)[:, 0] / part["full"]
    lift = [0.0, 0.0, robot.base.ground]
    tools = np.array([robot.pose(x)[0] for x in states])
    np.testing.assert_allclose(part["middle"] + part["half"] * points, tools - lift, atol=1e-3)
    if part["robot"] in part["moving"]:
        poses = (
            unpacked(part, "poses", "<i2").reshape(4, -1, 7)[:, part["moving"].index(part["robot"]), :3] / part["full"]
        )
        base = np.array([robot.pose(x, robot.description.base.body)[0] for x in states])
        np.testing.assert_allclose(part["middle"] + part["half"] * poses, base - lift, atol=1e-3)


def test_plans_have_their_own_times_and_states_of_wrappers_are_cut() -> None:
    robot = wb.load_robot("panda")
    x = np.column_stack([np.linspace(robot.home, robot.home + 0.3, 4), np.zeros(4)])
    found = wb.Solution(
        Status.CONVERGED, np.array([0.0, 0.1, 0.3, 1.0]), x, np.zeros((3, 7)), np.zeros((3, 7, 8)), 5, 1.0, 0.0, 0.0, 0.0, np.zeros((5, 8))
    )  # fmt: skip
    for plan, start in ((found, 0.0), (wb.Policy.of(found, 5.0), 5.0)):
        times = unpacked(part_of(wb.show(robot, plan)), "times", "<f8")
        np.testing.assert_allclose(times, start + found.times, atol=1e-6)


def test_a_run_shows_its_pictures_and_one_without_says_so() -> None:
    result = run(FakeSettings(), 3)
    with pytest.raises(wb.InputError, match="no pictures"):
        wb.show(result)
    result.motion = driving("<script>")
    picture = wb.show(result)
    assert part_of(picture)["name"] == "<script>" and len(repr(picture)) < 100


@pytest.mark.parametrize(
    ("states", "times", "said"),
    [
        (np.zeros(6), None, r"states \(n, 7\)"), (np.full(7, np.nan), None, "finite"), (np.zeros((2, 3, 7)), None, "states"),
        (np.zeros((2, 7)), [0.0], "times"), (np.zeros((2, 7)), [1.0, 1.0], "rise"), ("home", None, "numbers"),
    ],
)  # fmt: skip
def test_bad_states_are_rejected(states: Any, times: Any, said: str) -> None:
    with pytest.raises(wb.InputError, match=said):
        wb.show(wb.load_robot("panda"), states, times)


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
def test_a_notebook_shows_it_without_a_network(tmp_path: Path) -> None:
    """What IPython hands to a page: a robot that stands is drawn without a bar, one that moves plays; nothing is loaded."""
    formatters = pytest.importorskip("IPython.core.formatters")
    playwright = pytest.importorskip("playwright.sync_api")
    robot = wb.load_robot("rezero")
    moving = wb.show(robot, [robot.home, robot.home + 0.3])
    shown = [formatters.DisplayFormatter().format(picture)[0]["text/html"] for picture in (wb.show(robot), moving)]
    (tmp_path / "page.html").write_text(f"<!doctype html><body>{''.join(shown)}</body>")
    with playwright.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = browser.new_page(viewport={"width": 600, "height": 900})
        errors: list[str] = []
        asked: list[str] = []
        page.on("pageerror", lambda e: errors.append(str(e)))
        page.on("request", lambda r: asked.append(r.url))
        page.goto((tmp_path / "page.html").as_uri(), wait_until="load", timeout=120_000)
        ink = """() => new Promise(done => { const c = document.querySelector("canvas");
          document.dispatchEvent(new CustomEvent("replay-seek", { detail: 0 }));
          requestAnimationFrame(() => { const copy = document.createElement("canvas"); Object.assign(copy, { width: c.width, height: c.height });
            const i = copy.getContext("2d"); i.drawImage(c, 0, 0); const d = i.getImageData(0, 0, c.width, c.height).data; let n = 0;
            for (let k = 3; k < d.length; k += 4) if (d[k] > 250) n++; done(n / (c.width * c.height)) }) })"""
        frames = page.frames[1:]
        assert len(frames) == 2 and all(frame.evaluate(ink) > 0.02 for frame in frames)
        assert [frame.locator(".bar").is_visible() for frame in frames] == [False, True]
        browser.close()
    assert not errors and all(url.startswith(("file:", "about:")) for url in asked)
