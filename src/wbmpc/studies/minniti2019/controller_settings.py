"""Settings of the ball robot's controllers, one model for each choice: the MPC, and baselines with their searched gains.

Gains were found on tuning seeds by one search for all; ``wbmpc tune rezero-tune-NAME`` searches them. Those of accurate tasks: the same
search on the square with an unknown load.
"""

from __future__ import annotations

from typing import Literal

from wbmpc.bases.ball.defaults import BodyCost, MpcCost, RezeroCost, TorqueCost
from wbmpc.bases.ball.settings import STEPS_AND_PUSHES, EstimatedDisturbance
from wbmpc.configuration import OneOf
from wbmpc.settings import MpcSettings, MpcTiming, Nothing, PlanSettings, Positive, Settings, UniformPlan, Weight
from wbmpc.studies.minniti2019.controller_parts import (
    ACCURATE,
    ACCURATE_PLAN,
    BALL_HELD,
    DEAD_TIME,
    MPC,
    DeadTime,
    HardArmLimits,
    HardLimits,
    MpcDisturbance,
    NoisyTruth,
    PayloadDisturbance,
    PolicyTracking,
    PushFilter,
    RegulatorCost,
    SensorFilter,
    SeparateCost,
    SoftLimits,
    Tracking,
    part,
)
from wbmpc.studies.minniti2019.taskspace_control import TaskGains


class ControllerSettings(Settings):
    """What every controller has. ``estimator``: the state from the sensors (filter), or from the simulator with noise (truth)."""

    estimator: OneOf[SensorFilter | NoisyTruth] = SensorFilter()

    @property
    def learns(self) -> bool:
        """Whether it learns constant forces."""
        return isinstance(getattr(self, "disturbance", None), EstimatedDisturbance)

    @property
    def ahead(self) -> float:
        """How far ahead it reads its references [s]."""
        return 0.0


class Planning(ControllerSettings):
    """``plan``: grid and solver of an MPC; ``limits``: treatment of its limits."""

    plan: UniformPlan = part(UniformPlan, MPC)
    limits: OneOf[HardLimits | SoftLimits] = HardLimits()

    @property
    def ahead(self) -> float:
        """How far ahead it reads its references [s]."""
        return self.plan.horizon

    def planning(self, timing: MpcTiming) -> MpcSettings:
        """The settings of its MPC in a loop with this ``timing``."""
        return MpcSettings(**dict(timing), **dict(self.plan), limits=self.limits.kind)


class LearningController(ControllerSettings):
    """``disturbance``: whether constant ones are estimated, or none."""

    disturbance: OneOf[Nothing | EstimatedDisturbance] = EstimatedDisturbance()


class Planner(Planning, LearningController):
    """An MPC of the whole robot."""

    plan: PlanSettings = part(PlanSettings, MPC)
    limits: OneOf[HardArmLimits | SoftLimits] = HardArmLimits()

    @property
    def payload(self) -> bool:
        """Whether it models a mass at the end effector."""
        return isinstance(self.disturbance, PayloadDisturbance) and self.disturbance.estimate_payload

    @property
    def speed_slack(self) -> float:
        """Of the limit of the arm's speeds; soft limits have none."""
        return self.limits.speed_slack if isinstance(self.limits, HardArmLimits) else HardArmLimits().speed_slack


class PlanningController(Planner):
    """With the weights of the product's problem, ``cost``."""

    cost: MpcCost = part(MpcCost, STEPS_AND_PUSHES)

    @property
    def weights(self) -> RezeroCost:
        """The weights of its problem."""
        return RezeroCost(**dict(self.cost), speed_slack=self.speed_slack)


class TrackedMpc(PlanningController):
    """``tracking`` of the MPC's plans."""

    disturbance: OneOf[Nothing | PayloadDisturbance] = PayloadDisturbance()
    tracking: Tracking = PolicyTracking()


class WholeBodyMpc(TrackedMpc):
    """The MPC of the whole robot."""

    kind: Literal["mpc"] = "mpc"
    estimator: OneOf[PushFilter | NoisyTruth] = PushFilter()
    disturbance: OneOf[Nothing | MpcDisturbance] = MpcDisturbance()


class Regulator(LearningController):
    """One LQR, or one for each posture (scheduled): they track the body's states and know of no end effector but in its weights. Factors of
    the MPC's weights. ``torque``: weight of all torques; ``arm``: another one of the arm's; ``damping``: weight of the ball's speed and of
    the tilt rate; ``posture``: weight of the arm's angles and rates; ``end_effector``: weight of the end effector's pose;
    ``max_error`` [m]: position errors beyond it are cut; ``actuator_dead_time`` [s]: of the drives, that it assumes."""

    kind: Literal["lqr", "scheduled-lqr"] = "lqr"
    cost: RegulatorCost = part(RegulatorCost, STEPS_AND_PUSHES)
    torque: Positive = 1.0
    arm: Positive = 1.0
    posture: Positive = 1.0
    damping: Positive = 1.0
    end_effector: Positive = 1.0
    max_error: Positive = 0.1
    actuator_dead_time: DeadTime = DEAD_TIME


