"""Settings that the ball robot's experiments share; each controller has what it reads."""

from __future__ import annotations

from pydantic import Field

from wbmpc.bases.ball.perturbation import BallHardware, BallPerturbation
from wbmpc.settings import ACTUATOR_TIME_CONSTANT, ControlSettings, MpcTiming, Robot, Settings
from wbmpc.studies.minniti2019.controller_parts import MPC, NoisyTruth, part
from wbmpc.studies.minniti2019.controller_settings import (
    ACCURATE_MPC,
    AccurateController,
    Controller,
    ControllerSettings,
    WholeBodyMpc,
)


class RezeroSettings(Settings):
    """``robot``: a name or a file, of a base of type ball; the weights were found for Rezero. ``mpc``: when the loop plans, whatever
    ``controller`` is in it; ``payload`` [kg]: an unknown mass at the end effector; ``actuator_time_constant`` [s]: that the controller
    assumes, in the middle of what may be."""

    robot: Robot = "rezero"
    plant: BallHardware = BallHardware()
    mpc: MpcTiming = part(MpcTiming, MPC)
    control: ControlSettings = ControlSettings()
    controller: ControllerSettings = WholeBodyMpc()
    payload: float = Field(0.0, ge=0, le=5.0)
    actuator_time_constant: float = Field(ACTUATOR_TIME_CONSTANT, ge=0, le=0.5)

    @property
    def perturbation(self) -> BallPerturbation:
        """The plant, with the noise of the state where that takes the place of sensors."""
        sensed = self.controller.estimator
        noise = sensed.model_dump(exclude={"kind"}) if isinstance(sensed, NoisyTruth) else {}
        return BallPerturbation(**dict(self.plant), **noise)


class ControlledSettings(RezeroSettings):
    """``controller``: the MPC, or a baseline that has the same limits of the drives, with its gains."""

    controller: Controller = WholeBodyMpc()


class AccurateSettings(ControlledSettings):
    """An end effector that is led accurately while the ball has a place of its own: stiff weights, for references that move slowly; so have
    the baselines."""

    controller: AccurateController = ACCURATE_MPC
