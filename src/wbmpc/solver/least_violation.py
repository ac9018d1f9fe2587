"""The certificate of infeasibility: a stationary point of the violation at which constraints are still missed.

A solve that ends away from the constraints may have stopped for other reasons: steps that are too short, too few iterations. So the
violation alone is minimized from where it ended, φ(z) = ½ Σ gap² + ½ Σ miss² over the dynamics and all rows that must hold, by
Levenberg and Marquardt (Nocedal and Wright 2006, section 10.3). Where φ becomes zero the constraints can be met. Where its gradient
Jᵀ F vanishes before, measured by the cosine between F and each column of J, which no unit of a variable changes, no small change
of the motion makes the constraints hold better: they contradict each other, at least near there (section 17.2: what a penalty
method ends at with multipliers that grow forever).
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from wbmpc.ocp import Constraint
from wbmpc.solver.certificate import step_ends

if TYPE_CHECKING:
    import scipy.sparse as sp

    from wbmpc.solver.solver import Solver

#: Steps at most; cosine from which on a gradient has vanished; largest damping, as a share of the largest curvature.
STEPS, STATIONARY, DAMPED = 100, 1e-4, 1e8
#: A step that reduces φ by less, as a share, has arrived.
SETTLED = 1e-6


class Finding(Enum):
    """What minimizing the violation came to."""

    MET = "the constraints can be met"
    INFEASIBLE = "a stationary point of the violation"
    OPEN = "neither"


class _Misses:
    """Gaps of the dynamics and misses of rows as functions of states and inputs; the first state is the measured one."""

    def __init__(self, solver: Solver, rows: Mapping[str, np.ndarray]) -> None:
        self.problem, self.ws, self.x0 = solver.problem, solver.ws, solver.x0
        problem = self.problem
        all_terms = problem.ocp.terms
        terms = [(t, keep) for n, keep in rows.items() if isinstance(t := all_terms[n], Constraint)]
        args = [problem.x, problem.u, problem.p, problem.w]
        path = [(t, keep) for t, keep in terms if t.at != "terminal"]
        end = [(t, keep & ~problem.with_input(t)) for t, keep in terms if t.at != "path"]
        values = lambda chosen: ca.densify(ca.vertcat(*[problem.broken(t) for t, _ in chosen], ca.SX(0, 1)))
        join = lambda parts: np.concatenate([*parts, np.zeros(0, bool)]).astype(bool)
        self._path, self._end = ca.Function("path", args, [values(path)]), ca.Function("end", args, [values(end)])
        self._rows, self._end_rows = join(keep for _, keep in path), join(keep for _, keep in end)
        #: of the path's rows, those that count at the measured state
        self._first = join(problem.with_input(t)[keep] for t, keep in path)

    def node(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """(N, nx + rows): where each interval ends, and misses, of states (N, nx) and inputs (N, nu)."""
        n, p = len(u), self.ws.p[:, : self.problem.node.size]
        w = self.ws.w[: self.problem.constant.size]
        misses = np.array(self._path(x.T, u.T, p[:n].T, np.tile(w[:, None], (1, n)))).reshape(-1, n)[self._rows].T
        misses[0, ~self._first] = 0.0
        return np.hstack([step_ends(self.problem, self.ws, x, u), misses])

    def end(self, x: np.ndarray) -> np.ndarray:
        """Misses of the last state (nx)."""
        p, w = self.ws.p[len(self.ws.u), : self.problem.node.size], self.ws.w[: self.problem.constant.size]
        return np.array(self._end(x, np.zeros(self.problem.nu), p, w)).ravel()[self._end_rows]

    def __call__(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        along = self.node(x[:-1], u)
        along[:, : self.problem.nx] -= x[1:]
        return np.concatenate([along.ravel(), self.end(x[-1])])

    def jacobian(self, x: np.ndarray, u: np.ndarray) -> sp.csc_matrix:
        """By (x_0, u_0, x_1, …, x_N), by differences: one component of all nodes at a time."""
        import scipy.sparse as sp  # slow to import, and few solves need it

        nx, nz, n = self.problem.nx, self.problem.nx + self.problem.nu, len(u)
        here, last = self.node(x[:-1], u), self.end(x[-1])
        z, blocks = np.hstack([x[:-1], u]), np.zeros((n, here.shape[1], nz))
        step = 1e-7 * (1.0 + np.abs(z))
        for i in range(nz):
            moved = z.copy()
            moved[:, i] += step[:, i]
            blocks[:, :, i] = (self.node(moved[:, :nx], moved[:, nx:]) - here) / step[:, i, None]
        at_end = np.zeros((last.size, nx))
        for i in range(nx):
            moved = x[-1].copy()
            moved[i] += 1e-7 * (1.0 + abs(moved[i]))
            at_end[:, i] = (self.end(moved) - last) / (moved[i] - x[-1, i])
        own = sp.block_diag([*blocks, at_end], format="csc")
        # each interval ends in the next node's state
        rows = (np.arange(n)[:, None] * here.shape[1] + np.arange(nx)).ravel()
        columns = (np.arange(1, n + 1)[:, None] * nz + np.arange(nx)).ravel()
        return sp.csc_matrix(own - sp.csc_matrix((np.ones(rows.size), (rows, columns)), own.shape))


def _join(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    return np.concatenate([np.hstack([x[:-1], u]).ravel(), x[-1]])


def _split(z: np.ndarray, n: int, nx: int) -> tuple[np.ndarray, np.ndarray]:
    along = z[:-nx].reshape(n, -1)
    return np.vstack([along[:, :nx], z[-nx:]]), along[:, nx:]


def least_violation(solver: Solver, rows: Mapping[str, np.ndarray], feasibility: float) -> Finding:
    """Whether constraints contradict each other near the present iterate. ``rows``: which rows of which constraints must hold."""
    import scipy.sparse as sp
    from scipy.sparse.linalg import splu

    misses, n, nx = _Misses(solver, rows), len(solver.ws.u), solver.problem.nx
    x, u = solver.ws.x.copy(), solver.ws.u.copy()
    x[0] = solver.x0
    f, damping = misses(x, u), 1e-6
    if not np.isfinite(f).all():
        return Finding.OPEN
    for _ in range(STEPS):
        if np.abs(f).max(initial=0.0) <= feasibility:
            return Finding.MET
        jacobian = misses.jacobian(x, u)[:, nx:]  # the first state stays
        if not np.isfinite(jacobian.data).all():
            return Finding.OPEN
        gradient, lengths = jacobian.T @ f, np.sqrt(np.asarray(jacobian.multiply(jacobian).sum(axis=0)).ravel())
        if np.all(np.abs(gradient) <= STATIONARY * lengths * np.linalg.norm(f)):
            return Finding.INFEASIBLE
        normal, scale, before = sp.csc_matrix(jacobian.T @ jacobian), lengths.max() ** 2, f @ f
        while True:
            step = splu(normal + damping * scale * sp.identity(normal.shape[0], format="csc")).solve(-gradient)
            moved = _split(_join(x, u) + np.concatenate([np.zeros(nx), step]), n, nx)
            after = misses(*moved)
            if np.isfinite(after).all() and after @ after < before:
                break
            damping *= 10.0
            if damping > DAMPED:
                return Finding.OPEN
        (x, u), f, damping = moved, after, max(0.1 * damping, 1e-12)
        if before - f @ f < SETTLED * SETTLED * before:
            return Finding.OPEN
    return Finding.OPEN
