"""What a solver returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np

from wbmpc.solver.certificate import Violation
from wbmpc.solver.workspace import LOG


class Status(Enum):
    """How a solve ended; the value is a message."""

    CONVERGED = "converged: the optimality conditions hold to the tolerance"
    RELAXED = "converged, but a hard limit cannot be held: it was relaxed as little as possible"
    ITERATION_LIMIT = "stopped at the iteration limit"
    LINE_SEARCH_FAILED = "stopped: no step length improves cost or constraints"
    INFEASIBLE = "failed: the constraints cannot all be met, or not from this guess"
    NOT_FINITE = "failed: the cost, a constraint or the step is not finite"
    DIVERGED = "failed: the cost or the step grows without bound"
    INPUT_INFEASIBLE = "failed: the planned inputs miss a hard limit"
    EQUALITY_INFEASIBLE = "failed: the planned inputs miss an equality"


@dataclass(frozen=True)
class Solution:
    """A trajectory with its feedback policy and its certificate: ``status``, number of ``iterations``, ``solve_time`` [s].

    ``violations``: the worst of each constraint by name, in its own unit; ``detail``: the term, node or entry that the status refers to.
    ``times`` (N + 1,) [s, from the start of the horizon]; ``x`` (N + 1, nx); ``u`` (N, nu), held over each interval;
    ``gain`` (N, nu, nx): u = u_k + K_k (x − x_k). ``cost`` and ``violation`` (1-norm of gaps, equalities, rows and start)
    are those of this trajectory; ``kkt`` (largest component of the Lagrangian's gradient; NaN when it was not asked for) is that
    of the last point that was linearized, i.e. before the last step, as is the last row of
    ``log`` (iterations, columns :data:`LOG`).
    """

    status: Status
    times: np.ndarray
    x: np.ndarray
    u: np.ndarray
    gain: np.ndarray
    iterations: int
    cost: float
    violation: float
    kkt: float
    solve_time: float
    log: np.ndarray
    violations: Mapping[str, Violation] = field(default_factory=dict)
    detail: str = ""

    @property
    def worst(self) -> Violation | None:
        """The constraint that is violated most, in its own unit; None without constraints."""
        return max(self.violations.values(), key=lambda v: v.value, default=None)

    @property
    def usable(self) -> bool:
        """Whether the trajectory is finite and was not rejected."""
        bad = (Status.NOT_FINITE, Status.DIVERGED, Status.INPUT_INFEASIBLE, Status.EQUALITY_INFEASIBLE)
        return self.status not in bad and bool(np.isfinite(self.u[0]).all() and np.isfinite(self.x).all())

    def __repr__(self) -> str:
        return f"Solution({self})"

    def _repr_html_(self) -> str:
        from wbmpc.plots.notebook import html_table

        figures = {
            "status": self.status.value, "iterations": self.iterations, "cost": f"{self.cost:.6g}", "violation": f"{self.violation:.2e}",
            "KKT residual": f"{self.kkt:.2e}", "solve time [ms]": f"{1e3 * self.solve_time:.3f}", "horizon [s]": f"{self.times[-1]:g}",
            "intervals": len(self.u), "states, inputs": f"{self.x.shape[1]}, {self.u.shape[1]}", "detail": self.detail,
        }  # fmt: skip
        return html_table("Solution", (), [(name, value) for name, value in figures.items() if value != ""])

    def plot(self, dynamics: Any = None) -> Any:
        """States and inputs over the horizon as a Plotly figure; ``dynamics``: whose names and units they have (left out: numbers)."""
        from wbmpc.plots.notebook import figure, trajectories

        return figure(trajectories(self.times, self.x, self.u, dynamics))

    def __str__(self) -> str:
        why = f" ({self.detail})" if self.detail else ""
        return (
            f"{self.status.value}{why}; {self.iterations} iterations, cost {self.cost:.6g}, "
            f"violation {self.violation:.2e}, KKT residual {self.kkt:.2e}, {1e3 * self.solve_time:.3f} ms"
        )


COLUMNS = {name: i for i, name in enumerate(LOG)}
