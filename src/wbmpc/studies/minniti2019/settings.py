"""Settings that the ball robot's experiments share; what the chosen controller and estimator do not read is an error."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from wbmpc.bases.ball.defaults import BodyCost, EndEffectorCost, RezeroCost
from wbmpc.bases.ball.perturbation import BallPerturbation
from wbmpc.bases.ball.settings import LEARNED, STEPS_AND_PUSHES, mpc_settings
from wbmpc.configuration import POSITIVE, OneOf, Rules
from wbmpc.settings import ACTUATOR_TIME_CONSTANT, MpcSettings, Robot, Settings
from wbmpc.simulation.settings import ExperimentSettings
from wbmpc.studies.minniti2019.controller_settings import (
    PLANNERS,
    AccurateController,
    AccurateMpc,
    Controller,
    WholeBodyMpc,
)


class SensorFilter(Settings):
    """The state from encoders, gyro and accelerometer."""

    kind: Literal["filter"] = "filter"
    ignores: ClassVar[tuple[str, ...]] = tuple(f"plant.{n}_noise" for n in ("position", "angle", "speed", "rate"))


class NoisyTruth(Settings):
    """The state from the simulator, with noise, in which all is a push."""

    kind: Literal["truth"] = "truth"
    ignores: ClassVar[tuple[str, ...]] = (
        *(f"plant.{sensor}_{error}" for sensor in ("gyro", "accel") for error in ("noise", "bias", "walk")),
        "controller.expected_push_time",
    )


class RezeroSettings(ExperimentSettings):
    """``robot``: a name or a file, of a base of type ball; the weights were found for Rezero.
    ``estimator``: the state from the sensors (filter), or from the simulator with noise (truth); ``payload`` [kg]: an
    unknown mass at the end effector; ``estimate_disturbance``: whether constant disturbances are estimated;
    ``actuator_time_constant`` [s]: that the controller assumes, in the middle of what may be."""

    robot: Robot = "rezero"
    plant: BallPerturbation = BallPerturbation()
    mpc: MpcSettings = mpc_settings(barrier_mu=3e-2)
    cost: RezeroCost = STEPS_AND_PUSHES
    estimator: OneOf[SensorFilter | NoisyTruth] = SensorFilter()
    estimate_disturbance: bool = True
    payload: float = Field(0.0, ge=0, le=5.0)
    actuator_time_constant: float = Field(ACTUATOR_TIME_CONSTANT, ge=0, le=0.5)

    only_with: ClassVar[Rules] = {"cost.speed_slack": {"mpc.limits": "hard"}}


class ControlledSettings(RezeroSettings):
    """``controller``: the MPC, or a baseline that has its estimator and the same limits of the drives, with its gains."""

    controller: Controller = WholeBodyMpc()

    only_with: ClassVar[Rules] = {
        "mpc.horizon": {"controller.kind": PLANNERS},
        "controller.estimate_payload": LEARNED,
        "controller.max_pushed_speed": LEARNED,
        "controller.expected_push_time": {"cost.lean": POSITIVE},
    }


class AccurateSettings(ControlledSettings):
    """An end effector that is led accurately while the ball has a place of its own: stiff weights, for references that move slowly; so have
    the baselines."""

    cost: RezeroCost = RezeroCost(
        end_effector=EndEffectorCost(weight=1000.0, orientation=2.0, roll=0.0),
        body=BodyCost(ball=400.0, yaw=20.0),
        lean=0.6,
    )
    controller: AccurateController = AccurateMpc()
