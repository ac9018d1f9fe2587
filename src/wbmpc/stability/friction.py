"""How rough the ground has to be: the least coefficient of friction at which the feet hold a load.

Each foot may press with any force N ≥ 0 and answer with friction of μ N at most (Coulomb). The least μ at which such forces
add up to the load's answer is a linear programme: with friction forces t = μ τ, |τ| ≤ N, the load along the ground is μ times
what τ carries, and 1/μ is made as large as it can be.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.stability.geometry import checked_feet, margin, support_polygon
from wbmpc.stability.zmp import Load, zero_moment_point

#: Corners of the polygon inside the friction circle: the coefficient is never too small, and too large by 0.12 % at most.
CORNERS = 64
#: Part of the weight below which a load along the ground is rounding.
_ROUNDING = 1e-12


def friction_needed(feet: ArrayLike, load: Load) -> float:
    """Least coefficient at which ``feet`` (n, 2) [m] hold a ``load``, in axes of the ground (z along its normal).

    The feet share the load as suits them best, with wheels and legs held. Not a number where the load lifts the robot or tips
    it over.
    """
    points = checked_feet(feet)
    if not margin(support_polygon(points), zero_moment_point(load)) > 0.0:
        return float("nan")
    # In parts of the weight and of the feet's spread, about their middle: the programme's numbers are about 1.
    middle = points.mean(axis=0)
    points = points - middle
    spread, weight = float(np.linalg.norm(points, axis=1).max()), -float(load.force[2])
    force = load.force / weight
    moment = (load.moment - np.cross([*middle, 0.0], load.force)) / (weight * spread)
    size = max(float(np.hypot(*force[:2])), abs(float(moment[2])))
    if size <= _ROUNDING:
        return 0.0
    return size / _carried(points / spread, moment[:2], np.array([*force[:2], moment[2]]) / size)


def _carried(feet: Array, tipping: Array, along: Array) -> float:
    """How many times the load ``along`` the ground (force in x, y, moment about z) the feet (n, 2) hold at a coefficient of 1,
    pressed down by a force of 1 with the moments ``tipping`` about x and y. Unknown: τ (n, 2), N (n) and that number."""
    from scipy.optimize import linprog  # takes as long to import as all the rest of wbmpc

    n, (x, y) = len(feet), feet.T
    balance = np.zeros((6, 3 * n + 1))
    balance[0, 0 : 2 * n : 2] = balance[1, 1 : 2 * n : 2] = 1.0
    balance[2, 0 : 2 * n : 2], balance[2, 1 : 2 * n : 2] = -y, x
    balance[:3, -1] = along
    balance[3:, 2 * n : -1] = np.ones(n), y, -x
    answer = np.array([0.0, 0.0, 0.0, 1.0, -tipping[0], -tipping[1]])
    # One corner of the polygon is where the force points: plain slopes are exact.
    normals = np.arctan2(along[1], along[0]) + 2.0 * np.pi * (np.arange(CORNERS) + 0.5) / CORNERS
    sides = np.kron(np.eye(n), np.stack([np.cos(normals), np.sin(normals)], axis=1))
    reach = -np.cos(np.pi / CORNERS) * np.repeat(np.eye(n), CORNERS, axis=0)
    cones = np.hstack([sides, reach, np.zeros((n * CORNERS, 1))])
    free, positive = (None, None), (0.0, None)
    found = linprog(
        np.append(np.zeros(3 * n), -1.0),
        A_ub=cones,
        b_ub=np.zeros(len(cones)),
        A_eq=balance,
        b_eq=answer,
        bounds=[free] * (2 * n) + [positive] * (n + 1),
    )
    return float(found.x[-1]) if found.status == 0 and found.x[-1] > 0.0 else float("nan")
