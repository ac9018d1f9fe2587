"""The push map. Truth: robots of known strength, by formula; hands and balls that rest, come back or roll away, by formula."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from wbmpc.experiments.push_map import (
    FINE,
    MOST,
    Outcome,
    Outcomes,
    Point,
    bracket,
    impulse_at_failure,
    measure,
    points,
    push_map,
)
from wbmpc.experiments.rezero_push import LAST, NEAR, rest
from wbmpc.log import Log


@pytest.mark.parametrize("strength", [3.0, 22.0, 161.3])
def test_bisection_brackets_the_strength(strength: float) -> None:
    tried: list[float] = []

    def stands(point: Point, impulse: float) -> bool:
        tried.append(impulse)
        return impulse < strength

    low, high = impulse_at_failure(Point("hand", 0.0, 0.2, 0), stands)
    assert low < strength <= high <= low + FINE
    assert len(tried) < 9
    assert impulse_at_failure(Point("hand", 0.0, 0.2, 0), lambda p, i: True) == (MOST, np.inf)


class Known:
    """Recovers from less than 77 N s and stands less than 161.3; ``tried``: impulses [N s] that it was given."""

    def __init__(self) -> None:
        self.tried: list[float] = []

    def push(self, point: Point, impulse: float) -> Outcome:
        self.tried.append(impulse)
        return Outcome(impulse < 161.3, impulse < 77.0, 0.01 * impulse)


def test_a_run_counts_for_both_criteria() -> None:
    """Each is bracketed by its own strength, and no impulse is tried twice: two bisections of their own would take 14 runs."""
    known = Known()
    key, found = measure((Point("hand", 0.0, 0.2, 0), {}), run=known.push)
    assert key == Point("hand", 0.0, 0.2, 0).key
    for criterion, strength in (("recovers", 77.0), ("stands", 161.3)):
        low, high = bracket(found, criterion) or (0.0, 0.0)
        assert low < strength <= high <= low + FINE
    assert len(known.tried) == len(set(known.tried)) <= 12
    assert bracket({}, "stands") is None


def test_what_fails_once_is_not_believed_beyond_it() -> None:
    """Falls are no clean threshold: the smallest impulse that fails counts, whatever was stood above it."""
    found = {i: Outcome(i != 80.0, False, 0.0) for i in (40.0, 80.0, 120.0)}
    assert bracket(found, "stands") == (40.0, 80.0)
    assert bracket(found, "recovers") == (0.0, 40.0)


def test_a_map_has_all_pushes_once() -> None:
    todo = points("ball", 16, (0.05, 0.4), 3)
    assert len({p.key for p in todo}) == 32
    assert todo[4].direction == pytest.approx(np.pi / 2)
    other = points("ball", 16, (0.05, 0.4), 3, ("controller=lqr",))
    assert not {p.key for p in other} & {p.key for p in todo}


def test_an_interrupted_map_goes_on_and_is_made_finer(tmp_path: Path) -> None:
    """What the file has is not run again; the rest is, and is written at once; bisections go on inside of what was known."""
    known, file = Known(), tmp_path / "map.json"
    todo = points("hand", 2, (0.2,), 0)

    def at(fine: float, count: int) -> list[tuple[str, Outcomes]]:
        work = lambda left: (measure(w, fine, known.push) for w in left)
        return [found for _, found in zip(range(count), push_map(todo, file, work, fine), strict=False)]

    assert [key for key, _ in at(80.0, 1)] == [todo[0].key]
    assert set(json.loads(file.read_text())) == {todo[0].key}
    first = len(known.tried)
    assert {key for key, _ in at(80.0, 2)} == {p.key for p in todo}
    assert len(known.tried) == 2 * first
    known.tried.clear()
    for _, found in at(FINE, 2):
        low, high = bracket(found, "stands") or (0.0, 0.0)
        assert low < 161.3 <= high <= low + FINE
    assert min(known.tried) > 0.0 and max(known.tried) < 240.0 and MOST not in known.tried
    known.tried.clear()
    assert len(at(FINE, 2)) == 2 and not known.tried


# ---------------------------------------------------------------------- recovered or not
def logged(hand: np.ndarray, believed: np.ndarray | None = None) -> Log:
    """Hands (n, 3) [m], 100 a second, and where the robot believes them to be."""
    log = Log()
    for k, (place, felt) in enumerate(zip(hand, hand if believed is None else believed, strict=True)):
        log.add("state", 0.01 * k, np.zeros(16))
        log.add("hand", 0.01 * k, place)
        log.add("hand_estimated", 0.01 * k, felt)
    return log


def test_recovered_is_back_where_the_robot_knows_its_place_and_at_rest_in_the_world() -> None:
    still, t = np.zeros((701, 3)), 0.01 * np.arange(701)
    away = np.array([0.3, 0.0, 0.0])
    assert rest(logged(still), "hand", np.zeros(3), 7.0).recovered
    assert not rest(logged(still + away), "hand", np.zeros(3), 7.0).recovered
    slipped = rest(logged(still + away, still), "hand", np.zeros(3), 7.0)  # 30 cm of slip, which it cannot know
    assert slipped.recovered and slipped.world == pytest.approx(0.3) and slipped.felt == pytest.approx(0.0)
    rolls = np.outer(np.maximum(t - 6.0, 0.0), [1.5 * NEAR / LAST, 0.0, 0.0])  # and believes to stand
    assert rest(logged(rolls, still), "hand", np.zeros(3), 7.0).moves > NEAR
    assert not rest(logged(rolls, still), "hand", np.zeros(3), 7.0).recovered
    swings = 0.1 * np.outer(np.sin(2.0 * np.pi * t), [0.0, 0.0, 1.0])
    assert not rest(logged(swings), "hand", np.zeros(3), 7.0).recovered
    assert not rest(logged(still[:400]), "hand", np.zeros(3), 7.0).recovered  # it fell
    assert rest(logged(swings), "ball", np.zeros(2), 7.0).recovered
