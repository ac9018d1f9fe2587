"""Settings of obstacles that come from topics."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from wbmpc.settings import Settings


class ObstacleSettings(Settings):
    """Of ``topics.detections``, ``topics.occupancy_grid`` and ``topics.points``.

    ``max_age`` [s]: by its stamp, of the newest message of detections and of points; later the robot stops. ``grid_max_age`` [s]: the
    same of the occupancy grid (left out: a map that is published once). ``hold`` [s]: how long an object stays that newer messages do not
    have. ``std`` [m]: standard deviation of detected positions, by twice of which margins grow. ``max_speed`` [m/s] that a detected object
    may have, which is estimated from its positions; one that seems faster counts as standing.

    ``occupied``: cells of the occupancy grid from this value on are solid; ``unknown``: what cells without a value are; ``height`` [m] above
    the floor up to which they are. ``cell`` [m] of the local map of points; ``reach`` [m]: points farther from their sensor do not
    count.
    """

    max_age: float = Field(0.5, ge=0.05, le=10)
    grid_max_age: float | None = Field(None, ge=0.05, le=60)
    hold: float = Field(0.5, ge=0, le=10)
    std: float = Field(0.02, ge=0, le=1)
    max_speed: float = Field(3.0, ge=0, le=20)
    occupied: int = Field(65, ge=1, le=100)
    unknown: Literal["free", "occupied"] = "free"
    height: float = Field(2.0, ge=0.1, le=100)
    cell: float = Field(0.05, ge=0.02, le=0.5)
    reach: float = Field(4.0, ge=0.5, le=20)
