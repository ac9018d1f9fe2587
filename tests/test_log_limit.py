"""Truth: a clock that the test sets, and lines that are counted by hand."""

from __future__ import annotations

import logging

import pytest

from wbmpc.logs import MAX_CAUSES, RateLimit

LOG = logging.getLogger("wbmpc")


def test_a_flood_of_one_cause_is_a_few_lines_and_says_how_many_it_was(caplog: pytest.LogCaptureFixture) -> None:
    now = [0.0]
    limit = RateLimit(lines=2, period=10.0, clock=lambda: now[0])
    for i in range(100):
        now[0] = 0.05 * i
        limit.log(LOG, logging.WARNING, "/goal", f"bad goal {i}")
    now[0] = 10.0
    for i in range(3):
        limit.log(LOG, logging.WARNING, "/goal", f"late goal {i}")
    said = ["bad goal 0", "bad goal 1", "late goal 0 (98 more of this kind were left out)", "late goal 1"]
    assert caplog.messages == said


def test_causes_do_not_take_each_others_lines(caplog: pytest.LogCaptureFixture) -> None:
    limit = RateLimit(lines=1, clock=lambda: 0.0)
    for cause in ("a", "b", "a", "b"):
        limit.log(LOG, logging.ERROR, cause, cause)
    assert caplog.messages == ["a", "b"]


def test_causes_without_end_do_not_take_memory_without_end() -> None:
    limit = RateLimit(lines=1, clock=lambda: 0.0)
    assert [limit.left_out(i) for i in range(5 * MAX_CAUSES)] == [0] * (5 * MAX_CAUSES)
    assert len(limit._seen) == MAX_CAUSES
