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
from filmed import copy_film
from test_live import free_port

from effort import thorough
from fake_experiment import REGISTRY, FakeSettings
from wbmpc import lie
from wbmpc.recording.plots import positions
from wbmpc.recording.reader import read_recording
from wbmpc.report import plots_page, write_run
from wbmpc.reproduce import Job, write_site
from wbmpc.result import Plot
from wbmpc.view.camera import camera_offset
from wbmpc.view.core import LiveView
from wbmpc.view.replay import Film
from wbmpc.view.snapshot import fields
from wbmpc.view.user_commands import Controls

pytest.importorskip("viser")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
#: viser's cameras, vertically [rad].
FIELD = np.radians(75.0)


def start(*arguments: str) -> tuple[subprocess.Popen[str], str]:
    """A command that opens a view, and its address."""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2] / "src")}
    command = [sys.executable, "-m", "wbmpc", *arguments, "--port", str(free_port())]
    process = subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    assert process.stderr is not None
    for line in process.stderr:
        if " is at http" in line:
            return process, line.split()[-1]
    raise AssertionError("the view did not open")


class Shown:
    """A view's process without a run behind it: what it is to draw, and what the page has asked for."""

    def __init__(self, film: Film) -> None:
        self.view = LiveView("toy", "127.0.0.1", free_port(), lambda url: None, with_token=True)
        self.view.start(film.scene, Controls("toy", (), brakes=False, base=False), fields(film.scene))
        self.still = {**film.snapshot(0.0), "brakes": np.array(np.nan), "obstacle": np.zeros(8)}
        self.draw()

    def draw(self, **changed: np.ndarray) -> None:
        self.view.shown.write(**{**self.still, **changed})

    def asked(self, name: str) -> np.ndarray:
        """An order as it stands now."""
        self.view._read_requests()
        return np.array(self.view._requests[name])


def test_the_page_draws_and_hands_orders_over(tmp_path: Path) -> None:
    """What the run sends is drawn; a push, a goal that is dragged along its arrow and the end of the run arrive as orders."""
    copy_film(tmp_path)
    film = Film(read_recording(tmp_path))
    shown = Shown(film)
    try:
        with browser() as page:
            page.open(shown.view.url)
            assert page.errors == [] and page.outside == [] and page.page.title() == "toy"
            page.uncheck("Camera follows")  # from here on its place is known
            previous, poses, goal = page.picture(), shown.still["poses"], shown.still["goal"]
            shown.draw(poses=poses + np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0]))
            assert page.until(lambda: page.differs(previous) > 300, 60.0)
            shown.draw()
            page.click("Push")
            assert page.until(lambda: shown.asked("pushes") == 1.0, 20.0)
            np.testing.assert_allclose(shown.asked("push"), [60.0, 0.0, 0.0], atol=1e-9)
            # the gizmo's red arrow, 0.3 m long: it is pulled further along itself
            place, box = poses[film.scene.index, :3], (676.0, 700.0)
            eye, arrow = place + camera_offset(poses, film.scene), lie.quaternion_to_rotation(goal[3:])[:, 0]
            pixel = lambda along: project(goal[:3] + along * arrow, eye, place, box, FIELD)
            along = next(a for a in (0.22, 0.18, 0.25, 0.15) if page.grasp(pixel(a)))
            page.pull(pixel(along), pixel(along + 0.12))
            assert page.until(lambda: np.linalg.norm(shown.asked("goal")[:3] - goal[:3]) > 0.04, 20.0)
            moved = shown.asked("goal")[:3] - goal[:3]
            assert 0.04 < moved @ arrow < 0.3 and np.linalg.norm(moved - (moved @ arrow) * arrow) < 1e-3
            page.click("End the run")
            assert page.until(lambda: shown.asked("ends") == 1.0, 20.0) and page.errors == []
    finally:
        shown.view.close()


