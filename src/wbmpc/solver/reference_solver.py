"""The interpreted twin of the compiled solver: NumPy and CasADi's interpreter, the same algorithm, readable.

It is the oracle of the tests and the fallback where no code can be generated.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from wbmpc.ocp import Transcription
from wbmpc.solver.workspace import BoxTable, box_table

RELATIVE_COMPLIANCE = 1e-9


def barrier(boxes: BoxTable, z: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Value, gradient and diagonal curvature of the boxes' relaxed barriers at z = [x; u]."""
    h = boxes.sign * z[boxes.place] + boxes.offset
    mu, delta = boxes.mu, boxes.delta
    far, q = h > delta, (h - 2 * delta) / delta
    safe = np.where(far, h, 1.0)
    value = np.where(far, -mu * np.log(safe), mu * (0.5 * (q * q - 1.0) - np.log(delta))).sum()
    gradient, curvature = np.zeros(z.size), np.zeros(z.size)
    np.add.at(gradient, boxes.place, boxes.sign * np.where(far, -mu / safe, mu * q / delta))
    np.add.at(curvature, boxes.place, boxes.sign**2 * np.where(far, mu / safe**2, mu / delta**2))
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
    inverse = np.linalg.inv(m[nx:, nx:])
    gain, feed = -inverse @ m[nx:, :nx], -inverse @ s[nx:]
    if d.size:
        dm = d @ inverse @ d.T
        schur = np.linalg.inv(dm + np.diag(RELATIVE_COMPLIANCE * np.diag(dm) + eps))
        correction = inverse @ d.T @ schur
        gain, feed = gain - correction @ (c + d @ gain), feed - correction @ (e + d @ feed)
    # The value of the step is the quadratic along the constrained input, plus what the compliance pays.
    full = np.vstack([np.eye(nx), gain])
    p = full.T @ m @ full
    q = full.T @ (s + m @ np.concatenate([np.zeros(nx), feed]))
    if d.size:
        rows, rest = c + d @ gain, e + d @ feed
        weight = np.diag(1.0 / (RELATIVE_COMPLIANCE * np.diag(dm) + eps))
        p, q = p + rows.T @ weight @ rows, q + rows.T @ weight @ rest
    return gain, feed, 0.5 * (p + p.T), q


