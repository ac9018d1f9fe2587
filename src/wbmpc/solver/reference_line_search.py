"""The line search of the interpreted twin: trial points, their merit, and the step that is accepted."""

from __future__ import annotations

from typing import Any

import numpy as np

from wbmpc.solver.memory_layout import StateField
from wbmpc.solver.reference_direction import InterpretedDirections
from wbmpc.solver.reference_inequalities import RowState
from wbmpc.solver.reference_nonlinear_inputs import aims, hold_inputs
from wbmpc.solver.settings import THRESHOLDS


class InterpretedLineSearch(InterpretedDirections):
    """Adds step lengths to directions."""

    def _trial(self, s: dict[str, Any], alpha: float, x0: np.ndarray, single: bool) -> tuple[np.ndarray, np.ndarray]:
        """States and inputs a step further; with ``single`` the policy is rolled out."""
        ws = self.ws
        ws.state[StateField.TRIAL_POINTS] += 1.0
        ws.state[[StateField.INPUT_VIOLATION, StateField.MIXED_VIOLATION]] = 0.0
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
        rows = self.own[k]
        functions = self.derivatives["rows_jacobian"]
        held = rows.bounds_inputs & (~rows.soft | (self.hold > 1))
        at = lambda x, u: functions(x, u, self._p(k), self.ws.w)
        h, inside = hold_inputs(rows, held, self.mu, x, u, at)
        if not inside and self.hold > 1:
            h, _ = hold_inputs(rows, held & ~rows.soft, self.mu, x, u, at)
        self._report_outside(k, rows, h)
        if alpha > 0.0:
            least = np.where(np.arange(h.size) < rows.boxes, THRESHOLDS.kept_slack * rows.t, aims(rows, self.mu))
            lacking = np.maximum(least - h - rows.s - alpha * rows.ds, 0.0)
            rows.ds = np.where(held & rows.soft, rows.ds + lacking / alpha, rows.ds)
            carried = np.where(rows.soft, rows.s + alpha * rows.ds, 0.0)
            rows.dt = np.where(held, (np.maximum(h + carried, least) - rows.t) / alpha, rows.dt)

    def _report_outside(self, k: int, rows: RowState, h: np.ndarray) -> None:
        """Remember by how much node k's inputs are outside, where its rows are h."""
        state, by = self.ws.state, np.where(rows.bounds_inputs, -h, 0.0)
        for of, field, which in (
            (~rows.soft, StateField.INPUT_VIOLATION, StateField.INPUT_VIOLATION_ROW),
            (rows.soft, StateField.MIXED_VIOLATION, StateField.MIXED_VIOLATION_ROW),
        ):
            own = np.where(of, by, 0.0)
            if own.max(initial=0.0) > state[field]:
                state[[field, which]] = own.max(), k * self.ws.rows_h.shape[1] + int(np.argmax(own))

    def _report_passed(self, k: int, rows: RowState, h: np.ndarray) -> None:
        """Remember by how much node k's state is outside, where its rows are h."""

        state, by = self.ws.state, np.where(rows.hard & rows.counts & ~rows.bounds_inputs, -h, 0.0)
        by[by <= THRESHOLDS.limit_tolerance] = 0.0
        if by.max(initial=0.0) > state[StateField.STATE_VIOLATION]:
            state[[StateField.STATE_VIOLATION, StateField.STATE_VIOLATION_ROW]] = (
                by.max(),
                k * self.ws.rows_h.shape[1] + int(np.argmax(by)),
            )
        state[StateField.UNRELAXED_VIOLATION] = max(
            state[StateField.UNRELAXED_VIOLATION], by[rows.l < THRESHOLDS.gives_way * rows.penalty].max(initial=0.0)
        )

    def _compare_with_last(self, du: np.ndarray) -> tuple[float, float]:
        """As compare_with_last of the compiled solver."""
        last, self.last_du = self.last_du, du
        return float(np.sum(du * last)), float(np.sum(last * last))

    def _longest_step(self, du: np.ndarray, first: bool) -> float:
        """As longest_step of the compiled solver."""
        from wbmpc.solver.line_search import next_longest

        state = self.ws.state
        along, size = self._compare_with_last(du)
        if state[StateField.MAX_STEP] == 0.0:
            state[StateField.MAX_STEP] = 1.0
        elif first:
            state[StateField.MAX_STEP] = min(1.1 * state[StateField.MAX_STEP], 1.0)
        elif size > 0.0:
            state[StateField.MAX_STEP] = next_longest.python(
                state[StateField.MAX_STEP], state[StateField.LAST_STEP], along / size
            )
        return float(state[StateField.MAX_STEP])

    def _row_cost(self, x: np.ndarray, u: np.ndarray, alpha: float = 0.0) -> float:
        """What the rows add to the cost at a point."""
        h, last = np.append(np.diff(self.ws.grid), 1.0), len(u) - 1
        values = [self._rows(k, x[k], u[min(k, last)]) for k in range(len(x))]
        return float(sum(w * r.merit(v, alpha, self.mu)[0] for w, r, v in zip(h, self.own, values, strict=True)))

    def _search(
        self, s: dict[str, Any], x0: np.ndarray, c: Any, base: tuple[float, float, float, float], penalty: float, first: float,
        reach: float,
    ) -> float:  # fmt: skip
        """The accepted step length, 0 for none; the iterate has moved."""
        from wbmpc.solver.line_search import accept

        single, ratio = bool(c.single_shooting), first
        while ratio >= c.min_step or c.accept_min_step:
            forced = ratio < c.min_step
            alpha = (first if forced else ratio) * reach
            merit = self._try(s, alpha, x0, single)
            good = np.isfinite(merit).all() if forced else accept.python(*merit, *base, penalty, alpha)
            if not (good or single or forced) and c.compute_kkt and ratio == first and merit[1] > base[1]:
                merit = self._try(s, alpha, x0, True)
                good = accept.python(*merit, *base, penalty, alpha)
            if good:
                self._take(merit, alpha)
                return float(alpha)
            if forced:
                break
            ratio *= 0.5
        return 0.0

    def _try(self, s: dict[str, Any], alpha: float, x0: np.ndarray, single: bool) -> tuple[float, float]:
        """(Cost, violation) of a trial point, which is kept."""
        self.tried = self._trial(s, alpha, x0, single)
        return self._merit(*self.tried, x0, alpha)

    def _take(self, merit: tuple[float, float], alpha: float) -> None:
        """The last trial point becomes the iterate."""
        x, u = self.tried
        paid, apart, of_soft = self._soft_equality_terms(x, u, alpha)
        cost = merit[0] - self._row_cost(x, u, alpha) - paid
        self.ws.state[[StateField.COST, StateField.VIOLATION]] = cost, merit[1] + of_soft - apart
        self.ws.x[:], self.ws.u[:] = x, u
        for row in self.ws.x:
            self._normalize(row)
