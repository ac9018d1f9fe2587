"""The push map: the impulse at which the ball robot falls, over directions and lengths of pushes.

One bisection for each direction and length; results are written after each, so that a map that was interrupted goes on, and
one that was coarse is made finer.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wbmpc.configuration import configure
from wbmpc.experiments.rezero_push import RezeroPushBallSettings, RezeroPushHandSettings, RezeroPushSettings, survives

MODES: dict[str, type[RezeroPushSettings]] = {"ball": RezeroPushBallSettings, "hand": RezeroPushHandSettings}
#: Largest impulse [N s] that is tried, and the width [N s] at which a bisection ends.
MOST, FINE = 320.0, 5.0
#: Impulses [N s]: the robot stands after the first and falls after the second.
Bracket = tuple[float, float]


@dataclass(frozen=True)
class Point:
    """A push: held "ball" or "hand", ``direction`` [rad] in the horizontal plane, ``length`` [s]; ``seed`` of the plant;
    ``given``: other settings of the run (``key=value``), e.g. another controller."""

    mode: str
    direction: float
    length: float
    seed: int
    given: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        push = f"{self.mode}, {np.rad2deg(self.direction):.1f} deg, {self.length:g} s, seed {self.seed}"
        return ", ".join([push, *sorted(self.given)])


def points(
    mode: str, directions: int, lengths: tuple[float, ...], seed: int, given: tuple[str, ...] = ()
) -> list[Point]:
    """All pushes of a map."""
    angles = 2.0 * np.pi * np.arange(directions) / directions
    return [Point(mode, float(a), length, seed, given) for length in lengths for a in angles]


def impulse_at_failure(
    point: Point, stands: Callable[[Point, float], bool], fine: float = FINE, known: Bracket | None = None
) -> Bracket:
    """Largest impulse [N s] after which the robot stands, and the smallest after which it falls, by bisection to ``fine``.

    ``known``: a coarser answer to go on from. (MOST, infinite) when it always stands. A robot that falls after less and stands
    after more is not looked for.
    """
    low, high = known or (0.0, MOST)
    if known is None and stands(point, high):
        return high, float("inf")
    while np.isfinite(high) and high - low > fine:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stands(point, middle) else (low, middle)
    return low, high


def simulated(point: Point, impulse: float) -> bool:
    """Whether the robot stands after a push with that impulse [N s]."""
    settings = configure(MODES[point.mode], point.given, f"rezero-push-{point.mode}")
    result = survives(settings, point.seed, impulse / point.length, point.direction, point.length)
    return bool(result["stands"])


def measure(work: tuple[Point, Bracket | None], fine: float = FINE) -> tuple[str, Bracket]:
    """The push's key and its impulses [N s], simulated, to ``fine``, from what is known of them."""
    point, known = work
    return point.key, impulse_at_failure(point, simulated, fine, known)


def push_map(
    todo: list[Point],
    file: Path,
    work: Callable[[list[tuple[Point, Bracket | None]]], Iterable[tuple[str, Bracket]]],
    fine: float = FINE,
) -> Iterator[tuple[str, list[float | None]]]:
    """Impulses [N s] of (stands, falls) by push, as they come (falls: None if it never does). What ``file`` has to within
    ``fine`` is kept; what it has more coarsely is gone on with.

    ``work`` does :func:`measure` for many pushes, in any order, e.g. in several processes.
    """
    done: dict[str, list[float | None]] = json.loads(file.read_text()) if file.exists() else {}
    known = {p.key: _bracket(*done[p.key]) for p in todo if p.key in done}
    ready = [p.key for p in todo if p.key in known and not fine < known[p.key][1] - known[p.key][0] < np.inf]
    yield from ((key, done[key]) for key in ready)
    for key, (stands, falls) in work([(p, known.get(p.key)) for p in todo if p.key not in ready]):
        done[key] = [stands, falls if np.isfinite(falls) else None]
        part = file.with_suffix(".part")
        part.write_text(json.dumps(done, indent=1) + "\n")
        part.replace(file)  # a file that is half written never stands there
        yield key, done[key]


def _bracket(stands: float | None, falls: float | None) -> Bracket:
    """From a file, which has None for infinity."""
    return float(stands or 0.0), np.inf if falls is None else float(falls)
