"""The interpreted twin of the compiled solver: NumPy and CasADi's interpreter, the same algorithm, readable.

It is the oracle of the tests and the fallback where no code can be generated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from wbmpc.errors import InputError
from wbmpc.ocp import Transcription
from wbmpc.ocp.transcription import MIN_SOFTNESS
from wbmpc.solver.memory_layout import SETTINGS, StateField
from wbmpc.solver.reference_line_search import InterpretedLineSearch
from wbmpc.solver.settings import THRESHOLDS


def lacking(problem: Transcription, settings: Any) -> str:
    """What a problem or its settings need and the twin has not; empty if there is nothing."""
    needs = {
        "exact Hessian": problem.exact,
        "filter line search": settings.line_search != "merit",
        "grid that follows events": problem.ocp.align_events,
        "jumps of the state": problem.jumps,
    }
    return next((name for name, needed in needs.items() if needed), "")


@dataclass
class _Progress:
    """Of one solve: iterations allowed, the level that μ falls to, μ of the last one, how inputs are held; then what is found."""

    limit: int
    level: float
    last_mu: float
    hold: int
    again: bool
    count: int = 0
    penalty: float = 0.0
    first: float = 1.0
    last_kkt: float = np.inf
    last_residual: float = np.inf
    bias: float = 0.0
    shift: float = 0.0
    size: float = 1.0
    other: bool = True  # than the problem of the direction before


class InterpretedSolver(InterpretedLineSearch):
    """Runs what ``receding_solve`` runs, on the same fields x, u, p, w, k, grid of its ``ws``."""

    def run(
        self, tables: Any, t0: float, delta: float, x0: np.ndarray, settings: Any, log: np.ndarray,
        check: Callable[[], None] = lambda: None,
    ) -> tuple[int, int]:  # fmt: skip
        """The same as :func:`wbmpc.solver.receding.receding_solve`; merit line search, no moving grid, no jumps.

        ``check`` is called before every iteration and may raise.
        """
        from wbmpc.solver.barrier_update import start_adaptive
        from wbmpc.solver.receding import sample

        missing = lacking(self.problem, settings)
        if missing:
            raise InputError(f"the interpreted backend has no {missing}; valid: 'compiled'")
        ws = self.ws
        for k in range(len(ws.grid)):
            sample.python(tables.numbers, tables.integers, t0 + ws.grid[k], ws.p.ravel(), k * ws.p.shape[1])
        c = SimpleNamespace(**dict(zip(SETTINGS, settings.numbers(), strict=True)))
        if delta > 0.0:
            self._shift(tables, t0, delta)
            if not c.keep_slacks and all(rows.hard.all() for rows in self.own):
                self._shift_multipliers(delta)
        self.mu, self.shift = max(c.initial_barrier, c.keep_multipliers * self.mu), 0.0
        start_adaptive.python(ws.state, 0)
        ws.state[[StateField.DIRECTIONS, StateField.TRIAL_POINTS]] = 0.0
        rolled = c.single_shooting and c.keep_multipliers and bool(self.problem.path.rows or self.problem.end.rows)
        self.hold = 1 + int(c.keep_multipliers) if self.problem.nonlinear_input_rows else int(rolled)
        self._start_rows_of_solve(x0, c)
        if c.single_shooting:
            if not self.policy:
                self.iterate(x0)
            ws.x[:], ws.u[:] = self._trial({}, 0.0, x0, True)
            self._start_rows(self.mu, c.min_slack, bool(c.keep_multipliers), bool(c.keep_slacks))
        self.soft_residual = self._equality_values(ws.x, ws.u)
        return self._iterate_to_the_end(x0, c, log, check)

    def _products(self) -> tuple[float, float]:
        """(Mean, smallest) of slacks and multipliers; (0, 0) without any."""
        found = np.concatenate([r.products() for r in self.own])
        return (float(found.mean()), float(found.min())) if found.size else (0.0, 0.0)

    def _start_rows_of_solve(self, x0: np.ndarray, c: Any) -> None:
        """As start_rows_of_solve of the compiled solver."""
        real_time, misfit = bool(c.keep_multipliers), np.inf
        if self.ws.state[StateField.CONVERGED] > 0.0 and not c.single_shooting and not real_time:
            self._row_values()
            misfit = max([*(rows.residuals()[1] for rows in self.own), np.abs(x0 - self.ws.x[0]).max()])
        self.ws.state[StateField.CONVERGED] = 0.0
        if not misfit < c.min_slack:
            self._start_rows(self.mu, c.min_slack, real_time, bool(c.keep_slacks))
            return
        slack = max(misfit, np.sqrt(c.barrier))
        self._start_rows(min(c.initial_barrier, slack**2), slack, True, False)
        for rows in self.own:
            rows.limit_products(c.initial_barrier)
        self.mu = min(c.initial_barrier, max(self._products()[0], c.barrier))

    def _row_values(self) -> None:
        for k, rows in enumerate(self.own):
            rows.h = self._rows(k, self.ws.x[k], self.ws.u[min(k, len(self.ws.u) - 1)])
            rows.rho = 1.0

    def _start_rows(self, mu: float, min_slack: float, keep: bool, keep_slacks: bool) -> None:
        self._row_values()
        for rows in self.own:
            rows.start(mu, min_slack, keep, keep_slacks)

    def reset(self) -> None:
        """Slacks and multipliers restart."""
        state = self.ws.state
        state[[StateField.MAX_STEP, StateField.INFEASIBLE_SOLVES, StateField.BLOCKED_RESIDUAL]] = 0.0
        state[StateField.BLOCKED_TIME], state[StateField.CONVERGED] = 0.0, 0.0
        self.mu = 0.0
        for rows in self.own:
            rows.l, rows.started = np.zeros_like(rows.l), False

    def _iterate_to_the_end(
        self, x0: np.ndarray, c: Any, log: np.ndarray, check: Callable[[], None]
    ) -> tuple[int, int]:
        """(status, iterations); the settings ``c`` by name."""
        from wbmpc.solver.termination import ITERATION_LIMIT, NOT_FINITE

        again = (
            self.has_rows
            and bool(c.compute_kkt or (c.max_extra_iterations and c.rollout_restart))
            and not c.single_shooting
        )
        run, self.shift = _Progress(int(c.iterations), c.barrier, self.mu, self.hold, again), 0.0
        run.bias = 0.0 if self.mu >= c.initial_barrier else np.inf
        while run.count < run.limit:
            check()
            self.shift = run.shift
            cost, violation = self._merit(self.ws.x, self.ws.u, x0)
            row = log[run.count]
            row[:] = np.nan
            paid, apart, of_soft = self._soft_equality_terms(self.ws.x, self.ws.u)
            row[:2] = cost - self._row_cost(self.ws.x, self.ws.u) - paid, violation + of_soft - apart
            row[4:7] = 0.0, row[1], self._equalities()
            run.count += 1
            self.ws.state[StateField.DIRECTIONS] += 1.0
            try:
                s = self.iterate(x0)
            except np.linalg.LinAlgError:  # a Hessian that is not convex, or not finite
                run.shift = max(10.0 * run.shift, 1e-6)
                if run.count < run.limit and np.isfinite([cost, violation]).all() and run.shift <= c.max_regularization:
                    continue
                return NOT_FINITE, run.count
            ended = self._iteration(x0, s, c, cost, violation, row, run)
            if ended is not None:
                return ended, run.count
        return self._status_at_the_limit(c, ITERATION_LIMIT), run.count

    def _iteration(
        self, x0: np.ndarray, s: dict[str, Any], c: Any, cost: float, violation: float, row: np.ndarray, run: _Progress
    ) -> int | None:
        """What comes after a direction; a status if it is the end."""
        from wbmpc.solver.barrier_update import next_mu
        from wbmpc.solver.termination import CONVERGED, DIVERGED, LINE_SEARCH_FAILED, NOT_FINITE

        size = max(np.abs(s["dx"]).max(), np.abs(s["du"]).max())
        product, residual = (max(v) for v in zip(*(r.residuals() for r in self.own), strict=True))
        kkt = s["kkt"] if c.compute_kkt else np.nan
        row[2:4], row[7:] = (kkt, size), (residual, product, self.mu, run.shift, 1.0)
        if not np.isfinite([cost, violation, s["slope"]]).all():
            return NOT_FINITE
        self.ws.state[[StateField.COST, StateField.VIOLATION]] = row[:2]
        if run.count == 1:
            run.size = min(max(1.0, abs(cost)), THRESHOLDS.divergence)
        if max(abs(cost), size) > THRESHOLDS.divergence * run.size:
            return DIVERGED
        feasible = max(violation, residual) <= c.feasibility
        moved = max((np.abs(s[d]) / (1.0 + np.abs(z))).max() for d, z in (("dx", self.ws.x), ("du", self.ws.u)))
        if self.problem.softness.any() and residual <= c.feasibility and moved <= THRESHOLDS.at_rest:
            feasible = row[1] - self._equalities() <= c.feasibility
        if self.mu < run.last_mu:
            run.bias = moved * self.mu / (run.last_mu - self.mu)
        last, run.last_mu = self.mu <= run.level or not self.has_rows, self.mu
        small = moved <= THRESHOLDS.settled or not last
        blocked = min(r.reach(c.fraction_to_boundary)[1] for r in self.own) < THRESHOLDS.short
        close = 100.0 if blocked else 10.0
        if c.compute_kkt and kkt <= c.tolerance and feasible and product <= close * self.mu and small:
            if last and (not self.has_rows or run.bias <= THRESHOLDS.bias or self.mu <= c.min_barrier):
                self.ws.state[StateField.CONVERGED] = 1.0
                return CONVERGED
            run.level = max(0.2 * self.mu, c.min_barrier) if last else run.level
            self.mu, run.first, run.last_kkt = next_mu.python(self.mu, run.level, 0.0, self.mu), 1.0, np.inf
            return None
        if run.again and self._restarts(x0, c, max(abs(cost), cost + s["slope"] + 0.5 * s["curvature"])):
            run.again, run.limit, run.last_kkt, run.first = False, run.limit + 1, np.inf, 1.0
            return None
        if run.count < c.iterations + c.max_extra_iterations and self._raises_barrier(c):
            run.limit, run.other = max(run.limit, run.count + 1), True
            return None
        alpha, dual, primal = self._step_length(x0, s, c, cost, violation, kkt, run)
        if alpha == 0.0:
            self.ws.state[[StateField.COST, StateField.VIOLATION]] = row[:2]
            if self.hold == 1 and not c.keep_multipliers:  # once more along the step itself
                self.hold = 0
                return None
            run.shift = max(10.0 * run.shift, 1e-4)
            if run.shift > c.max_regularization:
                self._watch(c)
                return self._status_at_the_limit(c, LINE_SEARCH_FAILED)
            return None
        run.shift = 0.2 * run.shift if run.shift > 1e-6 else 0.0
        error = max(kkt, 0.0 if feasible else max(violation, residual)) if c.compute_kkt else 0.0
        self._settle_rows(c, (alpha, primal, dual), kkt, error, (product, residual, violation), run)
        self.policy, self.hold = True, run.hold
        row[4] = self.ws.state[StateField.LAST_STEP] = alpha
        self._one_more(c, alpha, run)
        return None

    def _raises_barrier(self, c: Any) -> bool:
        """As raise_barrier of the compiled solver, where slacks cut the step short."""
        from wbmpc.solver.barrier_update import raised_mu

        reach = min(r.reach(c.fraction_to_boundary)[0] for r in self.own)
        weights = [THRESHOLDS.slack_share * r.penalty[r.hard].min(initial=np.inf) for r in self.own]
        most = min([c.max_barrier, *weights])
        if reach >= THRESHOLDS.short or not c.keep_multipliers or self.mu >= most:
            return False
        self.mu = float(raised_mu.python(self.mu, most, reach))
        for rows in self.own:
            rows.raise_multipliers(self.mu)
        return True

    def _restarts(self, x0: np.ndarray, c: Any, expected: float) -> bool:
        """As restart_from_rollout of the compiled solver."""
        rows = self.own[0]
        ahead = np.where(rows.hard & ~rows.bounds_inputs, -(rows.h + rows.change), 0.0)
        ahead[-rows.change <= 0.5 * ahead] = 0.0
        reach = min(r.reach(c.fraction_to_boundary)[0] for r in self.own)
        if reach > THRESHOLDS.jammed or ahead.max(initial=0.0) <= THRESHOLDS.limit_tolerance:
            return False
        hold, self.hold = self.hold, max(self.hold, 1)
        x, u = self._trial({}, 0.0, x0, True)
        self.hold = hold
        most = THRESHOLDS.runaway * max(1.0, expected) if c.keep_multipliers else np.inf
        if not (np.isfinite(x).all() and np.isfinite(u).all() and abs(self._merit(x, u, x0)[0]) <= most):
            return False
        self.ws.x[:], self.ws.u[:] = x, u
        self._start_rows(self.mu, c.min_slack, bool(c.keep_multipliers), False)
        return True

    def _step_length(
        self, x0: np.ndarray, s: dict[str, Any], c: Any, cost: float, violation: float, kkt: float, run: _Progress
    ) -> tuple[float, float, float]:
        """(accepted step or 0, longest dual one, longest primal one); the iterate has moved."""
        h = np.append(np.diff(self.ws.grid), 1.0)
        drop = violation - sum(
            w * np.abs((r.h + r.change)[r.equal & r.counts]).sum() for w, r in zip(h, self.own, strict=True)
        )
        if drop > 1e-10:
            run.penalty = max(run.penalty, 2.0 * (s["slope"] + 0.5 * s["curvature"]) / drop)
        invisible = abs(s["slope"]) + run.penalty * drop < 1e-5 * (1.0 + abs(cost))
        overshoots = c.compute_kkt and self._compare_with_last(s["du"])[0] < 0.0 and kkt > run.last_kkt and invisible
        run.first = max(0.5 * run.first, 0.01) if overshoots else min(1.3 * run.first, 1.0)
        run.last_kkt = kkt
        if not c.compute_kkt:
            run.first = self._longest_step(s["du"], run.other)
        primal, dual = (min(v) for v in zip(*(r.reach(c.fraction_to_boundary) for r in self.own), strict=True))
        base = (cost, violation, s["slope"], drop)
        return self._search(s, x0, c, base, run.penalty, run.first, primal), dual, primal

    def _settle_rows(
        self, c: Any, lengths: tuple[float, float, float], kkt: float, error: float,
        found: tuple[float, float, float],
        run: _Progress,
    ) -> None:  # fmt: skip
        """As settle_rows of the compiled solver; ``lengths``: taken, primal, dual; ``found``: product, residual, violation."""
        from wbmpc.solver.barrier_update import adaptive_mu, next_mu, real_time_mu

        (alpha, primal, dual), (product, residual, violation) = lengths, found
        solved = not c.compute_kkt or kkt <= max(c.tolerance, 0.1 * residual)
        self.soft_residual += alpha * self.soft_step
        for rows in self.own:
            rows.take(alpha, dual, solved)
        run.other, changed = False, False
        if not self.has_rows:
            return
        after = next_mu.python(self.mu, run.level, error, product)
        state, products = self.ws.state, self._products()
        adapts = bool(c.compute_kkt) and not c.keep_multipliers and products[0] > 0.0
        if adapts:
            state[StateField.BARRIER], errors = self.mu, (max(kkt, violation, residual, product), error)
            after = min(adaptive_mu.python(state, 0, after, errors, products, primal, run.level), c.max_barrier)
        if c.keep_multipliers:
            after = real_time_mu.python(self.mu, run.level, primal)
        elif primal < THRESHOLDS.short:
            after = min(c.max_barrier, max(after, 10.0 * self.mu))
        if c.compute_kkt and (solved or alpha > 0.9):
            if residual > c.feasibility and residual > 0.25 * run.last_residual:
                changed = True
                for r in self.own:
                    r.rho = min(4.0 * r.rho, 1e6)
            run.last_residual = residual
        run.other = after != self.mu
        if run.other:
            changed = changed or not (adapts and abs(after - self.mu) < 0.1 * kkt)
            self.mu = after
        if changed:
            run.last_kkt = np.inf
            if c.compute_kkt and not c.single_shooting:
                run.penalty *= THRESHOLDS.kept_weight

    def _one_more(self, c: Any, alpha: float, run: _Progress) -> None:
        """Whether there is another iteration after what was to be the last one."""
        if run.count < run.limit:
            return
        self._watch(c)
        outside, maximum = (
            self.ws.state[StateField.INPUT_VIOLATION] > THRESHOLDS.limit_tolerance,
            int(c.iterations) + int(c.max_extra_iterations),
        )
        if run.limit < maximum and (
            alpha < 0.9 * run.first
            or self.mu > c.barrier
            or outside
            or self.ws.state[StateField.UNRELAXED_VIOLATION] > 0.0
            or self._misses_equality(c)
        ):
            run.limit += 1
        elif outside and c.keep_multipliers and run.hold == 0 and not self.problem.softness.size:
            run.hold = self.hold = 2
            run.limit += 1

    def _watch(self, c: Any) -> None:
        """In real time: by how much inputs are outside straight hard rows, and states from node 1 on outside theirs."""
        ws, last = self.ws, len(self.ws.u)
        ws.state[[StateField.STATE_VIOLATION, StateField.UNRELAXED_VIOLATION]] = 0.0
        if not c.keep_multipliers:
            return
        if not self.hold:
            ws.state[[StateField.INPUT_VIOLATION, StateField.MIXED_VIOLATION]] = 0.0
        for k, rows in enumerate(self.own):
            h = self._rows(k, ws.x[k], ws.u[min(k, last - 1)])
            if not self.hold and k < last:
                self._report_outside(k, rows, h)
            self._report_passed(k, rows, h)

    def _status_at_the_limit(self, c: Any, status: int) -> int:
        from wbmpc.solver.termination import EQUALITY_INFEASIBLE, INPUT_INFEASIBLE

        if self.ws.state[StateField.INPUT_VIOLATION] > THRESHOLDS.limit_tolerance:
            return INPUT_INFEASIBLE
        return EQUALITY_INFEASIBLE if self._misses_equality(c) else status

    def _misses_equality(self, c: Any) -> bool:
        return bool(c.keep_multipliers and self._first_equalities() > c.equality_bound)

    def _first_equalities(self) -> float:
        """As first_equalities of the compiled solver, with the rows' slopes at the plan itself."""

        ws, state = self.ws, self.ws.state
        e, cd = self.derivatives["equality_jacobian"](ws.x[0], ws.u[0], self._p(0), ws.w)
        d = cd[:, self.problem.nx :]
        by = np.abs(e.ravel()) / (
            np.maximum(np.linalg.norm(d, axis=1), THRESHOLDS.min_slope) + np.abs(d) @ np.abs(ws.u[0])
        )
        by[self.problem.softness > MIN_SOFTNESS] = 0.0
        if by.size:
            state[[StateField.EQUALITY_RESIDUAL, StateField.EQUALITY_ROW]] = by.max(), np.argmax(by)
        return float(by.max(initial=0.0))

    def _equalities(self) -> float:
        """1-norm of the rows of the recursion at the iterate."""
        return float(np.abs(self._equality_values(self.ws.x, self.ws.u)).sum())

    def _shift_multipliers(self, delta: float) -> None:
        """As shift_multipliers of the compiled solver."""
        nodes, times = self.own[:-1], self.ws.grid[:-1]
        if delta < self.ws.grid[-1] - self.ws.grid[0]:
            numbers = np.array([rows.l for rows in nodes])
            moved = np.array([np.interp(times + delta, times, c) for c in numbers.T]).reshape(-1, len(nodes))
            for rows, own in zip(nodes, moved.T, strict=True):
                rows.l = np.where(rows.from_now, rows.l, own)
