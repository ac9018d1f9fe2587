"""What a ball robot's controller makes of a policy, compiled: see :class:`wbmpc.bases.ball.control_steps.ControlSteps`."""

from __future__ import annotations

import numpy as np

from wbmpc.bases.ball.compilation import MODEL
from wbmpc.bases.ball.model_step import Model
from wbmpc.bases.ball.torque_step import Torques, limit_torques
from wbmpc.kernel.ir import Floats
from wbmpc.solver.feedback import Plan, interval, law
from wbmpc.solver.receding import simulate


@MODEL.step
def through(model: Model, nx: int, nu: int, rows: Floats, first: int, count: int, h: float) -> bool:
    """The state after ``count`` of the ``rows`` (nu) of torques from the ``first`` on, each for h [s], in ``trial``; whether all that it
    follows from is finite."""
    finite = True
    for i in range(nx):
        model.trial[i] = model.state[i]
        finite = finite and np.isfinite(model.state[i])
    for k in range(first, first + count):
        for i in range(nu):
            model.acted[i] = rows[k * nu + i]
            finite = finite and np.isfinite(model.acted[i])
        simulate(model.memory, model.table, model.trial, model.acted, 1, h)
    return finite


@MODEL.compiled
def follow(
    plan: Plan, drives: Torques, x: Floats, feedforward: Floats, rows: Floats, row: int, blend: float, t: float
) -> bool:  # fmt: skip
    """Torques of the ``plan`` at time t [s] in the state x, within limits, and what drives with a lag make of them, in a ``row`` after the
    one before; ``blend``: how much of the way they go. False where they are not finite; nothing is changed but room then."""
    size, k = drives.size, interval(plan.times, plan.n, t)
    if not (np.isfinite(t) and law(plan, t, x, drives.torque)):
        return False
    drives.lean[0], drives.lean[1] = x[3], x[4]
    limit_torques(drives)
    for i in range(size):
        feedforward[i] = plan.inputs[k * plan.nu + i]
        last = rows[(row - 1) * size + i]
        rows[row * size + i] = last + blend * (drives.out[i] - last)
    return True


@MODEL.step
def act(
    plan: Plan, drives: Torques, model: Model, feedforward: Floats, rows: Floats, blend: float, first: int, count: int, row: int,
    t: float, h: float,
) -> bool:  # fmt: skip
    """:func:`follow` in the state that :func:`through` finds."""
    if not through(model, plan.nx, plan.nu, rows, first, count, h):
        return False
    return follow(plan, drives, model.trial, feedforward, rows, row, blend, t)


@MODEL.step
def foresee(
    plan: Plan, drives: Torques, model: Model, feedforward: Floats, rows: Floats, blend: float, t: float, h: float
) -> bool:  # fmt: skip
    """:func:`follow` in the first two ``rows``, and what the model makes of the state ``trial`` in h [s]."""
    if not follow(plan, drives, model.trial, feedforward, rows, 1, blend, t):
        return False
    for i in range(drives.size):
        rows[i] = rows[drives.size + i]
        model.acted[i] = rows[i]
    simulate(model.memory, model.table, model.trial, model.acted, 1, h)
    return True
