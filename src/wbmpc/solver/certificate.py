"""What a solution is worth: the largest violation of every constraint by name, and what a failed solve died of."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from wbmpc.ocp import Constraint, Transcription
from wbmpc.ocp.rows import row_names

#: What messages call the model.
DYNAMICS = "the dynamics"


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
    found = _first_bad_number(problem, ws)
    if found:
        return found
    for name, function in _pieces(problem).items():
        for k in _nodes(name, ws):
            values = [np.array(v) for v in function.call(_arguments(problem, ws, k))]
            if not all(np.isfinite(v).all() for v in values):
                return f"{name} at node {k}"
    return ""


def largest_term(problem: Transcription, ws: Any) -> str:
    """The term of the largest absolute value (costs weighted, without the interval's length), with its node."""
    worst, found = 0.0, ""
    for name, function in _pieces(problem).items():
        if name == DYNAMICS:
            continue
        for k in _nodes(name, ws):
            value = float(np.max(np.abs(np.array(function.call(_arguments(problem, ws, k))[0])), initial=0.0))
            if value > worst:
                worst, found = value, f"{name} = {value:.3g} at node {k}"
    return found


def largest_variable(problem: Transcription, ws: Any) -> str:
    """The largest state or input of the iterate, with its node."""
    return _largest(problem, ws.x, ws.u, "= {:.3g}")


def largest_step(problem: Transcription, ws: Any) -> str:
    """The state or input that the last step was to change most, with its node; empty for the interpreted twin."""
    if not hasattr(ws, "dx"):
        return ""
    return _largest(problem, ws.dx[:, : problem.nx], ws.du, "by {:.3g}")


def _largest(problem: Transcription, x: np.ndarray, u: np.ndarray, form: str) -> str:
    d, found = problem.ocp.dynamics, []
    for kind, names, values in (("state", d.state.names, x), ("input", d.input.names, u)):
        size = np.where(np.isnan(values), np.inf, np.abs(values))
        if size.size:
            k, i = np.unravel_index(int(np.argmax(size)), size.shape)
            found.append((size[k, i], f"{kind} '{names[i]}' {form.format(values[k, i])} at node {k}"))
    return max(found)[1]


def largest_gap(problem: Transcription, ws: Any) -> tuple[float, str]:
    """By how much an interval misses a state of the next node at most, and a sentence with state and node.

    Infinite, without a place, for problems with jumps, which are not repeated here.
    """
    where = "gaps of the dynamics"
    if problem.jumps:
        return np.inf, where
    w, f = ws.w[: problem.constant.size], problem.values["dynamics"]
    gaps = np.zeros((len(ws.u), problem.nx))
    for k, h in enumerate(np.diff(ws.grid)):
        x, u, p = ws.x[k], ws.u[k], ws.p[k, : problem.node.size]
        slope = lambda at, u=u, p=p: np.array(f(at, u, p, w)).ravel()
        first = slope(x)
        second = slope(x + 0.5 * h * first)
        step = h * second
        if problem.ocp.integrator == "rk4":
            third = slope(x + 0.5 * h * second)
            step = h / 6.0 * (first + 2.0 * second + 2.0 * third + slope(x + h * third))
        gaps[k] = np.abs(x + step - ws.x[k + 1])
    for q in problem.ocp.dynamics.unit_quaternions:  # a unit quaternion is scaled after the step
        gaps[:, q : q + 4] = 0.0
    k, i = divmod(int(np.argmax(np.where(np.isnan(gaps), np.inf, gaps))), problem.nx)
    return float(
        gaps[k, i]
    ), f"{where}, largest: '{problem.ocp.dynamics.state.names[i]}' by {gaps[k, i]:.3g} at node {k + 1}"


def unseen_inputs(problem: Transcription) -> list[str]:
    """Inputs that no term of the path looks at: nothing but the motion says what they should be."""
    seen = np.zeros(problem.nu, bool)
    for value in problem.term_values("path").values():
        seen |= np.array([ca.depends_on(value, problem.u[i]) for i in range(problem.nu)])
    return [n for n, yes in zip(problem.ocp.dynamics.input.names, seen, strict=True) if not yes]


def _first_bad_number(problem: Transcription, ws: Any) -> str:
    """The first state or input along the horizon that is not finite: what is behind it follows from it."""
    bad = []
    names = (("state", problem.ocp.dynamics.state.names, ws.x), ("input", problem.ocp.dynamics.input.names, ws.u))
    for order, (kind, labels, values) in enumerate(names):
        bad += [(k, order, f"{kind} '{labels[i]}'") for k, i in np.argwhere(~np.isfinite(values))[:1]]
    return f"{min(bad)[2]} at node {min(bad)[0]} of the guess or the last iterate" if bad else ""


def _nodes(name: str, ws: Any) -> range:
    """Where a piece counts."""
    n = len(ws.u)
    return range(n, n + 1) if name.startswith("terminal") else range(n)


def _arguments(problem: Transcription, ws: Any, k: int) -> list[np.ndarray]:
    """(x, u, p, w) of node k; there is no input at the end."""
    u = ws.u[k] if k < len(ws.u) else np.zeros(problem.nu)
    return [ws.x[k], u, ws.p[k, : problem.node.size], ws.w[: problem.constant.size]]


def _pieces(problem: Transcription) -> Mapping[str, ca.Function]:
    """Every term, the dynamics and their derivatives as functions of (x, u, p, w)."""
    args = [problem.x, problem.u, problem.p, problem.w]
    z = problem.z
    make = lambda e: ca.Function("piece", args, [ca.densify(e), ca.densify(ca.jacobian(e, z))])
    pieces = {DYNAMICS: make(problem.rates)}
    for name, value in problem.term_values("path").items():
        pieces[f"term '{name}'"] = make(value)
    for name, value in problem.term_values("terminal").items():
        pieces[f"terminal term '{name}'"] = make(value)
    return pieces