@thorough
def test_the_view_draws_and_steers(tmp_path: Path) -> None:
    """The end effector's goal is dragged in the middle of a run; a push is asked for; the run is ended from the browser."""
    run = ("run", "rezero-steps", "--set", "settle_time=120", "--out", str(tmp_path), "--json", "--view")
    process, url = start(*run)
    try:
        with browser() as page:
            page.open(url)
            assert page.errors == [] and page.outside == [] and page.page.title() == "rezero-steps, seed 200"
            film = Film(_partly(tmp_path))
            eye = camera_offset(film.snapshot(0.0)["poses"], film.scene)
            page.uncheck("Camera follows")  # from here on its place is known
            previous = page.picture()
            page.click("Push")
            assert page.until(lambda: page.differs(previous) > 300, 180.0)
            assert page.until(lambda: _hand_off(tmp_path) > 0.03, 180.0)
            # the gizmo's red arrow, 0.3 m long: it is pulled further along itself
            goal, base, box = film.snapshot(0.0)["goal"], np.array([0.0, 0.0, 0.125]), (676.0, 700.0)
            arrow = lie.quaternion_to_rotation(goal[3:])[:, 0]
            pixel = lambda along: project(goal[:3] + along * arrow, base + eye, base, box, FIELD)
            # an end effector that sways may stand before the arrow: then another place, a little later
            along = next(a for a in (0.22, 0.18, 0.25, 0.15, 0.22, 0.18, 0.25) if page.grasp(pixel(a)))
            page.pull(pixel(along), pixel(along + 0.12))
            assert page.until(lambda: _goal_moved(tmp_path) > 0.04, 180.0)
            assert page.until(lambda: _end_effector_error(tmp_path) < 0.02, 180.0)
            page.click("End the run")
            out, _ = process.communicate(timeout=180)
        assert process.returncode == 130 and "ended in the view" in out
    finally:
        process.kill()
    recording = read_recording(tmp_path)
    _, goal_path = positions(recording, "/end_effector_reference")  # type: ignore[misc]
    _, hand_path = positions(recording, "/ground_truth/end_effector")  # type: ignore[misc]
    # pushed: the end effector left its place before the goal was touched
    touched = int(np.argmax(np.linalg.norm(goal_path - goal_path[0], axis=1) > 1e-6))
    assert touched > 0
    off = np.linalg.norm(hand_path[:touched] - goal_path[0], axis=1)
    assert off.max() > 0.03
    # dragged: the goal went along the arrow, and the end effector with it
    moved = goal_path[-1] - goal_path[0]
    assert 0.04 < moved @ arrow < 0.3 and np.linalg.norm(moved - (moved @ arrow) * arrow) < 1e-3
    assert np.linalg.norm(hand_path[-1] - goal_path[-1]) < 0.03


@thorough
def test_the_base_is_dragged_and_legs_are_moved(tmp_path: Path) -> None:
    """In a session: the arrow of the base's goal is pulled ahead, then A is clicked, then the session restarts."""
    process, url = start("view", "swerve-ur10", "--out", str(tmp_path))
    try:
        with browser() as page:
            page.open(url)
            film = Film(_partly(tmp_path))
            poses = film.snapshot(0.0)["poses"]
            place = poses[film.scene.index, :3]
            page.uncheck("Camera follows")
            eye, box = place + camera_offset(poses, film.scene), (676.0, 700.0)
            pixel = lambda along: project(np.array([along, 0.0, 0.02]), eye, place, box, FIELD)
            along = next(a for a in (0.45, 0.4, 0.5, 0.35, 0.45, 0.5) if page.grasp(pixel(a)))
            page.pull(pixel(along), pixel(along + 0.3))
            assert page.until(lambda: _last(tmp_path, "/odom", "pose.pose.position.x") > 0.1, 180.0)
            leg = lambda: _last(tmp_path, "/measured/leg", "data.0")
            previous = leg()
            page.click("A")
            assert page.until(lambda: abs(leg() - previous) > 0.1, 180.0)
            page.click("Reset")
            assert page.until(lambda: abs(_last(tmp_path, "/odom", "pose.pose.position.x")) < 0.01, 180.0)
            assert page.errors == [] and page.outside == []
            page.click("End the run")
            _, err = process.communicate(timeout=180)
        assert process.returncode == 0 and "ended in the view" in err
    finally:
        process.kill()


def _last(folder: Path, topic: str, column: str) -> float:
    """The newest number of a recording that is still being written."""
    return float(read_recording(folder).table(topic).columns[column][-1])


