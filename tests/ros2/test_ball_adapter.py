"""The ball robot's adapter without a bus. Truth: forward kinematics, clocks that a test sets, limits of the settings."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from needs import needs_dds

from wbmpc.bases.ball.posture import EVALUATIONS, resting
from wbmpc.bases.ball.ros import POSTURES, BallMessage, BallRosAdapter, bodies
from wbmpc.bases.ball.ros_settings import BallRosSettings
from wbmpc.errors import FallPredicted, InputError
from wbmpc.model.robot import load_robot
from wbmpc.ros2.clock import BusClock
from wbmpc.ros2.control import ControlNode
from wbmpc.ros2.convert import stamp
from wbmpc.ros2.goals import EndEffectorTrack, Planner
from wbmpc.ros2.joints import Inertial, Series
from wbmpc.ros2.robot import BusRobot
from wbmpc.ros2.settings import Speeds, Topics
from wbmpc.runtime.clock import WallClock

pytestmark = needs_dds
ROBOT = load_robot("rezero")


@pytest.fixture(scope="module")
def adapter() -> Any:
    """Making one takes seconds."""
    return BallRosAdapter(ROBOT, BallRosSettings(), 1.0 / 400.0)


@pytest.mark.parametrize("simulated", [True, False])
def test_time_that_goes_back_is_another_clocks(adapter: Any, simulated: bool) -> None:
    """A simulator that was restarted has the robot at its beginning again, its arm where the encoders say; with a clock that was
    set the robot is where it was. In both cases it is upright, and at the message's time."""
    adapter.settings = BallRosSettings(use_sim_time=simulated)
    arm, wheel, still = ROBOT.home[ROBOT.state["arm"]], np.zeros(3), (np.zeros(3), np.array([0.0, 0.0, 9.81]))
    x = ROBOT.home.copy()
    x[:3] = 0.5, -0.2, 0.3
    adapter.begin(x)
    for t in (17.0, 17.0025):
        adapter.controller.follow(BallMessage(t, t, wheel, arm, *still))
    adapter.stand(BallMessage(17.005, 17.005, wheel, arm, *still))
    t, previous = adapter.snapshot()
    assert t == pytest.approx(17.005) and previous[:3] == pytest.approx(x[:3], abs=1e-3)
    for t in (1.0, 1.0025):
        adapter.stand(BallMessage(t, t, wheel, arm + 0.1, *still))
        found = adapter.snapshot()
        assert found[0] == pytest.approx(t)
        np.testing.assert_allclose(found[1][ROBOT.state["arm"]], arm + 0.1, atol=1e-9)
        np.testing.assert_allclose(found[1][:3], np.zeros(3) if simulated else previous[:3], atol=1e-9)
        np.testing.assert_allclose(
            found[1], [*found[1][:3], *ROBOT.base.numeric.equilibrium(arm + 0.1)[0][3:]], atol=1e-9
        )


def test_encoders_of_another_series_roll_no_ball(adapter: Any) -> None:
    """After a run, later on the same clock: it stands upright where it was, whatever its wheels say."""
    adapter.settings = BallRosSettings()
    arm, still = ROBOT.home[ROBOT.state["arm"]], (np.zeros(3), np.array([0.0, 0.0, 9.81]))
    x = ROBOT.home.copy()
    x[:3] = 0.5, -0.2, 0.3
    adapter.begin(x)
    for t in (17.0, 17.0025):
        adapter.controller.follow(BallMessage(t, t, np.zeros(3), arm, *still))
    previous = adapter.snapshot()[1]
    for t in (21.0, 21.0025):
        adapter.stand(BallMessage(t, t, np.array([30.0, 20.0, -9.0]), arm, *still, series=Series(1)))
        t_found, found = adapter.snapshot()
        assert t_found == pytest.approx(t)
        np.testing.assert_allclose(found[:5], [*previous[:3], *ROBOT.base.numeric.equilibrium(arm)[0][3:5]], atol=1e-9)


