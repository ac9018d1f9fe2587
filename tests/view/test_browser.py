"""The live view in a real browser. Truth: pixels of the canvas, and the recording of the run that was steered."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from browser import CHROMIUM, browser, project
from test_live import free_port

from wbmpc.recording.plots import positions
from wbmpc.recording.reader import read
from wbmpc.view.stage import CAMERA

pytest.importorskip("viser")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
#: viser's cameras, vertically [rad].
FIELD = np.radians(75.0)


def start(*arguments: str) -> tuple[subprocess.Popen[str], str]:
    """A command that opens a view, and its address."""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2] / "src")}
    command = [sys.executable, "-m", "wbmpc", *arguments, "--port", str(free_port())]
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    for line in process.stderr:
        if "the view is at" in line:
            return process, line.split()[-1]
    raise AssertionError("the view did not open")


def test_the_view_draws_and_steers(tmp_path: Path) -> None:
    """The hand's goal is dragged in the middle of a run; a push is asked for; the run is ended from the browser."""
    run = ("run", "rezero-steps", "--set", "settle=120", "--out", str(tmp_path), "--json", "--view")
    process, url = start(*run)
    try:
        with browser() as page:
            page.open(url, 10.0)
            assert page.errors == [] and page.outside == []
            assert len(np.unique(page.picture().reshape(-1, 3), axis=0)) > 50  # a robot, not one colour
            now = positions(_partly(tmp_path), "/hand/pose")
            assert now is not None
            base = np.array([0.0, 0.0, 0.125])
            page.click("Push")
            assert page.changed(1.5) > 300
            page.wait(6.0)
            # the gizmo's arrow along z, three quarters of its 0.3 m up; and 0.25 m higher
            hand, box = now[1][-1], (676.0, 700.0)
            pixel = lambda z: project(hand + [0, 0, z], base + CAMERA, base, box, FIELD)
            page.drag(tuple(pixel(0.22)), tuple(pixel(0.22 - 0.12)))
            page.wait(5.0)
            page.click("End the run")
            out, _ = process.communicate(timeout=60)
        assert process.returncode == 1 and "ended in the view" in out
    finally:
        process.kill()
    recording = read(tmp_path)
    _, goal = positions(recording, "/hand/reference")  # type: ignore[misc]
    _, hand_path = positions(recording, "/hand/pose")  # type: ignore[misc]
    # pushed: the hand left its place before the goal was touched
    touched = int(np.argmax(np.linalg.norm(goal - goal[0], axis=1) > 1e-6))
    assert touched > 0
    off = np.linalg.norm(hand_path[:touched] - goal[0], axis=1)
    assert off.max() > 0.03
    # dragged: the goal went down, and the hand with it
    assert -0.4 < goal[-1, 2] - goal[0, 2] < -0.03
    assert np.linalg.norm(hand_path[-1] - goal[-1]) < 0.03
    assert hand_path[-1, 2] < goal[0, 2] - 0.03


def _partly(folder: Path):  # type: ignore[no-untyped-def]
    """The recording of a run that is still going on."""
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        if (folder / "run.mcap").exists() and "/hand/pose" in (found := read(folder)).topics:
            return found
        time.sleep(0.2)
    raise AssertionError("nothing was recorded")


def test_ctrl_c_ends_a_session(tmp_path: Path) -> None:
    process, _ = start("view", "rezero")
    time.sleep(1.0)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 130 and "Traceback" not in err
