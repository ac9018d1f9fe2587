"""The controls beside the picture. Truth: the orders that reach the run, and the brakes that the run's controller asks for."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_live import free_port

from wbmpc import lie
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.model.robot import load_robot
from wbmpc.obstacles.world import Obstacles
from wbmpc.runtime.shared_memory import Mailbox
from wbmpc.simulation.lockstep import PREPARATION, Watch, watched
from wbmpc.view.braked_joints import BrakedJoints
from wbmpc.view.snapshot import NUMBERS, status_text
from wbmpc.view.user_commands import OBSTACLE, REQUESTS, Controls, UserCommands, no_requests

viser = pytest.importorskip("viser")
live = pytest.importorskip("wbmpc.view.live")
panels = pytest.importorskip("wbmpc.view.panel")


@pytest.fixture
def panel() -> Any:
    server = viser.ViserServer(host="127.0.0.1", port=free_port(), verbose=False)
    yield panels.Panel(
        server,
        Mailbox(REQUESTS),
        Controls("test", ("end_effector",), brakes=True, base=True, obstacle=True, configurations=("H", "X")),
    )
    server.stop()


def show(panel: Any, brakes: float = np.nan, obstacle: Any = (0.0,) * 8) -> None:
    nothing = {"numbers": np.zeros(len(NUMBERS)), "goal": np.full(7, np.nan), "base_goal": np.full(3, np.nan)}
    for _ in range(panels._EVERY):
        panel.show({**nothing, "brakes": np.array(brakes), "obstacle": np.asarray(obstacle)})


def click(panel: Any, value: bool) -> None:
    """As a browser does it: the box's value, then the callbacks with that browser as their client."""
    panel._brakes._impl.value = value
    for callback in panel._brakes._impl.update_cb:
        callback(SimpleNamespace(client=object(), target=panel._brakes))


