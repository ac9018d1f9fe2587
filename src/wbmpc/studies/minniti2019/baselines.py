"""The ball robot's controllers by name: the MPC with either tracking, and its baselines with their searched gains."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal, get_args

import numpy as np
from pydantic import BeforeValidator, Field

from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.defaults import RezeroCost
from wbmpc.bases.ball.estimator import BallEstimator
from wbmpc.bases.ball.fall_detection import FallPredictor
from wbmpc.bases.ball.model import ball_base
from wbmpc.bases.ball.sent_torques import DriveSettings
from wbmpc.configuration import OnlyWith, kind_alone
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.settings import Positive, Settings, Weight
from wbmpc.studies.minniti2019.held_arm import base_problem
from wbmpc.studies.minniti2019.lqr import LqrController, LqrWeights, RegulatorGains
from wbmpc.studies.minniti2019.separate import ArmLoop, EndEffectorInverse, SeparateController
from wbmpc.studies.minniti2019.taskspace_control import TaskGains, TaskSpaceController
from wbmpc.studies.minniti2019.tracking_control import ActuatorGains, TrackingController

if TYPE_CHECKING:
    from wbmpc.studies.minniti2019.settings import RezeroSettings

Controller = Literal[
    "mpc", "lqr", "scheduled-lqr", "separate", "separate-integral", "separate-aware", "taskspace"
]  # fmt: skip


#: Those that track the body's states and know of no end effector but in its weights.
REGULATORS = ("lqr", "scheduled-lqr")


class RegulatorSettings(Settings):
    """Factors of the MPC's weights. ``torque``: weight of all torques; ``arm``: another one of the arm's; ``damping``: weight of the
    ball's speed and of the tilt rate; ``posture``: weight of the arm's angles and rates; ``end_effector``: weight of the end effector's
    pose; ``max_error`` [m]: position errors beyond it are cut."""

    torque: Positive = 1.0
    arm: Positive = 1.0
    posture: Positive = 1.0
    damping: Positive = 1.0
    end_effector: Positive = 1.0
    max_error: Positive = 0.1


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


class BaselineSettings(Settings):
    """Gains of each baseline, found on tuning seeds by one search for all; ``wbmpc tune rezero-tune-NAME`` searches them."""

    lqr: RegulatorSettings = RegulatorSettings()
    scheduled_lqr: RegulatorSettings = RegulatorSettings()
    separate: SeparateSettings = SeparateSettings(
        ball=50.9, ball_speed=6.85, tilt_rate=5.06, wheel=1.36, pace=22.1, integral=0.116
    )
    separate_integral: SeparateSettings = SeparateSettings()
    separate_aware: SeparateSettings = SeparateSettings(
        ball=51.7, ball_speed=1.13, tilt_rate=0.521, wheel=0.0328, pace=25.0, integral=2.57
    )
    taskspace: TaskspaceSettings = TaskspaceSettings()


_STIFF = SeparateSettings(ball=53.7, ball_speed=0.782, tilt_rate=0.569, wheel=0.0152, pace=40.0, integral=5.57)
#: With the factors of 1 the stiff weights make a regulator swing through the drives' lag until it falls (circle, tuning seed 0).
_DAMPED = RegulatorSettings(torque=30.0, damping=10.0, posture=10.0)
#: For accurate tasks: the same search on the square with an unknown load. The regulators were not searched: theirs
#: is the best of four sets that were tried on the circle.
ACCURATE_BASELINES = BaselineSettings(
    lqr=_DAMPED,
    scheduled_lqr=_DAMPED,
    separate=_STIFF,
    separate_integral=SeparateSettings(
        ball=63.9, ball_speed=2.26, tilt_rate=5.17, wheel=0.01, pace=40.0, integral=1.18
    ),
    separate_aware=_STIFF,
)


class PolicyTracking(Settings):
    """Between two plans the Riccati feedback acts at the controller's rate."""

    kind: Literal["policy"] = "policy"


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

    def gains(self) -> ActuatorGains:
        """The tracking controller's."""
        return ActuatorGains(**self.model_dump(exclude={"kind"}))


