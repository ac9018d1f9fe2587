"""Messages, inputs and policies for tests of the swerve robot's controller."""

from __future__ import annotations

import numpy as np

from toys import robot
from wbmpc.bases.swerve.estimator import EstimatorSettings
from wbmpc.bases.swerve.messages import SwerveMeasurement
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.policy import Policy

PERIOD = 0.0025
NO_GYRO = EstimatorSettings(use_gyro=False)
HURRIED = robot("swerve-ur10")
SWERVE = RobotModel(  # follows at once: no limits of acceleration
    HURRIED.description.model_copy(
        update={"limits": HURRIED.description.limits.model_copy(update={"acceleration": {}})}
    )
)


def constant_policy(u: np.ndarray, start: float = 0.0, steer: float = 0.0) -> Policy:
    """An input that holds, and a plan whose steering angles rise by 1 rad/s from ``steer``."""
    times = start + np.linspace(0.0, 10.0, 11)
    x = np.zeros((11, SWERVE.state.size))
    x[:, SWERVE.state["steer"]] = steer + (times - start)[:, None]
    return Policy(times, x, np.tile(u, (10, 1)), np.zeros((10, u.size, SWERVE.state.size)))


def swerve_input(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.5, 0.5, SWERVE.input.size)


def message(t: float = 0.0, **values: np.ndarray) -> SwerveMeasurement:
    parts = {"leg": np.zeros(4), "steer": np.zeros(4), "wheel": np.zeros(4), "arm": np.zeros(6), **values}
    return SwerveMeasurement(t, **parts)
