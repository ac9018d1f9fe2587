"""The replay inside a report. Truth: the poses that went in; pixels of a real browser; a recording's own frames."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import wbmpc as wb
from fake_experiment import FakeSettings, run
from view.browser import CHROMIUM, FLAGS
from wbmpc import lie
from wbmpc.plots.motion import NUMBERS, PATH, PICTURES, Motion, picture_points
from wbmpc.recording.reader import read_recording
from wbmpc.report import page
from wbmpc.report.replay import TRIANGLES, replay
from wbmpc.view.replay import Film

NOWHERE = (0.0, 0, 0, 1, 0, 0, 0)


def scene(*more: dict[str, Any], bodies: int = 2) -> dict[str, Any]:
    names = [f"body{k}" for k in range(bodies)]
    shape = {
        "kind": "box",
        "size": (0.2, 0.2, 0.2),
        "pose": NOWHERE,
        "color": (1.0, 0.0, 0.0, 1.0),
        "vertices": (),
        "faces": (),
    }
    shapes = [{"body": "world", **shape, "kind": "plane"}, *({"body": name, **shape} for name in names), *more]
    return {
        "robot": names[0],
        "bodies": [{"name": name, "parent": "world", "moves": True} for name in names],
        "shapes": shapes,
    }


def driving(name: str = "", pictures: int = 21) -> Motion:
    """The first body stands, the second drives along x and turns about z."""
    motion = Motion()
    motion.begin(name, scene())
    for k in range(pictures):
        t = 0.1 * k
        turned = [np.cos(0.5 * t), 0, 0, np.sin(0.5 * t)]
        points = picture_points(
            np.array([t, 1.0, 0.5]), None, [np.array([[t, 0, 0], [t + 1.0, 0, 0]]), np.zeros((0, 3))]
        )
        motion.add(t, np.array([NOWHERE, [0.5 * t, 0.0, 0.2, *turned]]), points)
    return motion


def data_of(html: str) -> list[dict[str, Any]]:
    found = re.search(r'<script type="application/json" class="data">(.*?)</script>', html, re.DOTALL)
    assert found
    data: list[dict[str, Any]] = json.loads(found[1])
    return data


def unpacked(part: dict[str, Any], key: str, kind: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(part[key]), kind)


def test_the_page_holds_the_poses() -> None:
    """To a 30 000th of the way, and of a unit; what stands is there once; missing points are marked."""
    motion = driving()
    (part,) = data_of(page_with(motion))
    assert part["moving"] == [1] and len(part["shapes"]) == 2 and part["robot"] == 0
    poses = unpacked(part, "poses", "<i2").reshape(-1, 7) / part["full"]
    true = np.array(motion.parts[0].poses)[:, 1]
    np.testing.assert_allclose(part["middle"] + part["half"] * poses[:, :3], true[:, :3], atol=part["half"] / 3e4)
    np.testing.assert_allclose(poses[:, 3:], true[:, 3:], atol=4e-5)
    np.testing.assert_allclose(unpacked(part, "times", "<f8"), motion.parts[0].times, atol=1e-6)
    points = unpacked(part, "points", "<i2").reshape(-1, part["count"], 3)
    assert (points[:, 1] == part["none"]).all() and (points[:, 2 + PATH :] == part["none"]).all()
    np.testing.assert_allclose(
        part["middle"][0] + part["half"] * points[:, 1 + PATH, 0] / part["full"], np.arange(21) * 0.1 + 1.0, atol=1e-3
    )


def page_with(motion: Motion) -> str:
    result = run(FakeSettings(), 3)
    result.motion = motion
    return page(result)


def test_a_run_without_pictures_has_no_replay() -> None:
    assert replay(None) == replay(Motion()) == replay(driving(pictures=1)) == ""


def test_what_a_file_says_stays_text() -> None:
    html = replay(driving("</script><img src=x onerror=alert(1)>"))
    assert "<img" not in html and data_of(html)[0]["name"] == "</script><img src=x onerror=alert(1)>"


@pytest.mark.parametrize("bodies", [1, 200])
def test_long_runs_are_thinned_out(bodies: int) -> None:
    """Ten hours of ten pictures a second, a world with many bodies: as many pictures as fit, from the first to the last moment."""
    motion, poses, points = Motion(), np.tile(NOWHERE, (bodies, 1)), np.zeros((2 + 2 * PATH, 3))
    motion.begin("", scene(bodies=bodies))
    last = 36_000.0
    for t in np.arange(0.0, last, 0.1):
        if motion.due(t):
            motion.add(t, poses, points)
    (part,) = motion.parts
    assert PICTURES / 2 <= len(part.times) <= PICTURES or len(part.times) * (poses.size + points.size) > NUMBERS / 2
    assert len(part.times) * (poses.size + points.size) <= NUMBERS
    assert part.times[0] == 0.0 and last - part.times[-1] < 1.01 * motion.period
    np.testing.assert_allclose(np.diff(part.times), motion.period, atol=0.11)


def test_meshes_that_are_too_large_become_boxes() -> None:
    corners = tuple(np.random.default_rng(1).uniform(-1.0, 3.0, 3 * 100))
    mesh = {
        "body": "body0",
        "kind": "mesh",
        "size": (1.0, 1, 1),
        "pose": NOWHERE,
        "color": (1.0, 1, 1, 1),
        "vertices": corners,
    }
    motion = driving()
    for faces, kind in ((TRIANGLES, "mesh"), (TRIANGLES + 1, "box")):
        motion.parts[0].shapes = [{**mesh, "body": 0, "faces": (0, 1, 2) * faces}]
        (shape,) = data_of(replay(motion))[0]["shapes"]
        assert shape["kind"] == kind
    low, high = (f(np.reshape(corners, (-1, 3)), axis=0) for f in (np.min, np.max))
    np.testing.assert_allclose(np.array(shape["offset"]) - shape["size"], low)
    np.testing.assert_allclose(np.array(shape["offset"]) + shape["size"], high)


def test_a_recorded_run_shows_what_its_recording_shows(tmp_path: Path) -> None:
    robot = wb.load_robot("differential-ur10")
    ocp = wb.OptimalControlProblem(robot.dynamics(), horizon=1.0, intervals=20, first_interval=0.02)
    ocp.add(wb.Cost("end_effector", wb.residuals.FramePose(robot, robot.tool), [1000.0] * 3 + [0.0] * 3))
    ocp.add(wb.Cost("speed", wb.residuals.Input(robot), 0.1))
    mpc = wb.MPC(ocp, rate=50.0)
    position, orientation = robot.pose(robot.home)
    mpc.reference["end_effector"] = wb.Reference.poses(
        [0.0, 1.0], np.array([position, position + [0.2, 0.0, 0.0]]), orientation
    )
    wb.simulate(robot, mpc, 1.0, out=tmp_path, settle_time=0.0)
    (part,) = data_of((tmp_path / "report.html").read_text())
    film = Film(read_recording(tmp_path))
    times, moving = unpacked(part, "times", "<f8"), part["moving"]
    assert times.size == 10 and moving
    poses = unpacked(part, "poses", "<i2").reshape(times.size, -1, 7) / part["full"]
    points = part["middle"] + part["half"] * unpacked(part, "points", "<i2").reshape(times.size, -1, 3) / part["full"]
    for t, placed, shown in zip(times, poses, points, strict=True):
        snapshot = film.snapshot(float(t) + 1e-5)  # (single precision)
        np.testing.assert_allclose(
            part["middle"] + part["half"] * placed[:, :3], snapshot["poses"][moving, :3], atol=1e-3
        )
        turned = [
            lie.quaternion_to_rotation(q) for q in placed[:, 3:] / np.linalg.norm(placed[:, 3:], axis=1, keepdims=True)
        ]
        np.testing.assert_allclose(
            turned, [lie.quaternion_to_rotation(q) for q in snapshot["poses"][moving, 3:]], atol=1e-3
        )
        np.testing.assert_allclose(shown[1], snapshot["goal"][:3], atol=1e-3)
        plan = snapshot["end_effector_plan"][np.isfinite(snapshot["end_effector_plan"]).all(axis=1)]
        np.testing.assert_allclose(shown[1 + PATH], plan[-1], atol=2e-3)


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
def test_it_plays_in_a_browser(tmp_path: Path) -> None:
    """A red box drives out of the picture's middle; time goes on while it plays; a plot's click goes to its time; nothing is loaded."""
    playwright = pytest.importorskip("playwright.sync_api")
    (tmp_path / "page.html").write_text(page_with(driving("<b>")))
    with playwright.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        shown = browser.new_page(viewport={"width": 600, "height": 500})
        errors: list[str] = []
        asked: list[str] = []
        shown.on("pageerror", lambda e: errors.append(str(e)))
        shown.on(
            "console",
            lambda m: errors.append(m.text) if m.type in ("error", "warning") and "GPU stall" not in m.text else None,
        )
        shown.on("request", lambda r: asked.append(r.url))
        shown.goto((tmp_path / "page.html").as_uri(), wait_until="load", timeout=120_000)
        red = """() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => {
          const canvas = document.querySelector(".replay canvas"), copy = document.createElement("canvas");
          document.dispatchEvent(new CustomEvent("replay-seek", { detail: TIME }));
          requestAnimationFrame(() => { Object.assign(copy, { width: canvas.width, height: canvas.height }); const ink = copy.getContext("2d");
            ink.drawImage(canvas, 0, 0); const d = ink.getImageData(0, 0, copy.width, copy.height).data; const at = [];
            for (let i = 0; i < d.length; i += 4) if (d[i] > 90 && d[i + 1] < 40 && d[i + 3] > 200) at.push((i / 4) % copy.width / copy.width);
            done([at.length, Math.max(...at) - Math.min(...at)]) }) })))"""
        together, apart = (shown.evaluate(red.replace("TIME", str(t))) for t in (0.0, 1.0))
        assert together[0] > 200 and apart[1] > together[1] + 0.1
        assert shown.locator(".replay output").text_content() == "1.0 s of 2.0 s"
        shown.locator(".replay .play").click()
        shown.wait_for_function("document.querySelector('.replay .play').textContent === 'Play'", timeout=60_000)
        assert (
            shown.locator(".replay output").text_content() == "2.0 s of 2.0 s"
            and shown.locator(".replay .part").is_hidden()
        )
        browser.close()
    assert not errors and all(url.startswith("file:") for url in asked)
