"""Events of a mode schedule against the grid of a horizon: which find no node, whose jumps are lost."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from wbmpc.errors import InputError

if TYPE_CHECKING:
    from wbmpc.solver.solver import Solver


def one_jump(first: float, second: float) -> str:
    """What to say of two events [s] within one interval whose jumps would be applied as one."""
    return (
        f"mode schedule: the events at {first:g} and {second:g} s can fall into one interval, which applies one jump of the state;"
        " valid: align_events=True, or events further apart than intervals are long"
    )


def check_events(solver: Solver, t0: float) -> None:
    """Raise :class:`InputError` for events within a horizon from ``t0`` [s] that the grid has no node for."""
    without = events_without_node(solver, t0)
    if without and not solver.ocp.align_events:
        raise InputError(one_jump(*lost_jumps(solver, t0)[0]))
    if without:
        nodes = solver.ocp.intervals - 1
        raise InputError(
            f"mode schedule: {without + nodes} events within the horizon, but {nodes} inner nodes: more intervals are needed"
        )


def events_without_node(solver: Solver, t0: float) -> int:
    """See :meth:`Solver.events_without_node`."""
    if not solver.ocp.align_events:
        return len(lost_jumps(solver, t0)) if solver.problem.jumps else 0
    numbers, integers, *_ = solver.data.tables()
    t = np.unique(numbers[: integers[1]]) - t0
    inside = int(np.sum((t > 1e-6) & (t < solver.ocp.horizon - 1e-6)))
    return max(inside - (solver.ocp.intervals - 1), 0)


def lost_jumps(solver: Solver, t0: float) -> list[tuple[float, float]]:
    """Pairs of successive events [s] that fall into one interval of the fixed grid of a horizon from ``t0`` [s]."""
    events = np.array(solver.schedule.events)
    interval = np.searchsorted(t0 + solver.ocp.grid + 1e-9, events)  # an event on a node belongs to the interval before
    same = np.flatnonzero((interval[1:] == interval[:-1]) & (interval[1:] > 0) & (interval[1:] <= solver.ocp.intervals))
    return [(float(events[i]), float(events[i + 1])) for i in same]
