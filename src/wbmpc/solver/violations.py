"""Messages that name the constraint which a plan violates most, its node, and by how much."""

from __future__ import annotations

from typing import TYPE_CHECKING

from wbmpc.solver.memory_layout import StateField
from wbmpc.solver.settings import THRESHOLDS
from wbmpc.solver.solution import Status

if TYPE_CHECKING:
    from wbmpc.solver.solver import Solver


def violation_message(solver: Solver, status: Status) -> str:
    """See :meth:`Solver.violation_message`."""
    state = solver.ws.state
    if status is Status.EQUALITY_INFEASIBLE:
        return _equality_message(solver)
    of_inputs = [(StateField.INPUT_VIOLATION, StateField.INPUT_VIOLATION_ROW)]
    others = [
        (StateField.MIXED_VIOLATION, StateField.MIXED_VIOLATION_ROW),
        (StateField.STATE_VIOLATION, StateField.STATE_VIOLATION_ROW),
    ]
    # what a plan is rejected for, else the worst
    fields = of_inputs if status is Status.INPUT_INFEASIBLE else of_inputs + others
    field, which = max(fields, key=lambda f: state[f[0]])
    by = float(state[field])
    if by <= THRESHOLDS.limit_tolerance:
        return ""
    node, row = divmod(int(state[which]), solver.ws.rows_h.shape[1])
    limit = (solver.problem.path if node < len(solver.ws.u) else solver.problem.end).rows[row]
    message = f"hard limit missed: {limit.name} by {by * limit.unit:.3g} at node {node}"
    if field is not StateField.STATE_VIOLATION:
        return message
    return f"{message}, {'not yet reached' if state[StateField.UNRELAXED_VIOLATION] == by else 'where its slack gives way'}"


def _equality_message(solver: Solver) -> str:
    names, row = solver.problem.equalities.names, int(solver.ws.state[StateField.EQUALITY_ROW])
    by = f"by {100.0 * solver.ws.state[StateField.EQUALITY_RESIDUAL]:.3g} % of the row's size"
    if row < len(names):
        return f"{names[row]} {by}, at the first input"
    node, row = divmod(row - len(names), solver.ws.rows_h.shape[1])
    own = (solver.problem.path if node < len(solver.ws.u) else solver.problem.end).rows[row]
    node_by, row_by = divmod(int(solver.ws.state[StateField.BLOCKING_ROW]), solver.ws.rows_h.shape[1])
    others = f"'{solver.problem.path.rows[row_by].name}' at node {node_by}" if node_by >= 0 else "others"
    return f"{own.name} {by} at node {node}: it cannot be met together with {others}"
