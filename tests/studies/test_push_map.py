"""The push map. Truth: robots of known strength, by formula; end effectors and balls that rest, come back or roll away, by formula."""

from __future__ import annotations

import json
from concurrent.futures import Future
from pathlib import Path

import numpy as np
import pytest

from wbmpc.errors import InputError
from wbmpc.log import Log
from wbmpc.studies.minniti2019.push import RezeroPushHandSettings
from wbmpc.studies.minniti2019.push_map import (
    FINE,
    MAXIMUM,
    Outcome,
    Point,
    bracket,
    measure,
    next_impulse,
    points,
    push_map,
    read,
)
from wbmpc.studies.minniti2019.push_once import push_once
from wbmpc.studies.minniti2019.recovery import LAST, NEAR, rest

AHEAD = Point("hand", 0.0, 0.2, 0)


class Known:
    """Recovers from less than 77 N s and stands less than 161.3; ``tried``: impulses [N s] that it was given."""

    def __init__(self) -> None:
        self.tried: list[float] = []

    def push(self, point: Point, impulse: float) -> Outcome:
        self.tried.append(impulse)
        return Outcome(impulse < 161.3, impulse < 77.0, 0.01 * impulse)

    def start(self, point: Point, impulse: float) -> Future[Outcome]:
        """As an executor does it, at once."""
        done: Future[Outcome] = Future()
        done.set_result(self.push(point, impulse))
        return done


@pytest.mark.parametrize("strength", [3.0, 22.0, 161.3])
def test_bisection_brackets_the_strength(strength: float) -> None:
    found = measure(AHEAD, criteria=("stands",), run=lambda p, i: Outcome(i < strength, False, 0.0))
    low, high = bracket(found, "stands") or (0.0, 0.0)
    assert low < strength <= high <= low + FINE
    assert len(found) < 9
    always = measure(AHEAD, criteria=("stands",), run=lambda p, i: Outcome(True, False, 0.0))
    assert list(always) == [MAXIMUM] and bracket(always, "stands") == (MAXIMUM, np.inf)


def test_only_recovering_is_looked_for_when_only_that_is_asked() -> None:
    known = Known()
    found = measure(AHEAD, criteria=("recovers",), run=known.push)
    low, high = bracket(found, "recovers") or (0.0, 0.0)
    assert low < 77.0 <= high <= low + FINE and len(known.tried) == 7  # 320, 160, 80, 40, 60, 70, 75
    assert next_impulse(found, criteria=("recovers",)) is None
    assert next_impulse(found, criteria=("stands",)) == 240.0  # stood at 160 N s and fell at 320 on the way


def test_a_run_counts_for_both_criteria() -> None:
    """Each is bracketed by its own strength, and no impulse is tried twice: two bisections of their own would take 14 runs."""
    known = Known()
    found = measure(AHEAD, run=known.push)
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


@pytest.mark.parametrize("length", [1e-4, 0.0333])
def test_a_push_is_never_longer_than_asked(length: float) -> None:
    """The plant is pushed for whole controller periods: 10 kN for 0.1 ms, 1 N s, was 25 N s."""
    with pytest.raises(InputError, match="length"):
        push_once(RezeroPushHandSettings(pause=2.0), 0, 1e4, 0.0, length)


def test_an_interrupted_map_goes_on_and_is_made_finer(tmp_path: Path) -> None:
    """What the file has is not run again; every push is written at once; bisections go on inside of what was known."""
    known, file = Known(), tmp_path / "map.json"
    todo = points("hand", 2, (0.2,), 0)

    def at(fine: float, count: int) -> list[tuple[str, float]]:
        pushes = push_map(todo, file, known.start, fine=fine)
        return [(point.key, impulse) for _, (point, impulse, _) in zip(range(count), pushes, strict=False)]

    whole = [(p.key, i) for p in todo for i in (320.0, 160.0, 80.0, 240.0)]  # to 80 N s
    assert at(80.0, 3) == whole[:3]
    assert {k: list(v) for k, v in json.loads(file.read_text()).items()} == {todo[0].key: ["80.0", "160.0", "320.0"]}
    assert at(80.0, 99) == whole[3:]
    assert not at(80.0, 99)
    assert not set(at(FINE, 99)) & set(whole)
    for found in read(file).values():
        for criterion, strength in (("recovers", 77.0), ("stands", 161.3)):
            low, high = bracket(found, criterion) or (0.0, 0.0)
            assert low < strength <= high <= low + FINE


def test_as_many_pushes_at_once_as_there_are_processes(tmp_path: Path) -> None:
    """Two directions are worked on in turn, and the third is begun when one of them is done."""
    todo = points("hand", 3, (0.2,), 0)
    pushes = list(push_map(todo, tmp_path / "map.json", Known().start, 2))
    directions, each = [point.direction for point, _, _ in pushes], len(pushes) // 3
    assert sorted(directions[: 2 * each]) == [todo[0].direction] * each + [todo[1].direction] * each
    assert directions[2 * each :] == [todo[2].direction] * each and directions[0] != directions[1]


# ---------------------------------------------------------------------- recovered or not
def logged(end_effector: np.ndarray, believed: np.ndarray | None = None) -> Log:
    """Hands (n, 3) [m], 100 a second, and where the robot believes them to be."""
    log = Log()
    for k, (place, felt) in enumerate(zip(end_effector, end_effector if believed is None else believed, strict=True)):
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
