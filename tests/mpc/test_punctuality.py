"""Which part of a tick made its command late. Truth: durations written by hand."""

from __future__ import annotations

import pytest

from wbmpc.runtime.statistics import Punctuality

USUAL = [1e-5, 2e-5, 3e-4, 1e-4, 5e-5, 8e-5]


def tick(p: Punctuality, due: float, durations: list[float]) -> float:
    """A tick whose parts take so long [s]."""
    now = due + durations[0]
    p.begin(due, now)
    for duration in durations[1:]:
        now += duration
        p.over(now)
    return p.sent()


def test_a_late_command_is_counted_for_the_part_that_took_long() -> None:
    p = Punctuality()
    for k in range(200):
        assert tick(p, 0.0025 * k, USUAL) == pytest.approx(sum(USUAL))
    assert p.late == 0
    for k, part in enumerate(p.PARTS):
        longer = list(USUAL)
        longer[k] += 1.1e-3
        tick(p, 1.0, longer)
        assert p.late == k + 1 and p.because[part] == 1
    longer = [d + 1.5e-4 for d in USUAL]  # 0.9 ms in all
    tick(p, 2.0, longer)
    assert p.late == 6


def test_what_is_usual_follows_slowly() -> None:
    """A robot whose estimator takes 0.6 ms longer from now on is not late 500 ticks later, when another 0.9 ms come."""
    p, longer = Punctuality(), list(USUAL)
    longer[2] += 6e-4
    for durations in (USUAL, longer):
        for k in range(500):
            tick(p, 0.0025 * k, durations)
    tick(p, 5.0, [*longer[:3], longer[3] + 9e-4, *longer[4:]])
    assert p.late == 0
