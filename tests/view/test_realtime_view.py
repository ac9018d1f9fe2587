"""The view of the real-time runner. Truth: symbolic kinematics against MuJoCo's bodies; the physics, which is another process
and knows nothing of the view's orders, shows where the robot has gone."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_live import free_port, panel_of

from wbmpc import lie
from wbmpc.cli import main
from wbmpc.model.robot import load_robot
from wbmpc.runtime.shared_memory import Board, Mailbox
from wbmpc.view.actuator_load import SHARES
from wbmpc.view.snapshot import NUMBERS, PLAN, REFERENCE
from wbmpc.view.user_commands import no_requests

pytest.importorskip("viser")
realtime = pytest.importorskip("wbmpc.view.realtime")
session = pytest.importorskip("wbmpc.view.session")
physics = pytest.importorskip("wbmpc.view.physics")


def moved(robot: Any) -> np.ndarray:
    """A state away from home: every place of the arm, the base and (swerve) the steering is another."""
    x = robot.home.copy()
    x[robot.state["base"]] += [1.0, -0.5, 0.7, 0.05, -0.04][: x[robot.state["base"]].size]
    x[robot.state["arm"]] += 0.2
    if "steer" in robot.state:
        x[robot.state["steer"]] += 0.4
    return x


@pytest.mark.parametrize("name", ["swerve-ur10", "rezero"])
def test_pictures_show_the_estimated_state(name: str) -> None:
    robot = load_robot(name)
    plant, reader = realtime.scene_of(robot)
    x = moved(robot)
    plant.arrange(x)
    frames = plant.world.frames(height=0.0)
    position, orientation = robot.pose(x)
    lift = [0.0, 0.0, getattr(robot.description.base, "ball_radius", 0.0)]
    np.testing.assert_allclose(frames["tool"], position + lift, atol=2e-3)
    turned = lie.rotation_to_quaternion(frames["tool_rotation"])
    assert abs(turned @ orientation) == pytest.approx(1.0, abs=1e-6)
    assert reader.poses(plant.data).shape == (len(reader.scene.bodies), 7)


def test_contacts_are_drawn_where_the_estimate_is() -> None:
    """The world's base is 0.5 m ahead of the estimate: what acts at its feet is shown 0.5 m back, forces as long as before."""
    robot = load_robot("swerve-ur10")
    moments = Mailbox({"t": (), "late": (), "x": (robot.home.size,), "ticks": (), "misses": ()})
    picture = realtime.Picture("swerve-ur10", moments, seen := Mailbox(physics.SEEN))
    moments.write(t=1.0, late=0.002, x=robot.home, ticks=400.0, misses=3.0)
    picture._plant.arrange(robot.home)
    base = picture._reader.poses(picture._plant.data)[picture._reader.scene.index].copy()
    base[0] += 0.5
    arrow, point = np.array([[1.2, 0.0, 0.0], [1.2, 0.0, 0.3]]), np.array([0.6, 0.1, 0.0])
    nothing = {name: np.full(shape, np.nan) for name, shape in physics.SEEN.items()}
    seen.write(**{**nothing, "base": base, "forces": np.tile(arrow, (8, 1, 1)), "pressure": point, "margin": 0.1})
    plan = np.tile(robot.home, (PLAN, 1))
    message = {
        "plan": plan, "reference": np.zeros((REFERENCE, 3)), "goal": np.array([*robot.pose(robot.home)[0], 1.0, 0, 0, 0]),
        "base_goal": np.zeros(3), "brakes": np.array(0.0), "obstacle": np.zeros(8), "solve": np.array(0.001), "deadline": np.array(0.02),
        "clearance": np.array(0.041),
    }  # fmt: skip
    shown = picture(message)
    np.testing.assert_allclose(shown["forces"][0], arrow - [0.5, 0, 0], atol=1e-9)
    np.testing.assert_allclose(shown["pressure"], point - [0.5, 0, 0], atol=1e-9)
    numbers = dict(zip(NUMBERS, shown["numbers"], strict=True))
    assert numbers["late"] == 0.002 and numbers["margin"] == 0.1 and numbers["clearance"] == 0.041
    assert (numbers["ticks"], numbers["late_ticks"]) == (400.0, 3.0) and np.isnan(numbers["factor"])
    # the physics goes at 0.8 of the clock
    for k in range(20):
        seen.write(**{**nothing, "base": base, "time": 0.08 * k, "clock": 7.0 + 0.1 * k})
        later = dict(zip(NUMBERS, picture(message)["numbers"], strict=True))
    assert later["factor"] == pytest.approx(0.8)
    assert numbers["margin"] == 0.1 and numbers["error"] < 1e-9
    np.testing.assert_allclose(shown["end_effector_plan"][0], robot.pose(robot.home)[0], atol=1e-9)


