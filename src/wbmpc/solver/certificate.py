"""What a solution is worth: the largest violation of every constraint by name, and why a failed solve failed.

``ws``: the memory of a solve. That of the interpreted twin has fewer fields: who needs others asks for them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from wbmpc.ocp import AugmentedLagrangian, Constraint, Transcription
from wbmpc.ocp.constraint_classification import Kind, row_names
from wbmpc.ocp.stage_costs import term_values
from wbmpc.ocp.term_rows import violation, with_input, with_state
from wbmpc.solver.memory_layout import StateField
from wbmpc.solver.workspace import Workspace

#: What messages call the model.
DYNAMICS = "the dynamics"


class Violation(NamedTuple):
    """``value`` in the residual's unit (0: met), at ``node``, in the residual's row ``row``."""

    value: float
    node: int
    row: str

    def __str__(self) -> str:
        return f"{self.row} by {self.value:.3g} at node {self.node}"


def must_hold(problem: Transcription, term: Any) -> bool:
    """Whether a constraint is to be met exactly. Relaxed barriers are soft, and so are rows that a softness softens (those of
    the Riccati recursion): no problem is infeasible because of them."""
    if isinstance(term.penalty, AugmentedLagrangian) or not term.equality:
        return term.hard or isinstance(term.penalty, AugmentedLagrangian)
    return term.softness == 0.0 or term.at == "terminal" or not with_input(problem, term).all()


def gives_way(problem: Transcription, term: Any) -> bool:
    """Whether a constraint is a hard limit with an L1 slack in all of its rows (those of inputs alone have none): whatever the start, there
    is a solution that misses it."""
    soft = _rows_that_give_way(problem, term)
    return bool(soft.any() and (soft | ~with_state(problem, term)).all())


def _rows_that_give_way(problem: Transcription, term: Any) -> np.ndarray:
    """Which rows of a constraint have an L1 slack: rows of inputs alone have none."""
    alone = with_input(problem, term) & ~with_state(problem, term)
    return np.asarray(np.isfinite(term.slacks) & ~alone & (term.hard and not term.equality))


def rows_that_must_hold(problem: Transcription) -> dict[str, np.ndarray]:
    """By constraint, which of its rows must hold exactly: of those with a slack, rows of inputs alone."""
    found = {}
    for name, term in problem.ocp.terms.items():
        if isinstance(term, Constraint) and must_hold(problem, term):
            found[name] = ~_rows_that_give_way(problem, term)
    return found


class Checks:
    """Functions of one problem that say how far every constraint is from being met."""

    def __init__(self, problem: Transcription) -> None:
        self.problem = problem
        terms = [t for t in problem.ocp.terms.values() if isinstance(t, Constraint)]
        self.path = [t for t in terms if t.at != "terminal"]
        self.end = [t for t in terms if t.at != "path"]
        args = [problem.x, problem.u, problem.p, problem.w]
        broken = lambda chosen: [violation(problem, t) for t in chosen]
        self._path = ca.Function("path", args, [ca.densify(e) for e in broken(self.path)])
        self._gradients: dict[str, ca.Function] = {}
        self._end = ca.Function("end", args, [ca.densify(e) for e in broken(self.end)])

    def violations(
        self, x: np.ndarray, u: np.ndarray, p: np.ndarray, w: np.ndarray, rows: Mapping[str, np.ndarray] | None = None
    ) -> dict[str, Violation]:
        """By constraint; rows of the state alone do not count at the measured state. ``rows``: which ones count, of which constraints."""
        n = len(u)
        p, w = p[:, : self.problem.node.size], w[: self.problem.constant.size]
        found: dict[str, Violation] = {}
        along = self._path.call([x[:n].T, u.T, p[:n].T, np.tile(w[:, None], (1, n))]) if self.path else []
        nothing = np.zeros(self.problem.nu)
        last = self._end.call([x[n], nothing, p[n], w]) if self.end else []
        for term, values in zip(self.path, along, strict=True):
            table = np.array(ca.DM(values)).reshape(term.residual.size, n)
            table[~with_input(self.problem, term), 0] = 0.0
            self._keep(found, term, table, 0, rows)
        for term, values in zip(self.end, last, strict=True):
            table = np.array(ca.DM(values)).reshape(term.residual.size, 1)
            table[with_input(self.problem, term)] = 0.0
            self._keep(found, term, table, n, rows)
        return found

    def slope(self, term: Constraint, where: Violation, ws: Workspace) -> float:
        """Length of the gradient of a violated row: how fast it changes with the variables."""
        problem = self.problem
        if where.row not in self._gradients:
            r = problem.residual(term)[row_names(term).index(where.row)]
            args = [problem.x, problem.u, problem.p, problem.w]
            self._gradients[where.row] = ca.Function("slope", args, [ca.densify(ca.jacobian(r, problem.z))])
        return float(np.linalg.norm(np.array(self._gradients[where.row](*_arguments(problem, ws, where.node)))))

    def _keep(
        self, found: dict[str, Violation], term: Constraint, table: np.ndarray, first: int,
        rows: Mapping[str, np.ndarray] | None,
    ) -> None:  # fmt: skip
        if rows is not None:
            table[~rows.get(term.name, np.zeros(len(table), bool))] = 0.0
        if not table.size:
            return
        row, node = np.unravel_index(int(np.argmax(np.where(np.isnan(table), np.inf, table))), table.shape)
        worst = Violation(float(table[row, node]), int(node) + first, row_names(term)[row])
        if term.name not in found or worst.value > found[term.name].value:
            found[term.name] = worst


def not_finite_trial(problem: Transcription, ws: Workspace) -> str:
    """As ``not_finite``, of the last trial point of the line search; empty for the interpreted twin."""
    return not_finite(problem, trial(ws)) if hasattr(ws, "x_trial") else ""


def trial(ws: Workspace) -> Workspace:
    """The last trial point of the line search in place of the iterate."""
    return replace(ws, x=ws.x_trial, u=ws.u_trial)


def after_full_step(problem: Transcription, ws: Workspace) -> Workspace:
    """Where the last direction leads."""
    return replace(ws, x=ws.x + ws.dx[:, : problem.nx], u=ws.u + ws.du)


def not_finite(problem: Transcription, ws: Workspace) -> str:
    """Which state, input, term or derivative is not finite, and at which node; empty if none is found."""
    found = _first_bad_number(problem, ws)
    if found:
        return found
    for name, function in _pieces(problem).items():
        for k in _nodes(name, ws):
            values = [np.array(v) for v in function.call(_arguments(problem, ws, k))]
            if not all(np.isfinite(v).all() for v in values):
                return f"{name} at node {k}"
    return _bad_jump(problem, ws)


def largest_term(problem: Transcription, ws: Workspace) -> str:
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


def largest_variable(problem: Transcription, ws: Workspace) -> str:
    """The largest state or input of the iterate, with its node."""
    return _largest(problem, ws.x, ws.u, "= {:.3g}")


def largest_step(problem: Transcription, ws: Workspace) -> str:
    """The state or input that the last step was to change most, with its node; empty for the interpreted twin."""
    if not hasattr(ws, "dx") or not np.isfinite(ws.dx).all():
        return ""
    return _largest(problem, ws.dx[:, : problem.nx], ws.du, "by {:.3g}")


def largest_of_rows(problem: Transcription, values: np.ndarray) -> tuple[float, str]:
    """The largest of numbers (N + 1, rows) of rows with a state of their own, and of which row at which node; (0, "") without any."""
    found = [
        (float(values[k, j]), f"{row.name} at node {k}")
        for k in range(len(values))
        for j, row in enumerate((problem.path if k < len(values) - 1 else problem.end).rows)
        if row.kind is Kind.HARD and not (k == 0 and row.state_only)
    ]
    return max(found, default=(0.0, ""))


def unsettled(problem: Transcription, ws: Workspace) -> str:
    """The slack of a hard limit that differs most from the limit's value, and by how much slacks cut the last step; empty for none."""
    if not hasattr(ws, "rows_t"):
        return ""
    with np.errstate(invalid="ignore"):
        off, where = largest_of_rows(problem, np.nan_to_num(np.abs(ws.rows_h + ws.rows_s - ws.rows_t)))
    cut = float(ws.state[StateField.MAX_PRIMAL_STEP])
    return f"the slack of {where} is off by {off:.3g} of its range, and slacks cut steps to {cut:.2g}" if off else ""


