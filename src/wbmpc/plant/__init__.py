"""Simulated robots in MuJoCo, perturbed against the planner's model."""

from wbmpc.plant.brakes import BRAKE_TORQUE, Brakes
from wbmpc.plant.door import Door, DoorPlant, ForceSensor
from wbmpc.plant.localisation import Localisation
from wbmpc.plant.perturbation import Draw, Perturbation
from wbmpc.plant.protocol import (
    GlobalPose,
    Plant,
    RezeroCommand,
    RezeroMeasurement,
    SwerveCommand,
    SwerveMeasurement,
    Truth,
    scale_wheels,
)
from wbmpc.plant.rezero import RezeroPlant
from wbmpc.plant.swerve import SwervePlant
from wbmpc.plant.world import TIMESTEP

__all__ = [
    "BRAKE_TORQUE",
    "TIMESTEP",
    "Brakes",
    "Door",
    "DoorPlant",
    "Draw",
    "ForceSensor",
    "GlobalPose",
    "Localisation",
    "Perturbation",
    "Plant",
    "RezeroCommand",
    "RezeroMeasurement",
    "RezeroPlant",
    "SwerveCommand",
    "SwerveMeasurement",
    "SwervePlant",
    "Truth",
    "scale_wheels",
]
