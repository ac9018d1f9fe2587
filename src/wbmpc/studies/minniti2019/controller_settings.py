"""Settings of the ball robot's controllers, one model for each choice: the MPC, and baselines with their searched gains.

Gains were found on tuning seeds by one search for all; ``wbmpc tune rezero-tune-NAME`` searches them. Those of accurate tasks: the same
search on the square with an unknown load.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from wbmpc.bases.ball.settings import PushedSettings
from wbmpc.configuration import OneOf
from wbmpc.settings import Positive, Settings, Weight
from wbmpc.studies.minniti2019.taskspace_control import TaskGains
from wbmpc.studies.minniti2019.tracking_control import ActuatorGains

#: Kinds of controllers that plan.
PLANNERS = ("mpc", "separate", "separate-integral", "separate-aware")
#: What a plan alone has, beside its horizon. (Its rate and delay are those of the loop, whatever controller is in it.)
_PLAN = tuple(
    f"mpc.{n}" for n in ("intervals", "first_interval", "iterations", "limits", "barrier_mu", "rollout_restart")
)
#: Dead time [s] of the drives that a controller assumes, in the middle of what may be.
DeadTime = Annotated[float, Field(ge=0, le=0.05)]
DEAD_TIME = 0.010


class PolicyTracking(Settings):
    """Between two plans the Riccati feedback acts at the controller's rate. ``actuator_dead_time`` [s]: of the drives, that it assumes."""

    kind: Literal["policy"] = "policy"
    actuator_dead_time: DeadTime = DEAD_TIME


class ActuatorTracking(Settings):
    """Between two plans the paper's feed-forward and PD act in the drives, with the gains of
    :class:`wbmpc.studies.minniti2019.tracking_control.ActuatorGains`. ``wheel_stiffness`` [N m/rad]: K_p of the wheels; ``wheel_damping``
    [N m s/rad]: K_d of the wheels; ``arm_stiffness`` [N m/rad]: K_p of the arm's joints; ``arm_damping`` [N m s/rad]: K_d of the arm's joints;
    ``leak_time_constant`` [s]: in which integrated speeds decay."""

    kind: Literal["actuators"] = "actuators"
    wheel_stiffness: Weight = ActuatorGains.wheel_stiffness
    wheel_damping: Weight = ActuatorGains.wheel_damping
    arm_stiffness: Weight = ActuatorGains.arm_stiffness
    arm_damping: Weight = ActuatorGains.arm_damping
    leak_time_constant: Positive = ActuatorGains.leak_time_constant


#: What happens between two plans.
Tracking = OneOf[PolicyTracking | ActuatorTracking]


class PlanSettings(Settings):
    """``estimate_payload``: whether a load at the end effector is one of the disturbances that are estimated, of which the MPC knows;
    ``tracking`` of the MPC's plans."""

    estimate_payload: bool = True
    tracking: Tracking = PolicyTracking()


class WholeBodyMpc(PlanSettings, PushedSettings):
    """The MPC of the whole robot."""

    kind: Literal["mpc"] = "mpc"


class Regulator(Settings):
    """One LQR, or one for each posture (scheduled): they track the body's states and know of no end effector but in its weights. Factors of
    the MPC's weights. ``torque``: weight of all torques; ``arm``: another one of the arm's; ``damping``: weight of the ball's speed and of
    the tilt rate; ``posture``: weight of the arm's angles and rates; ``end_effector``: weight of the end effector's pose;
    ``max_error`` [m]: position errors beyond it are cut; ``actuator_dead_time`` [s]: of the drives, that it assumes."""

    kind: Literal["lqr", "scheduled-lqr"] = "lqr"
    torque: Positive = 1.0
    arm: Positive = 1.0
    posture: Positive = 1.0
    damping: Positive = 1.0
    end_effector: Positive = 1.0
    max_error: Positive = 0.1
    actuator_dead_time: DeadTime = DEAD_TIME

    ignores: ClassVar[tuple[str, ...]] = (
        *_PLAN,
        *(f"cost.{n}" for n in ("end_effector.limit", "end_effector.turn_limit", "terminal", "lean", "speed_slack")),
    )