class InterpretedSolver:
    """Runs what ``receding_solve`` runs, on the same fields x, u, p, w, k, grid of its ``ws``."""

    def __init__(self, problem: Transcription) -> None:
        self.problem = problem
        n, nx, nu = problem.ocp.intervals, problem.nx, problem.nu
        self.ws = SimpleNamespace(
            grid=problem.ocp.grid.copy(), x=np.zeros((n + 1, nx)), u=np.zeros((n, nu)), w=problem.default_weights(),
            p=np.zeros((n + 1, max(problem.node.size, 1))), k=np.zeros((n, nu, nx)),
        )  # fmt: skip
        self.path, self.end = box_table(problem.path_boxes), box_table(problem.terminal_boxes)
        self.values, self.derivatives = problem.values, problem.derivatives

    def _p(self, k: int) -> np.ndarray:
        return self.ws.p[k, : self.problem.node.size]  # type: ignore[no-any-return]

    def _f(self, x: np.ndarray, u: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray]:
        f, j = self.derivatives["dynamics_jacobian"](x, u, self._p(k), self.ws.w)
        return np.array(f).ravel(), np.array(j)

    def _normalise(self, x: np.ndarray, j: np.ndarray | None = None) -> None:
        for start in self.problem.ocp.dynamics.unit_quaternions:
            part = slice(start, start + 4)
            norm = np.linalg.norm(x[part])
            x[part] /= norm
            if j is not None:
                j[part] = (j[part] - np.outer(x[part], x[part] @ j[part])) / norm

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
        self._normalise(end, total)
        return end, total

    def simulate(self, x: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
        """One Runge-Kutta step with the parameters of node 0."""
        saved = self.ws.grid
        self.ws.grid = np.array([0.0, h])
        try:
            return self.step(np.asarray(x, float), np.asarray(u, float), 0)[0]
        finally:
            self.ws.grid = saved

    def _merit(self, x: np.ndarray, u: np.ndarray, x0: np.ndarray) -> tuple[float, float]:
        ws, n = self.ws, len(u)
        violation = np.abs(x0 - x[0]).sum()
        cost = float(self.values["terminal"](x[n], self._p(n), ws.w)) + barrier(self.end, x[n])[0]
        for k in range(n):
            h = ws.grid[k + 1] - ws.grid[k]
            violation += np.abs(self.step(x[k], u[k], k)[0] - x[k + 1]).sum()
            arguments = (x[k], u[k], self._p(k), ws.w)
            cost += h * (float(self.values["cost"](*arguments)) + barrier(self.path, np.concatenate([x[k], u[k]]))[0])
            violation += np.abs(np.array(self.values["equality"](*arguments))).sum()
        return cost, float(violation)

    def _node(self, k: int) -> tuple[np.ndarray, ...]:
        """a, b, gap, h, g, c, d, e of one node."""
        ws, nx = self.ws, self.problem.nx
        h = ws.grid[k + 1] - ws.grid[k]
        arguments = (ws.x[k], ws.u[k], self._p(k), ws.w)
        _, g, hessian = self.derivatives["cost_quadratic"](*arguments, h)
        upper = np.array(hessian)
        full = upper + np.triu(upper, 1).T
        _, slope, curve = barrier(self.path, np.concatenate([ws.x[k], ws.u[k]]))
        end, ab = self.step(ws.x[k], ws.u[k], k)
        e, cd = (np.array(v) for v in self.derivatives["equality_jacobian"](*arguments))
        gradient = np.array(g).ravel() + h * slope
        return (
            ab[:, :nx],
            ab[:, nx:],
            end - ws.x[k + 1],
            full + h * np.diag(curve),
            gradient,
            cd[:, :nx],
            cd[:, nx:],
            e.ravel(),
        )

    def _terminal(self) -> tuple[np.ndarray, np.ndarray]:
        ws, n = self.ws, len(self.ws.u)
        _, g, hessian = self.derivatives["terminal_quadratic"](ws.x[n], self._p(n), ws.w)
        upper = np.array(hessian)
        _, slope, curve = barrier(self.end, ws.x[n])
        return upper + np.triu(upper, 1).T + np.diag(curve), np.array(g).ravel() + slope

    def iterate(self, x0: np.ndarray) -> dict[str, Any]:
        """Linearise and find the step; returns dx, du, the nodes' data and the cost's slope."""
        ws, n = self.ws, len(self.ws.u)
        nodes = [self._node(k) for k in range(n)]
        end, end_slope = value, slope = self._terminal()
        eps = self.problem.compliance + 1e-14
        feeds = [np.zeros(0)] * n
        for k in reversed(range(n)):
            ws.k[k], feeds[k], value, slope = riccati_step(*nodes[k], eps, value, slope)  # type: ignore[call-arg]
        dx, du = [x0 - ws.x[0]], []
        kkt, along, curvature = 0.0, 0.0, 0.0
        for k, (a, b, gap, h, g, *_) in enumerate(nodes):
            du.append(ws.k[k] @ dx[k] + feeds[k])
            dz = np.concatenate([dx[k], du[k]])
            kkt, along, curvature = max(kkt, np.abs(h @ dz).max()), along + g @ dz, curvature + dz @ h @ dz
            dx.append(a @ dx[k] + b @ du[k] + gap)
        kkt, along = max(kkt, np.abs(end @ dx[n]).max()), along + end_slope @ dx[n]
        curvature += dx[n] @ end @ dx[n]
        return {
            "dx": np.array(dx), "du": np.array(du), "kkt": kkt, "slope": along, "curvature": curvature, "value": value,
        }  # fmt: skip

    def run(
        self, tables: Any, t0: float, delta: float, x0: np.ndarray, settings: Any, log: np.ndarray
    ) -> tuple[int, int]:
        """The same as :func:`wbmpc.solver.receding.receding_solve`."""
        from wbmpc.solver.driver import accept
        from wbmpc.solver.receding import sample

        ws = self.ws
        for k in range(len(ws.grid)):
            sample(tables, t0 + ws.grid[k], ws.p.ravel(), k * ws.p.shape[1])
        if delta > 0.0:
            self._shift(delta)
        penalty, first_alpha, last_kkt = 0.0, 1.0, np.inf
        for it in range(settings.iterations):
            cost, violation = self._merit(ws.x, ws.u, x0)
            s = self.iterate(x0)
            size = max(np.abs(s["dx"]).max(), np.abs(s["du"]).max())
            log[it] = (cost, violation, s["kkt"], size, 0.0, violation, 0.0)
            if not np.isfinite([cost, violation, size]).all():
                return 3, it + 1
            if settings.certify and s["kkt"] <= settings.tolerance and violation <= settings.feasibility:
                return 0, it + 1
            if violation > 1e-12:
                curvature = s["curvature"] if settings.certify else 0.0  # the compiled solver has it only then
                penalty = max(penalty, 2.0 * (s["slope"] + 0.5 * curvature) / violation)
            first_alpha = max(0.5 * first_alpha, 0.1) if s["kkt"] > last_kkt else min(1.3 * first_alpha, 1.0)
            last_kkt = s["kkt"]
            alpha = first_alpha
            while True:
                x, u = ws.x + alpha * s["dx"], ws.u + alpha * s["du"]
                if accept(*self._merit(x, u, x0), cost, violation, s["slope"], penalty, alpha):
                    break
                alpha *= 0.5
                if alpha < settings.smallest_step:
                    alpha, x, u = 1.0, ws.x + s["dx"], ws.u + s["du"]
                    if settings.force_step and np.isfinite(self._merit(x, u, x0)).all():
                        break
                    return 2, it + 1
            ws.x[:], ws.u[:] = x, u
            for row in ws.x:
                self._normalise(row)
            log[it, 4] = alpha
        return 1, settings.iterations

    def _shift(self, delta: float) -> None:
        ws = self.ws
        middle = 0.5 * (ws.grid[1:] + ws.grid[:-1])
        for array, times in ((ws.x, ws.grid), (ws.u, middle)):
            array[:] = np.stack([np.interp(times + delta, times, c) for c in array.T], axis=1)
        for row in ws.x:
            self._normalise(row)
