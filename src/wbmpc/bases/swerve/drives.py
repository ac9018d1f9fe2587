"""What a swerve robot's drives make of commands: their first-order lag, and the arm's sag under loads that are not fed forward."""

from __future__ import annotations

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.tracking_step import learn_sag
from wbmpc.control.direct import lag_share
from wbmpc.kernel.step import bind
from wbmpc.model.robot import RobotModel

#: Time [s] over which the arm's sag is learned, longer than drives lag; the most that is taken for it [rad/s].
SAG_TIME, MAX_SAG = 1.0, 0.15


class DriveModel:
    """Drives of first order with a ``lag`` [s]. ``rates`` (nu): what they make of the commands now; the planned steering has no
    lag, so its rates are 0 where ``planned_steering``; ``turning`` (n) [rad/s]: of the steering drives in any case. ``arrays``: both,
    which :mod:`wbmpc.bases.swerve.tracking_step` writes."""

    def __init__(self, robot: RobotModel, period: float, lag: float, planned_steering: bool) -> None:
        self.lag, self.blend = lag, lag_share(period, lag)
        self.arrays = {"rates": np.zeros(robot.input.size), "turning": np.zeros(swerve_base(robot).geometry.modules)}
        self.rates, self.turning = self.arrays["rates"], self.arrays["turning"]


class ArmDrives:
    """The arm's ``count`` drives. ``sag`` (m) [rad/s]: by what joints turn besides their commands; ``command`` (m), the last one;
    ``rate`` and ``mean`` (m): what lagging drives make of the commands now and over the last period. ``arrays``: these."""

    def __init__(self, count: int, period: float, lag: float) -> None:
        self._period, self._lag, self._blend = period, lag, lag_share(period, lag)
        self.arrays = {name: np.zeros(count) for name in ("sag", "command", "rate", "mean", "turned")}
        self.sag, self.command, self.mean = (self.arrays[name] for name in ("sag", "command", "mean"))
        self._learn = bind(learn_sag, self.arrays, m=count, largest=MAX_SAG)

    def learn(self, turned: Array, h: float) -> None:
        """The sag from what the joints ``turned`` (m) [rad] in h [s] and what drives should have made of the commands."""
        if h > 0.0:
            self.arrays["turned"][:] = turned
            self._learn(float(1.0 - np.exp(-h / SAG_TIME)), h)

    def follow(self, command: Array) -> None:
        """A period under a command (m) [rad/s]."""
        a = self.arrays
        behind = a["rate"] - command
        a["command"][:], a["mean"][:] = command, command + behind * self._blend * self._lag / self._period
        a["rate"][:] = command + behind * (1.0 - self._blend)