def beyond_rounding(problem: Transcription, ws: Workspace) -> str:
    """What to say where no shift of the Hessian makes a subproblem convex."""
    size, where = largest_of_rows(problem, np.abs(ws.rows_l)) if hasattr(ws, "rows_l") else (0.0, "")
    most = f": the largest multiplier, of {where}, is {size:.2g}" if where else ""
    return f"the step: no shift of the Hessian makes the subproblem convex{most}"


def _largest(problem: Transcription, x: np.ndarray, u: np.ndarray, form: str) -> str:
    d, found = problem.ocp.dynamics, []
    for kind, names, values in (("state", d.state.names, x), ("input", d.input.names, u)):
        size = np.where(np.isnan(values), np.inf, np.abs(values))
        if size.size:
            k, i = np.unravel_index(int(np.argmax(size)), size.shape)
            found.append((size[k, i], f"{kind} '{names[i]}' {form.format(values[k, i])} at node {k}"))
    return max(found)[1]


def largest_gap(problem: Transcription, ws: Workspace, x0: np.ndarray) -> tuple[float, str]:
    """By how much the start, or an interval a state of the next node, is missed at most; and a message with state and node."""
    names = problem.ocp.dynamics.state.names
    first = int(np.argmax(np.abs(x0 - ws.x[0])))
    start = float(abs(x0[first] - ws.x[0, first]))
    gaps = np.abs(step_ends(problem, ws, ws.x[:-1], ws.u) - ws.x[1:])
    for q in problem.ocp.dynamics.unit_quaternions:  # a unit quaternion is scaled after the step
        gaps[:, q : q + 4] = 0.0
    k, i = divmod(int(np.argmax(np.where(np.isnan(gaps), np.inf, gaps))), problem.nx)
    largest = float(gaps[k, i])
    if start > largest:
        return start, f"the start is not reached: '{names[first]}' by {start:.3g}"
    return largest, f"gaps of the dynamics, largest: '{names[i]}' by {largest:.3g} at node {k + 1}"


