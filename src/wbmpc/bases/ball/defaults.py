"""The whole-body problem of the ball robot: one set of weights for end effector tasks."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field

from wbmpc.bases.ball import residuals as ball_residuals
from wbmpc.bases.ball.balance import Balance
from wbmpc.default_problem import keep_apart, keep_clear
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.obstacles.world import Obstacles
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem, Reference, RelaxedBarrier, SmoothL1, residuals, sets
from wbmpc.settings import MpcSettings, Positive, Settings, Weight


class PoseCost(Settings):
    """Weights of the end effector. ``weight`` [1/m²]: weight of the position; ``orientation`` [1/rad²]: weight of the orientation about
    the x and y axes of the end effector; ``roll`` [1/rad²]: weight of the rotation about the forearm, which the arm cannot control at
    rest."""

    weight: Weight = 300.0
    orientation: Weight = 60.0
    roll: Weight = 3.0


class MotionCost(PoseCost):
    """``twist`` [s²/m²]: weight of the linear velocity; ``angular`` [s²/rad²]: weight of the angular velocity."""

    twist: Weight = 1.0
    angular: Weight = 0.2


class ApproachCost(MotionCost):
    """``limit`` [m]: larger position errors pull no harder (SmoothL1), so that a sudden goal does not ask for more than the wheels'
    torque."""

    limit: Positive = 0.1


class EndEffectorCost(ApproachCost):
    """``turn_limit`` [rad]: larger errors of the orientation pull no harder."""

    turn_limit: Positive = 0.1


class PostureCost(Settings):
    """Weights per second. ``yaw``: weight of the heading; ``yaw_rate``: weight of the heading's rate; ``arm``: weight of the arm's posture
    (against home)."""

    yaw: Weight = 1.0
    yaw_rate: Weight = 0.5
    arm: Weight = 0.0


class BodyCost(PostureCost):
    """``ball``: weight of the ball's position; ``ball_speed``: weight of the ball's speed; ``tilt_rate``: weight of the lean's rate;
    ``arm_rate``: weight of the arm's joint speeds."""

    ball: Weight = 0.0
    ball_speed: Weight = 1.0
    tilt_rate: Weight = 2.0
    arm_rate: Weight = 0.2


class TorqueCost(Settings):
    """Weights. ``wheel``: weight of the wheels' torques; ``arm``: weight of arm torques beyond what holds the arm where it is."""

    wheel: Weight = 0.05
    arm: Weight = 0.005


class TaskCost(Settings):
    """All weights. ``terminal`` [s]: the end of the horizon counts like so long of it. ``lean``: a hard limit of the lean's
    divergent component, as a share of what the wheels can stop (:class:`wbmpc.bases.ball.balance.Balance`); 0: none."""

    end_effector: ApproachCost = ApproachCost()
    body: BodyCost = BodyCost()
    torque: TorqueCost = TorqueCost()
    terminal: Weight = 1.0
    lean: float = Field(default=0.0, ge=0, le=1.0)


class MpcCost(TaskCost):
    """Of an end effector that may be sent to other orientations at once."""

    end_effector: EndEffectorCost = EndEffectorCost()


class RezeroCost(MpcCost):
    """``speed_slack``: penalty of arm speeds beyond their limit, where that cannot be held [per range and second]."""

    speed_slack: Positive = 1e3


