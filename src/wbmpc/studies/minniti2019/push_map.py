"""The push map: the impulses from which the ball robot recovers, and after which it still stands, over directions and lengths.

To stand is no recovery: a robot that rolls away for ever, or swings its arm between the stops, stands. It recovers if it is back in
its place, and rests there, when the push experiments would push it again (:data:`wbmpc.studies.minniti2019.recovery.NEAR`). A bisection
for each direction, length and criterion; what came of a push is written at once, so that a map that was interrupted goes on, and
one that was coarse is made finer.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from wbmpc.configuration import configure
from wbmpc.errors import InputError
from wbmpc.studies.minniti2019.push import RezeroPushBallSettings, RezeroPushHandSettings, RezeroPushSettings
from wbmpc.studies.minniti2019.push_once import Outcome, push_once

MODES: dict[str, type[RezeroPushSettings]] = {"ball": RezeroPushBallSettings, "hand": RezeroPushHandSettings}
#: Largest impulse [N s] that is tried, and the width [N s] at which a bisection ends.
MAXIMUM, FINE = 320.0, 5.0
#: Settings of the push experiments that a map does not read: its pushes have lengths and forces of their own, after 1 s.
UNUSED = ("forces", "push_duration", "settle_time")
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


def simulated(point: Point, impulse: float) -> Outcome:
    """What comes of a push with that impulse [N s]."""
    settings = configure(MODES[point.mode], point.given, f"rezero-push-{point.mode}")
    return push_once(settings, point.seed, impulse / point.length, point.direction, point.length)


def check(point: Point) -> None:
    """Raise :class:`InputError` for a push that cannot be run, or settings that it does not read."""
    for given in point.given:
        if (key := given.partition("=")[0].strip()) in UNUSED:
            raise InputError(
                f"{key}: the push map does not use it; lengths are those of the map, forces what it looks for"
            )
    settings = (*point.given, f"push_duration={point.length!r}")
    configure(MODES[point.mode], settings, f"rezero-push-{point.mode}, {point.length:g} s long")


def bracket(found: Mapping[float, Outcome], criterion: str) -> Bracket | None:
    """What outcomes say of a criterion: the smallest impulse [N s] that fails, and the largest below it that passes; None if there
    are none."""
    if not found:
        return None
    fails = min((i for i, o in found.items() if not getattr(o, criterion)), default=np.inf)
    return max((i for i in found if i < fails), default=0.0), fails


def next_impulse(found: Outcomes, fine: float = FINE, criteria: Sequence[str] = CRITERIA) -> float | None:
    """The impulse [N s] that a bisection tries next; None if outcomes answer for every criterion to ``fine`` [N s].

    A robot that always passes is tried at ``MAXIMUM``. One that fails less and passes more is not looked for.
    """
    for criterion in criteria:
        low, high = bracket(found, criterion) or (0.0, np.inf)
        if low < MAXIMUM and np.isinf(high):
            return MAXIMUM
        if fine < high - low < np.inf:
            return 0.5 * (low + high)
    return None


def measure(
    point: Point,
    fine: float = FINE,
    criteria: Sequence[str] = CRITERIA,
    run: Callable[[Point, float], Outcome] = simulated,
) -> Outcomes:
    """A push's outcomes, to ``fine`` [N s] for each criterion. A run counts for all of them."""
    found: Outcomes = {}
    while (impulse := next_impulse(found, fine, criteria)) is not None:
        found[impulse] = run(point, impulse)
    return found


def read(file: Path) -> dict[str, Outcomes]:
    """The outcomes of a map's file, by push; none where there is no file. Raises :class:`InputError` for another file."""
    try:
        rows = json.loads(file.read_text()) if file.exists() else {}
        return {key: {float(i): Outcome(**o) for i, o in found.items()} for key, found in rows.items()}
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{file}: this is no file of a push map ({error}); move it away to begin anew") from error


def write(file: Path, done: Mapping[str, Outcomes]) -> None:
    """Make it a map's file."""
    rows = {key: {str(i): asdict(o) for i, o in sorted(found.items())} for key, found in done.items()}
    part = file.with_suffix(".part")
    part.write_text(json.dumps(rows, indent=1) + "\n")
    part.replace(file)  # a file that is half written never stands there


def push_map(
    todo: Sequence[Point],
    file: Path,
    push: Callable[[Point, float], Future[Outcome]],
    at_once: int = 1,
    fine: float = FINE,
    criteria: Sequence[str] = CRITERIA,
) -> Iterator[tuple[Point, float, Outcome]]:
    """Pushes, their impulses [N s] and what came of them, as they come and when they are in ``file``. What that has to within
    ``fine`` is kept; what it has more coarsely is gone on with.

    ``push`` starts :func:`simulated`; ``at_once``: how many pushes are worked on, each by one run after the other.
    """
    done, waiting = read(file), list(reversed(todo))
    running: dict[Future[Outcome], tuple[Point, float]] = {}
    while True:
        while waiting and len(running) < at_once:
            point = waiting.pop()
            if (impulse := next_impulse(done.get(point.key, {}), fine, criteria)) is not None:
                running[push(point, impulse)] = point, impulse
        if not running:
            return
        for ended in wait(running, return_when=FIRST_COMPLETED).done:
            point, impulse = running.pop(ended)
            outcome = ended.result()
            done.setdefault(point.key, {})[impulse] = outcome
            write(file, done)
            waiting.append(point)  # its bisection comes first
            yield point, impulse, outcome
