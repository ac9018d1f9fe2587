"""Plans by accelerations as controllers of speeds use them. Truth: integrals of constant accelerations, the robot's numeric stance."""

from __future__ import annotations

import numpy as np
import pytest

import wbmpc as wb
from planar_driving import write_robot
from wbmpc.default_problem import default_mpc, default_mpc_settings
from wbmpc.errors import InputError
from wbmpc.mpc.speed_commands import SpeedMPC, SpeedPolicy
from wbmpc.recording.observer import end_effector_goal
from wbmpc.settings import SupportMarginSettings
from wbmpc.stability import StanceOf

CORNERS = [((x, y), (0.0, 1.0, 0.0)) for x in (0.12, -0.12) for y in (0.2, -0.2)]
MARGIN = 0.05


@pytest.fixture(scope="module")
def upright(tmp_path_factory: pytest.TempPathFactory) -> tuple[wb.RobotModel, SpeedMPC]:
    """A short robot that keeps its zero-moment point 5 cm inside its wheels, and is asked to go half a meter aside at once."""
    path = write_robot(tmp_path_factory.mktemp("short"), CORNERS, {"type": "omnidirectional", "rollers": "mecanum"})
    robot = wb.load_robot(path)
    stability = SupportMarginSettings(margin=MARGIN)
    mpc = default_mpc(robot, default_mpc_settings(horizon=1.5, intervals=15), stability=stability)
    assert isinstance(mpc, SpeedMPC)
    position, turn = robot.pose(robot.home)
    mpc.reference["end_effector"] = wb.Reference.poses([0.0], [position + [0.5, 0.0, 0.0]], turn)
    return robot, mpc


def test_a_plan_gives_speeds_that_accelerations_integrate_to(upright: tuple[wb.RobotModel, SpeedMPC]) -> None:
    robot, mpc = upright
    mpc.reset(robot.home)
    policy = mpc.update(wb.Observation(0.0, robot.home))
    assert isinstance(policy, SpeedPolicy) and policy.x.shape[1] == robot.state.size
    assert policy.feedforward(0.0) == pytest.approx(np.zeros(robot.input.size), abs=1e-3)  # it begins at rest
    inner = mpc.solver.trajectory(0.0)
    base = robot.input["base"]
    for t in (0.01, 0.3, 1.1):
        k = int(np.searchsorted(policy.times, t)) - 1
        whole = np.diff(policy.times)[:k] @ inner.u[:k, base] + (t - policy.times[k]) * inner.u[k, base]
        assert policy.feedforward(t)[base] == pytest.approx(whole, abs=1e-6)
    assert policy(0.3, robot.home) == pytest.approx(policy.feedforward(0.3))


def test_the_next_plan_begins_with_the_speeds_that_are_planned(upright: tuple[wb.RobotModel, SpeedMPC]) -> None:
    robot, mpc = upright
    mpc.reset(robot.home)
    first = mpc.update(wb.Observation(0.0, robot.home))
    assert np.abs(first.feedforward(0.1)).max() > 0.05
    second = mpc.update(wb.Observation(0.1, first.state(0.1)))
    assert second.feedforward(0.1) == pytest.approx(first.feedforward(0.1), abs=1e-6)
    late = mpc.update(wb.Observation(60.0, robot.home))  # no plan is in force any more: the robot rests
    assert late.feedforward(60.0) == pytest.approx(np.zeros(robot.input.size), abs=1e-3)


def test_plans_keep_the_margin_which_others_do_not(upright: tuple[wb.RobotModel, SpeedMPC]) -> None:
    robot, mpc = upright
    mpc.reset(robot.home)
    policy = mpc.update(wb.Observation(0.0, robot.home))
    stance = StanceOf(robot)
    stances = [stance(policy.x[k], u=policy.u[k], u_rate=policy.slope[k]) for k in range(len(policy.u))]
    margins = np.array([s.polygon_margin for s in stances])
    assert margins[1:].min() == pytest.approx(MARGIN, abs=2e-3)  # it is the limit of how fast the robot starts
    assert stance(robot.home).polygon_margin > 1.5 * MARGIN


def test_speeds_are_held_in_simulation(upright: tuple[wb.RobotModel, SpeedMPC]) -> None:
    """Truth: the plain MPC of the same robot."""
    robot, mpc = upright
    plain, u = (
        default_mpc(robot, default_mpc_settings(horizon=1.5, intervals=15)),
        np.linspace(0.1, 0.4, robot.input.size),
    )
    for given in (u, np.array([u, -2.0 * u])):
        assert mpc.simulate(robot.home, given, 0.05) == pytest.approx(plain.simulate(robot.home, given, 0.05), abs=1e-9)
    with pytest.raises(InputError, match="inputs are needed"):
        mpc.simulate(robot.home, u[1:], 0.05)
    for x, step in ((0.0, 0.05), (robot.home[1:], 0.05), (np.nan * robot.home, 0.05), (robot.home, None)):
        with pytest.raises(InputError, match="simulate"):
            mpc.simulate(x, u, step)


def test_a_base_goes_along_a_path_as_fast_as_its_margin_allows(upright: tuple[wb.RobotModel, SpeedMPC]) -> None:
    """Truth: the distance to the path, and the stance at the speeds and accelerations of every plan."""
    robot, _ = upright
    body, stance, margin = robot.description.base.body, StanceOf(robot), 0.065
    start = robot.pose(robot.home, body)[0]
    stability = SupportMarginSettings(margin=margin)
    mpc = default_mpc(robot, default_mpc_settings(horizon=1.5, intervals=15), stability=stability, progress=body)
    assert (
        mpc.path.frame == body and end_effector_goal(mpc, 0.0, np.zeros(3)) is None
    )  # the path is not the end effector's
    mpc.path.follow(wb.Path.line(start, start + [1.0, 0.0, 0.0]), speed=1.0, acceleration=8.0)
    x, margins, places = robot.home, [], []
    mpc.reset(x)
    for k in range(100):
        policy = mpc.update(wb.Observation(0.02 * k, x))
        assert isinstance(policy, SpeedPolicy)
        assert (policy.x.shape[1], policy.u.shape[1]) == (robot.state.size, robot.input.size)
        margins.append(stance(policy.x[1], u=policy.u[1], u_rate=policy.slope[1]).polygon_margin)
        x = policy.state(0.02 * (k + 1))
        places.append(robot.pose(x, body)[0] - start)
    way = np.array(places)
    assert min(margins) == pytest.approx(margin, abs=3e-3)  # it is the limit of how fast the robot starts and stops
    assert np.abs(way[:, 1:]).max() < 2e-3  # it stays on the path
    assert way[-1, 0] == pytest.approx(1.0, abs=0.02)  # and gets there
    plain, u = upright[1], np.linspace(0.1, 0.4, robot.input.size)  # the path is no part of what is simulated
    assert mpc.simulate(x, u, 0.05) == pytest.approx(plain.simulate(x, u, 0.05), abs=1e-9)


def test_other_problems_are_rejected(upright: tuple[wb.RobotModel, SpeedMPC]) -> None:
    robot, _ = upright
    with pytest.raises(InputError, match="accelerations as inputs"):
        SpeedMPC(wb.OptimalControlProblem(robot.dynamics(), 1.0, 4))
