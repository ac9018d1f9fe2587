"""Compiled loops around the kernels, so that single parts of an iteration can be timed without the interpreter."""

from __future__ import annotations

from wbmpc.kernel.ir import Floats, Integers, PointerCall
from wbmpc.kernel.library import Library

LIBRARY = Library("race")
compiled = LIBRARY.compiled
call2, call5, call7 = PointerCall(2), PointerCall(5), PointerCall(7)

#: Entries of the sizes that the loops take.
N, NX, NU, LX, LZ, NODE_AB, NODE_H, NODE_E, NODE_K = range(9)


@compiled
def backward(
    address: int,
    sizes: Integers,
    ab: Floats,
    h: Floats,
    e: Floats,
    eps: Floats,
    end: Floats,
    value: Floats,
    k: Floats,
    scratch: Floats,
) -> None:
    """All Riccati steps, from the last node to the first. ``NODE_…``: doubles per node."""
    nx, lx = sizes[NX], sizes[LX]
    for i in range((nx + 1) * lx):
        value[i] = end[i]
    for node in range(sizes[N] - 1, -1, -1):
        call7(
            address,
            ab.ctypes.data + 8 * node * sizes[NODE_AB],
            h.ctypes.data + 8 * node * sizes[NODE_H],
            e.ctypes.data + 8 * node * sizes[NODE_E],
            eps.ctypes.data,
            value.ctypes.data,
            k.ctypes.data + 8 * node * sizes[NODE_K],
            scratch.ctypes.data,
        )
        for i in range(nx):
            for j in range(i):
                value[j * lx + i] = value[i * lx + j]


@compiled
def forward(sizes: Integers, ab: Floats, k: Floats, dx: Floats, du: Floats) -> None:
    """The step from the gains."""
    nx, nu, lx, lz = sizes[NX], sizes[NU], sizes[LX], sizes[LZ]
    for node in range(sizes[N]):
        x, u = node * lx, node * nu
        for j in range(nu):
            row, total = node * sizes[NODE_K] + j * lx, 0.0
            for i in range(nx + 1):
                total += k[row + i] * dx[x + i]
            du[u + j] = total
        for r in range(nx):
            row, total = node * sizes[NODE_AB] + r * lz, 0.0
            for i in range(nx + 1):
                total += ab[row + i] * dx[x + i]
            for j in range(nu):
                total += ab[row + nx + 1 + j] * du[u + j]
            dx[x + lx + r] = total


@compiled
def sweep(address: int, arguments: Integers, width: int, count: int, results: Integers) -> None:
    """A stage function at ``count`` blocks of nodes; every row of ``width`` ``arguments`` holds its pointers."""
    for k in range(count):
        call2(address, arguments.ctypes.data + 8 * k * width, results.ctypes.data)


@compiled
def chain_all(address: int, j: Floats, size: int, count: int, weights: Floats) -> None:
    """The chain rule of one Runge-Kutta stage at ``count`` blocks; ``j`` holds four matrices of ``size`` doubles."""
    first = j.ctypes.data
    for _ in range(count):
        call5(address, first, first + 8 * size, first + 16 * size, first + 24 * size, weights.ctypes.data)
