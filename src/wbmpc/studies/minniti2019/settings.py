"""Settings that the ball robot's experiments share; what the chosen controller and estimator do not read is an error."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from wbmpc.bases.ball.defaults import BodyCost, EndEffectorCost, RezeroCost
from wbmpc.bases.ball.perturbation import BallPerturbation
from wbmpc.bases.ball.settings import BallControllerSettings
from wbmpc.configuration import POSITIVE, OnlyWith, Rules, unused
from wbmpc.settings import Robot
from wbmpc.simulation.settings import ExperimentSettings
from wbmpc.studies.minniti2019.baselines import (
    ACCURATE_BASELINES,
    BaselineSettings,
    Controller,
    PolicyTracking,
    Tracking,
    by_controller,
)

#: What the filter alone reads of the simulated sensors, and what only the state of the simulator has [of ``plant``].
INERTIAL = tuple(f"plant.{sensor}_{kind}" for sensor in ("gyro", "accel") for kind in ("noise", "bias", "walk"))
STATE_NOISE = tuple(f"plant.{kind}_noise" for kind in ("position", "angle", "speed", "rate"))


class RezeroSettings(BallControllerSettings, ExperimentSettings):
    """``robot``: a name or a file, of a base of type ball; the weights were found for Rezero.
    ``estimator``: the state from the sensors (filter), or from the simulator with noise (truth); ``payload`` [kg]: an
    unknown mass at the end effector; ``controller``: the MPC, or a baseline that has its estimator and the same limits of the drives,
    with its gains (``baseline``); ``tracking`` of the MPC's plans. ``only_with``: what the chosen controller and estimator read."""

    robot: Robot = "rezero"
    plant: BallPerturbation = BallPerturbation()
    estimator: Literal["filter", "truth"] = "filter"
    payload: float = Field(0.0, ge=0, le=5.0)
    controller: Controller = "mpc"
    baseline: BaselineSettings = BaselineSettings()
    tracking: Tracking = PolicyTracking()

    only_with: ClassVar[Rules] = {
        **by_controller(),
        **unused("cost.torque.force", "cost.torque.moment"),
        **dict.fromkeys(INERTIAL, OnlyWith(estimator="filter")),
        **dict.fromkeys(STATE_NOISE, OnlyWith(estimator="truth")),
        "expected_push_time": OnlyWith(controller="mpc")
        & OnlyWith(estimator="filter")
        & OnlyWith({"cost.lean": POSITIVE}),
        "cost.speed_slack": by_controller()["cost.speed_slack"] & OnlyWith({"mpc.limits": "hard"}),
    }


class AccurateSettings(RezeroSettings):
    """An end effector that is led accurately while the ball has a place of its own: stiff weights, for references that move slowly; so have
    the baselines."""

    expected_push_time: float = Field(0.0, ge=0, le=1.0)
    cost: RezeroCost = RezeroCost(
        end_effector=EndEffectorCost(weight=1000.0, orientation=2.0, roll=0.0),
        body=BodyCost(ball=400.0, yaw=20.0),
        lean=0.6,
    )
    baseline: BaselineSettings = ACCURATE_BASELINES
