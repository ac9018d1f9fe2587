"""The interpreted twin of the compiled solver: NumPy and CasADi's interpreter, the same algorithm, readable.

It is the oracle of the tests and the fallback where no code can be generated.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from wbmpc.errors import InputError
from wbmpc.ocp import Transcription
from wbmpc.ocp.rows import Kind, Place
from wbmpc.solver.places import COST, GIVEN_WAY, LAST_ALPHA, LIMIT_TOLERANCE, LONGEST, MISSED, MOST_AT, VIOLATION
from wbmpc.solver.reference_curved import aims, curvature, hold_inputs
from wbmpc.solver.workspace import BoxTable, box_table

RELATIVE_COMPLIANCE = 1e-12


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
    lower = np.linalg.cholesky(m[nx:, nx:])
    apply = lambda right: np.linalg.solve(lower.T, np.linalg.solve(lower, right))
    both = -apply(np.column_stack([m[nx:, :nx], s[nx:]]))
    if d.size:
        half = np.linalg.solve(lower, d.T)
        schur = half.T @ half
        root = np.linalg.cholesky(schur + np.diag(RELATIVE_COMPLIANCE * np.diag(schur) + eps))
        multipliers = lambda left: np.linalg.solve(root.T, np.linalg.solve(root, left))
        rows = np.column_stack([c, e])
        nu = multipliers(rows + d @ both)
        both = both - apply(d.T @ nu)
        # once more for what an ill-conditioned Schur complement has left
        both = both - apply(d.T @ multipliers(rows + d @ both - eps[:, None] * nu))
    gain, feed = both[:, :-1], both[:, -1]
    # The value of the step is the quadratic along the constrained input, plus what the compliance pays.
    full = np.vstack([np.eye(nx), gain])
    p = full.T @ m @ full
    q = full.T @ (s + m @ np.concatenate([np.zeros(nx), feed]))
    if d.size:
        # eps ν² / 2 is what the compliance pays
        p, q = p + nu[:, :-1].T @ (eps[:, None] * nu[:, :-1]), q + nu[:, :-1].T @ (eps * nu[:, -1])
    return gain, feed, 0.5 * (p + p.T), q


class RowState:
    """Slacks t, multipliers l and L1 slacks s of one node's rows; see :mod:`wbmpc.solver.rows` for the formulas."""

    def __init__(self, place: Place, measured: bool) -> None:
        rows = place.rows
        table = np.array([(r.kind, r.place, r.sign, r.offset, r.penalty, r.state_only) for r in rows], float).reshape(
            -1, 6
        )
        self.kind, self.place, self.sign, self.offset, self.given, state_only = table.T
        self.rho = 1.0
        self.counts = ~(state_only.astype(bool) & measured)
        self.bounds_inputs = (self.kind == Kind.HARD) & ~state_only.astype(bool)
        self.boxes = len(place.boxes)
        self.hard, self.multiplier, self.equal = (self.kind == k for k in Kind)
        self.soft = self.hard & np.isfinite(self.penalty)
        n = len(rows)
        self.h, self.t, self.l, self.s = np.zeros(n), np.ones(n), np.zeros(n), np.zeros(n)
        self.jacobian = np.zeros((n, 0))
        self.started = False

    @property
    def penalty(self) -> np.ndarray:
        """Weight of a hard row's L1 slack, or ρ of a multiplier row."""
        return np.where(self.hard, self.given, self.rho * self.given)

    def values(self, z: np.ndarray, general: Any) -> np.ndarray:
        """h at z = [x; u]; ``general``: values of the rows that are not of one variable."""
        index = self.place[: self.boxes].astype(int)
        return np.concatenate(
            [self.sign[: self.boxes] * z[index] + self.offset[: self.boxes], np.array(general).ravel()]
        )

    def linearise(self, z: np.ndarray, general: Any, jacobian: Any) -> None:
        """h and its Jacobian by z."""
        self.h = self.values(z, general)
        selection = np.zeros((self.boxes, z.size))
        selection[np.arange(self.boxes), self.place[: self.boxes].astype(int)] = self.sign[: self.boxes]
        self.jacobian = np.vstack([selection, np.array(jacobian).reshape(-1, z.size)])

    def start(self, mu: float, least: float, keep: bool, keep_slacks: bool) -> None:
        """As start_rows of the compiled solver."""
        if keep_slacks and self.started:
            return
        self.started = True
        self.t = np.where(self.h > least, self.h, least)
        kept = self.l if keep else np.where(self.hard, mu / self.t, 0.0)
        kept = np.where(self.hard & ~(kept > 0.0), mu / self.t, kept)
        self.l = np.where(self.hard, np.clip(kept, 1e-12, 0.99 * self.penalty), kept)
        self.s = np.where(self.soft, np.maximum(self.t - self.h, mu / (self.penalty - self.l)), 0.0)

    def weights(self, mu: float) -> tuple[np.ndarray, np.ndarray]:
        """σ and e."""
        with np.errstate(divide="ignore", invalid="ignore"):
            y = self.penalty - self.l
            softness = np.where(self.hard, self.t / self.l + self.s / y, 1.0)
            sigma = np.where(self.hard, 1.0 / softness, self.penalty)
            e = self.h - mu / self.l + mu / y - self.l * softness
        e = np.where(
            self.hard, e, self.h + np.where(self.equal, 1.0, -1.0) * self.l / np.where(self.hard, 1.0, self.penalty)
        )
        active = self.counts & (self.hard | self.equal | (self.l > self.penalty * self.h))
        return np.where(active, sigma, 0.0), np.where(active, e, 0.0)

    def step(self, mu: float, dz: np.ndarray) -> None:
        """Changes of t, l and s."""
        sigma, e = self.weights(mu)
        change = self.jacobian @ dz
        following = -sigma * (change + e)
        with np.errstate(divide="ignore", invalid="ignore"):
            self.dl = np.where(self.hard, following, np.where(self.equal, -following, 0.0)) - self.l
            pull = np.maximum(0.0, self.l - self.penalty * (self.h + change))
            self.dl = np.where(self.multiplier, pull - self.l, self.dl)
            self.dt = np.where(self.hard, (mu - self.l * self.t - self.t * self.dl) / self.l, 0.0)
            self.ds = np.where(self.soft, (mu + self.s * self.dl) / (self.penalty - self.l) - self.s, 0.0)
        self.dl, self.dt, self.ds = (np.where(self.counts, d, 0.0) for d in (self.dl, self.dt, self.ds))
        self.change = change

    def slope(self, mu: float) -> float:
        """Directional derivative of the rows' cost."""
        with np.errstate(divide="ignore", invalid="ignore"):
            hard = np.where(self.hard, -mu * self.dt / self.t, 0.0)
            soft = np.where(self.soft, self.ds * (self.penalty - mu / self.s), 0.0)
            pull = np.where(self.multiplier, -np.maximum(0.0, self.l - self.penalty * self.h) * self.change, 0.0)
        return float(np.where(self.counts, hard + soft + pull, 0.0).sum())

    def reach(self, tau: float) -> tuple[float, float]:
        """Largest primal and dual step."""

        def longest(value: np.ndarray, step: np.ndarray, mask: np.ndarray) -> float:
            mask = mask & self.counts & (step < -tau * value)
            return float(np.min(-tau * value[mask] / step[mask], initial=1.0))

        primal = min(longest(self.t, self.dt, self.hard), longest(self.s, self.ds, self.soft))
        return primal, min(longest(self.l, self.dl, self.hard), longest(self.penalty - self.l, -self.dl, self.soft))

    def take(self, primal: float, dual: float, solved: bool) -> None:
        """Move; multipliers of MULTIPLIER rows only when their subproblem is ``solved``."""
        self.t, self.s = self.t + primal * self.dt, self.s + primal * self.ds
        self.l = self.l + np.where(self.hard, dual, np.where(self.multiplier & (not solved), 0.0, primal)) * self.dl

    def merit(self, h: np.ndarray, alpha: float, mu: float) -> tuple[float, float]:
        """Cost and violation at values h with slacks ``alpha`` of the step further."""
        t, s = (self.t + alpha * self.dt, self.s + alpha * self.ds) if alpha > 0.0 else (self.t, self.s)
        with np.errstate(divide="ignore", invalid="ignore"):
            cost = np.where(self.hard, -mu * np.log(t), 0.0)
            cost += np.where(self.soft, self.penalty * s - mu * np.log(np.where(self.soft, s, 1.0)), 0.0)
            pull = np.maximum(0.0, self.l - self.penalty * h)
            cost += np.where(self.multiplier, 0.5 * (pull**2 - self.l**2) / self.penalty, 0.0)
        violation = np.where(self.hard, np.abs(h + s - t), np.where(self.equal, np.abs(h), 0.0))
        return float(cost[self.counts].sum()), float(violation[self.counts].sum())

    def residuals(self) -> tuple[float, float]:
        """Largest complementarity product and primal residual."""
        with np.errstate(invalid="ignore"):
            product = np.where(self.hard, self.l * self.t, 0.0)
            product = np.maximum(product, np.where(self.soft, (self.penalty - self.l) * self.s, 0.0))
        other = np.where(self.equal, np.abs(self.h), np.abs(np.minimum(self.h, self.l / self.penalty)))
        primal = np.where(self.hard, np.abs(self.h + self.s - self.t), other)
        return float(np.max(product[self.counts], initial=0.0)), float(np.max(primal[self.counts], initial=0.0))