def test_a_run_that_begins_anew_is_shown_anew() -> None:
    """Its way and its speeds are not those of the run before, whose time was later. Truth: half of the arm's speed limit."""
    robot = load_robot("swerve-ur10")
    moments = Mailbox({"t": (), "late": (), "x": (robot.home.size,), "ticks": (), "misses": ()})
    picture = realtime.Picture("swerve-ur10", moments, None)
    message = {
        "plan": np.tile(robot.home, (PLAN, 1)), "reference": np.zeros((REFERENCE, 3)), "goal": np.array([0.0] * 3 + [1.0] + [0.0] * 3),
        "base_goal": np.zeros(3), "brakes": np.array(0.0), "obstacle": np.zeros(8), "solve": np.array(0.001), "deadline": np.array(0.02),
        "clearance": np.array(np.nan),
    }  # fmt: skip

    def shown(t: float, x: np.ndarray) -> tuple[float, np.ndarray]:
        moments.write(t=t, late=0.0, x=x, ticks=1.0, misses=0.0)
        values = picture(message)
        trail = values["trail"]
        return dict(zip(NUMBERS, values["numbers"], strict=True))[SHARES[0]], trail[np.isfinite(trail).all(axis=1)]

    far, fast = robot.home.copy(), robot.home.copy()
    far[robot.state["base"]] += [3.0, 0.0, 0.0]
    first = robot.state["arm"].start
    fast[first] += 0.05 * robot.description.limits.velocity[robot.state.groups["arm"][0]]
    shown(80.0, robot.home)
    assert len(shown(80.1, far)[1]) > 1
    share, trail = shown(0.0, robot.home)
    assert np.isnan(share) and np.ptp(trail, axis=0).max() < 1e-9
    assert shown(0.1, fast)[0] == pytest.approx(0.5)


@pytest.mark.wallclock
def test_the_runner_is_watched_and_steered() -> None:
    """Goals, weights, a push and the legs' brakes change a run of three processes that goes on meanwhile; a reset begins it
    again, and the end ends it."""
    view = realtime.RealtimeView("test", "swerve-ur10", "127.0.0.1", free_port())
    requests, runs, seen = no_requests(), [], {}  # type: ignore[var-annotated]
    make = session.runner_of

    def kept(*arguments: Any) -> Any:
        runs.append(make(*arguments))
        if len(runs) == 1:
            threading.Thread(target=act, daemon=True).start()
        return runs[-1]

    def give(**values: Any) -> None:
        for name, value in values.items():
            requests[name][...] = value
        panel_of(view).write(**requests)

    def until(true: Callable[[], bool], seconds: float = 120.0) -> bool:
        deadline = time.monotonic() + seconds
        while not true() and time.monotonic() < deadline:
            time.sleep(0.05)
        return true()

    def act() -> None:
        runner, world = runs[0]
        end_effector = lambda: np.array([world.board.samples(n)[-1] for n in "xyz"])
        seen["running"] = until(lambda: runner.state == "running" and world.board["time"] > 50)
        home, weights, memory = end_effector(), np.ones_like(requests["weights"]), runner.mpc.solver.constants
        goal = np.array([*(home + [0.0, 0.2, 0.1]), *load_robot("swerve-ur10").pose(runner.controller.robot.home)[1]])
        give(goals=1, goal=goal)
        seen["hand"] = until(lambda: float(np.linalg.norm(end_effector() - goal[:3])) < 0.02)
        give(base_goals=1, base_goal=np.array([0.25, 0.2, 0.0]))
        seen["base"] = until(lambda: bool(runner.controller.state()[0] > 0.1))
        weights[0] = 10.0
        previous = memory.copy()
        give(weights=weights)
        seen["weights"] = until(lambda: bool(np.any((memory == 10.0 * previous) & (previous > 0.0))))
        at = end_effector()
        give(pushes=1, push=np.array([900.0, 0.0, 0.0]), push_time=1.0)
        seen["push"] = until(lambda: float(np.linalg.norm(end_effector() - at)) > 5e-4)
        give(brake_clicks=1, brakes_open=1.0)
        seen["brakes"] = until(lambda: bool(runner.controller.brakes(0.0).all()))
        give(resets=1)
        seen["reset"] = until(lambda: len(runs) == 2 and runs[1][0].state == "running")
        world.seen.read()  # what the view's process was opened with
        messages: list[Any] = []
        seen["shown"] = until(lambda: messages.append(world.seen.read()) or any(messages), 20.0)  # type: ignore[func-returns-value]
        give(ends=1)

    session_runner, session.runner_of = session.runner_of, kept
    try:
        reason = session.run_realtime("swerve-ur10", 1, view)
    finally:
        session.runner_of = session_runner
        view.close()
    assert seen == dict.fromkeys(("running", "hand", "base", "weights", "push", "brakes", "reset", "shown"), True)
    assert reason == "ended in the view" and not runs[1][0].stopped
    assert not runs[0][1].process.is_alive() and not runs[1][1].process.is_alive()


