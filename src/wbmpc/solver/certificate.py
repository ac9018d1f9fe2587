"""What a solution is worth: the largest violation of every constraint by name, and what a failed solve died of."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from wbmpc.ocp import Constraint, Transcription
from wbmpc.ocp.rows import row_names


class Violation(NamedTuple):
    """``value`` in the residual's unit (0: met), at ``node``, in the residual's row ``row``."""

    value: float
    node: int
    row: str

    def __str__(self) -> str:
        return f"{self.row} by {self.value:.3g} at node {self.node}"


class Checks:
    """Functions of one problem that say how far every constraint is from being met."""

    def __init__(self, problem: Transcription) -> None:
        self.problem = problem
        terms = [t for t in problem.ocp.terms.values() if isinstance(t, Constraint)]
        self.path = [t for t in terms if t.at != "terminal"]
        self.end = [t for t in terms if t.at != "path"]
        args = [problem.x, problem.u, problem.p, problem.w]
        broken = lambda chosen: [problem.broken(t) for t in chosen]
        self._path = ca.Function("path", args, [ca.densify(e) for e in broken(self.path)])
        self._end = ca.Function("end", args, [ca.densify(e) for e in broken(self.end)])

    def violations(self, x: np.ndarray, u: np.ndarray, p: np.ndarray, w: np.ndarray) -> dict[str, Violation]:
        """By constraint; rows of the state alone do not count at the measured state."""
        n = len(u)
        p, w = p[:, : self.problem.node.size], w[: self.problem.constant.size]
        found: dict[str, Violation] = {}
        along = self._path.call([x[:n].T, u.T, p[:n].T, np.tile(w[:, None], (1, n))]) if self.path else []
        nothing = np.zeros(self.problem.nu)
        last = self._end.call([x[n], nothing, p[n], w]) if self.end else []
        for term, values in zip(self.path, along, strict=True):
            table = np.array(ca.DM(values)).reshape(term.residual.size, -1)
            table[~self.problem.with_input(term), 0] = 0.0
            self._keep(found, term, table, 0)
        for term, values in zip(self.end, last, strict=True):
            table = np.array(ca.DM(values)).reshape(-1, 1)
            table[self.problem.with_input(term)] = 0.0
            self._keep(found, term, table, n)
        return found

    def _keep(self, found: dict[str, Violation], term: Constraint, table: np.ndarray, first: int) -> None:
        if not table.size:
            return
        row, node = np.unravel_index(int(np.argmax(np.where(np.isnan(table), np.inf, table))), table.shape)
        worst = Violation(float(table[row, node]), int(node) + first, row_names(term)[row])
        if term.name not in found or worst.value > found[term.name].value:
            found[term.name] = worst


def not_finite(problem: Transcription, ws: Any) -> str:
    """Which state, input, term or derivative is not finite, and at which node; empty if none is found."""
    n, p, w = len(ws.u), ws.p[:, : problem.node.size], ws.w[: problem.constant.size]
    names = {"state": (problem.ocp.dynamics.state.names, ws.x), "input": (problem.ocp.dynamics.input.names, ws.u)}
    for kind, (labels, values) in names.items():
        bad = np.argwhere(~np.isfinite(values))
        if bad.size:
            return f"{kind} '{labels[bad[0][1]]}' at node {bad[0][0]} of the guess or the last iterate"
    for name, function in _pieces(problem).items():
        for k in range(n + (1 if name.startswith("terminal") else 0)):
            if name.startswith("terminal") and k < n:
                continue
            u = ws.u[k] if k < n else np.zeros(problem.nu)
            values = [np.array(v) for v in function.call([ws.x[k], u, p[k], w])]
            if not all(np.isfinite(v).all() for v in values):
                return f"{name} at node {k}"
    return ""


def _pieces(problem: Transcription) -> Mapping[str, ca.Function]:
    """Every term, the dynamics and their derivatives as functions of (x, u, p, w)."""
    args = [problem.x, problem.u, problem.p, problem.w]
    z = problem.z
    make = lambda e: ca.Function("piece", args, [ca.densify(e), ca.densify(ca.jacobian(e, z))])
    pieces = {"the dynamics": make(problem.rates)}
    for name, value in problem.term_values("path").items():
        pieces[f"term '{name}'"] = make(value)
    for name, value in problem.term_values("terminal").items():
        pieces[f"terminal term '{name}'"] = make(value)
    return pieces
