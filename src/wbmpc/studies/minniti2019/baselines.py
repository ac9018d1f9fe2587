"""The ball robot's controllers: the MPC with either tracking, and its baselines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.estimator import BallEstimator
from wbmpc.bases.ball.fall_detection import FallPredictor
from wbmpc.bases.ball.model import ball_base
from wbmpc.bases.ball.sent_torques import DriveSettings
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.studies.minniti2019.controller_parts import ActuatorTracking
from wbmpc.studies.minniti2019.controller_settings import (
    ControllerSettings,
    Regulator,
    SeparateAware,
    SeparateSettings,
    TaskspaceSettings,
    TrackedMpc,
)
from wbmpc.studies.minniti2019.held_arm import base_problem
from wbmpc.studies.minniti2019.lqr import LqrController, LqrWeights, RegulatorGains
from wbmpc.studies.minniti2019.separate import ArmLoop, EndEffectorInverse, SeparateController
from wbmpc.studies.minniti2019.settings import RezeroSettings
from wbmpc.studies.minniti2019.taskspace_control import TaskGains, TaskSpaceController
from wbmpc.studies.minniti2019.tracking_control import ActuatorGains, TrackingController


@dataclass(frozen=True)
class Parts:
    """What every controller is built from. ``arm`` (m) [rad]: angles at the start."""

    robot: RobotModel
    mpc: MPC
    torque: np.ndarray
    period: float
    estimator: BallEstimator | None
    arm: np.ndarray


def make_controller(
    settings: RezeroSettings, chosen: ControllerSettings, p: Parts
) -> tuple[BallController, MPC | None]:
    """The ``chosen`` controller, and the MPC that plans for it (None: nothing does)."""
    if isinstance(chosen, TrackedMpc):
        own, lag = (p.robot, p.mpc, p.torque, p.period), settings.actuator_time_constant
        more = (chosen.learns, p.estimator, FallPredictor(p.robot, p.arm))
        if isinstance(chosen.tracking, ActuatorTracking):
            gains = ActuatorGains(**chosen.tracking.model_dump(exclude={"kind"}))
            return TrackingController(*own, DriveSettings(lag), *more, gains=gains), p.mpc
        return BallController(*own, DriveSettings(lag, chosen.tracking.actuator_dead_time), *more), p.mpc
    controller, planner = _baseline(settings, chosen, p)
    # by the state alone, for plans that they have are not the optimizer's of the whole robot
    controller.fall_predictor = FallPredictor(p.robot, p.arm, ahead=0.0)
    return controller, planner


def _baseline(settings: RezeroSettings, chosen: ControllerSettings, p: Parts) -> tuple[BallController, MPC | None]:
    if isinstance(chosen, TaskspaceSettings):
        return _taskspace(settings, chosen, p), None
    if isinstance(chosen, SeparateSettings):
        return _separate(settings, chosen, p)
    assert isinstance(chosen, Regulator)
    drives = DriveSettings(settings.actuator_time_constant, chosen.actuator_dead_time)
    controller = LqrController(p.robot, p.mpc, p.torque, p.period, drives, chosen.learns, p.estimator)
    regulator = RegulatorGains(p.robot, regulator_weights(p.robot, chosen), p.period)
    scheduled = chosen.kind == "scheduled-lqr"
    controller.regulate(regulator, lambda t: p.mpc.reference["body"].at(t), scheduled, chosen.max_error)
    return controller, None


def _taskspace(settings: RezeroSettings, chosen: TaskspaceSettings, p: Parts) -> TaskSpaceController:
    def goal(t: float) -> tuple[np.ndarray, np.ndarray]:
        pose = p.mpc.reference["end_effector"].at(t)
        return pose[:3], pose[3:]

    home = ball_base(p.robot).numeric.equilibrium(p.arm)[0]
    more = (p.period, DriveSettings(settings.actuator_time_constant), chosen.learns, p.estimator)
    gains = TaskGains(**chosen.model_dump(exclude={"kind", "estimator", "disturbance"}))
    controller = TaskSpaceController(p.robot, p.mpc, goal, gains, home, p.torque, *more)
    controller.stance = lambda t: p.mpc.reference["body"].at(t)
    return controller


def _separate(settings: RezeroSettings, gains: SeparateSettings, p: Parts) -> tuple[SeparateController, MPC]:
    h, planning = gains.cost.end_effector, gains.planning(settings.mpc)
    planner = MPC(base_problem(p.robot, planning, gains.weights), planning.solver(), planning.rate)
    planner.reference["body"] = p.mpc.reference["body"]
    inverse = EndEffectorInverse(
        p.robot, np.array([h.weight] * 3 + [h.orientation, h.orientation, h.roll]), max(gains.cost.body.arm, 0.1)
    )
    controller = SeparateController(
        p.robot, p.mpc, p.torque, p.period, DriveSettings(settings.actuator_time_constant),
        gains.learns, p.estimator,
        planner=planner, inverse=inverse, arm=ArmLoop(gains.pace, gains.integral),
        aware=isinstance(gains, SeparateAware),
    )  # fmt: skip
    home = ball_base(p.robot).numeric.equilibrium(p.arm)[0]
    planner.reset(controller.believed(home), p.torque[p.robot.input["wheel"]])
    return controller, planner


def regulator_weights(robot: RobotModel, r: Regulator) -> LqrWeights:
    """The MPC's weights, times the baseline's factors, for a regulator."""
    h, b, t = r.cost.end_effector, r.cost.body, r.cost.torque
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