def test_the_bodys_posture_moves_no_hand() -> None:
    """Forward kinematics of the body's references is where the end effector is led, at rest: on a way, at steps and when it is carried."""
    planner, x = Planner(ROBOT, Speeds()), ROBOT.base.numeric.equilibrium(ROBOT.home[ROBOT.state["arm"]])[0]
    position, turned = ROBOT.pose(x)
    goal = position + [0.3, 0.1, 0.08]
    way = planner.to_end_effector(x, 1.0, goal, turned)
    body = bodies(way, ROBOT, x)
    assert body.times[0] == 1.0 and body.times[-1] == way.end_effector.times[-1] and body.times.size == POSTURES
    for t in body.times:
        at = np.array([np.interp(t, way.end_effector.times, c) for c in way.end_effector.positions.T])
        np.testing.assert_allclose(ROBOT.pose(body.at(t))[0], at, atol=2e-3)
    steps = EndEffectorTrack(
        np.array([0.0, 2.0, 2.001, 4.0]), np.array([position, position, goal, goal]), np.tile(turned, (4, 1))
    )
    body = bodies(planner.along_end_effector_path(x, 0.0, steps, None), ROBOT, x)
    for t, where in ((0.5, position), (1.99, position), (2.01, goal), (3.9, goal)):
        np.testing.assert_allclose(ROBOT.pose(body.at(t))[0], where, atol=2e-3)
    folded = x.copy()
    folded[ROBOT.state["arm"]] += [0.2, -0.3, 0.1]
    carried = bodies(planner.to_base(folded, 0.0, np.array([1.0, 0.0, 0.5])), ROBOT, folded)
    assert np.all(carried.values[:, ROBOT.state["arm"]] == folded[ROBOT.state["arm"]])
    np.testing.assert_allclose(carried.values[-1, :3], [1.0, 0.0, 0.5], atol=1e-9)


def test_what_it_needs(adapter: Any) -> None:
    node: Any = SimpleNamespace(subscribe=lambda *given, **also: None)
    with pytest.raises(InputError, match="needs an inertial unit"):
        BusRobot(node, adapter, BallRosSettings(topics=Topics(imu="")), WallClock())
    assert BallRosSettings().command_topics(ROBOT)["wheel_controller"].joints == ("wheel_0", "wheel_1", "wheel_2")


