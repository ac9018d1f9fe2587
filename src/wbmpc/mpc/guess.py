"""Initial guesses: where an MPC's solves start from."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from wbmpc.clearance.plan_step import predict
from wbmpc.errors import InputError
from wbmpc.solver import Solver, Trajectory

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


def check_guess(guess: object) -> None:
    """Raise :class:`InputError` unless this can be called or is None."""
    if not (guess is None or callable(guess)):
        raise InputError(f"mpc.guess: a function of t, x0 and the last trajectory is needed, or None; got {guess!r}")


def check_found(found: object) -> None:
    """Raise :class:`InputError` unless this is what a guess returns: numbers are checked by :meth:`Solver.warm_start`."""
    if not isinstance(found, Trajectory):
        raise InputError(
            f"mpc.guess: it must return a Trajectory, such as the one that it gets, or None; got {type(found).__name__}"
        )


def predicted(solver: Solver, t: float, delta: float) -> tuple[np.ndarray, np.ndarray]:
    """Times (N + 1) [s] of the nodes of a solve at ``t`` [s], and where the last plan, ``delta`` [s] old, is then (N + 1, nx)."""
    grid, plan = np.ascontiguousarray(solver.node_times(t)), solver.trajectory(copy=False)
    states = np.empty_like(plan.x)
    predict(len(plan.u), plan.x.shape[1], plan.grid, 0, plan.x, 0, grid, delta, states)
    return t + grid, states
