"""Default settings of the ball robot's controller: weights, the MPC's grid and rate, pushes."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from wbmpc.bases.ball.defaults import BodyCost, EndEffectorCost, RezeroCost, TorqueCost
from wbmpc.settings import MpcSettings, Settings

#: One set of weights for fast steps of the end effector and for pushes of 200 N. What keeps the robot up is the limit of the lean; the
#: arm stays near its posture at home (unless a goal needs another one), so that the next push does not find it folded up. A
#: stiff penalty of its speeds asks for all the torque there is after any excess, and through the lag of the drives the arm then
#: swings from limit to limit forever.
STEPS_AND_PUSHES = RezeroCost(
    end_effector=EndEffectorCost(weight=450.0, orientation=80.0, turn_limit=0.2), body=BodyCost(tilt_rate=3.0, arm=1.0),
    torque=TorqueCost(wheel=0.1, arm=0.3), lean=0.6, speed_slack=20.0,
)  # fmt: skip
#: How fast [m/s] the robot may be pushed along before it leans against the force.
PUSHED_SPEED = 2.0


def mpc_settings(barrier_mu: float) -> MpcSettings:
    """80 Hz, a horizon of 1.3 s in 65 intervals. A lean grows 450 times within it: no plan starts as a motion without feedback."""
    return MpcSettings(
        rate=80.0, horizon=1.3, intervals=65, first_interval=0.0, barrier_mu=barrier_mu, rollout_restart=False
    )


class EstimatedDisturbance(Settings):
    """Constant forces on base and arm are learned."""

    kind: Literal["estimated"] = "estimated"


class PushedDisturbance(EstimatedDisturbance):
    """``max_pushed_speed`` [m/s]: a ball that goes faster under a strong force that lasts ends the run."""

    max_pushed_speed: float = Field(PUSHED_SPEED, ge=0.01, le=100)


class ExpectedPush(Settings):
    """``expected_push_time`` [s]: how much longer a detected push is expected to last, for the MPC's limit of the lean (0: pushes are
    ignored)."""

    expected_push_time: float = Field(0.3, ge=0, le=1.0)
