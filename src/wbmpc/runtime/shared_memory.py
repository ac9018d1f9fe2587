"""Lock-free hand-over of messages from one writer to one reader: two threads, or two processes on shared memory.

A message goes into one of four slots in turn; a sequence number in the slot is zero while it is written and the number of the
message afterwards. The reader copies the newest slot and accepts the copy if the number was the same before and after. It
never waits: while the writer overtakes it again and again it keeps what it has. That relies on 8-byte stores becoming visible
in the order of the program, which x86-64 guarantees; on other machines every message also carries a checksum.
"""

from __future__ import annotations

import ctypes
import math
import multiprocessing
import platform
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from wbmpc.errors import InputError
from wbmpc.model.augment import WithPath
from wbmpc.mpc.policy import InputLimits, Policy
from wbmpc.ocp import OptimalControlProblem, Transcription
from wbmpc.ocp.input_rows import input_planes

SLOTS = 4
#: Whether stores become visible in the order of the program.
ORDERED = platform.machine() in ("x86_64", "AMD64")
#: Words (8 bytes) before the slots, and before the data of a slot: number, checksum. A cache line each.
_HEAD, _SLOT_HEAD = 8, 8

Fields = Mapping[str, tuple[int, ...]]


def shared_words(count: int) -> Any:
    """Memory of ``count`` words that another process gets when it is started with it as an argument."""
    return multiprocessing.get_context("spawn").RawArray(ctypes.c_int64, count)


class Message(NamedTuple):
    """A message with its number (from 1) and the reader's own copy of its fields."""

    number: int
    values: dict[str, np.ndarray]


class Mailbox:
    """The newest message of a writer for a reader. ``fields``: shapes by name; all numbers are float64.

    ``memory``: int64 words (:meth:`words`), for another process; left out, the memory is private to this process. In one
    process the same object serves both threads. ``checked``: whether messages carry a checksum. With two ``slots`` or more the
    reader is rarely overtaken.
    """

    def __init__(self, fields: Fields, memory: Any = None, checked: bool = not ORDERED, slots: int = SLOTS) -> None:
        self.fields, self.checked, self.slots = dict(fields), checked, slots
        need = self.words(self.fields, slots)
        self.memory = np.zeros(need, np.int64) if memory is None else memory
        words = np.frombuffer(self.memory, np.int64)
        if words.size < need:
            raise InputError(f"mailbox: {need} words of memory are needed, got {words.size}")
        size = _slot_words(self.fields)
        self._latest = words[:1]
        places = [words[_HEAD + i * size : _HEAD + (i + 1) * size] for i in range(slots)]
        self._heads = [s[:2] for s in places]
        length = sum(math.prod(s) for s in self.fields.values())
        self._data = [s[_SLOT_HEAD : _SLOT_HEAD + length].view(np.float64) for s in places]
        self._views = [_views(d, self.fields) for d in self._data]
        self._written = self._seen = 0

    @staticmethod
    def words(fields: Fields, slots: int = SLOTS) -> int:
        """Length of the memory [words of 8 bytes]."""
        return _HEAD + slots * _slot_words(fields)

    @classmethod
    def shared(cls, fields: Fields, checked: bool = not ORDERED, slots: int = SLOTS) -> Mailbox:
        """A mailbox that can be an argument of a process that is started."""
        return cls(fields, shared_words(cls.words(fields, slots)), checked, slots)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.fields, self.memory, self.checked, self.slots)

    # ------------------------------------------------------------------ writer
    def begin(self) -> dict[str, np.ndarray]:
        """Views of the slot that the next message goes into; the reader does not see it before :meth:`commit`.

        The last message that was committed stays readable for the writer too: :meth:`last`.
        """
        slot = (self._written + 1) % self.slots
        self._heads[slot][0] = 0
        return self._views[slot]

    def commit(self) -> int:
        """Hand the slot over; returns the message's number."""
        number = self._written + 1
        slot = number % self.slots
        if self.checked:
            self._heads[slot][1] = zlib.adler32(self._data[slot])  # type: ignore[arg-type]
        self._heads[slot][0] = number
        self._latest[0] = number
        self._written = number
        return number

    def write(self, **values: Any) -> int:
        """A whole message from its fields; returns its number."""
        if values.keys() != self.fields.keys():
            raise InputError(f"message: the fields are {', '.join(self.fields)}; got {', '.join(values)}")
        views = self.begin()
        for name, value in values.items():
            views[name][...] = value
        return self.commit()

    @property
    def last(self) -> dict[str, np.ndarray] | None:
        """The writer's last message (not to be changed), None before the first."""
        return self._views[self._written % self.slots] if self._written else None

    # ------------------------------------------------------------------ reader
    def read(self) -> Message | None:
        """The newest message if it has not been read yet, else None. Never waits."""
        for _ in range(2 * self.slots):
            number = int(self._latest[0])
            if number == self._seen:
                return None
            head, data = self._heads[number % self.slots], self._data[number % self.slots]
            if head[0] != number:
                continue
            copy, checksum = duplicate(data), int(head[1])
            if head[0] == number and (not self.checked or zlib.adler32(copy) == checksum):  # type: ignore[arg-type]
                self._seen = number
                return Message(number, _views(copy, self.fields))
        return None


