"""Nearest points of balls about a robot's frames and a grid of distances, compiled.

The first side of a frame is where its nearest ball is; further ones are nearest of those that the grid pushes to another direction: what
stands left and right of a frame is then known at once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wbmpc.clearance.compilation import compiled
from wbmpc.kernel.ir import Floats, Integers

#: Slopes below this show no direction; normals within this cosine of each other are one side.
FLAT, SAME = 0.1, 0.5
#: By how many cells a value may be more than one at a corner of the same cell: values change by two per cell at most.
DROP = 3.5


class Balls(NamedTuple):
    """Balls about a robot's frames."""

    frame_of: Integers  # (b)
    local: Floats  # (b, 3) [m], in axes of their frames
    radius: Floats  # (b) [m]


class Grid(NamedTuple):
    """Distances at cells."""

    nx: int
    ny: int
    nz: int
    cell: float  # [m]
    layer: float  # [m], between cells along z
    values: Floats  # (nx, ny, nz) [m]
    place: Floats  # (3) [m], of cell (0, 0, 0)
    turn: Floats  # (3, 3), the grid's axes


class Sides(NamedTuple):
    """What is nearest by state, frame and side; limits of ``distance`` come in it."""

    distance: Floats  # (n, F, sides) [m]
    normal: Floats  # (n, F, sides, 3)
    ball: Integers  # (n, F, sides), -1: none
    center: Floats  # (n, b, 3) [m], of the balls


@compiled
def corner(grid: Grid, x: float, y: float, z: float) -> int:
    """Where the values of the cell around a point (in cells) begin; -1 outside of the grid."""
    nx, ny, nz = grid.nx, grid.ny, grid.nz
    if not (x >= 0.0 and y >= 0.0 and z >= 0.0 and x <= nx - 1.0 and y <= ny - 1.0 and z <= nz - 1.0):
        return -1
    i, j, k = min(int(x), nx - 2), min(int(y), ny - 2), min(int(z), nz - 2)
    return (i * ny + j) * nz + k


@compiled
def trilinear(grid: Grid, at: int, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Value and slopes (per cell) at a point (in cells), in the cell whose values begin ``at``."""
    nx, ny, nz, values = grid.nx, grid.ny, grid.nz, grid.values
    u, v, w = x - float(min(int(x), nx - 2)), y - float(min(int(y), ny - 2)), z - float(min(int(z), nz - 2))
    a = at + ny * nz
    l00, l01 = values[at] * (1.0 - w) + values[at + 1] * w, values[at + nz] * (1.0 - w) + values[at + nz + 1] * w
    h00, h01 = values[a] * (1.0 - w) + values[a + 1] * w, values[a + nz] * (1.0 - w) + values[a + nz + 1] * w
    low, high = l00 * (1.0 - v) + l01 * v, h00 * (1.0 - v) + h01 * v
    d00, d01 = values[at + 1] - values[at], values[at + nz + 1] - values[at + nz]
    e00, e01 = values[a + 1] - values[a], values[a + nz + 1] - values[a + nz]
    gz = (d00 * (1.0 - v) + d01 * v) * (1.0 - u) + (e00 * (1.0 - v) + e01 * v) * u
    return low * (1.0 - u) + high * u, high - low, (l01 - l00) * (1.0 - u) + (h01 - h00) * u, gz


@compiled
def insert_ball(found: Sides, side: int, row: int, b: int, d: float, nx: float, ny: float, nz: float) -> None:
    """A ball at distance ``d`` with its normal, where it is nearer than the entry ``row + side`` and of another side than those before."""
    distance, normal, ball = found.distance, found.normal, found.ball
    if d >= distance[row + side]:
        return
    for s in range(side):
        o = 3 * (row + s)
        if ball[row + s] >= 0 and normal[o] * nx + normal[o + 1] * ny + normal[o + 2] * nz > SAME:
            return
    at = row + side
    distance[at], ball[at] = d, b
    normal[3 * at], normal[3 * at + 1], normal[3 * at + 2] = nx, ny, nz


@compiled
def nearest(
    n: int,
    frames: int,
    count: int,
    sides: int,
    balls: Balls,
    position: Floats,
    rotation: Floats,
    grid: Grid,
    found: Sides,
) -> None:
    """Of n states, by frame and side, the nearest of ``count`` balls; frames at ``position`` (n, F, 3) with ``rotation`` (n, F, 3, 3)."""
    frame_of, local, radius, center = balls.frame_of, balls.local, balls.radius, found.center
    cell, layer, values, place, turn = grid.cell, grid.layer, grid.values, grid.place, grid.turn
    for side in range(sides):
        for k in range(n):
            for b in range(count):
                at, c = k * frames + frame_of[b], 3 * (k * count + b)
                row = at * sides
                if side > 0 and found.ball[row] < 0:
                    continue
                for i in range(3):
                    r = 9 * at + 3 * i
                    center[c + i] = (
                        position[3 * at + i]
                        + rotation[r] * local[3 * b]
                        + rotation[r + 1] * local[3 * b + 1]
                        + rotation[r + 2] * local[3 * b + 2]
                    )
                x, y, z = center[c] - place[0], center[c + 1] - place[1], center[c + 2] - place[2]
                gx = (turn[0] * x + turn[3] * y + turn[6] * z) / cell
                gy = (turn[1] * x + turn[4] * y + turn[7] * z) / cell
                gz = (turn[2] * x + turn[5] * y + turn[8] * z) / layer
                first = corner(grid, gx, gy, gz)
                if first < 0 or values[first] - DROP * cell - radius[b] >= found.distance[row + side]:
                    continue
                d, sx, sy, sz = trilinear(grid, first, gx, gy, gz)
                sz = sz * cell / layer
                steep = np.sqrt(sx * sx + sy * sy + sz * sz)
                if steep > FLAT * cell:
                    insert_ball(
                        found, side, row, b, d - radius[b],
                        (turn[0] * sx + turn[1] * sy + turn[2] * sz) / steep,
                        (turn[3] * sx + turn[4] * sy + turn[5] * sz) / steep,
                        (turn[6] * sx + turn[7] * sy + turn[8] * sz) / steep,
                    )  # fmt: skip
