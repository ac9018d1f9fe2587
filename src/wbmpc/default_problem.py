"""The whole-body problem of any robot whose inputs are speeds: weights that follow from the robot's size and limits, without tuning."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.obstacles.pairs import arm_pairs
from wbmpc.obstacles.world import Obstacles
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem, Reference, RelaxedBarrier, residuals, sets
from wbmpc.ocp.scaling import scaled_weights
from wbmpc.settings import MpcSettings, Settings, Weight

Array = NDArray[np.float64]
#: Of clearance rows [1/m, per second]: more than what costs of the end effector pull with when it is a metre from where it should be.
CLEARANCE_SLACK = 3e4
#: Of the accelerations, for plans among obstacles: wheels of a base are limited together, and feedback needs some.
ACCELERATION_SHARE = 0.6


class DefaultCost(Settings):
    """Weights per second, in units of the robot's size and limits.

    ``end_effector`` [1/m²]: position of the end effector, and of its orientation times (reach / 4)²; ``input``: of every input over its
    limit; ``posture``: of every arm joint over half its range; ``terminal`` [s]: factor of the end effector's weights at the end.
    """

    end_effector: Weight = 4000.0
    input: Weight = 0.4
    posture: Weight = 0.5
    terminal: Weight = 0.5


def default_settings(**changes: Any) -> MpcSettings:
    """Settings of :func:`default_mpc`; ``changes`` of them by name."""
    return MpcSettings(**{"horizon": 4.0, "intervals": 40, "first_interval": 0.02, **changes})


def default_problem(
    robot: RobotModel, settings: MpcSettings | None = None, cost: DefaultCost | None = None
) -> OptimalControlProblem:
    """Pose of the end effector ("end_effector"), posture and inputs as costs; ranges, speeds and the wheels' rates as inequalities."""
    settings, cost = settings or default_settings(), cost or DefaultCost()
    first = settings.first_interval or None
    ocp = OptimalControlProblem(robot.dynamics(), settings.horizon, settings.intervals, first_interval=first)
    limits, hard = robot.limits, settings.limits == "hard"
    weights = scaled_weights(robot, cost.end_effector, cost.input, cost.posture)
    effector = weights.end_effector
    frame = residuals.FramePose(robot, robot.tool)
    ocp.add(
        Cost("end_effector", frame, list(effector), at="path+terminal", terminal_weight=list(cost.terminal * effector))
    )
    posture = {group: list(weights.posture) if group == "arm" else 0.0 for group in robot.state.groups}
    ocp.add(Cost("state", residuals.State(robot), posture))
    ocp.add(Cost("input", residuals.Input(robot), weights.input))
    for constraint in robot.base.constraints(robot, hard=hard):
        ocp.add(constraint)
    barrier = RelaxedBarrier(settings.barrier_mu, 0.02)
    ranges = sets.Box(limits.state_lower, limits.state_upper)
    free_state = residuals.State(robot, reference=None)
    ocp.add(Constraint("positions", free_state, ranges, at="path+terminal", penalty=barrier, hard=hard))
    speeds = sets.Box(limits.input_lower, limits.input_upper)
    ocp.add(Constraint("speeds", residuals.Input(robot, reference=None), speeds, penalty=barrier, hard=hard))
    return ocp


def keep_clear(
    ocp: OptimalControlProblem, robot: RobotModel, obstacles: Obstacles | None, slack: float = CLEARANCE_SLACK
) -> OptimalControlProblem:
    """The problem with hard rows that keep the whole robot clear of ``obstacles`` (None: as it is) and its arm clear of itself, and
    accelerations within their limits: who evades folds the arm, and must be able to at the last moment."""
    if obstacles is None:
        return ocp
    free = sets.NonNegative()
    rows = Constraint("clearance", residuals.Clearance(robot), free, at="path+terminal", hard=True, slack=slack)
    ocp.add(rows)
    pairs = arm_pairs(robot)
    if pairs:
        own = residuals.SelfClearance(robot, pairs)
        ocp.add(Constraint("self_clearance", own, free, at="path+terminal", hard=True, slack=slack))
    rates = robot.limits.input_rate
    limited = [g for g in robot.input.groups if np.isfinite(rates[robot.input[g]]).all()]
    if limited and "accelerations" not in ocp.terms:
        ocp.add(
            Constraint(
                "accelerations", residuals.AccelerationLimit(robot, limited, ACCELERATION_SHARE), free, hard=True
            )
        )
    return ocp


def default_mpc(
    robot: RobotModel, settings: MpcSettings | None = None, cost: DefaultCost | None = None,
    obstacles: Obstacles | None = None,
) -> MPC:  # fmt: skip
    """The MPC of that problem with its real-time settings, whose goal is the robot's home; it keeps clear of ``obstacles``."""
    settings = settings or default_settings()
    ocp = keep_clear(default_problem(robot, settings, cost), robot, obstacles)
    mpc = MPC(ocp, settings.solver(), settings.rate, obstacles=obstacles)
    stay_at_home(robot, mpc)
    return mpc


def stay_at_home(robot: RobotModel, mpc: MPC) -> None:
    """Begin at home, with references of end effector, state and input that rest there."""
    position, orientation = robot.pose(robot.home)
    mpc.reference["end_effector"] = Reference.poses([0.0], [position], orientation)
    mpc.reference["state"] = Reference.constant(robot.home)
    mpc.reference["input"] = Reference.constant(np.zeros(robot.input.size))
    mpc.reset(robot.home)
