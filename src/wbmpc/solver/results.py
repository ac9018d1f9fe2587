"""What the last solve left in a solver's memory: read-only arrays and numbers."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np

from wbmpc.ocp import Transcription
from wbmpc.solver.memory_layout import StateField
from wbmpc.solver.settings import THRESHOLDS, Effort


@dataclass
class Trajectory:
    """``start`` [s]: time of the first node; ``grid`` (N + 1,) [s]: from there on; ``x`` (N + 1, nx); ``u`` (N, nu), held over each
    interval."""

    start: float
    grid: np.ndarray
    x: np.ndarray
    u: np.ndarray

    @property
    def times(self) -> np.ndarray:
        """Of the nodes, (N + 1,) [s]."""
        return self.start + self.grid


def _read_only(part: np.ndarray) -> np.ndarray:
    view = part.view()
    view.flags.writeable = False
    return view


class SolverResults:
    """Reads the memory ``ws`` of a solve from the state ``x0`` (nx)."""

    ws: Any
    x0: np.ndarray
    problem: Transcription

    def trajectory(self, start: float = 0.0, copy: bool = True) -> Trajectory:
        """The present states and inputs; ``start`` [s]: when their horizon starts. Not copied: read-only, and overwritten by
        the next solve."""
        parts = (self.ws.grid, self.ws.x, self.ws.u)
        return Trajectory(start, *(part.copy() if copy else _read_only(part) for part in parts))

    @property
    def gain(self) -> np.ndarray:
        """Feedback of the present trajectory, (N, nu, nx), read-only: u = u_k + K_k (x − x_k)."""
        return _read_only(self.ws.k[:, :, : self.problem.nx])

    @property
    def node_parameters(self) -> np.ndarray:
        """References, mode values and switches of every node as the last solve sampled them, (N + 1, np), read-only; which is
        which: ``problem.node.slices``."""
        return _read_only(self.ws.p)

    @property
    def constants(self) -> np.ndarray:
        """The model's parameters and all weights (n,), read-only; which is which: ``problem.constant.slices``."""
        return _read_only(self.ws.w[: self.problem.constant.size])

    @property
    def integrator(self) -> dict[str, np.ndarray]:
        """The arguments ``memory`` and ``table`` of :func:`wbmpc.solver.receding.simulate`, for compiled steps that integrate the problem's
        dynamics."""
        return {"memory": self.ws.memory, "table": self.ws.table}

    @property
    def parameters(self) -> np.ndarray:
        """The model's parameters (np,), read-only."""
        return _read_only(self.ws.w[self.problem.constant.slices["parameters"]])

    def non_finite_part(self) -> str:
        """Which part of the present plan has numbers that are not finite; empty if none."""
        parts = {"planned state": self.ws.x, "planned input": self.ws.u, "feedback gain": self.ws.k}
        # what is infinite or no number stays so in a sum, which takes a third of the time; one that is not finite may be of large numbers
        with np.errstate(over="ignore", invalid="ignore"):
            sums = {name: float(np.add.reduce(values, axis=None)) for name, values in parts.items()}
        return next((n for n, values in parts.items() if not (isfinite(sums[n]) or np.isfinite(values).all())), "")

    @property
    def effort(self) -> Effort:
        """What the last solve has cost; at most :attr:`SQP.max_effort`."""
        state = self.ws.state
        return Effort(int(state[StateField.DIRECTIONS]), int(state[StateField.TRIAL_POINTS]))

    @property
    def limit_violation(self) -> float:
        """By how much the last plan's states, from node 1 on, are outside hard limits, as a share of the range; in real time only,
        and 0 up to the tolerance. Rows of states with inputs count from node 0 on."""
        worst = float(max(self.ws.state[StateField.STATE_VIOLATION], self.ws.state[StateField.MIXED_VIOLATION]))
        return worst if worst > THRESHOLDS.limit_tolerance else 0.0

    @property
    def initial_state_mismatch(self) -> float:
        """By how much the last plan starts elsewhere than in the measured state, as plans of cut steps do: the largest |x_0 − x|
        beside 1 + |x|; 0 up to the tolerance."""
        worst = float((np.abs(self.ws.x[0] - self.x0) / (1.0 + np.abs(self.x0))).max())
        return worst if worst > THRESHOLDS.limit_tolerance else 0.0
