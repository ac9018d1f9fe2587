"""What a swerve robot's drives make of commands: their first-order lag, and the arm's sag under loads that nobody fed forward."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wbmpc.model.robot import RobotModel

Array = NDArray[np.float64]
#: Time [s] over which the arm's sag is learned, longer than drives lag; the most that is taken for it [rad/s].
SAG_TIME, MAX_SAG = 1.0, 0.15


def lag_share(period: float, lag: float) -> float:
    """Share of the way to a command that a drive of first order goes in a period [s]; 1 without a ``lag`` [s]."""
    return float(1.0 - np.exp(-period / lag)) if lag > 0.0 else 1.0


class DriveModel:
    """Drives of first order with a ``lag`` [s]. ``rates`` (nu): what they make of the commands now; the planned steering has no
    lag, so its rates are 0 where ``planned_steering``; ``turning`` (n) [rad/s]: of the steering drives in any case."""

    def __init__(self, robot: RobotModel, period: float, lag: float, planned_steering: bool) -> None:
        self.lag, self._blend, self._planned_steering = lag, lag_share(period, lag), planned_steering
        self._steer = robot.input["steer"]
        self.rates: Array = np.zeros(robot.input.size)
        self.turning: Array = np.zeros(robot.base.geometry.modules)

    def follow(self, sent: Array) -> None:
        """A period under a command ``sent`` (nu)."""
        self.rates[self._steer] = self.turning
        self.rates += self._blend * (sent - self.rates)
        self.turning = self.rates[self._steer].copy()
        if self._planned_steering:
            self.rates[self._steer] = 0.0


class ArmDrives:
    """The arm's ``count`` drives. ``sag`` (m) [rad/s]: by what joints turn besides their commands; ``command`` (m), the last one;
    ``rate`` and ``mean`` (m): what lagging drives make of the commands now and over the last period."""

    def __init__(self, count: int, period: float, lag: float) -> None:
        self._period, self._lag, self._blend = period, lag, lag_share(period, lag)
        self.sag, self.command, self.rate, self.mean = np.zeros((4, count))

    def learn(self, turned: Array, h: float) -> None:
        """The sag from what the joints ``turned`` (m) [rad] in h [s] and what drives should have made of the commands."""
        if h > 0.0:
            share = 1.0 - np.exp(-h / SAG_TIME)
            self.sag = np.clip(self.sag + share * (turned / h - self.mean - self.sag), -MAX_SAG, MAX_SAG)

    def follow(self, command: Array) -> None:
        """A period under a command (m) [rad/s]."""
        behind = self.rate - command
        self.command, self.mean = command, command + behind * self._blend * self._lag / self._period
        self.rate = command + behind * (1.0 - self._blend)
