"""Rows of a function that differ only in which numbers they read and where they put theirs: distances of one frame to several obstacles.

As straight-line code such rows are fetched from memory instruction by instruction, which takes longer than to execute them: they become a loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import casadi as ca

from wbmpc.kernel.scalar import OutputMap

#: Of every result and non-zero, the row that it belongs to.
Rows = Sequence[Sequence[int]]
_MANY = -1


@dataclass(frozen=True)
class Node:
    """One instruction: its operation and operands (numbers of nodes), and what it reads or writes: (argument or result, index or offset)."""

    op: int
    operands: tuple[int, ...]
    place: tuple[int, int] = (0, 0)
    constant: float = 0.0


@dataclass
class Run:
    """The instructions of ``rows`` that are alike; ``strides``: by how much what those of the first one read and write moves on from row to
    row."""

    rows: list[list[int]]
    strides: dict[int, int] = field(default_factory=dict)

    @property
    def own(self) -> list[int]:
        """The instructions of the first row."""
        return self.rows[0]


def nodes_of(function: ca.Function, outputs: OutputMap) -> list[Node] | None:
    """The instructions of a function; None where a result goes to several places."""
    found, last = [], dict[int, int]()
    for k in range(function.n_instructions()):
        op, to, of = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
        if op == ca.OP_CONST:
            node = Node(op, (), constant=function.instruction_constant(k))
        elif op == ca.OP_INPUT:
            node = Node(op, (), (of[0], of[1]))
        elif op == ca.OP_OUTPUT:
            offsets = outputs[to[0]][to[1]]
            if len(offsets) != 1:
                return None
            node = Node(op, (last[of[0]],), (to[0], offsets[0]))
        else:
            node = Node(op, tuple(last[i] for i in of))
        found.append(node)
        if op != ca.OP_OUTPUT:
            last[to[0]] = k
    return found


def _own(function: ca.Function, nodes: Sequence[Node], rows: Rows, shared: Sequence[int]) -> dict[int, list[int]]:
    """Of every row the instructions that nothing else needs."""
    owner: dict[int, int] = {}
    for k in reversed(range(len(nodes))):
        node = nodes[k]
        if node.op == ca.OP_OUTPUT:
            result, nonzero = function.instruction_output(k)
            owner[k] = rows[result][nonzero]
        elif node.op == ca.OP_INPUT and node.place[0] in shared:
            owner[k] = _MANY
        for i in node.operands:
            owner[i] = owner[k] if owner.get(i, owner[k]) == owner[k] else _MANY
    found: dict[int, list[int]] = {}
    for k, node in enumerate(nodes):
        if owner.get(k, _MANY) != _MANY and node.op != ca.OP_CONST:
            found.setdefault(owner[k], []).append(k)
    return found


def _moves(nodes: Sequence[Node], one: list[int], other: list[int]) -> dict[int, int] | None:
    """By how much the places of another row's instructions are from those of one; None: they are not alike."""
    if len(one) != len(other):
        return None
    place, moves = {k: i for i, k in enumerate(one)}, dict[int, int]()
    there = {k: i for i, k in enumerate(other)}
    for a, b in zip(one, other, strict=True):
        p, q = nodes[a], nodes[b]
        if p.op != q.op or p.place[0] != q.place[0] or len(p.operands) != len(q.operands):
            return None
        for i, j in zip(p.operands, q.operands, strict=True):
            own = i in place and place[i] == there.get(j, -1)
            constant = nodes[i].op == nodes[j].op == ca.OP_CONST and nodes[i].constant == nodes[j].constant
            if not (own or constant or (i == j and i not in place)):
                return None
        if p.op in (ca.OP_INPUT, ca.OP_OUTPUT):
            moves[a] = q.place[1] - p.place[1]
    return moves


def find_runs(function: ca.Function, nodes: Sequence[Node], rows: Rows, shared: Sequence[int]) -> list[Run]:
    """Neighboring rows that are alike, two at least."""
    runs: list[Run] = []
    own = _own(function, nodes, rows, shared)
    for row in sorted(own):
        last = runs[-1] if runs else Run([[]])
        moves = _moves(nodes, last.own, own[row])
        if moves is not None and len(last.rows) == 1:
            last.strides = moves
        if moves is not None and moves == {k: len(last.rows) * stride for k, stride in last.strides.items()}:
            last.rows.append(own[row])
        else:
            runs.append(Run([own[row]]))
    return [run for run in runs if len(run.rows) > 1]
