"""The twin of :mod:`wbmpc.solver.riccati` in NumPy: a problem linearized by CasADi's interpreter, and one direction."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from wbmpc.model.numeric import Numeric
from wbmpc.ocp import Transcription
from wbmpc.ocp.parameters import default_weights
from wbmpc.ocp.transcription import MIN_SOFTNESS
from wbmpc.solver.reference_inequalities import RowState
from wbmpc.solver.reference_nonlinear_inputs import curvature
from wbmpc.solver.workspace import STATE_SIZE, BoxTable, box_table

RELATIVE_SOFTNESS = 1e-12


def barrier(boxes: BoxTable, z: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Value, gradient and diagonal curvature of the boxes' relaxed barriers at z = [x; u]."""
    h = boxes.sign * z[boxes.variable] + boxes.offset
    mu, delta = boxes.mu, boxes.delta
    far, q = h > delta, (h - 2 * delta) / delta
    safe = np.where(far, h, 1.0)
    value = np.where(far, -mu * np.log(safe), mu * (0.5 * (q * q - 1.0) - np.log(delta))).sum()
    gradient, curvature = np.zeros(z.size), np.zeros(z.size)
    np.add.at(gradient, boxes.variable, boxes.sign * np.where(far, -mu / safe, mu * q / delta))
    np.add.at(curvature, boxes.variable, boxes.sign**2 * np.where(far, mu / safe**2, mu / delta**2))
    return float(value), gradient, curvature


