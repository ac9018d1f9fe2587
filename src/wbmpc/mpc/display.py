"""What a prompt and a notebook show of an MPC."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from wbmpc.mpc.statistics import Statistics
    from wbmpc.ocp.problem import OptimalControlProblem
    from wbmpc.solver.solver import Solver


class Described:
    """An MPC's line and table, by what it has."""

    ocp: OptimalControlProblem
    rate: float
    solver: Solver
    statistics: Statistics
    fault: str

    def __repr__(self) -> str:
        d, solver = self.ocp.dynamics, type(self.solver.settings).__name__
        sizes = f"{self.ocp.intervals} intervals, {d.state.size} states, {d.input.size} inputs"
        return f"MPC({self.rate:g} Hz, {solver}, {self.ocp.horizon:g} s, {sizes})"

    def _repr_html_(self) -> str:
        from wbmpc.plots.notebook import html_table

        counts = self.statistics
        rows: list[tuple[str, object]] = [
            ("terms", ", ".join(self.ocp.terms)), ("references", ", ".join(self.solver.references)), ("solves", counts.solves),
            ("without a new plan", counts.failures + counts.no_step), ("with more than twice the iterations", counts.extended),
            ("last fault", self.fault or "none"),
        ]  # fmt: skip
        if counts.solve_times:
            rows.append(("solve time, median", f"{1e3 * np.median(counts.solve_times):.3g} ms"))
        return html_table(repr(self), (), rows)
