"""The leg configurations H, X and A of a base with two front and two rear legs.

Source: Pankert et al., RA-L 2022 (arXiv 2206.15298), Fig. 2 and Table I. The paper gives no angles; these reproduce all
six areas of the table. (The commands of the authors' release: 0.72 rad for X and −0.5,
0.72 rad for A, give 1.80 and 0.45, 1.16 and 0.75 m².)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from wbmpc.checks import parse_number
from wbmpc.errors import InputError, unknown_name
from wbmpc.model.robot import RobotModel
from wbmpc.model.wheels import ModuleGeometry
from wbmpc.stability.robot import standing

#: Outward angles [rad] of front and rear legs from the body's x axis, ahead and behind (negative: turned inwards).
CONFIGURATIONS = {"H": (0.0, 0.0), "X": (np.pi / 4, np.pi / 4), "A": (-0.498, 0.747)}


def leg_angles(robot: RobotModel, configuration: str | Sequence[float]) -> NDArray[np.float64]:
    """Leg angles (n) [rad] of a configuration by name, or of n joint angles given as numbers or as "0.1,0,-0.2,0".

    Names need a base with two front and two rear hinges, one on each side (:func:`corners`). Raises :class:`InputError` for
    angles outside the limits.
    """
    geometry = _hinged(robot)
    if isinstance(configuration, str) and configuration.upper() in CONFIGURATIONS:
        return _named(robot, configuration.upper())
    angles = _parsed(configuration, geometry.modules)
    reject_beyond(robot, "leg", angles, "configuration")
    return angles


def _hinged(robot: RobotModel) -> ModuleGeometry:
    """The legs of a robot, if they can turn."""
    geometry = standing(robot).modules
    if geometry is None or not geometry.legs_move:
        raise InputError(
            f"{robot.description.name}: its legs are fixed, so it has no leg configurations; valid: robots with hinged legs"
        )
    return geometry


def reject_beyond(robot: RobotModel, group: str, angles: NDArray[np.float64], what: str) -> None:
    """Raise :class:`InputError` where an angle [rad] of a joint of the group is outside its limits."""
    part, names = robot.state[group], robot.state.groups[group]
    limits = robot.limits.state_lower[part], robot.limits.state_upper[part]
    for name, value, low, high in zip(names, angles, *limits, strict=True):
        if not low <= value <= high:
            raise InputError(f"{what}: {name} at {value:g} rad is outside its limits {low:g} to {high:g}")


def corners(robot: RobotModel) -> dict[str, int]:
    """Which module (index) is left front, right front, left and right behind: ``LF``, ``RF``, ``LB``, ``RB``.

    Raises :class:`InputError` for bases without two front and two rear hinges, one on each side.
    """
    g = _hinged(robot)
    x, y = (g.hinge - g.hinge.mean(axis=0)).T
    sides, ends = np.where(y > 0.0, "L", "R"), np.where(x > 0.0, "F", "B")
    found = {f"{side}{end}": i for i, (side, end) in enumerate(zip(sides, ends, strict=True))}
    if g.modules != 4 or len(found) != 4:
        raise InputError(
            f"{robot.description.name}: configurations H, X and A are of bases with two front and two rear legs, one on each side; "
            "others have angles only"
        )
    return {name: found[name] for name in ("LF", "RF", "LB", "RB")}


def _named(robot: RobotModel, name: str) -> NDArray[np.float64]:
    places = corners(robot)
    (ahead, behind), heading = CONFIGURATIONS[name], _hinged(robot).leg_heading
    # a leg along its half of the x axis moves its foot to the left by a positive angle if it is a front leg, else by a negative one
    target = {"LF": (0.0, ahead), "RF": (0.0, -ahead), "LB": (np.pi, -behind), "RB": (np.pi, behind)}
    angles = np.zeros(4)
    for corner, (axis, turn) in target.items():
        i = places[corner]
        # where a leg stands at joint angle 0 is the description's choice
        angles[i] = turn - ((heading[i] - axis + np.pi) % (2.0 * np.pi) - np.pi)
    part = robot.state["leg"]
    low, high = robot.limits.state_lower[part], robot.limits.state_upper[part]
    for other in (angles + 2.0 * np.pi, angles - 2.0 * np.pi):  # as where a range is 0 to 2π
        angles = np.where(((angles < low) | (angles > high)) & (low <= other) & (other <= high), other, angles)
    reject_beyond(robot, "leg", angles, f"configuration {name}")
    return angles


def _parsed(configuration: str | Sequence[float], legs: int) -> NDArray[np.float64]:
    try:
        parts = configuration.replace(",", " ").split() if isinstance(configuration, str) else configuration
        angles = np.array([parse_number(v) if isinstance(v, str) else float(v) for v in parts])
    except ValueError:
        choices = [*CONFIGURATIONS, f"{legs} angles in rad such as {','.join(['0.1'] * legs)}"]
        raise unknown_name("configuration", str(configuration), choices) from None
    if angles.shape != (legs,) or not np.isfinite(angles).all():
        raise InputError(f"configuration: {legs} angles [rad] are needed, finite, one per leg, got {configuration!r}")
    return angles
