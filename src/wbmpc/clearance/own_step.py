"""Nearest points of a robot's own parts at the nodes of a plan, and parameters of their rows, in two calls for all nodes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wbmpc.clearance.compilation import step
from wbmpc.clearance.pairs_step import Gaps, nearest_own, place_solids
from wbmpc.clearance.support_step import Solids
from wbmpc.kernel.ir import Floats, Integers, PointerCall

call2 = PointerCall(2)


class Parts(NamedTuple):
    """A robot's own parts, and which pairs of them are compared."""

    address: int  # of the function that gives the poses of frames
    nx: int  # numbers of a state
    all_frames: int  # with those in whose axes pairs are compared
    frames: int
    shapes: int
    rows: int  # pairs of frames
    pairs: int  # pairs of shapes
    frame_of: Integers  # (shapes)
    row_of: Integers  # (pairs)
    one: Integers  # (pairs), shapes
    two: Integers  # (pairs)
    local: Floats  # (shapes, 3) [m], in axes of their frames
    turn: Floats  # (shapes, 3, 3)


class Places(NamedTuple):
    """Where these are at n states, and which pairs touch."""

    poses: Floats  # (n, all_frames, 12), position [m] and rotation
    table: Integers  # (2), addresses of the function's argument and result
    position: Floats  # (n, frames, 3) [m]
    rotation: Floats  # (n, frames, 3, 3)
    place: Floats  # (n, shapes, 3) [m]
    axes: Floats  # (n, shapes, 3, 3)
    touching: Integers  # (n · pairs)


@step
def measure(
    n: int, reach: float, states: Floats, parts: Parts, at_states: Places, solids: Solids, gaps: Gaps, work: Floats
) -> int:
    """Poses of frames at ``states`` (n, nx) by the function at ``address``, then :func:`~wbmpc.clearance.pairs_step.nearest_own` within
    ``reach`` [m]: how many pairs touch."""
    address, nx, all_frames, frames, shapes, rows = (
        parts.address,
        parts.nx,
        parts.all_frames,
        parts.frames,
        parts.shapes,
        parts.rows,
    )
    poses, table, position, rotation = at_states.poses, at_states.table, at_states.position, at_states.rotation
    for k in range(n):
        table[0] = states.ctypes.data + 8 * k * nx
        table[1] = poses.ctypes.data + 8 * k * 12 * all_frames
        call2(address, table.ctypes.data, table.ctypes.data + 8)
        for f in range(frames):
            at, to = 12 * (k * all_frames + f), k * frames + f
            for i in range(3):
                position[3 * to + i] = poses[at + i]
            for i in range(9):
                rotation[9 * to + i] = poses[at + 3 + i]
    place_solids(
        n, shapes, frames, parts.frame_of, parts.local, parts.turn, position, rotation, at_states.place, at_states.axes
    )
    for i in range(n * rows):
        gaps.distance[i] = reach
    _compared, touch = nearest_own(
        n=n, shapes=shapes, rows=rows, pairs=parts.pairs, solids=solids, gaps=gaps, row_of=parts.row_of, one=parts.one,
        two=parts.two, place=at_states.place, axes=at_states.axes, touching=at_states.touching, work=work,
    )  # fmt: skip
    return touch


@step
def fill(
    n: int, all_frames: int, rows: int, reach: float, margins: Floats, poses: Floats, of_a: Integers, of_b: Integers, above: Integers,
    gaps: Gaps, parameters: Floats,
) -> None:  # fmt: skip
    """``parameters`` (n, rows, 10): normal in the axes of the frame ``above`` both, the nearest points in those of the pair's frames, the
    pair's margin; zeros beyond ``reach``, where ``distance`` becomes infinite."""
    distance, normal, own, other = gaps.distance, gaps.normal, gaps.own, gaps.other
    for k in range(n):
        for r in range(rows):
            i, to = k * rows + r, 10 * (k * rows + r)
            a, b = 12 * (k * all_frames + of_a[r]), 12 * (k * all_frames + of_b[r])
            top = 12 * (k * all_frames + above[r])
            there = distance[i] < reach
            for c in range(3):
                n_c, a_c, b_c = 0.0, 0.0, 0.0
                for j in range(3):
                    n_c += normal[3 * i + j] * poses[top + 3 + 3 * j + c]
                    a_c += (own[3 * i + j] - poses[a + j]) * poses[a + 3 + 3 * j + c]
                    b_c += (other[3 * i + j] - poses[b + j]) * poses[b + 3 + 3 * j + c]
                parameters[to + c] = n_c if there else 0.0
                parameters[to + 3 + c] = a_c if there else 0.0
                parameters[to + 6 + c] = b_c if there else 0.0
            parameters[to + 9] = margins[r] if there else 0.0
            if not there:
                distance[i] = np.inf
