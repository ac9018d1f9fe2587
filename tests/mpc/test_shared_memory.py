"""Mailboxes between threads and processes. Truth: what was written; every message carries a checksum of its own."""

from __future__ import annotations

import multiprocessing
import threading
import time
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from effort import some
from wbmpc.errors import InputError
from wbmpc.runtime import shared_memory as buffer
from wbmpc.runtime.shared_memory import SLOTS, Board, Mailbox

FIELDS = {"number": (), "data": (400, 30), "sum": ()}
MESSAGES = 20_000


def message(number: int) -> dict[str, Any]:
    """All data depend on the number, so that parts of two messages do not fit together."""
    data = number + np.arange(12_000.0).reshape(400, 30)
    return {"number": number, "data": data, "sum": float(zlib.crc32(data.tobytes()))}


def hammer(box: Mailbox, go: Any) -> None:
    """Write all messages as fast as possible, once the reader is there."""
    while not go[0]:
        time.sleep(1e-4)
    ready = [message(number) for number in range(16)]
    for number in range(1, MESSAGES + 1):
        box.write(**{**ready[number % 16], "number": number})
        if number % 500 == 0:
            time.sleep(1e-4)  # where both share a core the reader gets a turn


def receive(box: Mailbox, go: Any) -> list[int]:
    """Read until the last message; the numbers that came."""
    seen: list[int] = []
    go[0] = 1
    end = time.perf_counter() + 60.0
    while (not seen or seen[-1] < MESSAGES) and time.perf_counter() < end:
        got = box.read()
        if got is None:
            continue
        v = got.values
        assert got.number == int(v["number"])
        assert float(zlib.crc32(v["data"])) == float(v["sum"]), f"message {got.number} is torn"
        seen.append(got.number)
    return seen


def check(seen: list[int]) -> None:
    assert seen[-1] == MESSAGES
    assert len(seen) > 10
    assert (np.diff(seen) > 0).all()


@pytest.mark.parametrize("checked", [False, True])
def test_two_threads(checked: bool) -> None:
    box, go = Mailbox(FIELDS, checked=checked), [0]
    writer = threading.Thread(target=hammer, args=(box, go))
    writer.start()
    seen = receive(box, go)
    writer.join()
    check(seen)


@pytest.mark.parametrize("slots", some([1, SLOTS], [0]))
def test_two_processes(slots: int) -> None:
    """With one slot the reader is in the writer's way all the time."""
    box = Mailbox.shared(FIELDS, slots=slots)
    context = multiprocessing.get_context("spawn")
    go = context.RawArray("b", 1)
    writer = context.Process(target=hammer, args=(box, go), daemon=True)
    writer.start()
    seen = receive(box, go)
    writer.join()
    check(seen)


@pytest.fixture
def interrupted(monkeypatch: pytest.MonkeyPatch) -> Callable[[Mailbox, Callable[[], Any]], Mailbox]:
    """A mailbox whose first copy is overtaken: half of it is from before, half from after ``happens`` has run."""

    def make(box: Mailbox, happens: Callable[[], Any]) -> Mailbox:
        actions = [happens]

        def copy(data: np.ndarray) -> np.ndarray:
            out = data.copy()
            if actions:
                actions.pop()()
            out[out.size // 2 :] = data[out.size // 2 :]
            return out

        monkeypatch.setattr(buffer, "duplicate", copy)
        return box

    return make


@pytest.mark.parametrize("checked", [False, True])
def test_a_reader_that_is_overtaken_takes_the_newest(checked: bool, interrupted: Any) -> None:
    box = Mailbox(FIELDS, checked=checked)
    box.write(**message(1))
    again = interrupted(box, lambda: [box.write(**message(n)) for n in range(2, 2 + SLOTS)]).read()
    assert again is not None and again.number == 1 + SLOTS
    np.testing.assert_array_equal(again.values["data"], message(1 + SLOTS)["data"])


def test_a_reader_is_not_disturbed_by_the_other_slots(interrupted: Any) -> None:
    box = Mailbox(FIELDS)
    box.write(**message(1))
    got = interrupted(box, lambda: [box.write(**message(n)) for n in range(2, SLOTS)]).read()
    assert got is not None and got.number == 1
    np.testing.assert_array_equal(got.values["data"], message(1)["data"])


def test_a_message_half_written_is_not_seen_and_does_not_block() -> None:
    box = Mailbox(FIELDS)
    box.write(**message(1))
    box.begin()["data"][...] = 77.0
    got = box.read()
    assert got is not None and got.number == 1
    # the writer is in the slot of the newest message: nothing to be had, and no waiting
    box._heads[1][0] = 0
    box._seen = 0
    assert box.read() is None  # one that waited would wait forever


def test_a_wrong_checksum_is_rejected() -> None:
    box = Mailbox(FIELDS, checked=True)
    box.write(**message(1))
    box._data[1][5] += 1.0
    assert box.read() is None
    box.write(**message(2))
    assert box.read() is not None


def test_only_the_newest_once_and_as_a_copy() -> None:
    box = Mailbox(FIELDS)
    assert box.read() is None and box.last is None
    for number in (1, 2, 3):
        assert box.write(**message(number)) == number
    got = box.read()
    assert got is not None and float(got.values["number"]) == 3.0
    assert box.read() is None
    assert box.last is not None
    np.testing.assert_array_equal(box.last["data"], message(3)["data"])
    for number in range(4, 20):
        box.write(**message(number))
    np.testing.assert_array_equal(got.values["data"], message(3)["data"])


def test_wrong_fields_are_named() -> None:
    box = Mailbox(FIELDS)
    with pytest.raises(InputError, match="the fields are number, data, sum; got number"):
        box.write(number=1)
    with pytest.raises(InputError, match=r"words of memory are needed, got 3"):
        Mailbox(FIELDS, np.zeros(3, np.int64))


def test_board() -> None:
    board = Board(("a", "b"), ("r",), capacity=4)
    board["a"] = 1.5
    board.count("b")
    board.count("b", 2)
    for value in range(6):
        board.sample("r", float(value))
    assert (board["a"], board["b"], board["r"]) == (1.5, 3.0, 6.0)
    np.testing.assert_array_equal(board.samples("r"), [2.0, 3.0, 4.0, 5.0])
    board.text = "first ü" * 500
    assert board.text.startswith("first ü")
    board.text = "second"
    assert board.text == "second"
    # a second object on the same memory sees the same
    assert Board(("a", "b"), ("r",), 4, board.memory)["b"] == 3.0
