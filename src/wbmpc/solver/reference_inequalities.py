"""The twin of :mod:`wbmpc.solver.inequalities` in NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np

from wbmpc.ocp.constraint_classification import Kind, RowGroup
from wbmpc.solver.inequalities import ROUNDING


class RowState:
    """Slacks t, multipliers l and L1 slacks s of one node's rows; see :mod:`wbmpc.solver.inequalities` for the formulas."""

    def __init__(self, group: RowGroup, measured: bool) -> None:
        rows = group.rows
        table = np.array(
            [(r.kind, r.variable, r.sign, r.offset, r.penalty, r.state_only) for r in rows], float
        ).reshape(-1, 6)
        self.kind, self.variable, self.sign, self.offset, self.row_penalty, state_only = table.T
        self.rho = 1.0
        self.from_now = np.array([r.from_now for r in rows], bool)
        self.counts = ~(state_only.astype(bool) & measured)
        self.bounds_inputs = (self.kind == Kind.HARD) & ~state_only.astype(bool)
        self.boxes = len(group.boxes)
        self.hard, self.multiplier, self.equal = (self.kind == k for k in Kind)
        self.soft = self.hard & np.isfinite(self.penalty)
        n = len(rows)
        self.h, self.t, self.l, self.s = np.zeros(n), np.ones(n), np.zeros(n), np.zeros(n)
        self.jacobian = np.zeros((n, 0))
        self.started = False

    @property
    def penalty(self) -> np.ndarray:
        """Weight of a hard row's L1 slack, or ρ of a multiplier row."""
        return np.where(self.hard, self.row_penalty, self.rho * self.row_penalty)

    def values(self, z: np.ndarray, general: Any) -> np.ndarray:
        """h at z = [x; u]; ``general``: values of the rows that are not of one variable."""
        index = self.variable[: self.boxes].astype(int)
        return np.concatenate(
            [self.sign[: self.boxes] * z[index] + self.offset[: self.boxes], np.array(general).ravel()]
        )

    def linearize(self, z: np.ndarray, general: Any, jacobian: Any) -> None:
        """h and its Jacobian by z."""
        self.h = self.values(z, general)
        selection = np.zeros((self.boxes, z.size))
        selection[np.arange(self.boxes), self.variable[: self.boxes].astype(int)] = self.sign[: self.boxes]
        self.jacobian = np.vstack([selection, np.array(jacobian).reshape(-1, z.size)])

    def start(self, mu: float, min_slack: float, keep: bool, keep_slacks: bool) -> None:
        """As start_rows of the compiled solver."""
        if keep_slacks and self.started:
            return
        self.started = True
        self.t = np.where(self.h > min_slack, self.h, min_slack)
        kept = self.l if keep else np.where(self.hard, mu / self.t, 0.0)
        kept = np.where(self.hard & ~(kept > 0.0), mu / self.t, kept)
        self.l = np.where(self.hard, np.clip(kept, 1e-12, 0.99 * self.penalty), kept)
        self.s = np.where(self.soft, np.maximum(self.t - self.h, mu / (self.penalty - self.l)), 0.0)

    def limit_products(self, largest: float) -> None:
        """As limit_products of the compiled solver."""
        self.l = np.where(self.hard, np.minimum(self.l, largest / self.t), self.l)

    def raise_multipliers(self, mu: float) -> None:
        """As raise_barrier of the compiled solver."""
        self.l = np.where(self.hard, np.minimum(np.maximum(self.l, mu / self.t), 0.99 * self.penalty), self.l)

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

    def reach(self, fraction: float) -> tuple[float, float]:
        """Largest primal and dual step."""

        def longest(value: np.ndarray, step: np.ndarray, mask: np.ndarray) -> float:
            mask = mask & self.counts & (step < -fraction * value)
            return float(np.min(-fraction * value[mask] / step[mask], initial=1.0))

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

    def products(self) -> np.ndarray:
        """Slacks times multipliers of hard rows that count, and of their L1 slacks."""
        hard, soft = self.hard & self.counts, self.soft & self.counts
        return np.concatenate([(self.l * self.t)[hard], ((self.penalty - self.l)[soft] * self.s[soft])])

    def residuals(self) -> tuple[float, float]:
        """Largest complementarity product and primal residual."""
        with np.errstate(invalid="ignore"):
            noise = np.where(self.soft, ROUNDING * self.penalty, 0.0)
            product = np.where(self.hard, (self.l - noise) * self.t, 0.0)
            product = np.maximum(product, np.where(self.soft, (self.penalty - self.l - noise) * self.s, 0.0))
        other = np.where(self.equal, np.abs(self.h), np.abs(np.minimum(self.h, self.l / self.penalty)))
        primal = np.where(self.hard, np.abs(self.h + self.s - self.t), other)
        return float(np.max(product[self.counts], initial=0.0)), float(np.max(primal[self.counts], initial=0.0))