def riccati_step(
    a: np.ndarray, b: np.ndarray, gap: np.ndarray, h: np.ndarray, g: np.ndarray, c: np.ndarray, d: np.ndarray,
    e: np.ndarray, eps: np.ndarray, value: np.ndarray, slope: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """One backward step with rows C δx + D δu + e = 0: (K, k, P, p). h, g: Hessian and gradient by [x; u]."""
    nx = a.shape[0]
    ab = np.hstack([a, b])
    m = h + ab.T @ value @ ab
    s = g + ab.T @ (slope + value @ gap)
    lower = np.linalg.cholesky(m[nx:, nx:])
    apply = lambda right: np.linalg.solve(lower.T, np.linalg.solve(lower, right))
    both = -apply(np.column_stack([m[nx:, :nx], s[nx:]]))
    if d.size:
        half = np.linalg.solve(lower, d.T)
        schur = half.T @ half
        root = np.linalg.cholesky(schur + np.diag(RELATIVE_SOFTNESS * np.diag(schur) + eps))
        multipliers = lambda left: np.linalg.solve(root.T, np.linalg.solve(root, left))
        rows = np.column_stack([c, e])
        nu = multipliers(rows + d @ both)
        both = both - apply(d.T @ nu)
        # once more for what an ill-conditioned Schur complement has left
        both = both - apply(d.T @ multipliers(rows + d @ both - eps[:, None] * nu))
    gain, feed = both[:, :-1], both[:, -1]
    # The value of the step is the quadratic along the constrained input, plus what the softness pays.
    full = np.vstack([np.eye(nx), gain])
    p = full.T @ m @ full
    q = full.T @ (s + m @ np.concatenate([np.zeros(nx), feed]))
    if d.size:
        # eps ν² / 2 is what the softness pays
        p, q = p + nu[:, :-1].T @ (eps[:, None] * nu[:, :-1]), q + nu[:, :-1].T @ (eps * nu[:, -1])
    return gain, feed, 0.5 * (p + p.T), q


class InterpretedDirections:
    """One problem linearized around the fields x, u, p, w of its ``ws``, and the step from there."""

    def __init__(self, problem: Transcription) -> None:
        self.problem = problem
        n, nx, nu = problem.ocp.intervals, problem.nx, problem.nu
        self.ws = SimpleNamespace(
            grid=problem.ocp.grid.copy(), x=np.zeros((n + 1, nx)), u=np.zeros((n, nu)), w=default_weights(problem),
            p=np.zeros((n + 1, max(problem.node.size, 1))), k=np.zeros((n, nu, nx)), state=np.zeros(STATE_SIZE),
            rows_h=np.zeros((n + 1, max(len(problem.path.rows), len(problem.end.rows), 1))),
        )  # fmt: skip
        self.path, self.end = box_table(problem.path.barriers), box_table(problem.end.barriers)
        self.values, self.derivatives = (
            {name: Numeric(f) for name, f in functions.items()} for functions in (problem.values, problem.derivatives)
        )
        self.own = [RowState(problem.path if k < n else problem.end, k == 0) for k in range(n + 1)]
        self.has_rows = any(r.kind.size for r in self.own)
        self.mu, self.shift, self.policy, self.hold = 0.0, 0.0, False, 0
        self.feed, self.last_du = np.zeros((n, nu)), np.zeros((n, nu))
        self.soft_residual, self.soft_step = (np.zeros((n, problem.softness.size)) for _ in range(2))

    def _p(self, k: int) -> np.ndarray:
        return self.ws.p[k, : self.problem.node.size]  # type: ignore[no-any-return]

    def _f(self, x: np.ndarray, u: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray]:
        f, j = self.derivatives["dynamics_jacobian"](x, u, self._p(k), self.ws.w)
        return f.ravel(), j

    def _normalize(self, x: np.ndarray, j: np.ndarray | None = None) -> None:
        for start in self.problem.ocp.dynamics.unit_quaternions:
            part = slice(start, start + 4)
            norm = np.linalg.norm(x[part])
            x[part] /= norm
            if j is not None:
                j[part] = (j[part] - np.outer(x[part], x[part] @ j[part])) / norm

    def _shift(self, tables: Any, t0: float, delta: float) -> None:
        """As shift of the compiled solver."""
        ws, events = self.ws, tables.numbers[: tables.integers[1]]
        middle, old = 0.5 * (ws.grid[1:] + ws.grid[:-1]), ws.u.copy()
        for array, times in ((ws.x, ws.grid), (ws.u, middle)):
            array[:] = np.stack([np.interp(times + delta, times, c) for c in array.T], axis=1)
        modes = [np.searchsorted(events, t + ws.grid[:-1] + 1e-9, side="right") for t in (t0 - delta, t0)]
        last = len(middle) - 1
        for k, t in enumerate(middle + delta):
            i = min(max(int(np.searchsorted(middle, t, side="right")) - 1, 0), max(last - 1, 0))
            after = min(i + 1, last)
            if modes[0][i] != modes[0][after]:
                ws.u[k] = old[i if modes[1][k] == modes[0][i] else after]
        for row in ws.x:
            self._normalize(row)

    def step(self, x: np.ndarray, u: np.ndarray, k: int, derivative: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """One Runge-Kutta step of interval k and its Jacobian by [x; u]."""
        h, nx = self.ws.grid[k + 1] - self.ws.grid[k], x.size
        grow = lambda j, s, c: j + c * j[:, :nx] @ s
        f1, j1 = self._f(x, u, k)
        f2, j2 = self._f(x + 0.5 * h * f1, u, k)
        s2 = grow(j2, j1, 0.5 * h)
        if self.problem.ocp.integrator == "rk2":
            end, total = x + h * f2, h * s2
        else:
            f3, j3 = self._f(x + 0.5 * h * f2, u, k)
            s3 = grow(j3, s2, 0.5 * h)
            f4, j4 = self._f(x + h * f3, u, k)
            end = x + h / 6 * (f1 + 2 * f2 + 2 * f3 + f4)
            total = h / 6 * (j1 + 2 * s2 + 2 * s3 + grow(j4, s3, h))
        total = total + np.eye(nx, total.shape[1])
        self._normalize(end, total)
        return end, total

    def simulate(self, x: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
        """One Runge-Kutta step with the parameters of node 0."""
        saved = self.ws.grid
        self.ws.grid = np.array([0.0, h])
        try:
            return self.step(np.asarray(x, float), np.asarray(u, float), 0)[0]
        finally:
            self.ws.grid = saved

    def _rows(self, k: int, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Values of node k's rows."""
        general = self.values["rows"](x, u, self._p(k), self.ws.w) if k < len(self.ws.u) else None
        general = self.values["end_rows"](x, self._p(k), self.ws.w) if general is None else general
        return self.own[k].values(np.concatenate([x, u]), general[0])

    def _merit(self, x: np.ndarray, u: np.ndarray, x0: np.ndarray, alpha: float = 0.0) -> tuple[float, float]:
        ws, n = self.ws, len(u)
        violation = np.abs(x0 - x[0]).sum()
        cost = self.values["terminal"](x[n], self._p(n), ws.w)[0].item() + barrier(self.end, x[n])[0]
        for k in range(n):
            h = ws.grid[k + 1] - ws.grid[k]
            violation += np.abs(self.step(x[k], u[k], k)[0] - x[k + 1]).sum()
            arguments = (x[k], u[k], self._p(k), ws.w)
            cost += h * (
                self.values["cost"](*arguments)[0].item() + barrier(self.path, np.concatenate([x[k], u[k]]))[0]
            )
            exact = self.problem.softness <= MIN_SOFTNESS
            violation += np.abs(self.values["equality"](*arguments)[0].ravel()[exact]).sum()
            more, broken = self.own[k].merit(self._rows(k, x[k], u[k]), alpha, self.mu)
            cost, violation = cost + h * more, violation + h * broken
        more, broken = self.own[n].merit(self._rows(n, x[n], u[-1]), alpha, self.mu)
        paid, apart, _ = self._soft_equality_terms(x, u, alpha)
        return cost + more + paid, float(violation + broken + apart)

    def _soft_equality_terms(self, x: np.ndarray, u: np.ndarray, alpha: float = 0.0) -> tuple[float, float, float]:
        """As soft_equality_terms of the compiled solver, of all nodes."""
        soft = self.problem.softness > MIN_SOFTNESS
        g, r = self._equality_values(x, u)[:, soft], (self.soft_residual + alpha * self.soft_step)[:, soft]
        paid = np.sum(0.5 * r**2 / self.problem.softness[soft])
        return float(paid), float(np.abs(g - r).sum()), float(np.abs(g).sum())

    def _equality_values(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Rows of the recursion (N, equalities)."""
        f = self.values["equality"]
        return np.array([f(x[k], u[k], self._p(k), self.ws.w)[0].ravel() for k in range(len(u))])

    def _node(self, k: int) -> tuple[np.ndarray, ...]:
        """a, b, gap, h, g, c, d, e of one node; then h without the rows and the gradient without them."""
        ws, nx = self.ws, self.problem.nx
        h = ws.grid[k + 1] - ws.grid[k]
        arguments = (ws.x[k], ws.u[k], self._p(k), ws.w)
        _, g, upper = self.derivatives["cost_quadratic"](*arguments, h)
        z = np.concatenate([ws.x[k], ws.u[k]])
        _, slope, curve = barrier(self.path, z)
        full = upper + np.triu(upper, 1).T + h * np.diag(curve)
        end, ab = self.step(ws.x[k], ws.u[k], k)
        e, cd = self.derivatives["equality_jacobian"](*arguments)
        gradient = g.ravel() + h * slope
        rows = self.own[k]
        rows.linearize(z, *self.derivatives["rows_jacobian"](*arguments))
        sigma, offset = rows.weights(self.mu)
        j = rows.jacobian
        if self.problem.nonlinear_input_rows:
            full = full + curvature(self.problem, self.derivatives["lagrangian"], rows, arguments, h)
        whole = full + h * j.T @ (sigma[:, None] * j) + self.shift * np.eye(z.size)
        pulled = gradient + h * j.T @ (sigma * offset)
        parts = (ab[:, :nx], ab[:, nx:], end - ws.x[k + 1], whole, pulled, cd[:, :nx], cd[:, nx:], e.ravel())
        return (*parts, full, gradient)

    def _terminal(self) -> tuple[np.ndarray, ...]:
        """h, g with rows, h, g without."""
        ws, n, nx = self.ws, len(self.ws.u), self.problem.nx
        _, g, upper = self.derivatives["terminal_quadratic"](ws.x[n], self._p(n), ws.w)
        _, slope, curve = barrier(self.end, ws.x[n])
        full, gradient = upper + np.triu(upper, 1).T + np.diag(curve), g.ravel() + slope
        rows = self.own[n]
        values, jacobian = self.derivatives["end_rows_jacobian"](ws.x[n], self._p(n), ws.w)
        rows.linearize(ws.x[n], values, jacobian)
        sigma, offset = rows.weights(self.mu)
        j = rows.jacobian
        whole = full + j.T @ (sigma[:, None] * j) + self.shift * np.eye(nx)
        return whole, gradient + j.T @ (sigma * offset), full, gradient

    def iterate(self, x0: np.ndarray) -> dict[str, Any]:
        """Linearize and find the step; returns dx, du, the nodes' data and the cost's slope."""
        ws, n = self.ws, len(self.ws.u)
        nodes = [self._node(k) for k in range(n)]
        end = self._terminal()
        value, slope = end[:2]
        eps = self.problem.softness + 1e-14
        for k in reversed(range(n)):
            ws.k[k], self.feed[k], value, slope = riccati_step(*nodes[k][:8], eps, value, slope)  # type: ignore[call-arg]
        dx, du = [x0 - ws.x[0]], []
        kkt, along, bend = 0.0, 0.0, 0.0
        soft = self.problem.softness > MIN_SOFTNESS
        for k, (a, b, gap, h, _, c, d, e, own, g) in enumerate(nodes):
            du.append(ws.k[k] @ dx[k] + self.feed[k])
            dz = np.concatenate([dx[k], du[k]])
            kkt, along, bend = max(kkt, np.abs(own @ dz).max()), along + g @ dz, bend + dz @ h @ dz
            self.soft_step[k] = e + np.hstack([c, d]) @ dz - self.soft_residual[k]
            along += sum(self.soft_residual[k, soft] * self.soft_step[k, soft] / self.problem.softness[soft])
            dx.append(a @ dx[k] + b @ du[k] + gap)
            self.own[k].step(self.mu, dz)
        kkt, along = max(kkt, np.abs(end[2] @ dx[n]).max()), along + end[3] @ dx[n]
        self.own[n].step(self.mu, dx[n])
        bend += dx[n] @ end[0] @ dx[n]
        h = np.append(np.diff(ws.grid), 1.0)
        along += sum(w * rows.slope(self.mu) for w, rows in zip(h, self.own, strict=True))
        return {
            "dx": np.array(dx), "du": np.array(du), "kkt": kkt, "slope": along, "curvature": bend, "value": value,
            "ab": [np.hstack(node[:2]) for node in nodes], "gaps": [node[2] for node in nodes],
        }  # fmt: skip