def _paths(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """What is recorded so far: the end effector's reference (n, 3) and the end effector (n, 3)."""
    recording = read_recording(folder)
    found = [positions(recording, topic) for topic in ("/end_effector_reference", "/ground_truth/end_effector")]
    goal, end_effector = (np.zeros((0, 3)) if f is None else f[1] for f in found)
    rows = min(len(goal), len(end_effector))
    return goal[:rows], end_effector[:rows]


def _hand_off(folder: Path) -> float:
    """How far the end effector has ever been from its first goal [m]."""
    goal, end_effector = _paths(folder)
    return float(np.linalg.norm(end_effector - goal[0], axis=1).max())


def _goal_moved(folder: Path) -> float:
    goal, _ = _paths(folder)
    return float(np.linalg.norm(goal[-1] - goal[0]))


def _end_effector_error(folder: Path) -> float:
    goal, end_effector = _paths(folder)
    return float(np.linalg.norm(end_effector[-1] - goal[-1]))


def _partly(folder: Path):  # type: ignore[no-untyped-def]
    """The recording of a run that is still going on."""
    deadline = time.monotonic() + 180.0
    while time.monotonic() < deadline:
        if (folder / "run.mcap").exists() and "/ground_truth/end_effector" in (found := read_recording(folder)).topics:
            return found
        time.sleep(0.2)
    raise AssertionError("nothing was recorded")


@pytest.mark.parametrize("what", ["view", pytest.param("replay", marks=thorough)])
def test_ctrl_c_ends_a_session(what: str, tmp_path: Path) -> None:
    """As a terminal sends it: to the view's process too."""
    if what == "replay":
        copy_film(tmp_path)
    process, _ = start(what, "rezero" if what == "view" else str(tmp_path))
    time.sleep(1.0)
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=180)
    assert process.returncode == 130 and "Traceback" not in err


def test_pages_of_runs_open_without_errors(tmp_path: Path) -> None:
    """A run's page, an experiment's and the index of `wbmpc reproduce`, `log plot`'s page: no error in the console, nothing from
    a network, and every plot of the run is drawn."""
    result = REGISTRY["fake"].run(FakeSettings(duration=1.0), 1, None)
    job = Job("fake", 1, tmp_path / "fake" / "seed1")
    write_run(result, job.directory)
    job.mark.touch()
    index = write_site([job], {}, tmp_path, clips=False)
    plots = tmp_path / "plots.html"
    plots.write_text(plots_page("plots", "of a run", [p for p in result.plots if isinstance(p, Plot)]))
    pages = (index, index.parent / "fake" / "index.html", job.directory / "report.html", plots)
    with browser() as page:
        page.page.context.set_offline(True)
        for path in pages:
            page.page.goto(path.as_uri(), timeout=120_000)
            page.drawn(2)
            assert page.errors == [] and page.outside == [], path
            if path.name in ("report.html", "plots.html"):
                assert page.page.locator(".main-svg").count() >= len(result.plots)
        # what is linked is there
        page.page.goto(index.as_uri(), timeout=60_000)
        page.page.get_by_role("link", name="fake").click()
        assert page.page.get_by_role("heading", name="fake", exact=True).count() == 1
        frame = page.page.frame_locator("iframe")
        assert page.until(lambda: frame.locator(".main-svg").count() >= len(result.plots), 180.0)


def test_a_page_keeps_its_access_over_reloads(tmp_path: Path) -> None:
    """The address with the token lets the page, its WebSocket and a reload in; nothing that the page sends by itself
    is left out; a page of another origin stays outside."""
    copy_film(tmp_path)
    process, url = start("replay", str(tmp_path))
    try:
        with browser() as page:
            page.open(url)
            page.page.mouse.move(300.0, 400.0)
            page.page.mouse.wheel(0.0, 200.0)  # the camera moves: the page says where it is
            page.drawn(3)
            page.page.reload(timeout=120_000)
            page.page.wait_for_selector("canvas[data-engine]", timeout=120_000)
            assert page.errors == [] and "Not done" not in page.page.content()
            # nothing of it is in the browser for other addresses: another server at this host would get it
            own, base = page.page.context, url.rsplit("/", 2)[0]
            assert own.cookies() == [] and own.request.get(url).status == 200 and own.request.get(base).status == 403
        os.killpg(process.pid, signal.SIGINT)
        _, err = process.communicate(timeout=60)
        assert "Traceback" not in err and "malformed" not in err
    finally:
        process.kill()