def _end(problem: Transcription, ws: Workspace, k: int) -> np.ndarray:
    """The state at the end of interval k: one Runge-Kutta step, and the jump where an event is."""
    return step_ends(problem, ws, ws.x[k : k + 1], ws.u[k : k + 1], k)[0]


def step_ends(problem: Transcription, ws: Workspace, x: np.ndarray, u: np.ndarray, first: int = 0) -> np.ndarray:
    """As many states (n, nx) and inputs (n, nu) from node ``first`` on, an interval later: (n, nx)."""
    n, f = len(u), problem.values["dynamics"]
    p, w = ws.p[first : first + n + 1, : problem.node.size].T, np.tile(ws.w[: problem.constant.size, None], (1, n))
    h = np.diff(ws.grid)[first : first + n]
    slope = lambda at: np.array(f(at, u.T, p[:, :n], w)).reshape(problem.nx, n)
    k1 = slope(x.T)
    k2 = slope(x.T + 0.5 * h * k1)
    step = h * k2
    if problem.ocp.integrator == "rk4":
        k3 = slope(x.T + 0.5 * h * k2)
        step = h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + slope(x.T + h * k3))
    end, events = x.T + step, np.asarray(_events(problem, ws)[first : first + n], bool)
    if events.any():
        end[:, events] = np.array(problem.values["jump"](end, p[:, 1:], w)).reshape(problem.nx, n)[:, events]
    return end.T  # type: ignore[no-any-return]


def _events(problem: Transcription, ws: Workspace) -> np.ndarray:
    """For every interval, whether the state jumps at its end: the last entries of the solver's table."""
    n = len(ws.u)
    return ws.table[-n:] if problem.jumps else np.zeros(n)


def _bad_jump(problem: Transcription, ws: Workspace) -> str:
    """The first jump whose result is not finite, with the node after it; empty if there is none."""
    bad = [k + 1 for k in np.flatnonzero(_events(problem, ws)) if not np.isfinite(_end(problem, ws, int(k))).all()]
    return f"the jump at node {bad[0]}" if bad else ""