class SeparateSettings(Planning):
    """The base's MPC and the arm's joint loop. ``ball``: weight of the ball's position; ``ball_speed``: weight of its speed; ``tilt_rate``:
    weight of the tilt rate; ``wheel``: weight of the wheel torques; ``pace`` [rad/s]: bandwidth of the arm's joint loop; ``integral``
    [1/s]: rate of its integral part."""

    cost: SeparateCost = part(SeparateCost, STEPS_AND_PUSHES)
    ball: Weight = 30.0
    ball_speed: Weight = 3.0
    tilt_rate: Weight = 3.0
    wheel: Positive = 0.1
    pace: Positive = 10.0
    integral: Weight = 1.0

    @property
    def weights(self) -> MpcCost:
        """The weights of the base's problem."""
        gains = {n: getattr(self, n) for n in ("ball", "ball_speed", "tilt_rate")}
        return MpcCost(
            body=BodyCost(**dict(self.cost.body), **gains), torque=TorqueCost(wheel=self.wheel),
            terminal=self.cost.terminal, lean=self.cost.lean,
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


class SeparateIntegral(SeparateSettings, LearningController):
    """A base that learns constant forces."""

    kind: Literal["separate-integral"] = "separate-integral"


class SeparateAware(SeparateSettings, LearningController):
    """A base that learns constant forces and knows how its arm is going to move."""

    kind: Literal["separate-aware"] = "separate-aware"
    ball: Weight = 51.7
    ball_speed: Weight = 1.13
    tilt_rate: Weight = 0.521
    wheel: Positive = 0.0328
    pace: Positive = 25.0
    integral: Weight = 2.57


class TaskspaceSettings(LearningController):
    """Gains of the task-space controller. ``end_effector`` [rad/s]: natural frequency of the end effector's position; ``turn`` [rad/s]:
    natural frequency of its orientation; ``ball``: weight of the ball's position in the balance's LQR; ``ball_speed``: weight of its speed
    there; ``yaw``: weight of the yaw there; ``tilt``: weight of the tilt there; ``wheel_torque``: weight of the wheel torques there;
    ``balance``: weight of the squared accelerations of ball and base against those of the end effector."""

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


#: Which controller moves the ball robot.
Controller = OneOf[WholeBodyMpc | Regulator | Separate | SeparateIntegral | SeparateAware | Taskspace]


class HeldRegulator(Regulator):
    """Of a ball that is held."""

    cost: RegulatorCost = part(RegulatorCost, BALL_HELD)


class _Held(Settings):
    cost: SeparateCost = part(SeparateCost, BALL_HELD)


class HeldSeparate(_Held, Separate):
    """Of a ball that is held."""


class HeldSeparateIntegral(_Held, SeparateIntegral):
    """Of a ball that is held."""


class HeldSeparateAware(_Held, SeparateAware):
    """Of a ball that is held."""


#: The same with the weights of a ball that is held.
HeldController = OneOf[
    WholeBodyMpc | HeldRegulator | HeldSeparate | HeldSeparateIntegral | HeldSeparateAware | Taskspace
]


class AccurateRegulator(Regulator):
    """Not searched: the best of four sets that were tried on the circle. With the factors of 1 the stiff weights make a regulator swing
    through the drives' lag until it falls (circle, tuning seed 0)."""

    cost: RegulatorCost = part(RegulatorCost, ACCURATE)
    torque: Positive = 30.0
    damping: Positive = 10.0
    posture: Positive = 10.0


class _Accurate(Settings):
    cost: SeparateCost = part(SeparateCost, ACCURATE)


class _Stiff(_Accurate, SeparateSettings):
    ball: Weight = 53.7
    ball_speed: Weight = 0.782
    tilt_rate: Weight = 0.569
    wheel: Positive = 0.0152
    pace: Positive = 40.0
    integral: Weight = 5.57


class AccurateSeparate(_Stiff, Separate):
    """Of accurate tasks."""


class AccurateSeparateIntegral(_Accurate, SeparateIntegral):
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
    WholeBodyMpc | AccurateRegulator | AccurateSeparate | AccurateSeparateIntegral | AccurateSeparateAware | Taskspace
]
#: The MPC of a ball that is held, and that of accurate tasks, which ignores pushes.
HELD_MPC = WholeBodyMpc(cost=part(MpcCost, BALL_HELD))
ACCURATE_MPC = WholeBodyMpc(
    estimator=PushFilter(expected_push_time=0.0),
    limits=HardArmLimits(speed_slack=ACCURATE_PLAN.speed_slack),
    cost=part(MpcCost, ACCURATE_PLAN),
)
