"""What a solver returns."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from wbmpc.solver.workspace import LOG


class Status(Enum):
    """How a solve ended; the value is a sentence."""

    CONVERGED = "converged: the optimality conditions hold to the tolerance"
    ITERATION_LIMIT = "stopped at the iteration limit"
    NO_STEP = "stopped: no step length improves cost or constraints"
    NOT_FINITE = "failed: the cost, a constraint or the step is not finite"
    DIVERGED = "failed: the cost or the step grows without bound"


@dataclass(frozen=True)
class Solution:
    """A trajectory with its feedback policy and its certificate.

    ``times`` (N + 1,) [s, from the start of the horizon]; ``x`` (N + 1, nx); ``u`` (N, nu), held over each interval;
    ``gain`` (N, nu, nx): u = u_k + K_k (x − x_k). ``cost``, ``violation`` (1-norm of gaps, equalities and start) and
    ``kkt`` (largest component of the Lagrangian's gradient; NaN when it was not asked for) belong to the last point
    that was linearised, i.e. before the last step; ``log`` has one row per iteration, columns :data:`LOG`.
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

    @property
    def usable(self) -> bool:
        """Whether the trajectory is finite and was not refused."""
        return self.status is not Status.NOT_FINITE and bool(np.isfinite(self.u[0]).all())

    def __str__(self) -> str:
        return (
            f"{self.status.value}; {self.iterations} iterations, cost {self.cost:.6g}, violation {self.violation:.2e}, "
            f"KKT residual {self.kkt:.2e}, {1e3 * self.solve_time:.3f} ms"
        )


COLUMNS = {name: i for i, name in enumerate(LOG)}