def unstable_interval(problem: Transcription, ws: Workspace) -> str:
    """Where the grid is too coarse for the dynamics: a motion that decays and that the integrator lets grow; a message.

    Looked for at five nodes.
    """
    lengths, rk4 = np.diff(ws.grid), problem.ocp.integrator == "rk4"
    for k in np.unique(np.linspace(0, len(lengths) - 1, 5).astype(int)):
        found = _state_jacobian(problem, ws, k)
        if not np.isfinite(found).all():
            continue
        h = float(lengths[k])
        z = h * np.linalg.eigvals(found)
        growth = np.abs(1.0 + z + z**2 / 2.0 + (z**3 / 6.0 + z**4 / 24.0 if rk4 else 0.0))
        growth[z.real > -1.0] = 0.0
        i = int(np.argmax(growth))
        if growth[i] > 1.0 + 1e-6:
            return (
                f"; the interval of {h:.3g} s at node {k} is too long for the integrator: a motion that decays within "
                f"{h / abs(z[i].real):.2g} s grows {growth[i]:.2g} times"
            )
    return ""


def _state_jacobian(problem: Transcription, ws: Workspace, k: int) -> np.ndarray:
    """∂f/∂x at node k by differences: a warm start has no derivatives as functions."""
    x, u, p, w = _arguments(problem, ws, k)
    step = 1e-6 * (1.0 + np.abs(x))
    points = np.hstack([x[:, None] + np.diag(step), x[:, None] - np.diag(step)])
    values = np.array(problem.values["dynamics"](points, u, p, w)).reshape(problem.nx, -1)
    return (values[:, : problem.nx] - values[:, problem.nx :]) / (2.0 * step)  # type: ignore[no-any-return]


def unweighted_inputs(problem: Transcription) -> list[str]:
    """Inputs that no term of the path depends on: nothing but the motion says what they should be."""
    seen = np.zeros(problem.nu, bool)
    for value in term_values(problem, "path").values():
        seen |= np.array([ca.depends_on(value, problem.u[i]) for i in range(problem.nu)])
    return [n for n, yes in zip(problem.ocp.dynamics.input.names, seen, strict=True) if not yes]


def _first_bad_number(problem: Transcription, ws: Workspace) -> str:
    """The first state or input along the horizon that is not finite: what is behind it follows from it."""
    bad = []
    names = (("state", problem.ocp.dynamics.state.names, ws.x), ("input", problem.ocp.dynamics.input.names, ws.u))
    for order, (kind, labels, values) in enumerate(names):
        bad += [(int(k), order, f"{kind} '{labels[i]}'") for k, i in np.argwhere(~np.isfinite(values))[:1]]
    if not bad:
        return ""
    k, order, name = min(bad)
    origin = "of the guess or the last iterate"
    if k > 0 and order == 0 and not np.isfinite(_end(problem, ws, k - 1)).all():
        origin = f"from {'the jump there' if _events(problem, ws)[k - 1] else DYNAMICS}"
    return f"{name} at node {k} {origin}"


def _nodes(name: str, ws: Workspace) -> range:
    """Where a piece counts."""
    n = len(ws.u)
    return range(n, n + 1) if name.startswith("terminal") else range(n)


def _arguments(problem: Transcription, ws: Workspace, k: int) -> list[np.ndarray]:
    """(x, u, p, w) of node k; there is no input at the end."""
    u = ws.u[k] if k < len(ws.u) else np.zeros(problem.nu)
    return [ws.x[k], u, ws.p[k, : problem.node.size], ws.w[: problem.constant.size]]


def _pieces(problem: Transcription) -> Mapping[str, ca.Function]:
    """Every term, the dynamics and their derivatives as functions of (x, u, p, w)."""
    args = [problem.x, problem.u, problem.p, problem.w]
    z = problem.z
    second = lambda e: [ca.densify(ca.hessian(ca.sum1(e), z)[0])] if problem.exact else []
    make = lambda e: ca.Function("piece", args, [ca.densify(e), ca.densify(ca.jacobian(e, z)), *second(e)])
    pieces = {DYNAMICS: make(problem.rates)}
    for name, value in term_values(problem, "path").items():
        pieces[f"term '{name}'"] = make(value)
    for name, value in term_values(problem, "terminal").items():
        pieces[f"terminal term '{name}'"] = make(value)
    return pieces
