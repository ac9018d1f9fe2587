"""Where the legs of a base stand best: of any number, on hinges or sliding, by the margin of support under the robot at rest."""

from __future__ import annotations

from collections.abc import Callable
from weakref import WeakKeyDictionary

import numpy as np

from wbmpc.arrays import Array
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel
from wbmpc.model.wheels import ModuleGeometry
from wbmpc.stability.configurations import leg_group
from wbmpc.stability.geometry import area, cross, support_polygon
from wbmpc.stability.geometry import margin as margin_to
from wbmpc.stability.robot import StanceOf, standing

#: Positions of a leg that are tried; stances from which the search begins; how often it goes round all legs at most.
PLACES, STARTS, ROUNDS = 25, 5, 12
#: Legs keep so many wheel radii from each other: wheels turn freely beside each other.
APART = 2.2
#: What an area of 1 m² counts against a margin of 1 m, a limit that is passed by 1 m, and a leg that goes all of its way from home: the
#: margin is that of the nearest edge alone, and many stances have the same.
AREA, PASSED, AWAY = 0.02, 20.0, 0.002

#: Stances that were found, by width.
_FOUND: WeakKeyDictionary[RobotModel, dict[float, Array]] = WeakKeyDictionary()


def best_stance(robot: RobotModel, half_width: float = np.inf) -> Array:
    """Positions of the legs (n) [rad, or m of those that slide] with the largest margin of support: from the zero-moment point of the robot
    at rest, its arm at home, to the border of the support polygon.

    ``half_width`` [m]: steer axes stay within it of the body's x axis. Legs stay within their ranges and apart from each other. By coordinate
    ascent from several starts, always the same ones; of one robot once for each width. Raises :class:`InputError` for legs that do not move,
    and where no stance is so narrow.
    """
    found = _FOUND.setdefault(robot, {})
    if half_width not in found:
        found[half_width] = _searched(robot, half_width)
    return found[half_width].copy()


def _searched(robot: RobotModel, half_width: float) -> Array:
    geometry = standing(robot).modules
    if geometry is None or not geometry.legs_move:
        raise InputError(f"{robot.description.name}: its legs are fixed, it has one stance")
    part = robot.state[leg_group(robot)]
    lower, upper = (np.clip(v[part], -np.pi, np.pi) for v in (robot.limits.state_lower, robot.limits.state_upper))
    home, stance, x = np.clip(robot.home[part], lower, upper), StanceOf(robot), robot.home.copy()

    def score(leg: Array) -> float:
        x[part] = leg
        now = stance(x)
        polygon = support_polygon(now.feet)
        away = float(np.mean(np.abs(leg - home) / (upper - lower)))
        passed = beyond(geometry, leg, half_width)
        return float(margin_to(polygon, now.zmp)) + AREA * area(polygon) - PASSED * passed - AWAY * away

    rng = np.random.default_rng(0)
    starts = [home, lower, upper, *rng.uniform(lower, upper, (STARTS - 3, home.size))]
    best = max((climbed(score, start, lower, upper) for start in starts), key=score)
    if beyond(geometry, best, half_width) > 0.0:
        raise InputError(
            f"{robot.description.name}: no stance of its legs, apart from each other, is within {half_width:g} m of the body's axis"
        )
    return best


def climbed(
    score: Callable[[Array], float],
    start: Array,
    lower: Array,
    upper: Array,
    places: int = PLACES,
    rounds: int = ROUNDS,
) -> Array:
    """The legs (n) where no other place of a single leg scores better, of ``places`` in its range, after ``rounds`` over all at most."""
    leg, value = start.copy(), score(start)
    for _ in range(rounds):
        before = value
        for i in range(leg.size):
            for place in np.linspace(lower[i], upper[i], places):
                other = leg.copy()
                other[i] = place
                if (found := score(other)) > value:
                    leg, value = other, found
        if value == before:
            break
    return leg


def beyond(geometry: ModuleGeometry, leg: Array, half_width: float = np.inf) -> float:
    """By how much [m] in sum legs (n) pass the width, or come nearer to each other than their wheels need."""
    feet, hinges = geometry.steer_axes(leg), geometry.hinge
    wide = np.clip(np.abs(feet[:, 1]) - half_width, 0.0, None).sum() if np.isfinite(half_width) else 0.0
    i, j = np.triu_indices(geometry.modules, 1)
    # hinges stand where they stand: no more is asked of legs than of these
    kept = np.minimum(APART * geometry.wheel_radius, np.linalg.norm(hinges[i] - hinges[j], axis=1))
    return float(wide + np.clip(kept - between(hinges[i], feet[i], hinges[j], feet[j]), 0.0, None).sum())


def between(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Smallest distances (n) [m] of lines from a to b to lines from c to d (n, 2 each)."""
    crossed = (cross(b - a, c - a) * cross(b - a, d - a) < 0.0) & (cross(d - c, a - c) * cross(d - c, b - c) < 0.0)
    ends = np.minimum.reduce([_to_line(a, c, d), _to_line(b, c, d), _to_line(c, a, b), _to_line(d, a, b)])
    return np.where(crossed, 0.0, ends)


def _to_line(p: Array, a: Array, b: Array) -> Array:
    along, to = b - a, p - a
    share = np.clip(np.sum(to * along, axis=1) / np.maximum(np.sum(along * along, axis=1), 1e-12), 0.0, 1.0)
    return np.asarray(np.linalg.norm(to - share[:, None] * along, axis=1))