#: What happens between two plans.
Tracking = Annotated[PolicyTracking | ActuatorTracking, Field(discriminator="kind"), BeforeValidator(kind_alone)]


def _weights() -> frozenset[str]:
    """Names of all settings of the costs."""
    usual = RezeroCost()
    parts = {n: getattr(usual, n) for n in RezeroCost.model_fields}
    inside = {
        f"cost.{n}.{key}" for n, part in parts.items() if isinstance(part, Settings) for key in type(part).model_fields
    }
    return frozenset(inside | {f"cost.{n}" for n, part in parts.items() if not isinstance(part, Settings)})


#: What a plan of the whole robot alone has. (Its rate and delay are those of the loop, whatever controller is in it.)
_PLAN = frozenset(
    f"mpc.{n}"
    for n in ("horizon", "intervals", "first_interval", "iterations", "limits", "barrier_mu", "rollout_restart")
)
#: What regulators take of the costs (:func:`regulator_weights`) is all but these; what `separate` and its like take: these.
_NO_REGULATORS = frozenset(
    f"cost.{n}"
    for n in (
        "end_effector.limit",
        "end_effector.turn_limit",
        "terminal",
        "lean",
        "speed_slack",
        "torque.force",
        "torque.moment",
    )
)
_SEPARATES = frozenset(
    f"cost.{n}"
    for n in (
        "end_effector.weight",
        "end_effector.orientation",
        "end_effector.roll",
        "body.yaw",
        "body.yaw_rate",
        "body.arm",
        "lean",
    )
)


def _unread(controller: Controller) -> frozenset[str]:
    """Keys of the ball robot's settings that a controller does not read."""
    others = {f"baseline.{name}" for name in BaselineSettings.model_fields if name != controller.replace("-", "_")}
    if controller == "mpc":
        return frozenset(others)
    idle = others | {"expected_push_time", "max_pushed_speed", "estimate_payload", "tracking"}
    if controller in REGULATORS:
        return frozenset(idle | _PLAN | _NO_REGULATORS)
    if controller == "taskspace":
        return frozenset(idle | _PLAN | _weights() | {"actuator_dead_time"})
    blind = {"estimate_disturbance"} if controller == "separate" else set()
    return frozenset(idle | blind | {"mpc.first_interval", "actuator_dead_time"} | (_weights() - _SEPARATES))


def by_controller() -> dict[str, OnlyWith]:
    """Which controllers read a setting, for all that not every controller reads."""
    names: tuple[Controller, ...] = get_args(Controller)
    idle = {name: _unread(name) for name in names}
    rules = {
        key: OnlyWith(controller=tuple(n for n in names if key not in idle[n]))
        for key in sorted(set().union(*idle.values()))
    }
    # in the drives the commands of the MPC act at once
    rules["actuator_dead_time"] &= OnlyWith({"controller": REGULATORS, "tracking.kind": "policy"})
    return rules


@dataclass(frozen=True)
class Parts:
    """What every controller is built from. ``arm`` (m) [rad]: angles at the start."""

    robot: RobotModel
    mpc: MPC
    torque: np.ndarray
    period: float
    estimator: BallEstimator | None
    arm: np.ndarray


def make_controller(settings: RezeroSettings, p: Parts) -> tuple[BallController, MPC | None]:
    """The controller that the settings name, and the MPC that plans for it (None: nothing does)."""
    policies = settings.controller == "mpc" and settings.tracking.kind == "policy"
    late = policies or settings.controller in REGULATORS
    drives = DriveSettings(settings.actuator_time_constant, settings.actuator_dead_time if late else 0.0)
    own = (p.robot, p.mpc, p.torque, p.period, drives, settings.estimate_disturbance, p.estimator)
    name = settings.controller
    if name == "mpc":
        more = (*own, FallPredictor(p.robot, p.arm))
        if settings.tracking.kind == "actuators":
            return TrackingController(*more, gains=settings.tracking.gains()), p.mpc
        return BallController(*more), p.mpc
    if name == "taskspace":
        return _taskspace(settings, p), None
    if name in REGULATORS:
        gains = settings.baseline.lqr if name == "lqr" else settings.baseline.scheduled_lqr
        controller = LqrController(*own)
        regulator = RegulatorGains(p.robot, regulator_weights(p.robot, settings, gains), p.period)
        controller.regulate(
            regulator, lambda t: p.mpc.reference["body"].at(t), name == "scheduled-lqr", gains.max_error
        )
        controller.forecast = _felt(p)
        return controller, None
    return _separate(settings, p)


