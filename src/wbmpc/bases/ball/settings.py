"""Default settings of the ball robot's controller: weights, the MPC's grid and rate, what is learned of the world."""

from __future__ import annotations

from typing import Annotated, Protocol

import numpy as np
from pydantic import Field

from wbmpc.bases.ball.defaults import BodyCost, EndEffectorCost, RezeroCost, TorqueCost
from wbmpc.bases.ball.lean_control import LeanControl
from wbmpc.configuration import OnlyWith
from wbmpc.model.robot import RobotModel
from wbmpc.settings import ACTUATOR_TIME_CONSTANT, MpcSettings, Settings

#: One set of weights for fast steps of the end effector and for pushes of 200 N. What keeps the robot up is the limit of the lean; the
#: arm stays near its posture at home (unless a goal needs another one), so that the next push does not find it folded up. A
#: stiff penalty of its speeds asks for all the torque there is after any excess, and through the lag of the drives the arm then
#: swings from limit to limit forever.
STEPS_AND_PUSHES = RezeroCost(
    end_effector=EndEffectorCost(weight=450.0, orientation=80.0, turn_limit=0.2),
    body=BodyCost(tilt_rate=3.0, arm=1.0),
    torque=TorqueCost(wheel=0.1, arm=0.3),
    lean=0.6,
    speed_slack=20.0,
)
#: Of settings that are of learned forces.
LEARNED = OnlyWith(estimate_disturbance=True)


def mpc_settings(barrier_mu: float) -> MpcSettings:
    """80 Hz, a horizon of 1.3 s in 65 intervals. A lean grows 450 times within it: no plan starts as a motion without feedback."""
    return MpcSettings(
        rate=80.0, horizon=1.3, intervals=65, first_interval=0.0, barrier_mu=barrier_mu, rollout_restart=False
    )


class BallControllerSettings(Settings):
    """``estimate_disturbance``: whether constant disturbances are estimated; ``estimate_payload``: whether a load at the end effector is one of
    them, of which the MPC knows;
    ``expected_push_time`` [s]: how much longer a detected push is expected to last, for the MPC's limit of the lean (0: pushes are ignored);
    ``max_pushed_speed`` [m/s]: a ball that goes faster under a strong force that lasts ends the run;
    ``actuator_time_constant`` [s]: that the controller assumes, in the middle of what may be; ``actuator_dead_time`` [s]: that the MPC's
    policy and the regulators assume, the same."""

    mpc: MpcSettings = mpc_settings(barrier_mu=3e-2)
    cost: RezeroCost = STEPS_AND_PUSHES
    estimate_disturbance: bool = True
    estimate_payload: Annotated[bool, LEARNED] = True
    expected_push_time: float = Field(0.3, ge=0, le=1.0)
    max_pushed_speed: Annotated[float, LEARNED] = Field(2.0, ge=0.01, le=100)
    actuator_time_constant: float = Field(ACTUATOR_TIME_CONSTANT, ge=0, le=0.5)
    actuator_dead_time: float = Field(0.010, ge=0, le=0.05)


class BallControlSettings(Protocol):
    """Settings of whatever controls a ball robot with the MPC."""

    @property
    def estimate_disturbance(self) -> bool: ...
    @property
    def cost(self) -> RezeroCost: ...
    @property
    def max_pushed_speed(self) -> float: ...


def lean_control_of(settings: BallControlSettings, robot: RobotModel, arm: np.ndarray) -> LeanControl | None:
    """How the MPC's robot leans against forces that it learns, its ``arm`` (m) [rad] about there; None if it learns none."""
    return (
        LeanControl(robot, arm, settings.cost.lean, settings.max_pushed_speed)
        if settings.estimate_disturbance
        else None
    )