class SeparateSettings(Settings):
    """The base's MPC and the arm's joint loop. ``ball``: weight of the ball's position; ``ball_speed``: weight of its speed; ``tilt_rate``: weight
    of the tilt rate; ``wheel``: weight of the wheel torques; ``pace`` [rad/s]: bandwidth of the arm's joint loop; ``integral`` [1/s]: rate of
    its integral part."""

    ball: Weight = 30.0
    ball_speed: Weight = 3.0
    tilt_rate: Weight = 3.0
    wheel: Positive = 0.1
    pace: Positive = 10.0
    integral: Weight = 1.0

    ignores: ClassVar[tuple[str, ...]] = (
        "mpc.first_interval", "cost.torque", "cost.terminal", "cost.speed_slack",
        *(f"cost.end_effector.{n}" for n in ("limit", "turn_limit", "twist", "angular")),
        *(f"cost.body.{n}" for n in ("ball", "ball_speed", "tilt_rate", "arm_rate")),
    )  # fmt: skip


class Separate(SeparateSettings):
    """The paper's: a base that does not know of its arm, and learns no forces."""

    kind: Literal["separate"] = "separate"
    ball: Weight = 50.9
    ball_speed: Weight = 6.85
    tilt_rate: Weight = 5.06
    wheel: Positive = 1.36
    pace: Positive = 22.1
    integral: Weight = 0.116

    ignores = (*SeparateSettings.ignores, "estimate_disturbance")


class SeparateIntegral(SeparateSettings):
    """A base that learns constant forces."""

    kind: Literal["separate-integral"] = "separate-integral"


class SeparateAware(SeparateSettings):
    """A base that learns constant forces and knows how its arm is going to move."""

    kind: Literal["separate-aware"] = "separate-aware"
    ball: Weight = 51.7
    ball_speed: Weight = 1.13
    tilt_rate: Weight = 0.521
    wheel: Positive = 0.0328
    pace: Positive = 25.0
    integral: Weight = 2.57


class TaskspaceSettings(Settings):
    """Gains of the task-space controller. ``end_effector`` [rad/s]: natural frequency of the end effector's position; ``turn`` [rad/s]: natural
    frequency of its orientation; ``ball``: weight of the ball's position in the balance's LQR; ``ball_speed``: weight of its speed there; ``yaw``:
    weight of the yaw there; ``tilt``: weight of the tilt there; ``wheel_torque``: weight of the wheel torques there; ``balance``: weight of
    the squared accelerations of ball and base against those of the end effector."""

    end_effector: Positive = 5.02
    turn: Positive = 2.5
    ball: Positive = 6.04
    ball_speed: Positive = 1.07
    yaw: Positive = TaskGains.yaw
    tilt: Positive = 212.0
    wheel_torque: Positive = 6.69
    balance: Positive = 1.63


class Taskspace(TaskspaceSettings):
    """The controller of the end effector's task at each instant."""

    kind: Literal["taskspace"] = "taskspace"

    ignores: ClassVar[tuple[str, ...]] = (*_PLAN, "cost")


#: Settings of one controller, whether they name their kind or belong to an experiment that has no choice.
AnyController = PlanSettings | Regulator | SeparateSettings | TaskspaceSettings
#: Which controller moves the ball robot.
Controller = OneOf[WholeBodyMpc | Regulator | Separate | SeparateIntegral | SeparateAware | Taskspace]


class AccurateMpc(WholeBodyMpc):
    """Pushes are ignored."""

    expected_push_time: float = Field(0.0, ge=0, le=1.0)


class AccurateRegulator(Regulator):
    """Not searched: the best of four sets that were tried on the circle. With the factors of 1 the stiff weights make a regulator swing
    through the drives' lag until it falls (circle, tuning seed 0)."""

    torque: Positive = 30.0
    damping: Positive = 10.0
    posture: Positive = 10.0


class _Stiff(SeparateSettings):
    ball: Weight = 53.7
    ball_speed: Weight = 0.782
    tilt_rate: Weight = 0.569
    wheel: Positive = 0.0152
    pace: Positive = 40.0
    integral: Weight = 5.57


class AccurateSeparate(_Stiff, Separate):
    """Of accurate tasks."""


class AccurateSeparateIntegral(SeparateIntegral):
    """Of accurate tasks."""

    ball: Weight = 63.9
    ball_speed: Weight = 2.26
    tilt_rate: Weight = 5.17
    wheel: Positive = 0.01
    pace: Positive = 40.0
    integral: Weight = 1.18


class AccurateSeparateAware(_Stiff, SeparateAware):
    """Of accurate tasks."""


#: The same with the gains of accurate tasks.
AccurateController = OneOf[
    AccurateMpc | AccurateRegulator | AccurateSeparate | AccurateSeparateIntegral | AccurateSeparateAware | Taskspace
]