def _felt(p: Parts) -> FallPredictor:
    """Falls that baselines foresee: by the state alone, for plans that they have are not the optimizer's of the whole robot."""
    return FallPredictor(p.robot, p.arm, ahead=0.0)


def _taskspace(settings: RezeroSettings, p: Parts) -> TaskSpaceController:
    def goal(t: float) -> tuple[np.ndarray, np.ndarray]:
        pose = p.mpc.reference["end_effector"].at(t)
        return pose[:3], pose[3:]

    home, gains = (
        ball_base(p.robot).numeric.equilibrium(p.arm)[0],
        TaskGains(**settings.baseline.taskspace.model_dump()),
    )
    more = (p.period, DriveSettings(settings.actuator_time_constant), settings.estimate_disturbance, p.estimator)
    controller = TaskSpaceController(p.robot, p.mpc, goal, gains, home, p.torque, *more)
    controller.stance = lambda t: p.mpc.reference["body"].at(t)
    controller.forecast = _felt(p)
    return controller


def _separate(settings: RezeroSettings, p: Parts) -> tuple[SeparateController, MPC]:
    name = settings.controller
    gains: SeparateSettings = getattr(settings.baseline, name.replace("-", "_"))
    h, b = settings.cost.end_effector, settings.cost.body
    weights = {"ball": gains.ball, "ball_speed": gains.ball_speed, "tilt_rate": gains.tilt_rate}
    cost = settings.cost.model_copy(update={
        "body": b.model_copy(update=weights),
        "torque": settings.cost.torque.model_copy(update={"wheel": gains.wheel}),
    })  # fmt: skip
    planner = MPC(base_problem(p.robot, settings.mpc, cost), settings.mpc.solver(), settings.mpc.rate)
    planner.reference["body"] = p.mpc.reference["body"]
    inverse = EndEffectorInverse(
        p.robot, np.array([h.weight] * 3 + [h.orientation, h.orientation, h.roll]), max(b.arm, 0.1)
    )
    controller = SeparateController(
        p.robot, p.mpc, p.torque, p.period, DriveSettings(settings.actuator_time_constant),
        settings.estimate_disturbance and name != "separate", p.estimator,
        planner=planner, inverse=inverse, arm=ArmLoop(gains.pace, gains.integral), aware=name == "separate-aware",
    )  # fmt: skip
    controller.forecast = _felt(p)
    home = ball_base(p.robot).numeric.equilibrium(p.arm)[0]
    planner.reset(controller.believed(home), p.torque[p.robot.input["wheel"]])
    return controller, planner


def regulator_weights(robot: RobotModel, settings: RezeroSettings, r: RegulatorSettings) -> LqrWeights:
    """The MPC's weights, times the baseline's factors, for a regulator."""
    h, b, t = settings.cost.end_effector, settings.cost.body, settings.cost.torque
    fast, tilt = r.damping * b.ball_speed, r.damping * b.tilt_rate
    arm, joints = r.posture * np.array([b.arm, b.arm_rate]), ball_base(robot).nq - 5
    state = robot.state.vector({
        "base": [b.ball, b.ball, b.yaw, 0.0, 0.0], "arm": [arm[0]] * joints,
        "base_velocity": [fast, fast, b.yaw_rate, tilt, tilt], "arm_velocity": [arm[1]] * joints,
    })  # fmt: skip
    end_effector = r.end_effector * np.array([h.weight] * 3 + [h.orientation, h.orientation, h.roll])
    twist = np.array([h.twist] * 3 + [h.angular] * 3)
    wheels = len(robot.input.groups["wheel"])
    torque = r.torque * np.array([t.wheel] * wheels + [r.arm * t.arm] * joints)
    return LqrWeights(end_effector, twist, state, torque)
