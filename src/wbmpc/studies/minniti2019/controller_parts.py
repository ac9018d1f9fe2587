"""Parts of the settings of the ball robot's controllers: weights, estimators, disturbances, what happens between two plans."""

from __future__ import annotations

from typing import Annotated, Literal, TypeVar

from pydantic import BaseModel, Field

from wbmpc.bases.ball.defaults import (
    BodyCost,
    EndEffectorCost,
    MotionCost,
    PoseCost,
    PostureCost,
    RezeroCost,
    TorqueCost,
)
from wbmpc.bases.ball.perturbation import StateNoise
from wbmpc.bases.ball.settings import (
    STEPS_AND_PUSHES,
    EstimatedDisturbance,
    ExpectedPush,
    PushedDisturbance,
    mpc_settings,
)
from wbmpc.configuration import OneOf
from wbmpc.settings import Positive, Settings, Weight
from wbmpc.studies.minniti2019.tracking_control import ActuatorGains

M = TypeVar("M", bound=BaseModel)


def part(model: type[M], whole: BaseModel) -> M:
    """What a ``model`` with fewer settings has of the ``whole``."""
    values = {name: getattr(whole, name) for name in model.model_fields}
    inside = {n: type(i.default) for n, i in model.model_fields.items() if isinstance(i.default, BaseModel)}
    return model(**{n: part(inside[n], v) if n in inside else v for n, v in values.items()})


MPC = mpc_settings(barrier_mu=3e-2)
#: Weights that hold the ball and, of the end effector, only its orientation (the paper's first task).
BALL_HELD = STEPS_AND_PUSHES.model_copy(
    update={
        "end_effector": STEPS_AND_PUSHES.end_effector.model_copy(update={"weight": 0.0}),
        "body": STEPS_AND_PUSHES.body.model_copy(update={"ball": 10.0}),
    }
)
#: Stiff weights for an end effector that is led accurately, by references that move slowly, while the ball has a place of its own.
ACCURATE = RezeroCost(
    end_effector=EndEffectorCost(weight=1000.0, orientation=2.0, roll=0.0),
    body=BodyCost(ball=400.0, yaw=20.0),
    lean=0.6,
)
#: Those of the MPC; baselines keep the weights that their gains were searched with. An arm of three joints that holds a place has no
#: orientation left: a weight of 2 draws the ball aside for it. How far a lean that is not known at the start carries the ball is up to
#: the wheels' torque: it is cheap.
ACCURATE_PLAN = ACCURATE.model_copy(
    update={
        "end_effector": ACCURATE.end_effector.model_copy(update={"orientation": 0.2}),
        "torque": ACCURATE.torque.model_copy(update={"wheel": 0.01}),
    }
)


class SensorFilter(Settings):
    """The state from encoders, gyro and accelerometer."""

    kind: Literal["filter"] = "filter"


class PushFilter(ExpectedPush, SensorFilter):
    """It detects pushes, too."""


class NoisyTruth(StateNoise):
    """The state from the simulator, with noise, in which all is a push."""

    kind: Literal["truth"] = "truth"


class PayloadDisturbance(EstimatedDisturbance):
    """``estimate_payload``: whether a load at the end effector is one of the disturbances that are estimated, of which the MPC knows."""

    estimate_payload: bool = True


class MpcDisturbance(PayloadDisturbance, PushedDisturbance):
    """Of an MPC that follows a robot that is pushed along."""


class HardLimits(Settings):
    """By an interior point."""

    kind: Literal["hard"] = "hard"


class HardArmLimits(HardLimits):
    """``speed_slack``: penalty of arm speeds beyond their limit, where that cannot be held [per range and second]."""

    speed_slack: Positive = STEPS_AND_PUSHES.speed_slack


class SoftLimits(Settings):
    """By relaxed barriers."""

    kind: Literal["soft"] = "soft"


class RegulatorCost(Settings):
    """The weights of the MPC that a regulator has."""

    end_effector: MotionCost = MotionCost()
    body: BodyCost = BodyCost()
    torque: TorqueCost = TorqueCost()


class SeparateCost(Settings):
    """The weights of the MPC that base and arm have. ``terminal`` [s]: the end of the base's horizon counts like so long of it; ``lean``:
    limit of the lean of the base's plans, as of the MPC."""

    end_effector: PoseCost = PoseCost()
    body: PostureCost = PostureCost()
    terminal: Weight = 1.0
    lean: float = Field(default=0.0, ge=0, le=1.0)


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
    [N m s/rad]: K_d of the wheels; ``arm_stiffness`` [N m/rad]: K_p of the arm's joints; ``arm_damping`` [N m s/rad]: K_d of the arm's
    joints; ``leak_time_constant`` [s]: in which integrated speeds decay."""

    kind: Literal["actuators"] = "actuators"
    wheel_stiffness: Weight = ActuatorGains.wheel_stiffness
    wheel_damping: Weight = ActuatorGains.wheel_damping
    arm_stiffness: Weight = ActuatorGains.arm_stiffness
    arm_damping: Weight = ActuatorGains.arm_damping
    leak_time_constant: Positive = ActuatorGains.leak_time_constant


#: What happens between two plans.
Tracking = OneOf[PolicyTracking | ActuatorTracking]
