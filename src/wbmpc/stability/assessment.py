"""All figures of one stance in one place: what ``wbmpc stability`` prints and draws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel
from wbmpc.stability.configurations import configuration_positions, leg_group, reject_beyond
from wbmpc.stability.geometry import Region, area, overlap_regions, region_margin, support_polygon
from wbmpc.stability.robot import Stance, StanceOf, standing
from wbmpc.stability.zmp import GRAVITY


@dataclass(frozen=True)
class Assessment:
    """A robot in a configuration under a wrench: its ``stance`` at the state ``x`` (nx), and the ``regions`` in which two or
    more support triangles overlap (the largest first)."""

    robot: RobotModel
    configuration: str
    x: Array
    stance: Stance
    regions: list[Region]

    @property
    def names(self) -> list[str]:
        """Names of the wheels, in the order of the feet."""
        return list(standing(self.robot).names)

    @property
    def polygon_area(self) -> float:
        """Area [m²] of the support polygon."""
        return area(support_polygon(self.stance.feet))

    @property
    def double_support_area(self) -> float:
        """Area [m²] of the largest region in which two or more support triangles overlap; 0 on three feet."""
        return max((r.area for r in self.regions), default=0.0)

    @property
    def region_margin(self) -> float:
        """How far [m] the zero-moment point may move before the robot can rock (negative: it tips over)."""
        return float(region_margin(self.stance.feet, self.stance.zmp))

    def summary(self) -> dict[str, Any]:
        """Everything as plain numbers and lists (SI units); what is not a number is None. ``stays_upright``: it does not tip over;
        whether it slides, ``friction_needed`` says (None if it tips over)."""
        s = self.stance
        group = leg_group(self.robot)
        legs = self.x[self.robot.state[group]] if group else np.zeros(0)
        return {
            "robot": self.robot.description.name,
            "configuration": self.configuration,
            "leg_angles": _plain(legs),
            "feet": dict(zip(self.names, _plain(s.feet), strict=True)),
            "support_polygon_area": self.polygon_area,
            "double_support_area": self.double_support_area,
            "regions": [{"area": r.area, "triangles": [self._named(t) for t in r.triangles]} for r in self.regions],
            "mass": s.mass,
            "center_of_mass": _plain(s.com),
            "force": _plain(s.force),
            "zero_moment_point": _plain(s.zmp) if np.isfinite(s.zmp).all() else None,
            "polygon_margin": _plain(s.polygon_margin),
            "triangle_margins": [
                {"triangle": self._named(t), "margin": _plain(m)} for t, m in s.triangle_margins.items()
            ],
            "region_margin": _plain(self.region_margin),
            "stays_upright": s.polygon_margin > 0.0,
            "friction_needed": _plain(s.friction_needed),
        }

    def text(self) -> str:
        """The figures for people."""
        s, double = self.stance, self.double_support_area
        rows = [
            f"{self.robot.description.name}, {self.title}",
            f"  support polygon              {self.polygon_area:.3f} m2",
            f"  largest region of 2 triangles {double:.3f} m2" if self.regions else "  no two triangles overlap",
            f"  mass, center of mass         {s.mass:.2f} kg, ({s.com[0]:.3f}, {s.com[1]:.3f}, {s.com[2]:.3f}) m",
        ]
        if not np.isfinite(s.zmp).all():
            return "\n".join([*rows, "  the load does not press on the ground: the robot lifts off"])
        rows.append(f"  zero-moment point            ({s.zmp[0]:.3f}, {s.zmp[1]:.3f}) m")
        rows.append(f"  margin to the polygon        {1e3 * s.polygon_margin:.1f} mm")
        for triangle, m in s.triangle_margins.items():
            rows.append(f"  margin to {', '.join(self._named(triangle))}: {1e3 * m:.1f} mm")
        needed = s.friction_needed
        rows.append(f"  friction needed not to slide {'–' if np.isnan(needed) else f'{needed:.2f}'}")
        if s.polygon_margin <= 0.0:
            rows.append("  the robot tips over")
        else:
            rows.append(f"  it cannot rock while the point moves by less than {1e3 * self.region_margin:.1f} mm")
        return "\n".join(rows)

    @property
    def title(self) -> str:
        """The configuration in words."""
        words = {"home": "at home", "angles": "with the given leg angles"}
        return words.get(self.configuration, f"configuration {self.configuration}")

    def _named(self, feet: Sequence[int]) -> list[str]:
        return [self.names[i] for i in feet]


def _plain(value: ArrayLike) -> Any:
    array = np.asarray(value, float)
    if not array.ndim:
        return float(array) if np.isfinite(array) else None
    return [_plain(v) for v in array]


def _arm_angles(robot: RobotModel, arm: ArrayLike) -> Array:
    angles = np.asarray(arm, float)
    size = len(robot.state.groups["arm"])
    if angles.shape != (size,) or not np.isfinite(angles).all():
        raise InputError(f"arm: {size} finite angles [rad] are needed, got {angles}")
    reject_beyond(robot, "arm", angles, "arm")
    return angles


def assess(
    robot: RobotModel,
    configuration: str | Sequence[float] | None = None,
    wrench: ArrayLike = (0.0,) * 6,
    gravity: ArrayLike = GRAVITY,
    arm: ArrayLike | None = None,
) -> Assessment:
    """The robot at rest: at its home, but with the legs in a ``configuration`` (a name or angles [rad]) and the arm at the
    angles ``arm`` [rad] if given; the world's ``wrench`` (6) on the end effector (force [N], moment [N m]), ``gravity`` (3) [m/s²],
    both in the frame of the ground (z along its normal, also on a slope). Raises :class:`InputError` for angles outside the
    limits."""
    steered, x = standing(robot).steered, robot.home.copy()
    name = "home"
    if configuration is not None:
        angles = configuration_positions(robot, configuration)
        assert steered is not None  # what has leg angles has legs
        x = steered.with_legs(x, angles)
        name = configuration.upper() if isinstance(configuration, str) and len(configuration) == 1 else "angles"
    if arm is not None:
        x[robot.state["arm"]] = _arm_angles(robot, arm)
    stance = StanceOf(robot)(x, wrench, gravity)
    return Assessment(robot, name, x, stance, overlap_regions(stance.feet))
