"""Log lines of one cause, limited. Truth: counted by hand, against a clock that the test turns."""

from __future__ import annotations

import logging

import pytest

from interrupting import in_time, interrupted
from wbmpc.logs import MAX_CAUSES, PlaceLimit, RateLimit, RateLimitFilter


class Lines(logging.Handler):
    def __init__(self) -> None:
        super().__init__()
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.texts.append(self.format(record))


def logger(limit: RateLimitFilter) -> tuple[logging.Logger, list[str]]:
    log, lines = logging.Logger("test"), Lines()
    log.addHandler(lines)
    log.addFilter(limit)
    return log, lines.texts


def test_a_flood_of_one_cause_is_one_line_in_each_interval() -> None:
    """1 000 records in 10 s at one line in 5 s: at 0 s, 5 s; the second says how many were left out."""
    now = [0.0]
    log, lines = logger(RateLimitFilter(5.0, lambda: now[0]))
    for k in range(1000):
        now[0] = 0.01 * k
        log.warning("frame %d is malformed", k)
    assert lines == ["frame 0 is malformed", "frame 500 is malformed (499 more like this)"]


def test_causes_do_not_silence_each_other() -> None:
    log, lines = logger(RateLimitFilter(5.0, lambda: 0.0))
    for _ in range(3):
        log.warning("malformed %s", "a")
        log.error("malformed %s", "a")
        log.warning("rejected")
    assert lines == ["malformed a", "malformed a", "rejected"]
    limit = RateLimitFilter(5.0, lambda: 0.0)
    assert [limit.limit.left_out(c) for c in ("one", "one", "two", "one")] == [0, None, 0, None]


def test_what_was_left_out_is_said_once() -> None:
    now = [0.0]
    limit = RateLimitFilter(2.0, lambda: now[0])
    found = []
    for now[0] in (0.0, 1.0, 1.5, 2.0, 2.5, 4.5, 10.0):
        found.append(limit.limit.left_out("cause"))
    assert found == [0, None, None, 2, None, 1, 0]


def test_many_causes_do_not_fill_the_memory() -> None:
    limit = RateLimitFilter(5.0, lambda: 0.0)
    for k in range(10_000):
        assert limit.limit.left_out(k) == 0
    assert len(limit.limit._seen) <= MAX_CAUSES


def test_brief_lines_name_the_exception_without_its_traceback() -> None:
    for brief in (True, False):
        log, lines = logger(RateLimitFilter(5.0, lambda: 0.0, brief=brief))
        try:
            raise ValueError("no number")
        except ValueError:
            log.exception("handler failed")
        assert ("Traceback" in lines[0]) == (not brief) and "ValueError: no number" in lines[0]


def test_a_handler_that_logs_in_the_middle_does_not_wait_for_what_it_interrupts() -> None:
    limit, step, more = RateLimitFilter(5.0, lambda: 0.0).limit, 0, True
    with in_time(30):
        while more:
            step += 1
            _, more = interrupted(lambda: limit.left_out("cause"), lambda: limit.left_out("other"), step)
    assert step > 10


@pytest.mark.parametrize("by_place", [False, True])
def test_a_line_that_cannot_be_written_stops_nobody(by_place: bool) -> None:
    """A filter raises into who logs, which Python's handlers do not. The third line says how many were left out."""
    times = iter((0.0, 1.0, 10.0))
    clock = lambda: next(times)
    limit = PlaceLimit(RateLimit(1, 5.0, clock)) if by_place else RateLimitFilter(5.0, clock)
    records = [logging.LogRecord("x", logging.ERROR, "x.py", 1, "%d of them", ("seven",), None) for _ in range(3)]
    assert [limit.filter(record) for record in records] == [True, False, True]
    assert records[2].getMessage().startswith("%d of them (its text cannot be made) (1 more ")