def lacking(problem: Transcription, settings: Any) -> str:
    """What a problem or its settings need and the twin has not; empty if there is nothing."""
    needs = {
        "exact Hessian": problem.exact,
        "filter line search": settings.line_search != "merit",
        "grid that follows events": problem.ocp.align_events,
        "jumps of the state": problem.jumps,
    }
    return next((name for name, needed in needs.items() if needed), "")


class InterpretedSolver:
    """Runs what ``receding_solve`` runs, on the same fields x, u, p, w, k, grid of its ``ws``."""

    def __init__(self, problem: Transcription) -> None:
        self.problem = problem
        n, nx, nu = problem.ocp.intervals, problem.nx, problem.nu
        self.ws = SimpleNamespace(
            grid=problem.ocp.grid.copy(), x=np.zeros((n + 1, nx)), u=np.zeros((n, nu)), w=problem.default_weights(),
            p=np.zeros((n + 1, max(problem.node.size, 1))), k=np.zeros((n, nu, nx)), state=np.zeros(24),
            rows_h=np.zeros((n + 1, max(len(problem.path.rows), len(problem.end.rows), 1))),
        )  # fmt: skip
        self.path, self.end = box_table(problem.path_boxes), box_table(problem.terminal_boxes)
        self.values, self.derivatives = problem.values, problem.derivatives
        self.own = [RowState(problem.path if k < n else problem.end, k == 0) for k in range(n + 1)]
        self.mu, self.shift, self.policy, self.hold = 0.0, 0.0, False, 0
        self.feed, self.last_du = np.zeros((n, nu)), np.zeros((n, nu))

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

    def _rows(self, k: int, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Values of node k's rows."""
        general = self.values["rows"](x, u, self._p(k), self.ws.w) if k < len(self.ws.u) else None
        general = self.values["end_rows"](x, self._p(k), self.ws.w) if general is None else general
        return self.own[k].values(np.concatenate([x, u]), general)

    def _merit(self, x: np.ndarray, u: np.ndarray, x0: np.ndarray, alpha: float = 0.0) -> tuple[float, float]:
        ws, n = self.ws, len(u)
        violation = np.abs(x0 - x[0]).sum()
        cost = float(self.values["terminal"](x[n], self._p(n), ws.w)) + barrier(self.end, x[n])[0]
        for k in range(n):
            h = ws.grid[k + 1] - ws.grid[k]
            violation += np.abs(self.step(x[k], u[k], k)[0] - x[k + 1]).sum()
            arguments = (x[k], u[k], self._p(k), ws.w)
            cost += h * (float(self.values["cost"](*arguments)) + barrier(self.path, np.concatenate([x[k], u[k]]))[0])
            violation += np.abs(np.array(self.values["equality"](*arguments))).sum()
            more, broken = self.own[k].merit(self._rows(k, x[k], u[k]), alpha, self.mu)
            cost, violation = cost + h * more, violation + h * broken
        more, broken = self.own[n].merit(self._rows(n, x[n], u[-1]), alpha, self.mu)
        return cost + more, float(violation + broken)

    def _node(self, k: int) -> tuple[np.ndarray, ...]:
        """a, b, gap, h, g, c, d, e of one node; then h without the rows and the gradient without them."""
        ws, nx = self.ws, self.problem.nx
        h = ws.grid[k + 1] - ws.grid[k]
        arguments = (ws.x[k], ws.u[k], self._p(k), ws.w)
        _, g, hessian = self.derivatives["cost_quadratic"](*arguments, h)
        upper = np.array(hessian)
        z = np.concatenate([ws.x[k], ws.u[k]])
        _, slope, curve = barrier(self.path, z)
        full = upper + np.triu(upper, 1).T + h * np.diag(curve)
        end, ab = self.step(ws.x[k], ws.u[k], k)
        e, cd = (np.array(v) for v in self.derivatives["equality_jacobian"](*arguments))
        gradient = np.array(g).ravel() + h * slope
        rows = self.own[k]
        rows.linearise(z, *self.derivatives["rows_jacobian"](*arguments))
        sigma, offset = rows.weights(self.mu)
        j = rows.jacobian
        if self.problem.curved:
            full = full + curvature(self.problem, rows, arguments, h)
        whole = full + h * j.T @ (sigma[:, None] * j) + self.shift * np.eye(z.size)
        pulled = gradient + h * j.T @ (sigma * offset)
        parts = (ab[:, :nx], ab[:, nx:], end - ws.x[k + 1], whole, pulled, cd[:, :nx], cd[:, nx:], e.ravel())
        return (*parts, full, gradient)

    def _terminal(self) -> tuple[np.ndarray, ...]:
        """h, g with rows, h, g without."""
        ws, n, nx = self.ws, len(self.ws.u), self.problem.nx
        _, g, hessian = self.derivatives["terminal_quadratic"](ws.x[n], self._p(n), ws.w)
        upper = np.array(hessian)
        _, slope, curve = barrier(self.end, ws.x[n])
        full, gradient = upper + np.triu(upper, 1).T + np.diag(curve), np.array(g).ravel() + slope
        rows = self.own[n]
        values, jacobian = self.derivatives["end_rows_jacobian"](ws.x[n], self._p(n), ws.w)
        rows.linearise(ws.x[n], values, jacobian)
        sigma, offset = rows.weights(self.mu)
        j = rows.jacobian
        whole = full + j.T @ (sigma[:, None] * j) + self.shift * np.eye(nx)
        return whole, gradient + j.T @ (sigma * offset), full, gradient

    def iterate(self, x0: np.ndarray) -> dict[str, Any]:
        """Linearise and find the step; returns dx, du, the nodes' data and the cost's slope."""
        ws, n = self.ws, len(self.ws.u)
        nodes = [self._node(k) for k in range(n)]
        end = self._terminal()
        value, slope = end[:2]
        eps = self.problem.compliance + 1e-14
        for k in reversed(range(n)):
            ws.k[k], self.feed[k], value, slope = riccati_step(*nodes[k][:8], eps, value, slope)  # type: ignore[call-arg]
        dx, du = [x0 - ws.x[0]], []
        kkt, along, bend = 0.0, 0.0, 0.0
        for k, (a, b, gap, h, _, _, _, _, own, g) in enumerate(nodes):
            du.append(ws.k[k] @ dx[k] + self.feed[k])
            dz = np.concatenate([dx[k], du[k]])
            kkt, along, bend = max(kkt, np.abs(own @ dz).max()), along + g @ dz, bend + dz @ h @ dz
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

    def _trial(self, s: dict[str, Any], alpha: float, x0: np.ndarray, single: bool) -> tuple[np.ndarray, np.ndarray]:
        """States and inputs a step further; with ``single`` the policy is rolled out."""
        ws = self.ws
        ws.state[[MISSED, GIVEN_WAY]] = 0.0
        if not single and not self.hold:
            return ws.x + alpha * s["dx"], ws.u + alpha * s["du"]
        x, u = np.zeros_like(ws.x), np.zeros_like(ws.u)
        x[0] = x0 if single else ws.x[0] + alpha * s["dx"][0]
        for k in range(len(u)):
            u[k] = ws.u[k] + alpha * self.feed[k] + ws.k[k] @ (x[k] - ws.x[k])
            if self.hold:
                self._hold(k, x[k], u[k], alpha)
            if single:
                x[k + 1] = self.step(x[k], u[k], k)[0]
            else:
                change = s["ab"][k] @ np.concatenate([x[k] - ws.x[k], u[k] - ws.u[k]])
                x[k + 1] = ws.x[k + 1] + change + alpha * s["gaps"][k]
        return x, u

    def _hold(self, k: int, x: np.ndarray, u: np.ndarray, alpha: float) -> None:
        """Node k's trial inputs within the true rows, in place."""
        state, rows = self.ws.state, self.own[k]
        functions = self.derivatives["rows_jacobian"]
        held = rows.bounds_inputs & (~rows.soft | (self.hold > 1))
        h = hold_inputs(rows, held, self.mu, x, u, lambda x, u: functions(x, u, self._p(k), self.ws.w))
        by = np.where(rows.bounds_inputs, -h, 0.0)
        if by.max(initial=0.0) > max(state[MISSED], state[GIVEN_WAY]):
            state[MOST_AT] = k * self.ws.rows_h.shape[1] + int(np.argmax(by))
        state[MISSED] = max(state[MISSED], by[~rows.soft].max(initial=0.0))
        state[GIVEN_WAY] = max(state[GIVEN_WAY], by[rows.soft].max(initial=0.0))
        if alpha > 0.0:
            carried = np.where(rows.soft, rows.s + alpha * rows.ds, 0.0)
            general = held & (np.arange(h.size) >= rows.boxes)
            rows.dt = np.where(general, (np.maximum(h + carried, aims(rows, self.mu)) - rows.t) / alpha, rows.dt)

    def run(
        self, tables: Any, t0: float, delta: float, x0: np.ndarray, settings: Any, log: np.ndarray
    ) -> tuple[int, int]:
        """The same as :func:`wbmpc.solver.receding.receding_solve`; merit line search, no moving grid, no jumps."""
        from wbmpc.solver.driver import SETTINGS
        from wbmpc.solver.receding import sample

        missing = lacking(self.problem, settings)
        if missing:
            raise InputError(f"the interpreted backend has no {missing}; valid: 'compiled'")
        ws = self.ws
        for k in range(len(ws.grid)):
            sample.python(*tables, t0 + ws.grid[k], ws.p.ravel(), k * ws.p.shape[1])
        if delta > 0.0:
            self._shift(delta)
        c = SimpleNamespace(**dict(zip(SETTINGS, settings.numbers(), strict=True)))
        self.mu, self.shift = c.mu_start, 0.0
        rolled = c.single_shooting and c.keep_multipliers and bool(self.problem.path.rows or self.problem.end.rows)
        self.hold = 1 + int(c.keep_multipliers) if self.problem.curved else int(rolled)
        start = (self.mu, c.least_slack, bool(c.keep_multipliers), bool(c.keep_slacks))
        self._start_rows(*start)
        if c.single_shooting:
            if not self.policy:
                self.iterate(x0)
            ws.x[:], ws.u[:] = self._trial({}, 0.0, x0, True)
            self._start_rows(*start)
        return self._iterate_to_the_end(x0, c, log)

    def _start_rows(self, mu: float, least: float, keep: bool, keep_slacks: bool) -> None:
        for k, rows in enumerate(self.own):
            rows.h = self._rows(k, self.ws.x[k], self.ws.u[min(k, len(self.ws.u) - 1)])
            rows.rho = 1.0
            rows.start(mu, least, keep, keep_slacks)

    def forget(self) -> None:
        """Slacks and multipliers start anew."""
        for rows in self.own:
            rows.l, rows.started = np.zeros_like(rows.l), False

    def _iterate_to_the_end(self, x0: np.ndarray, c: Any, log: np.ndarray) -> tuple[int, int]:
        from wbmpc.solver.driver import DIVERGED, LIMIT_MISSED, NO_STEP, NOT_FINITE, next_mu
        from wbmpc.solver.settings import AT_REST, BIAS, HUGE, UNSETTLED

        penalty, first, last_kkt, it, limit = 0.0, 1.0, np.inf, 0, int(c.iterations)
        last_residual, hold, level, last_mu, bias = np.inf, self.hold, c.mu_end, c.mu_start, 0.0
        self.shift, shift, has_rows = 0.0, 0.0, any(r.kind.size for r in self.own)
        while it < limit:
            self.shift = shift
            cost, violation = self._merit(self.ws.x, self.ws.u, x0)
            try:
                s = self.iterate(x0)
            except np.linalg.LinAlgError:  # a Hessian that is not convex, or not finite
                shift = max(10.0 * shift, 1e-6)
                log[it] = (
                    cost - self._row_cost(self.ws.x, self.ws.u),
                    violation,
                    np.nan,
                    np.nan,
                    0.0,
                    violation,
                    self._equalities(),
                    *[np.nan] * 5,
                )
                it += 1
                if it < limit and np.isfinite([cost, violation]).all() and 0.0 < shift <= c.largest_shift:
                    continue
                return NOT_FINITE, it
            size = max(np.abs(s["dx"]).max(), np.abs(s["du"]).max())
            product, residual = (max(v) for v in zip(*(r.residuals() for r in self.own), strict=True))
            kkt = s["kkt"] if c.certify else np.nan
            log[it] = (
                cost - self._row_cost(self.ws.x, self.ws.u),
                violation,
                kkt,
                size,
                0.0,
                violation,
                self._equalities(),
                residual,
                product,
                self.mu,
                shift,
                1.0,
            )
            it += 1
            if not np.isfinite([cost, violation, s["slope"]]).all():
                return NOT_FINITE, it
            self.ws.state[[COST, VIOLATION]] = log[it - 1, 0], violation
            if abs(cost) > HUGE or size > HUGE:
                return DIVERGED, it
            feasible = max(violation, residual) <= c.feasibility
            moved = max((np.abs(s[d]) / (1.0 + np.abs(z))).max() for d, z in (("dx", self.ws.x), ("du", self.ws.u)))
            if self.problem.compliance.any() and residual <= c.feasibility and moved <= AT_REST:
                feasible = violation - self._equalities() <= c.feasibility
            if self.mu < last_mu:
                bias = moved * self.mu / (last_mu - self.mu)
            last, last_mu = self.mu <= level or not has_rows, self.mu
            small = moved <= UNSETTLED or not last
            if c.certify and kkt <= c.tolerance and feasible and product <= 10.0 * self.mu and small:
                if last and (not has_rows or bias <= BIAS or self.mu <= c.mu_floor):
                    return 0, it
                level = max(0.2 * self.mu, c.mu_floor) if last else level
                self.mu, first, last_kkt = next_mu.python(self.mu, level, 0.0, self.mu), 1.0, np.inf
                continue
            h = np.append(np.diff(self.ws.grid), 1.0)
            drop = violation - sum(
                w * np.abs((r.h + r.change)[r.equal & r.counts]).sum() for w, r in zip(h, self.own, strict=True)
            )
            if drop > 1e-10:
                curvature = s["curvature"] if c.certify else 0.0  # the compiled solver has it only then
                penalty = max(penalty, 2.0 * (s["slope"] + 0.5 * curvature) / drop)
            invisible = abs(s["slope"]) + penalty * drop < 1e-5 * (1.0 + abs(cost))
            first = max(0.5 * first, 0.1) if kkt > last_kkt and invisible else min(1.3 * first, 1.0)
            last_kkt = kkt
            first = first if c.certify else self._longest_step(s["du"], it == 1)
            reaches = [r.reach(c.tau) for r in self.own]
            primal, dual = (min(v) for v in zip(*reaches, strict=True))
            alpha = self._search(s, x0, c, (cost, violation, s["slope"], drop), penalty, first, primal)
            if alpha == 0.0:
                self.ws.state[[COST, VIOLATION]] = log[it - 1, 0], violation
                if self.hold == 1 and not c.keep_multipliers:  # once more along the step itself
                    self.hold = 0
                    continue
                shift = max(10.0 * shift, 1e-4)
                if shift > c.largest_shift:
                    return NO_STEP, it
                continue
            shift = 0.2 * shift if shift > 1e-6 else 0.0
            solved = not c.certify or kkt <= max(c.tolerance, 0.1 * residual)
            for rows in self.own:
                rows.take(alpha, dual, solved)
            if has_rows:
                error = max(kkt, 0.0 if feasible else max(violation, residual)) if c.certify else 0.0
                after = next_mu.python(self.mu, level, error, product)
                after = min(c.mu_start, 10.0 * self.mu) if primal < 0.1 else after
                if c.certify and (solved or alpha > 0.9):
                    if residual > c.feasibility and residual > 0.25 * last_residual:
                        last_kkt = np.inf
                        for r in self.own:
                            r.rho = min(4.0 * r.rho, 1e6)
                    last_residual = residual
                if after != self.mu:
                    self.mu, last_kkt = after, np.inf
            self.policy, self.hold = True, hold
            log[it - 1, 4] = self.ws.state[LAST_ALPHA] = alpha
            if it == limit and alpha < 0.9 * first and limit < int(c.iterations) + int(c.extra_when_cut):
                limit += 1
        return (LIMIT_MISSED if self.ws.state[MISSED] > LIMIT_TOLERANCE else 1), it

    def _equalities(self) -> float:
        """1-norm of the rows of the recursion at the iterate."""
        ws, f = self.ws, self.values["equality"]
        return float(sum(np.abs(np.array(f(ws.x[k], ws.u[k], self._p(k), ws.w))).sum() for k in range(len(ws.u))))

    def _longest_step(self, du: np.ndarray, first: bool) -> float:
        """As longest_step of the compiled solver."""
        from wbmpc.solver.driver import next_longest

        state, last, self.last_du = self.ws.state, self.last_du, du
        size = float(np.sum(last * last))
        if state[LONGEST] == 0.0:
            state[LONGEST] = 1.0
        elif first:
            state[LONGEST] = min(1.1 * state[LONGEST], 1.0)
        elif size > 0.0:
            state[LONGEST] = next_longest.python(state[LONGEST], state[LAST_ALPHA], float(np.sum(du * last)) / size)
        return float(state[LONGEST])

    def _row_cost(self, x: np.ndarray, u: np.ndarray, alpha: float = 0.0) -> float:
        """What the rows add to the cost at a point."""
        h, last = np.append(np.diff(self.ws.grid), 1.0), len(u) - 1
        values = [self._rows(k, x[k], u[min(k, last)]) for k in range(len(x))]
        return float(sum(w * r.merit(v, alpha, self.mu)[0] for w, r, v in zip(h, self.own, values, strict=True)))

    def _search(
        self, s: dict[str, Any], x0: np.ndarray, c: Any, base: tuple[float, ...], penalty: float, first: float,
        reach: float,
    ) -> float:  # fmt: skip
        """The accepted step length, 0 for none; the iterate has moved."""
        from wbmpc.solver.driver import accept

        single, ratio = bool(c.single_shooting), first
        while ratio >= c.smallest_step or c.force_step:
            alpha = (ratio if ratio >= c.smallest_step else first) * reach
            x, u = self._trial(s, alpha, x0, single)
            merit = self._merit(x, u, x0, alpha)
            forced = ratio < c.smallest_step
            good = np.isfinite(merit).all() if forced else accept.python(*merit, *base, penalty, alpha)
            if good:
                self.ws.state[[COST, VIOLATION]] = merit[0] - self._row_cost(x, u, alpha), merit[1]
                self.ws.x[:], self.ws.u[:] = x, u
                for row in self.ws.x:
                    self._normalise(row)
                return float(alpha)
            if forced:
                break
            ratio *= 0.5
        return 0.0

    def _shift(self, delta: float) -> None:
        ws = self.ws
        middle = 0.5 * (ws.grid[1:] + ws.grid[:-1])
        for array, times in ((ws.x, ws.grid), (ws.u, middle)):
            array[:] = np.stack([np.interp(times + delta, times, c) for c in array.T], axis=1)
        for row in ws.x:
            self._normalise(row)
