"""The whole-body problem of robots on fixed wheels: weights that follow from the robot's size and limits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem, Reference, RelaxedBarrier, residuals, sets
from wbmpc.settings import MpcSettings, Settings, Weight

Array = NDArray[np.float64]
#: Half range [rad] of a joint that turns on and on; largest speed [rad/s] of one without a limit.
_TURNS, _FAST = np.pi, 2.0
#: Random postures of the arm whose spread is its reach.
_POSTURES = 400


class PlanarCost(Settings):
    """Weights per second, in units of the robot's size and limits.

    ``end_effector`` [1/m²]: position of the end effector, and of its orientation times (reach / 4)²; ``input``: of every input over its
    limit; ``posture``: of every arm joint over half its range; ``terminal`` [s]: factor of the end effector's weights at the end.
    """

    end_effector: Weight = 4000.0
    input: Weight = 0.4
    posture: Weight = 0.5
    terminal: Weight = 0.5


def reach(robot: RobotModel) -> float:
    """How far [m] the end effector gets from the middle of where it can be: 98 % of random postures."""
    arm = robot.state["arm"]
    low, high = robot.limits.state_lower[arm], robot.limits.state_upper[arm]
    low, high = np.where(np.isfinite(low), low, -_TURNS), np.where(np.isfinite(high), high, _TURNS)
    states = np.zeros((_POSTURES, robot.state.size))
    states[:, arm] = np.random.default_rng(0).uniform(low, high, (_POSTURES, low.size))
    at = robot.poses(states)[:, :3]
    return float(np.quantile(np.linalg.norm(at - at.mean(axis=0), axis=1), 0.98))


def planar_settings() -> MpcSettings:
    """Horizon and grid of :func:`planar_mpc`."""
    return MpcSettings(horizon=4.0, intervals=40, first_interval=0.02)


def planar_problem(
    robot: RobotModel, settings: MpcSettings | None = None, cost: PlanarCost | None = None
) -> OptimalControlProblem:
    """Pose of the end effector ("end_effector"), posture and inputs as costs; ranges, speeds and the wheels' rates as inequalities."""
    settings, cost = settings or planar_settings(), cost or PlanarCost()
    first = settings.first_interval or None
    ocp = OptimalControlProblem(robot.dynamics(), settings.horizon, settings.intervals, first_interval=first)
    limits, hard = robot.limits, settings.limits == "hard"
    effector = cost.end_effector * np.array([1.0] * 3 + [(reach(robot) / 4.0) ** 2] * 3)
    frame = residuals.FramePose(robot, robot.tool)
    ocp.add(
        Cost("end_effector", frame, list(effector), at="path+terminal", terminal_weight=list(cost.terminal * effector))
    )
    arm = robot.state["arm"]
    half = np.minimum(0.5 * (limits.state_upper[arm] - limits.state_lower[arm]), _TURNS)
    ocp.add(Cost("state", residuals.State(robot), {"base": 0.0, "arm": list(cost.posture / half**2)}))
    maximum = np.where(np.isfinite(limits.input_upper), limits.input_upper, _FAST)
    rates = {group: list(cost.input / maximum[robot.input[group]] ** 2) for group in robot.input.groups}
    ocp.add(Cost("input", residuals.Input(robot), rates))
    for constraint in robot.base.constraints(robot, hard=hard):
        ocp.add(constraint)
    barrier = RelaxedBarrier(settings.barrier_mu, 0.02)
    ranges = sets.Box(limits.state_lower, limits.state_upper)
    free_state = residuals.State(robot, reference=None)
    ocp.add(Constraint("positions", free_state, ranges, at="path+terminal", penalty=barrier, hard=hard))
    speeds = sets.Box(limits.input_lower, limits.input_upper)
    ocp.add(Constraint("speeds", residuals.Input(robot, reference=None), speeds, penalty=barrier, hard=hard))
    return ocp


def planar_mpc(robot: RobotModel, settings: MpcSettings | None = None, cost: PlanarCost | None = None) -> MPC:
    """The MPC of that problem with its real-time settings, whose goal is the robot's home."""
    settings = settings or planar_settings()
    mpc = MPC(planar_problem(robot, settings, cost), settings.solver(), settings.rate)
    position, orientation = robot.pose(robot.home)
    mpc.reference["end_effector"] = Reference.poses([0.0], [position], orientation)
    mpc.reference["state"] = Reference.constant(robot.home)
    mpc.reference["input"] = Reference.constant(np.zeros(robot.input.size))
    mpc.reset(robot.home)
    return mpc
