"""The leg configurations H, X and A of a base with two front and two rear legs.

Source: Pankert et al., RA-L 2022 (arXiv 2206.15298), Fig. 2 and Table I. The paper gives no angles; these reproduce all
six areas of the table. (The commands of the authors' release: 0.72 rad for X and −0.5,
0.72 rad for A, give 1.80 and 0.45, 1.16 and 0.75 m².)
"""

from __future__ import annotations

import numpy as np

from wbmpc.arrays import Array
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel
from wbmpc.stability.configurations import hinged

#: Outward angles [rad] of front and rear legs from the body's x axis, ahead and behind (negative: turned inwards).
CONFIGURATIONS = {"H": (0.0, 0.0), "X": (np.pi / 4, np.pi / 4), "A": (-0.498, 0.747)}
#: Names of hinges by where they are: left front, right front, left and right behind.
CORNERS = ("LF", "RF", "LB", "RB")


def corners(robot: RobotModel) -> dict[str, int]:
    """Which module (index) is at which of the :data:`CORNERS`.

    Raises :class:`InputError` for bases without two front and two rear hinges, one on each side.
    """
    found = _corners(robot)
    if found is None:
        raise InputError(
            f"{robot.description.name}: configurations {', '.join(CONFIGURATIONS)} are of bases with two front and two rear legs, one on "
            "each side; others have angles only"
        )
    return found


def _corners(robot: RobotModel) -> dict[str, int] | None:
    """The same; None for bases whose hinges are elsewhere."""
    g = hinged(robot)
    x, y = (g.hinge - g.hinge.mean(axis=0)).T
    sides, ends = np.where(y > 0.0, "L", "R"), np.where(x > 0.0, "F", "B")
    found = {f"{side}{end}": i for i, (side, end) in enumerate(zip(sides, ends, strict=True))}
    return {name: found[name] for name in CORNERS} if g.modules == len(found) == len(CORNERS) else None


def configurations(robot: RobotModel) -> dict[str, Array]:
    """Leg angles (4) [rad] of H, X and A, within the hinges' limits or not; empty where legs are fixed, or not at the :data:`CORNERS`."""
    if "leg" not in robot.state or (places := _corners(robot)) is None:
        return {}
    return {name: _angles(robot, places, *turned) for name, turned in CONFIGURATIONS.items()}


def _angles(robot: RobotModel, places: dict[str, int], ahead: float, behind: float) -> Array:
    heading = hinged(robot).leg_heading
    # a leg along its half of the x axis moves its foot to the left by a positive angle if it is a front leg, else by a negative one
    target = {"LF": (0.0, ahead), "RF": (0.0, -ahead), "LB": (np.pi, -behind), "RB": (np.pi, behind)}
    angles = np.zeros(len(CORNERS))
    for corner, (axis, turn) in target.items():
        i = places[corner]
        # where a leg stands at joint angle 0 is the description's choice
        angles[i] = turn - ((heading[i] - axis + np.pi) % (2.0 * np.pi) - np.pi)
    part = robot.state["leg"]
    low, high = robot.limits.state_lower[part], robot.limits.state_upper[part]
    for other in (angles + 2.0 * np.pi, angles - 2.0 * np.pi):  # as where a range is 0 to 2π
        angles = np.where(((angles < low) | (angles > high)) & (low <= other) & (other <= high), other, angles)
    return angles