@pytest.mark.parametrize("other", [(-0.5,), (1000.0, 0.0)])
def test_a_driver_whose_clock_was_set_back_is_not_late(
    adapter: Any, other: tuple[float, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the wall clock a measurement of a robot at rest is as old as it was, half a second off and after a single message from
    the future too; every goal ended in a stop, for its states were taken as old."""
    now, heard = [100.0], dict[str, Any]()
    monkeypatch.setattr("wbmpc.ros2.robot.time", SimpleNamespace(perf_counter=lambda: now[0]))
    node: Any = SimpleNamespace(
        subscribe=lambda topic, kind, take, *_, **__: heard.update({topic: take}), publisher=lambda *_, **__: None
    )
    settings = BallRosSettings()
    clock: Any = SimpleNamespace(now=lambda: now[0], origin=0.0)
    body = BusRobot(node, adapter, settings, clock)
    names, values, point = body._reader.names, np.zeros(len(body._reader.names)), SimpleNamespace(x=0.0, y=0.0, z=9.81)

    def ages(off: float) -> list[float]:
        now[0] += 0.0025
        sec, nanosec = divmod(round(1e9 * (1e6 + now[0] + off)), 10**9)
        at = SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=nanosec))
        heard["/imu"](SimpleNamespace(header=at, angular_velocity=point, linear_acceleration=point))
        heard["/joint_states"](SimpleNamespace(header=at, name=names, position=values))
        return [m.now - m.time for m in body.unread()]

    for off in (0.0, *other, other[-1]):
        found = ages(off)  # none of the first message whose time went back
    assert found == pytest.approx([settings.state_age], abs=1e-4)


def test_joint_states_that_come_late_let_no_robot_go_and_hold_one_that_balances(adapter: Any) -> None:
    """By /clock: 50 ms after their stamps for 0.3 s, then in time."""
    heard, held, clock = dict[str, Any](), list[str](), BusClock()
    node: Any = SimpleNamespace(
        subscribe=lambda topic, kind, take, *_, **__: heard.update({topic: take}), publisher=lambda *_, **__: None
    )
    body = BusRobot(node, adapter, BallRosSettings(use_sim_time=True), clock)
    body._inertial.put(1.0, Inertial(np.zeros(3), np.zeros(3)))
    control: Any = SimpleNamespace(
        _other_publisher="", settings=body.settings, adapter=adapter, robot_io=body, running=True, _hold_reason="",
        source=SimpleNamespace(source=SimpleNamespace(settle=lambda: "")), obstacles=SimpleNamespace(lost=lambda: ""),
        _stop_or_hold=held.append,
    )  # fmt: skip
    names, values = body._reader.names, np.zeros(len(body._reader.names))
    for late, says in ((0.0, ""), (0.05, "come more than 0.03 s after their stamps"), (0.0, "")):
        for _ in range(30):
            clock.set(clock.stamp() + 0.01)
            at = SimpleNamespace(stamp=SimpleNamespace(**stamp(clock.stamp() - late)))
            if clock.stamp() - late > 0.0:
                heard["/joint_states"](SimpleNamespace(header=at, name=names, position=values))
        assert says in body.waiting_reason() and bool(says) == bool(body.waiting_reason())
        held.clear()
        ControlNode._check_other_publishers(control)
        assert held == [body.lateness.fault] * bool(says)


def test_readings_of_a_gyro_say_nothing_of_the_time_after_them(adapter: Any) -> None:
    """Joint states that are stamped 0.05 s ahead would turn the odometry for so long; by the wall's clock their arrival counts."""
    node: Any = SimpleNamespace(subscribe=lambda *given, **also: None, publisher=lambda *given, **also: None)
    for clock, covered in ((BusClock(), False), (WallClock(), True)):
        body = BusRobot(node, adapter, BallRosSettings(use_sim_time=True), clock)
        for stamp_of_joints, readings, known in (
            (1.0, (0.98, 0.99), True),
            (1.05, (1.0, 1.01), covered),
            (1.02, (1.02,), True),
        ):
            for at in readings:
                body._inertial.put(at, Inertial(np.ones(3), np.zeros(3)))
            found = body._inertial.averaged(stamp_of_joints)
            assert found is not None and (found.turning is not None) == known


def test_a_robot_that_has_fallen_gets_no_more_torques(adapter: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The run ends with what has happened, not with numbers of a model that has no answer there. By hand: acos(cos 0.5 cos 0.55)
    is 42°, acos(cos² 0.49) 39°."""
    arm, still = ROBOT.home[ROBOT.state["arm"]], (np.zeros(3), np.array([0.0, 0.0, 9.81]))
    adapter.begin(ROBOT.home)
    controller, x = adapter.controller, ROBOT.home.copy()
    monkeypatch.setattr(controller.estimator, "update", lambda *given: x)
    x[3:5] = 0.49
    controller.measure(BallMessage(1.0, 1.0, np.zeros(3), arm, *still))
    x[3:5] = 0.5, -0.55
    with pytest.raises(FallPredicted, match="the robot fell, it leans by 42 degrees; motors off"):
        controller.measure(BallMessage(1.0025, 1.0025, np.zeros(3), arm, *still))
    x[3] = np.nan
    with pytest.raises(FallPredicted, match="the robot fell"):
        controller.measure(BallMessage(1.005, 1.005, np.zeros(3), arm, *still))


def test_a_pose_far_out_of_reach_takes_no_longer_than_a_few_within(monkeypatch: pytest.MonkeyPatch) -> None:
    """On the floor, under the body: what is nearest is balanced, and found with as many evaluations as are allowed."""
    solve, count = ROBOT.base.numeric.equilibrium, []

    def counted(*given: Any, **more: Any) -> Any:
        count.append(1)
        return solve(*given, **more)

    monkeypatch.setattr(ROBOT.base.numeric, "equilibrium", counted)
    x = resting(ROBOT, np.array([0.0, 0.0, -0.12]), np.array([1.0, 0.0, 0.0, 0.0]))
    variables = 3 + len(ROBOT.state.groups["arm"])
    assert len(count) <= EVALUATIONS * (variables + 1) + 1
    monkeypatch.undo()
    np.testing.assert_allclose(x[3:5], solve(x[ROBOT.state["arm"]], yaw=float(x[2]))[0][3:5], atol=1e-9)