def test_a_stop_by_safety_is_reported_once_and_in_the_page(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Status 1; the message on standard error and on the page's board."""
    pages: list[str] = []
    make, close = session.runner_of, realtime.RealtimeView.close

    def stopping(*arguments: Any) -> Any:
        runner, world = make(*arguments)
        threading.Timer(1.5, runner.halt, ("a test wanted it",)).start()
        return runner, world

    def closed(view: Any) -> None:
        pages.append(view.board.text)
        close(view)

    monkeypatch.setattr(session, "runner_of", stopping)
    monkeypatch.setattr(realtime.RealtimeView, "close", closed)
    assert main(["view", "swerve-ur10", "--realtime", "--port", str(free_port())]) == 1
    assert capsys.readouterr().err.count("a test wanted it") == 1
    assert pages[0].startswith("The run is over: stopped at ") and pages[0].endswith(": a test wanted it")


@pytest.mark.parametrize("more", [["--realtime"], []])
def test_a_session_ends_with_the_process_of_its_page(
    more: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The system ends processes for want of memory: the robot went on for a day, with nobody who saw it."""
    start, guard = realtime.RealtimeView.start, threading.Timer(60.0, os.kill, (os.getpid(), signal.SIGINT))

    def killed(view: Any, *arguments: Any) -> None:
        start(view, *arguments)
        threading.Timer(1.0, view.process.kill).start()
        guard.start()

    monkeypatch.setattr("wbmpc.view.core.Window.start", killed)
    try:
        assert main(["view", "panda", *more, "--port", str(free_port())]) == 1
    finally:
        guard.cancel()
    assert "the process that shows the view has ended" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("by", "says"),
    [
        (signal.SIGKILL, "the process of the physics has ended with exit code -9"),
        (signal.SIGSTOP, "the limit is 2 s: the machine is too busy, or its process was held up"),
    ],
)
def test_a_session_without_its_physics_says_so_and_leaves_no_process(
    by: signal.Signals, says: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed, or held up: the command names the cause and ends. Truth: the system's table of processes."""
    worlds, make, end = [], session.runner_of, physics.Simulated.close

    def without(*arguments: Any) -> Any:
        runner, world = make(*arguments)
        worlds.append(world)
        threading.Timer(1.5, os.kill, (world.process.pid, by)).start()
        return runner, world

    def close(world: Any) -> None:
        end(world)
        seen.append(world.process.is_alive())
        world.process.kill()

    seen: list[bool] = []
    monkeypatch.setattr(session, "runner_of", without)
    monkeypatch.setattr(physics.Simulated, "close", close)
    assert main(["view", "panda", "--realtime", "--port", str(free_port())]) == 1
    assert says in capsys.readouterr().err
    assert seen == [False]


def test_a_robot_that_falls_after_its_stop_begins_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A push from the page that is too much switches the motors off before the robot has fallen, which ended the command."""
    view: Any = SimpleNamespace(wants_reset=False, stopped=False, robot=load_robot("rezero"))
    worlds: list[Any] = []

    def runner_of(*_: object) -> tuple[object, Any]:
        world = physics.Simulated.__new__(physics.Simulated)
        world.board = Board(physics.NUMBERS)
        world.process = SimpleNamespace(is_alive=lambda: True, join=lambda _: None, kill=lambda: None)
        worlds.append(world)
        return None, world

    def follow(_: object) -> str:
        view.stopped = len(worlds) == 1
        if view.stopped:
            threading.Timer(0.4, worlds[0].board.__setitem__, ("fell", 1.0)).start()
        return "motors off" if view.stopped else "ended in the view"

    view.follow = follow
    monkeypatch.setattr(session, "runner_of", runner_of)
    assert session.run_realtime("rezero", 1, view) == "ended in the view" and len(worlds) == 2
    assert all(world.board["end"] for world in worlds)
