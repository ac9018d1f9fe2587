"""The whole-body problem of the swerve robots: one set of weights for all their experiments."""

from __future__ import annotations

from typing import Any

import numpy as np

from wbmpc.bases.swerve.model import swerve_base
from wbmpc.default_problem import (
    ACCELERATION_SLACK,
    keep_apart,
    keep_clear,
    keep_off_floor,
    keep_standing,
    keep_upright,
    make_mpc,
)
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.guess import Guess
from wbmpc.mpc.mpc import MPC
from wbmpc.obstacles.world import Obstacles
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem, RelaxedBarrier, path_problem, residuals, sets
from wbmpc.settings import MpcSettings, Settings, StabilitySettings, Weight

#: Of the rolling rows in a receding horizon. The planned steering angles that a plan is shifted to are consistent up to the
#: integration error of an interval only, and rows of four wheels that nearly depend on each other can then be met exactly
#: by absurd motions only. On uniform grids (0.1 and 0.2 s) 0 fails, 1e-9 to 1e-4 do not; the plan slips by 1e-6 m/s at most.
ROLLING_SOFTNESS = 1e-6


class EndEffectorCost(Settings):
    """Weights of the end effector, per second. ``weight`` [1/m²]: weight of the position; ``orientation`` [1/rad²]: weight of the orientation."""

    weight: Weight = 1000.0
    orientation: Weight = 200.0


class StateCost(Settings):
    """Weights per second. ``position``: weight of the base's position; ``yaw``: weight of the base's heading; ``leg``: weight of leg
    angles; ``steer``: weight of steering angles; ``arm``: weight of the arm's posture."""

    position: Weight = 1.0
    yaw: Weight = 5.0
    leg: Weight = 1.0
    steer: Weight = 0.0
    arm: Weight = 0.05


class InputCost(Settings):
    """Weights per second. ``base``: weight of the twist (against the reference); ``leg``: weight of leg rates; ``steer``: weight of
    steering rates; ``wheel``: weight of wheel rates; ``arm``: weight of joint speeds."""

    base: Weight = 0.5
    leg: Weight = 1.0
    steer: Weight = 0.05
    wheel: Weight = 0.001
    arm: Weight = 0.1


class SwerveCost(Settings):
    """All weights; ``terminal``: seconds by which the state's weights are multiplied at the end of the horizon."""

    end_effector: EndEffectorCost = EndEffectorCost()
    state: StateCost = StateCost()
    input: InputCost = InputCost()
    terminal: Weight = 10.0


def swerve_problem(
    robot: RobotModel, settings: MpcSettings, cost: SwerveCost, side_softness: float = 0.0, *,
    accelerations: bool = False, allow_side_slip: bool = False,
) -> OptimalControlProblem:  # fmt: skip
    """End effector pose, base pose, posture and twist as costs; rolling and brakes as equalities; limits as inequalities.

    ``accelerations``: those of the robot's description too, from the last command on (which an MPC knows); ``allow_side_slip``: the
    reference "rolling" lets wheels slip sideways while they turn about.
    """
    first = settings.first_interval or None
    ocp = OptimalControlProblem(robot.dynamics(), settings.horizon, settings.intervals, first_interval=first)
    end_effector = np.array([cost.end_effector.weight] * 3 + [cost.end_effector.orientation] * 3)
    s, i = cost.state, cost.input
    state = residuals.State(robot)
    posture: dict[str, Any] = {"base": [s.position, s.position, s.yaw], "leg": s.leg, "steer": s.steer, "arm": s.arm}
    posture = {g: v for g, v in posture.items() if g in robot.state}
    rates = {"base": i.base, "leg": i.leg, "steer": i.steer, "wheel": i.wheel, "arm": i.arm}
    rates = {g: v for g, v in rates.items() if g in robot.input}
    end = {g: list(cost.terminal * np.atleast_1d(v)) if g == "base" else cost.terminal * v for g, v in posture.items()}
    frame = residuals.FramePose(robot, robot.tool)
    ocp.add(
        Cost(
            "end_effector", frame, list(end_effector), at="path+terminal",
            terminal_weight=list(cost.terminal * end_effector),
        )
    )  # fmt: skip
    ocp.add(Cost("state", state, posture, at="path+terminal", terminal_weight=end))
    ocp.add(Cost("input", residuals.Input(robot), rates))
    for constraint in swerve_base(robot).constraints(robot, side_softness, allow_side_slip=allow_side_slip):
        ocp.add(constraint)
    barrier, hard = RelaxedBarrier(settings.barrier_mu, 0.02), settings.limits == "hard"
    limits = robot.limits
    free_state = residuals.State(robot, reference=None)
    box = sets.Box(limits.state_lower, limits.state_upper)
    ocp.add(Constraint("positions", free_state, box, at="path+terminal", penalty=barrier, hard=hard))
    limited = [g for g in robot.input.groups if accelerations and np.isfinite(limits.input_rate[robot.input[g]]).all()]
    free_input = residuals.Input(robot, reference=None)
    box = sets.Box(limits.input_lower, limits.input_upper)
    ocp.add(Constraint("speeds", free_input, box, penalty=barrier, hard=hard))
    if limited:  # with a slack, unlike speeds: a brake that closes under a moving leg stops wheels harder than they may
        reachable = residuals.AccelerationLimit(robot, limited)
        free, slack = sets.NonNegative(), ACCELERATION_SLACK
        ocp.add(Constraint("accelerations", reachable, free, penalty=barrier, hard=hard, slack=slack))
    return ocp


def swerve_mpc(
    robot: RobotModel, settings: MpcSettings, cost: SwerveCost, guess: Guess | None = None, *,
    allow_side_slip: bool = False, obstacles: Obstacles | None = None, stability: StabilitySettings | None = None,
    progress: str | None = None, guarded: bool = False,
) -> MPC:  # fmt: skip
    """The MPC of that problem with its real-time settings, which keeps clear of ``obstacles``, and upright by ``stability``; ``progress``:
    the frame that follows a path, see :func:`wbmpc.path_problem`; ``guarded``: whether it keeps apart the pairs that the robot file
    lists, and the robot upright without ``stability`` too (:func:`wbmpc.default_problem.keep_standing`)."""
    ocp = swerve_problem(robot, settings, cost, ROLLING_SOFTNESS, accelerations=True, allow_side_slip=allow_side_slip)
    ocp = keep_apart(ocp, robot) if guarded else ocp
    if stability is not None:  # arms that are counterweights swing down to the floor
        ocp = keep_upright(keep_off_floor(ocp, robot), robot, stability)
    elif guarded and not swerve_base(robot).geometry.legs_move:  # other legs, other distances
        ocp = keep_standing(ocp, robot)
    ocp = keep_clear(path_problem(ocp, frame=progress) if progress else ocp, robot, obstacles)
    return make_mpc(ocp, settings, stability, guess=guess, obstacles=obstacles)
