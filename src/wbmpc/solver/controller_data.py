"""Compiled code of what a controller's owner sets and reads: references, schedule, weights, figures."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from wbmpc.kernel.ir import Floats, Integers
from wbmpc.solver.controller import Count, Result, Value, compiled, finite
from wbmpc.solver.memory_layout import W
from wbmpc.solver.receding import HOLD, POSE, POSE_HOLD


class Figure(IntEnum):
    """What a controller reports: see :data:`wbmpc.embedded.texts.FIGURES`."""

    STATUS = 0
    ITERATIONS = 1
    UPDATES = 2
    FAILURES = 3
    CUT = 4
    COST = 5
    VIOLATION = 6
    LIMIT_VIOLATION = 7
    INITIAL_STATE_MISMATCH = 8
    BEGINNING = 9
    END = 10
    EVENTS_WITHOUT_NODE = 11
    BRAKING_PLANS = 12
    CLEARANCE = 13
    EXTENDED = 14


@compiled
def figures(count: Integers, value: Floats, times: Floats, n: int, out: Floats) -> int:
    """Everything of :class:`Figure`."""
    out[Figure.STATUS], out[Figure.ITERATIONS] = count[Count.STATUS], count[Count.ITERATIONS]
    out[Figure.UPDATES], out[Figure.FAILURES] = count[Count.UPDATES], count[Count.FAILURES]
    out[Figure.CUT], out[Figure.COST] = count[Count.CUT], value[Value.COST]
    out[Figure.VIOLATION], out[Figure.LIMIT_VIOLATION] = value[Value.VIOLATION], value[Value.LIMIT_VIOLATION]
    out[Figure.INITIAL_STATE_MISMATCH] = value[Value.INITIAL_STATE_MISMATCH]
    out[Figure.BEGINNING], out[Figure.END] = times[0], times[n]
    out[Figure.EVENTS_WITHOUT_NODE] = count[Count.EVENTS_WITHOUT_NODE]
    out[Figure.EXTENDED] = count[Count.EXTENDED]
    out[Figure.BRAKING_PLANS], out[Figure.CLEARANCE] = count[Count.BRAKING_PLANS], value[Value.CLEARANCE]
    return Result.OK


@compiled
def fill(block: Integers, size: int, runs: Integers, words: Integers, count: int) -> int:
    """A block of ``size`` words as it is in the beginning: zeros, and ``count`` runs (first, length) of ``words``."""
    for i in range(size):
        block[i] = 0
    at = 0
    for k in range(count):
        for i in range(runs[2 * k + 1]):
            block[runs[2 * k] + i] = words[at + i]
        at += runs[2 * k + 1]
    return Result.OK


@compiled
def set_reference(
    numbers: Floats, integers: Integers, capacities: Integers, slots: int, slot: int, kind: int, samples: int, t: Floats,
    v: Floats,
) -> int:  # fmt: skip
    """``samples`` of the reference in a slot. Quaternions get unit length, neighbors in the same half sphere."""
    if slot < 0 or slot >= slots or kind < 0 or kind > POSE_HOLD:
        return Result.NO_SUCH_INDEX
    s = 4 + 6 * slot
    times, values, width = integers[s], integers[s + 2], integers[s + 3]
    pose = kind >= POSE and kind != HOLD
    if pose and width != 7:
        return Result.NO_SUCH_INDEX
    if samples < 1 or samples > capacities[slot]:
        return Result.TOO_MANY
    if not (finite(t, 0, samples) and finite(v, 0, samples * width)):
        return Result.NOT_A_NUMBER
    for i in range(samples - 1):
        if t[i + 1] < t[i]:
            return Result.NOT_SORTED
    if pose and not rotations(v, samples):
        return Result.NOT_A_ROTATION
    integers[s + 1], integers[s + 4] = samples, kind
    for i in range(samples):
        numbers[times + i] = t[i]
        for j in range(width):
            numbers[values + i * width + j] = v[i * width + j]
    if pose:
        align_quaternions(numbers, values, samples)
    return Result.OK


@compiled
def rotations(v: Floats, samples: int) -> bool:
    """Whether no quaternion of the poses has the length zero."""
    smallest = np.inf
    for i in range(samples):
        smallest = min(smallest, v[7 * i + 3] ** 2 + v[7 * i + 4] ** 2 + v[7 * i + 5] ** 2 + v[7 * i + 6] ** 2)
    return smallest > 1e-12


@compiled
def align_quaternions(numbers: Floats, values: int, samples: int) -> None:
    """Unit length, and neighbors in the same half sphere (q and −q are the same rotation)."""
    for i in range(samples):
        q, product = values + 7 * i + 3, 0.0
        norm = np.sqrt(numbers[q] ** 2 + numbers[q + 1] ** 2 + numbers[q + 2] ** 2 + numbers[q + 3] ** 2)
        for j in range(4):
            numbers[q + j] /= norm
            if i > 0:
                product += numbers[q + j] * numbers[q - 7 + j]
        if product < 0.0:
            for j in range(4):
                numbers[q + j] = -numbers[q + j]


@compiled
def set_schedule(
    numbers: Floats, integers: Integers, modes: Floats, known_modes: int, max_events: int, events: int, t: Floats, mode: Integers
) -> int:  # fmt: skip
    """``events`` times, and the modes before, between and after them, by their places in the table ``modes``."""
    width = integers[2]
    if events < 0 or events > max_events:
        return Result.TOO_MANY
    if not finite(t, 0, events):
        return Result.NOT_A_NUMBER
    for i in range(events - 1):
        if t[i + 1] <= t[i]:
            return Result.NOT_SORTED
    for i in range(events + 1):
        if mode[i] < 0 or mode[i] >= known_modes:
            return Result.NO_SUCH_INDEX
    integers[1] = events
    for i in range(events):
        numbers[i] = t[i]
    for i in range(events + 1):
        for j in range(width):
            numbers[events + i * width + j] = modes[mode[i] * width + j]
    return Result.OK


@compiled
def set_constants(m: Floats, o: Integers, groups: Integers, known_groups: int, group: int, v: Floats) -> int:
    """One group of the numbers that are constant over the horizon: the model's parameters, or the weights of a cost.
    ``groups``: first and length of each."""
    if group < 0 or group >= known_groups:
        return Result.NO_SUCH_INDEX
    first, length = o[W] + groups[2 * group], groups[2 * group + 1]
    if not finite(v, 0, length):
        return Result.NOT_A_NUMBER
    for i in range(length):
        m[first + i] = v[i]
    return Result.OK
