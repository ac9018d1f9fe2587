"""Initial guesses: where an MPC's solves start from."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from wbmpc.solver import Trajectory

if TYPE_CHECKING:
    from wbmpc.mpc.mpc import MPC


class Guess(Protocol):
    """Where a solve for the state ``x0`` (nx) at time ``t`` [s] starts from. ``trajectory``: the last plan, a copy that may be
    changed and returned; the solver then moves it forward to ``t``. None: the last plan as it is."""

    def __call__(self, t: float, x0: np.ndarray, trajectory: Trajectory) -> Trajectory | None: ...


@runtime_checkable
class Bound(Protocol):
    """A guess that needs the MPC it serves: its references, to read or to set before a solve, its schedule."""

    def bind(self, mpc: MPC) -> None: ...
