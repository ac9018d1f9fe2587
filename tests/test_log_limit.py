"""Truth: a clock that the test sets, and lines that are counted by hand."""

from __future__ import annotations

import logging

import pytest

from wbmpc.logs import MAX_CAUSES, PlaceLimit, RateLimit

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


def test_lines_of_one_place_are_few_for_all_handlers_together() -> None:
    """Two handlers, as a terminal and /rosout. What a limit has let pass by its causes is not counted once more."""
    now, heard = [0.0], ([], [])  # type: ignore[var-annotated]
    log = logging.Logger("places")
    for lines in heard:
        handler = logging.Handler()
        handler.emit = lambda record, to=lines: to.append(record.getMessage())  # type: ignore[method-assign]
        handler.addFilter(PlaceLimit(RateLimit(lines=2, period=10.0, clock=lambda: now[0])))
        log.addHandler(handler)
    by_cause = RateLimit(lines=1, clock=lambda: now[0])
    for i in range(100):
        now[0] = 0.05 * i
        log.error("stopped at %d", i)
        by_cause.log(log, logging.ERROR, i, f"cause {i}")
    now[0] = 10.0
    log.error("another place")
    assert heard[0] == heard[1]
    assert [t for t in heard[0] if "stopped" in t] == ["stopped at 0", "stopped at 1"]
    assert sum("cause" in t for t in heard[0]) == 100 and heard[0][-1] == "another place"


def test_causes_do_not_take_each_others_lines(caplog: pytest.LogCaptureFixture) -> None:
    limit = RateLimit(lines=1, clock=lambda: 0.0)
    for cause in ("a", "b", "a", "b"):
        limit.log(LOG, logging.ERROR, cause, cause)
    assert caplog.messages == ["a", "b"]


def test_causes_without_end_do_not_take_memory_without_end() -> None:
    limit = RateLimit(lines=1, clock=lambda: 0.0)
    assert [limit.left_out(i) for i in range(5 * MAX_CAUSES)] == [0] * (5 * MAX_CAUSES)
    assert len(limit._seen) == MAX_CAUSES
