"""Kernels of rows of one variable, h = sign z + offset, that know which variable each row has.

A variable is its index in [x, 1, u]; the rows of a node lie side by side, eight to a vector, in the order of their variables.
"""

from __future__ import annotations

from collections.abc import Sequence

from wbmpc.kernel.dense import Body


def _gather(b: Body, nx: int, variables: Sequence[int]) -> str:
    """Up to eight variables of the states X and the inputs U as one vector; neighbors are loaded together."""
    places = [("X", v) if v < nx else ("U", v - nx - 1) for v in variables]
    found, got = "poison", set[int]()
    while len(got) < len(places):
        array, start = min(place for lane, place in enumerate(places) if lane not in got)
        near = {q for q, (a, i) in enumerate(places) if a == array and start <= i < start + 8 and q not in got}
        vector = b.load_unaligned(array, start)
        lanes = [q if q in got else 8 + places[q][1] - start if q in near else 0 for q in range(len(places))]
        found, got = b.shuffle(found, vector, [*lanes, *[0] * (8 - len(lanes))]), got | near
    return found


def emit_box_values(name: str, nx: int, variables: Sequence[int], offsets: bool) -> str:
    """OUT[j] = SIGN[j] z + OFFSET[j] of every row, without the last summand unless ``offsets``; arguments X, U, SIGN, OFFSET, OUT.

    What is loaded beside a variable is not used, up to seven numbers behind a node's."""
    b = Body(name, "X U SIGN OFFSET OUT")
    for first in range(0, len(variables), 8):
        own = variables[first : first + 8]
        z, sign = _gather(b, nx, own), b.load("SIGN", first)
        value = b.fma(z, sign, b.load("OFFSET", first)) if offsets else b.scale(z, sign)
        b.store_some(value, len(own), "OUT", first)
    return b.text()


def emit_add_boxes(name: str, nx: int, variables: Sequence[int], lz: int) -> str:
    """H += w σ sign² on the diagonal and w σ sign e in the constant's row and column; arguments SIGN, C (σ), E, W (w), H.

    Of the Hessian what is above the diagonal."""
    b = Body(name, "SIGN C E W H")
    w, curves, slopes = b.spread_from("W", 0), dict[int, list[str]](), dict[int, list[str]]()
    for first in range(0, len(variables), 8):
        sign = b.load("SIGN", first)
        slope = b.scale(b.scale(w, b.load("C", first)), sign)
        parts = ((curves, b.scale(slope, sign)), (slopes, b.scale(slope, b.load("E", first))))
        for lane, variable in enumerate(variables[first : first + 8]):
            for sums, vector in parts:
                sums.setdefault(variable, []).append(b.extract(vector, lane))
    for variable, parts_of_it in curves.items():
        gradient = nx * lz + variable if variable < nx else variable * lz + nx
        for at, summands in ((variable * lz + variable, parts_of_it), (gradient, slopes[variable])):
            total = b.load_scalar("H", at)
            for summand in summands:
                total = b.new(f"fadd double {total}, {summand}")
            b.store_scalar(total, "H", at)
    return b.text()
