"""Settings of simulated experiments."""

from __future__ import annotations

from pydantic import Field

from wbmpc.settings import Settings
from wbmpc.simulation.localization import Localization


class LidarSettings(Settings):
    """A simulated source of global poses, as a LIDAR with a map is: ``rate`` [Hz]: rate of the poses; ``age`` [s]: age of a measurement
    at its delivery; ``position`` [m]: standard deviation of each coordinate; ``yaw`` [rad]: standard deviation of the heading."""

    rate: float = Field(10.0, gt=0, le=1000)
    age: float = Field(0.050, ge=0, le=0.4)
    position: float = Field(0.005, gt=0, le=100)
    yaw: float = Field(0.002, gt=0, le=3.2)

    def source(self, seed: int) -> Localization:
        """The simulated source."""
        return Localization(self.rate, self.age, self.position, self.yaw, seed)
