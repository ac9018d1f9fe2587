"""The push map: the impulses from which the ball robot recovers, and after which it still stands, over directions and lengths.

To stand is no recovery: a robot that rolls away for ever, or swings its arm between the stops, stands. It recovers if it is back in
its place, and rests there, when the push experiments would push it again (:data:`wbmpc.experiments.rezero_push.NEAR`). A bisection
for each direction, length and criterion; what was run is written after each, so that a map that was interrupted goes on, and one
that was coarse is made finer.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from wbmpc.configuration import configure
from wbmpc.experiments.rezero_push import (
    Outcome,
    RezeroPushBallSettings,
    RezeroPushHandSettings,
    RezeroPushSettings,
    push_once,
)

MODES: dict[str, type[RezeroPushSettings]] = {"ball": RezeroPushBallSettings, "hand": RezeroPushHandSettings}
#: Largest impulse [N s] that is tried, and the width [N s] at which a bisection ends.
MOST, FINE = 320.0, 5.0
#: What is asked of the robot after a push, the harder first: attributes of an outcome.
CRITERIA = ("recovers", "stands")
#: Impulses [N s]: the robot does what is asked after the first, and not after the second.
Bracket = tuple[float, float]
#: What came of a push, by its impulse [N s].
Outcomes = dict[float, Outcome]


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
    point: Point, passes: Callable[[Point, float], bool], fine: float = FINE, known: Bracket | None = None
) -> Bracket:
    """Largest impulse [N s] that the robot ``passes`` (stands after), and the smallest that it fails, by bisection to ``fine``.

    ``known``: a coarser answer to go on from. (MOST, infinite) when it always passes. A robot that fails less and passes more is
    not looked for.
    """
    low, high = known or (0.0, MOST)
    if known is None and passes(point, high):
        return high, float("inf")
    while np.isfinite(high) and high - low > fine:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if passes(point, middle) else (low, middle)
    return low, high


def simulated(point: Point, impulse: float) -> Outcome:
    """What comes of a push with that impulse [N s]."""
    settings = configure(MODES[point.mode], point.given, f"rezero-push-{point.mode}")
    return push_once(settings, point.seed, impulse / point.length, point.direction, point.length)


def bracket(found: Mapping[float, Outcome], criterion: str) -> Bracket | None:
    """What outcomes say of a criterion: the smallest impulse [N s] that fails, and the largest below it that passes; None if there
    are none."""
    if not found:
        return None
    fails = min((i for i, o in found.items() if not getattr(o, criterion)), default=np.inf)
    return max((i for i in found if i < fails), default=0.0), fails


def measure(
    work: tuple[Point, Outcomes], fine: float = FINE, run: Callable[[Point, float], Outcome] = simulated
) -> tuple[str, Outcomes]:
    """The push's key and its outcomes, to ``fine`` [N s] for each criterion, from those that are known. A run counts for both."""
    point, found = work[0], dict(work[1])

    def passes(criterion: str) -> Callable[[Point, float], bool]:
        def tried(point: Point, impulse: float) -> bool:
            found[impulse] = found.get(impulse) or run(point, impulse)
            return bool(getattr(found[impulse], criterion))

        return tried

    for criterion in CRITERIA:
        impulse_at_failure(point, passes(criterion), fine, bracket(found, criterion))
    return point.key, found


def _ready(found: Outcomes, fine: float) -> bool:
    """Whether outcomes answer for every criterion to ``fine``."""
    brackets = [bracket(found, c) for c in CRITERIA]
    return all(b is not None and not fine < b[1] - b[0] < np.inf for b in brackets)


def read(file: Path) -> dict[str, Outcomes]:
    """The outcomes of a map's file, by push; none where there is no file."""
    rows = json.loads(file.read_text()) if file.exists() else {}
    return {key: {float(i): Outcome(**o) for i, o in found.items()} for key, found in rows.items()}


def push_map(
    todo: list[Point],
    file: Path,
    work: Callable[[list[tuple[Point, Outcomes]]], Iterable[tuple[str, Outcomes]]],
    fine: float = FINE,
) -> Iterator[tuple[str, Outcomes]]:
    """Outcomes by push, as they come. What ``file`` has to within ``fine`` is kept; what it has more coarsely is gone on with.

    ``work`` does :func:`measure` for many pushes, in any order, e.g. in several processes.
    """
    done = read(file)
    ready = [p.key for p in todo if _ready(done.get(p.key, {}), fine)]
    yield from ((key, done[key]) for key in ready)
    for key, found in work([(p, done.get(p.key, {})) for p in todo if p.key not in ready]):
        done[key] = found
        part = file.with_suffix(".part")
        rows = {k: {str(i): asdict(o) for i, o in sorted(v.items())} for k, v in done.items()}
        part.write_text(json.dumps(rows, indent=1) + "\n")
        part.replace(file)  # a file that is half written never stands there
        yield key, found