def test_the_box_shows_how_the_brakes_are(panel: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever moved them; a click stays until the run had time to follow it; showing is no click."""
    clock = [100.0]
    monkeypatch.setattr(panels, "time", SimpleNamespace(monotonic=lambda: clock[0]))
    show(panel, 1.0)  # X was clicked: the run opens them
    assert panel._brakes.value is True
    show(panel, 0.0)  # they are there: it closes them
    assert panel._brakes.value is False and panel._values["brake_clicks"] == 0
    click(panel, True)
    assert (panel._values["brake_clicks"], panel._values["brakes_open"]) == (1, 1.0)
    show(panel, 0.0)
    assert panel._brakes.value is True
    clock[0] += 1.1  # the run has rejected
    show(panel, 0.0)
    assert panel._brakes.value is False and panel._values["brake_clicks"] == 1
    show(panel, np.nan)
    assert panel._brakes.value is False


def test_open_are_brakes_of_which_all_are() -> None:
    steering = UserCommands.__new__(UserCommands)
    for brakes, reported in (([1, 1, 1, 1], 1.0), ([0, 0, 0, 0], 0.0), ([1, 0, 1, 1], 0.0)):
        steering.braked = BrakedJoints.__new__(BrakedJoints)
        steering.braked._controller = SimpleNamespace(brakes=lambda t, b=brakes: np.array(b))  # type: ignore[assignment]
        assert steering.brakes_open(0.0) == reported
    steering.braked = None
    assert np.isnan(steering.brakes_open(0.0))


def test_a_goal_is_given_where_its_handle_is_moved(panel: Any) -> None:
    """Grasping it and letting go gives none; while it is held the run does not move it."""
    handle = panel._goal

    def drag(phase: str) -> None:
        for callback in handle._impl_aux.update_cb:
            asyncio.run(callback(SimpleNamespace(phase=phase, client=object(), target=handle)))

    drag("start")
    assert panel._dragged and panel._values["goals"] == 0
    handle.position = (1.0, 2.0, 3.0)
    drag("update")
    assert panel._values["goals"] == 1
    np.testing.assert_allclose(panel._values["goal"][:3], [1.0, 2.0, 3.0])
    drag("end")
    assert not panel._dragged and panel._values["goals"] == 1


def test_a_box_is_put_dragged_and_taken_away(panel: Any) -> None:
    """What the run gets: pose and edge, 0 without a box."""
    drawn = panel.server.scene._handle_from_node_name["/obstacle/cube"]
    buttons = {h.label: h for h in panel.server.gui._gui_input_handle_from_uuid.values() if hasattr(h, "label")}

    def press(label: str) -> None:
        for callback in buttons[label]._impl.update_cb:
            asyncio.run(callback(SimpleNamespace(client=object(), target=buttons[label])))

    press("Put there")
    assert panel._box.visible and panel._values["obstacles"] == 1
    np.testing.assert_allclose(panel._values["obstacle"], [*panels.AHEAD, 1.0, 0.0, 0.0, 0.0, 0.3])
    panel._box.position = (1.0, 2.0, 0.5)

    def move() -> None:
        for callback in panel._box._impl_aux.update_cb:
            asyncio.run(callback(SimpleNamespace(phase="update", client=object(), target=panel._box)))

    move()
    assert panel._values["obstacles"] == 2
    np.testing.assert_allclose(panel._values["obstacle"][:3], [1.0, 2.0, 0.5])
    edge = buttons["Edge [m]"]
    edge._impl.value = 0.8  # of another size it is drawn, and avoided, at once
    for callback in edge._impl.update_cb:
        asyncio.run(callback(SimpleNamespace(client=object(), target=edge)))
    assert panel._values["obstacles"] == 3 and panel._values["obstacle"][7] == 0.8
    assert tuple(drawn.dimensions) == (0.8,) * 3
    press("Take away")
    assert not panel._box.visible and panel._values["obstacles"] == 4 and not panel._values["obstacle"].any()
    move()
    assert panel._values["obstacles"] == 4 and not panel._values["obstacle"].any()  # it is not there


def test_a_box_that_is_not_done_goes_back_to_where_the_run_has_it(panel: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is drawn is what is avoided, once the run has had a second to answer; not while it is dragged."""
    drawn, box = panel.server.scene._handle_from_node_name["/obstacle/cube"], panel._box
    buttons = {h.label: h for h in panel.server.gui._gui_input_handle_from_uuid.values() if hasattr(h, "label")}
    now = [0.0]
    monkeypatch.setattr(panels.time, "monotonic", lambda: now[0])

    def press(label: str) -> None:
        for callback in buttons[label]._impl.update_cb:
            asyncio.run(callback(SimpleNamespace(client=object(), target=buttons[label])))

    def drag(phase: str, position: tuple[float, float, float]) -> None:
        box.position = position
        for callback in box._impl_aux.update_cb:
            asyncio.run(callback(SimpleNamespace(phase=phase, client=object(), target=box)))

    taken = np.array([1.5, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0, 0.3])
    press("Put there")
    show(panel)
    assert box.visible  # the run has not answered yet
    now[0] = 2.0
    show(panel, obstacle=taken)
    drag("start", (1.5, 0.0, 0.3)), drag("update", (40.0, 0.0, 0.3))
    now[0] = 5.0
    show(panel, obstacle=taken)
    assert tuple(box.position) == (40.0, 0.0, 0.3)
    drag("end", (40.0, 0.0, 0.3))
    show(panel, obstacle=taken)
    np.testing.assert_allclose([*box.position, *drawn.dimensions], [1.5, 0.0, 0.3, 0.3, 0.3, 0.3])
    drawn.dimensions, buttons["Edge [m]"].value = (0.8,) * 3, 0.8
    now[0] = 9.0
    show(panel, obstacle=taken)
    assert tuple(drawn.dimensions) == (0.3,) * 3 and box.visible and buttons["Edge [m]"].value == 0.3
    show(panel)  # another run has none
    assert not box.visible


def test_a_box_of_the_user_is_an_obstacle_of_the_plan() -> None:
    """It stands where the user sees it: the estimate drifts, and the plan's origin is 0.4 m above the floor. What cannot be meant changes
    nothing."""
    world, rejected = Obstacles(), []
    mpc = SimpleNamespace(obstacles=world, ocp=SimpleNamespace(terms={}), dynamics=SimpleNamespace(state={}, mode={}))
    running: Any = SimpleNamespace(mpc=mpc, controller=None)
    steering, requests = UserCommands(running, np.array([0.0, 0.0, 0.4]), rejected.append), no_requests()
    drift = np.array([0.5, -0.2, 0.0, *lie.quaternion_about((0, 0, 1), 0.3)])
    seen = np.array([2.0, 1.0, 0.3, *lie.quaternion_about((0, 0, 1), 0.7)])

    def ask(*values: float) -> None:
        requests["obstacles"] += 1
        requests["obstacle"][...] = values
        steering.apply(0.0, requests, drift)

    def check() -> None:
        (found,) = world.snapshot(0.0).obstacles
        place = np.concatenate([found.position + [0.0, 0.0, 0.4], found.orientation])
        np.testing.assert_allclose(lie.pose_compose(drift, place), seen, atol=1e-12)
        assert found.name == OBSTACLE and np.ptp(np.asarray(found.shape.half) - 0.1) == 0.0

    ask(*seen, 0.2)
    check()
    np.testing.assert_allclose(steering.obstacle(drift), [*seen, 0.2], atol=1e-12)
    wrong = ((np.nan, "finite"), (50.0, "at most 5 m"), (2.0, "0.05 to 2"), (2.0, "length 1"))
    for (x, why), (edge, w) in zip(wrong, ((0.2, 1.0), (0.2, 1.0), (9.0, 1.0), (0.2, 3.0)), strict=True):
        ask(x, 0.0, 0.3, w, 0.0, 0.0, 0.0, edge)
        assert why in rejected[-1]
        check()
        np.testing.assert_allclose(steering.obstacle(drift), [*seen, 0.2], atol=1e-12)
    steering.skip(requests)  # another run: the last order stands
    ask(*np.zeros(8))
    assert not len(world) and not steering.obstacle(drift).any()


def test_a_drive_before_the_run_says_how_the_legs_stand() -> None:
    """It has a robot with legs, and no MPC that moves them. Truth: the configuration in which this robot is at home."""
    robot, view = load_robot("swerve-ur10"), live.View("test", port=free_port())
    plant, still = SwervePlant(robot.description), SwerveCommand.stop()
    try:
        with watched(plant, 0.01, 0.4, Watch(None, (view,), PREPARATION), SimpleNamespace(robot=robot)) as tick:
            for k in range(40):
                tick(0.01 * k, still)
                plant.step(still, 20)
            controls = view._controls(None, robot, (), pushes=False)
            value = dict(zip(NUMBERS, view.shown.read().values["numbers"], strict=True))
        assert "configuration: X" in status_text(value, controls.configurations) and not controls.brakes
        assert view.process.is_alive()
    finally:
        view.close()
