"""The ``base`` section of a robot with a differential drive."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from wbmpc.bases.planar_motion.description import Place, PlanarBaseDescription


class DifferentialBaseDescription(PlanarBaseDescription):
    """Driven wheels on one axle. ``casters`` (x, y) [m] in the axes of the body: what else carries the robot in the simulator; left
    out: one ahead of and one behind the axle, at half the distance between the wheels."""

    type: Literal["differential"]
    casters: tuple[tuple[Place, Place], ...] | None = Field(None, min_length=1)