def rezero_problem(robot: RobotModel, settings: MpcSettings, cost: RezeroCost) -> OptimalControlProblem:
    """End effector pose and twist, ball, yaw, rates and torques as costs (Minniti et al. 2019, section III-B); limits."""
    first = settings.first_interval or None
    ocp = OptimalControlProblem(robot.dynamics(), settings.horizon, settings.intervals, first_interval=first)
    h, b, t = cost.end_effector, cost.body, cost.torque
    pose = np.array([h.weight] * 3 + [h.orientation, h.orientation, h.roll])
    twist = np.array([h.twist] * 3 + [h.angular] * 3)
    speeds = [b.ball_speed, b.ball_speed, b.yaw_rate, b.tilt_rate, b.tilt_rate]
    body: dict[str, Any] = {
        "base": [b.ball, b.ball, b.yaw, 0.0, 0.0], "base_velocity": speeds, "arm": b.arm, "arm_velocity": b.arm_rate,
    }  # fmt: skip
    end: dict[str, Any] = {
        g: [cost.terminal * w for w in v] if isinstance(v, list) else cost.terminal * v for g, v in body.items()
    }
    ocp.add(
        Cost(
            "end_effector", residuals.FramePose(robot, robot.tool, axes="reference"), list(pose),
            norm=SmoothL1((h.limit,) * 3 + (h.turn_limit,) * 3), at="path+terminal",
            terminal_weight=list(cost.terminal * pose),
        )
    )  # fmt: skip
    frame_twist = residuals.FrameTwist(robot, robot.tool)
    ocp.add(Cost("twist", frame_twist, list(twist), at="path+terminal", terminal_weight=list(cost.terminal * twist)))
    ocp.add(Cost("body", residuals.State(robot), body, at="path+terminal", terminal_weight=end))
    inputs = {"wheel": t.wheel, "arm": 0.0, "force": 1.0, "moment": 1.0}
    ocp.add(Cost("torque", residuals.Input(robot), {g: inputs[g.split("_")[0]] for g in robot.input.groups}))
    ocp.add(Cost("effort", ball_residuals.JointEffort(robot), t.arm))
    limit_arm(ocp, robot, settings, cost.speed_slack)
    limit_torques(ocp, robot, settings, cost.lean, None)
    return ocp


def limit_arm(ocp: OptimalControlProblem, robot: RobotModel, settings: MpcSettings, slack: float) -> None:
    """Hard limits of the arm's angles and speeds; ``slack`` of the speeds, as of a :class:`RezeroCost`."""
    limits = robot.limits
    box = lambda g: sets.Box(limits.state_lower[robot.state[g]], limits.state_upper[robot.state[g]])
    free_state = residuals.State(robot, ["arm"], reference=None)
    rates = residuals.State(robot, ["arm_velocity"], reference=None)
    barrier, hard = RelaxedBarrier(settings.barrier_mu, 0.02), settings.limits == "hard"
    ocp.add(Constraint("ranges", free_state, box("arm"), at="path+terminal", penalty=barrier, hard=hard))
    ocp.add(
        Constraint("speeds", rates, box("arm_velocity"), at="path+terminal", penalty=barrier, hard=hard, slack=slack)
    )


def limit_torques(
    ocp: OptimalControlProblem, robot: RobotModel, settings: MpcSettings, lean_share: float, groups: list[str] | None
) -> None:
    """Hard limits of the torques (``groups`` of the input; all), of the spin of the ball and of the lean (as of a :class:`MpcCost`)."""
    barrier, hard, limits = RelaxedBarrier(settings.barrier_mu, 0.1), settings.limits == "hard", robot.limits
    free = residuals.Input(robot, groups, reference=None)
    box = sets.Box(limits.input_lower[free.indices], limits.input_upper[free.indices])
    ocp.add(Constraint("torques", free, box, penalty=barrier, hard=hard))
    spin = robot.description.limits.spin_effort
    if np.isfinite(spin):
        ocp.add(Constraint("spin", ball_residuals.BallSpin(robot), sets.Box(-spin, spin), penalty=barrier, hard=hard))
    if lean_share > 0.0:
        balance = Balance.of(robot, robot.home[robot.state["arm"]])
        answer = balance.answer if "force" in robot.input else 0.0
        pushed = groups is None  # a base whose arm others move has parameters of its own
        lean = ball_residuals.CapturePoint(robot, balance.pole, answer=answer, pushed=pushed)
        reach = lean_share * float(balance.reach.min())
        ocp.add(Constraint("lean", lean, sets.Box(-reach, reach), at="path+terminal", penalty=barrier, hard=hard))


def rezero_mpc(robot: RobotModel, settings: MpcSettings, cost: RezeroCost, obstacles: Obstacles | None = None) -> MPC:
    """The MPC of that problem with its real-time settings, which keeps clear of ``obstacles``, and apart the pairs that the robot file
    lists."""
    ocp = keep_clear(keep_apart(rezero_problem(robot, settings, cost), robot), robot, obstacles)
    return MPC(ocp, settings.solver(), settings.rate, obstacles=obstacles)


def set_home_references(mpc: MPC, robot: RobotModel, torque: np.ndarray, home: np.ndarray | None = None) -> None:
    mpc.reference["body"] = Reference.constant(robot.home if home is None else home)
    mpc.reference["twist"] = Reference.constant(np.zeros(6))
    mpc.reference["torque"] = Reference.constant(torque)