def duplicate(data: np.ndarray) -> np.ndarray:
    """A copy (n). NumPy's own lets the interpreter go when it is long, and a control loop would wait to have it back."""
    copy = np.empty_like(data)
    memoryview(copy)[:] = memoryview(data)  # type: ignore[arg-type]
    return copy


def _slot_words(fields: Fields) -> int:
    return _SLOT_HEAD + -(-sum(math.prod(s) for s in fields.values()) // 8) * 8


def _views(data: np.ndarray, fields: Fields) -> dict[str, np.ndarray]:
    views, start = {}, 0
    for name, shape in fields.items():
        size = math.prod(shape)
        views[name] = data[start : start + size].reshape(shape)
        start += size
    return views


@dataclass(frozen=True)
class Sizes:
    """What messages about a problem need: numbers of states ``nx``, inputs ``nu``, intervals ``n``, model ``parameters`` and straight
    hard ``rows`` of several inputs (or of some modes, or around references), and whether such rows are ``moving``."""

    nx: int
    nu: int
    n: int
    parameters: int = 0
    rows: int = 0
    moving: bool = False

    @classmethod
    def of(cls, ocp: OptimalControlProblem, transcription: Transcription | None = None) -> Sizes:
        """The sizes of a problem, of ``mpc.solver.ocp`` where the solver refines the grid (:class:`wbmpc.SLQ`); ``transcription``: its
        own, where there is one already (``mpc.solver.problem``)."""
        d, hard = ocp.dynamics, any(t.hard for t in ocp.inequalities)
        if isinstance(d, WithPath):
            raise InputError(
                "runner: a problem with progress along a path runs in virtual time only; valid: one without WithPath"
            )
        own = (d.state.size, d.input.size, ocp.intervals, d.parameters.size)
        if not hard:
            return cls(*own)
        planes = input_planes(transcription or Transcription(ocp))
        return cls(*own, planes.offset.size, planes.move)

    def observation(self) -> Fields:
        """An observation: measured at ``observed`` [s]; state ``x`` (nx) predicted for time ``t`` [s] of the plan's clock,
        for a policy that becomes active at ``valid_from`` [s]; model parameters."""
        return {"observed": (), "valid_from": (), "t": (), "x": (self.nx,), "parameters": (self.parameters,)}

    def policy(self) -> Fields:
        """A policy; ``observation``: number of the message that it answers; ``ready`` [s]: when its first answer was;
        ``limit_violation``: as of a :class:`Policy`."""
        n, nx, nu = self.n, self.nx, self.nu
        scalars: Fields = {"observed": (), "valid_from": (), "ready": (), "observation": (), "limit_violation": ()}
        return {**scalars, "times": (n + 1,), "x": (n + 1, nx), "u": (n, nu), "gain": (n, nu, nx), **self.limits()}

    def limits(self) -> Fields:
        """Hard bounds and rows of the inputs, the same in every policy; which rows count in each interval's mode; and where they
        are at its beginning and end, if they move."""
        nu, r = self.nu, self.rows
        fixed: Fields = {"lower": (nu,), "upper": (nu,), "matrix": (r, nu), "offset": (r,), "active": (self.n, r)}
        return {**fixed, "moving": (self.n, 2, r)} if self.moving else fixed


@dataclass(frozen=True)
class TimedPolicy(Policy):
    """A policy that was handed over: see :meth:`Sizes.policy`; ``number`` of its message."""

    valid_from: float
    observed: float
    ready: float
    observation: int
    number: int

    @classmethod
    def take(cls, policies: Mailbox) -> TimedPolicy | None:
        """The newest policy if it has not been read yet."""
        message = policies.read()
        if message is None:
            return None
        v = message.values
        start, seen, ready = (float(v[name]) for name in ("valid_from", "observed", "ready"))
        number = int(v["observation"])
        limits = InputLimits(v["lower"], v["upper"], v["matrix"], v["offset"])
        active = v["active"] if v["offset"].size else None
        own = (start, seen, ready, number, message.number)
        violation, moving = float(v["limit_violation"]), v.get("moving")
        return cls(
            v["times"], v["x"], v["u"], v["gain"], *own,
            limits=limits, active=active, moving=moving, limit_violation=violation,
        )  # fmt: skip


class Board:
    """Named numbers and records of samples that one side writes and the other may read at any time.

    A number is one word, so it is never torn. ``names`` of single numbers; ``records``: rings of the last ``capacity`` samples.
    ``memory`` as for :class:`Mailbox`.
    """

    TEXT, TEXTS = 256, 2  # words each

    def __init__(
        self, names: tuple[str, ...], records: tuple[str, ...] = (), capacity: int = 1, memory: Any = None
    ) -> None:
        self.names, self.records, self.capacity = names, records, capacity
        size = len(names) + len(records) * (1 + capacity) + self.TEXT * self.TEXTS
        self.memory = np.zeros(size, np.int64) if memory is None else memory
        words = np.frombuffer(self.memory, np.int64)
        self._numbers = words[: len(names) + len(records)].view(np.float64)
        self._place = {name: i for i, name in enumerate((*names, *records))}
        end = size - self.TEXT * self.TEXTS
        rings = words[self._numbers.size : end].view(np.float64)
        self._rings = {name: rings[i * capacity : (i + 1) * capacity] for i, name in enumerate(records)}
        self._texts = words[end:size].view(np.uint8).reshape(self.TEXTS, -1)

    @classmethod
    def shared(cls, names: tuple[str, ...], records: tuple[str, ...] = (), capacity: int = 1) -> Board:
        """A board that can be an argument of a process that is started."""
        words = len(names) + len(records) * (1 + capacity) + cls.TEXT * cls.TEXTS
        return cls(names, records, capacity, shared_words(words))

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.names, self.records, self.capacity, self.memory)

    def __getitem__(self, name: str) -> float:
        return float(self._numbers[self._place[name]])

    def __setitem__(self, name: str, value: float) -> None:
        self._numbers[self._place[name]] = value

    def count(self, name: str, by: int = 1) -> None:
        """Add to a number."""
        self._numbers[self._place[name]] += by

    def sample(self, name: str, value: float) -> None:
        """Add to a record."""
        i = self._place[name]
        done = int(self._numbers[i])
        self._rings[name][done % self.capacity] = value
        self._numbers[i] = done + 1

    def samples(self, name: str) -> np.ndarray:
        """The last samples of a record (at most ``capacity``), oldest first."""
        done, ring = int(self[name]), self._rings[name]
        return ring[:done].copy() if done <= self.capacity else np.roll(ring, -(done % self.capacity))

    @property
    def text(self) -> str:
        """A message from the writer: what went wrong."""
        return self._read(0)

    @text.setter
    def text(self, message: str) -> None:
        self._write(0, message)

    @property
    def note(self) -> str:
        """Another one: what was not as it should be, and went on."""
        return self._read(1)

    @note.setter
    def note(self, message: str) -> None:
        self._write(1, message)

    def _read(self, i: int) -> str:
        return bytes(self._texts[i]).split(b"\0", 1)[0].decode(errors="replace")

    def _write(self, i: int, message: str) -> None:
        room = self._texts[i]
        data = message.encode()[: room.size - 1]
        room[: len(data)] = np.frombuffer(data, np.uint8)
        room[len(data)] = 0
