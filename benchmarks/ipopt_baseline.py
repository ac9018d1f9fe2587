"""The discretized problem of a solver for IPOPT, with the L1 slacks of hard state rows as unknowns of its own."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from wbmpc.benchmark.program import Stages, sampled
from wbmpc.ocp.constraint_classification import Kind, Row
from wbmpc.solver import Solver

_OPTIONS = {
    "print_time": 0,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.max_iter": 1000,
    "ipopt.max_cpu_time": 30.0,
    "ipopt.tol": 1e-9,
    "ipopt.constr_viol_tol": 1e-8,
    "ipopt.bound_relax_factor": 0.0,
}
#: From what is thought to be a solution.
_NEAR = {"ipopt.mu_init": 1e-6, "ipopt.bound_push": 1e-7, "ipopt.slack_bound_push": 1e-7}


class Found(NamedTuple):
    """What IPOPT says: whether it solved, cost, states (N + 1, nx), inputs (N, nu), the largest L1 slack, its own status."""

    solved: bool
    cost: float
    x: np.ndarray
    u: np.ndarray
    slack: float
    kind: str


def _closed(rows: list[Row]) -> list[int]:
    """Which rows have an L1 slack."""
    return [i for i, r in enumerate(rows) if r.kind is Kind.HARD and np.isfinite(r.penalty)]


class IpoptBaseline:
    """The problem as the solver has last seen it, from ``x0`` (nx).

    Unknowns: stages (x, u, slacks), then the end (x, slacks). Rows: start, stages [gap; equality; rows], rows of the end.
    """

    def __init__(self, solver: Solver, x0: np.ndarray) -> None:
        self.t = t = solver.problem
        self.n, self.nx, self.nu = t.ocp.intervals, t.nx, t.nu
        self.local = t.nx + t.equality.shape[0]
        self.closed, self.end_closed = _closed(t.path.rows), _closed(t.end.rows)
        self.stage = t.nx + t.nu + len(self.closed)
        z, last = ca.MX.sym("z", self.stage, self.n), ca.MX.sym("last", t.nx + len(self.end_closed))
        cost, rows, ends = self._terms(solver, z, last)
        unknowns = ca.vertcat(ca.vec(z), last)
        g = ca.vertcat(z[: t.nx, 0] - x0, ca.vec(rows), ends)
        self.rows, self.cost = ca.Function("rows", [unknowns], [g]), ca.Function("cost", [unknowns], [cost])
        self.program = {"x": unknowns, "f": cost, "g": g}
        self.lower, self.upper = self._bounds()
        slacks = np.concatenate([np.full(t.nx + t.nu, -np.inf), np.zeros(len(self.closed))])
        self.least = np.concatenate([np.tile(slacks, self.n), np.full(t.nx, -np.inf), np.zeros(len(self.end_closed))])

    def _terms(self, solver: Solver, z: ca.MX, last: ca.MX) -> tuple[ca.MX, ca.MX, ca.MX]:
        """Cost, rows of the stages (one column each), rows of the end."""
        t, s, stages = self.t, sampled(solver), Stages(self.t)
        x, u, slacks, end = z[: t.nx, :], z[t.nx : t.nx + t.nu, :], z[t.nx + t.nu :, :], last[: t.nx]
        given = [x, u, ca.DM(s.p[:-1].T), ca.repmat(ca.DM(s.w), 1, self.n), ca.DM(s.h[None, :])]
        of_end = [end, ca.DM(s.p[-1]), ca.DM(s.w)]
        cost = ca.sum2(stages.cost().map(self.n)(*given)) + stages.end()[0](*of_end)
        rows, ends = stages.constraint().map(self.n)(*given), stages.end_rows()[0](*of_end)
        rows[: t.nx, :] += ca.horzcat(x[:, 1:], end)
        for i, row in enumerate(self.closed):
            rows[self.local + row, :] += slacks[i, :]
            cost += t.path.rows[row].penalty * ca.dot(ca.DM(s.h), slacks[i, :].T)
        for i, row in enumerate(self.end_closed):
            ends[row] += last[t.nx + i]
            cost += t.end.rows[row].penalty * last[t.nx + i]
        return cost, rows, ends

    def _bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Of the rows. Those of the state alone do not count at the measured state."""
        path = self.t.path.rows
        above = [0.0] * self.local + [0.0 if r.kind is Kind.EQUAL else np.inf for r in path]
        upper = np.tile(above, (self.n, 1))
        lower = np.zeros_like(upper)
        free = self.local + np.flatnonzero([r.state_only for r in path])
        lower[0, free], upper[0, free] = -np.inf, np.inf
        end = np.array([0.0 if r.kind is Kind.EQUAL else np.inf for r in self.t.end.rows])
        start = np.zeros(self.nx)
        return np.concatenate([start, lower.ravel(), np.zeros(end.size)]), np.concatenate([start, upper.ravel(), end])

    def vector(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Trajectories x (N + 1, nx), u (N, nu) as unknowns, with the slacks that they need."""
        table = np.hstack([x[:-1], u, np.zeros((self.n, len(self.closed)))])
        none = np.concatenate([table.ravel(), x[-1], np.zeros(len(self.end_closed))])
        missing = np.maximum(self.lower - np.array(self.rows(none)).ravel(), 0.0)
        ends = missing.size - len(self.t.end.rows)
        stages = missing[self.nx : ends].reshape(self.n, -1)
        table[:, self.nx + self.nu :] = stages[:, [self.local + i for i in self.closed]]
        return np.concatenate([table.ravel(), x[-1], missing[ends:][self.end_closed]])

    def outside(self, z: np.ndarray) -> float:
        """The largest violation of a row."""
        g = np.array(self.rows(z)).ravel()
        return float(np.maximum(np.maximum(self.lower - g, g - self.upper), 0.0).max())

    def solve(self, z: np.ndarray, near: bool) -> Found:
        """From ``z``; ``near``: it is thought to be a solution."""
        other = ca.nlpsol("other", "ipopt", self.program, _OPTIONS | (_NEAR if near else {}))
        found = other(x0=z, lbx=self.least, ubx=np.inf, lbg=self.lower, ubg=self.upper)
        end = np.array(found["x"]).ravel()
        table, last = end[: self.n * self.stage].reshape(self.n, -1), end[self.n * self.stage :]
        slack = max([0.0, *table[:, self.nx + self.nu :].ravel(), *last[self.nx :]])
        x, u = np.vstack([table[:, : self.nx], last[: self.nx]]), table[:, self.nx : self.nx + self.nu]
        stats = other.stats()
        return Found(bool(stats["success"]), float(found["f"]), x, u, float(slack), str(stats["return_status"]))
