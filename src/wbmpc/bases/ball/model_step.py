"""What a ball robot's controller makes of states and policies by its model, compiled: see :class:`wbmpc.bases.ball.model_steps.ModelSteps`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wbmpc.bases.ball.compilation import MODEL
from wbmpc.bases.ball.disturbance import Clock, Disturbance, Gate, Setting, observe
from wbmpc.bases.ball.lean_step import Lean, lean_offsets
from wbmpc.bases.ball.payload_step import Load, Payload, update_mass
from wbmpc.bases.ball.torque_step import Torques, approach, limit_torques
from wbmpc.kernel.ir import Floats, Integers, PointerCall
from wbmpc.solver.feedback import Plan, interval, law
from wbmpc.solver.receding import simulate

call2 = PointerCall(2)


class Model(NamedTuple):
    """The model as a solver integrates it, from a state and the torques that acted there."""

    memory: Floats  # of the solver, whose integrator and parameters the model has
    table: Integers
    state: Floats  # (nx)
    acted: Floats  # (nu)
    trial: Floats  # (nx), room for another state


class Inertia(NamedTuple):
    """A function of the coordinates that was compiled by itself."""

    inertia: int  # its address
    places: Integers  # (2), room for the addresses of its argument and its results
    inertial: Floats  # (n n + n), its results: the mass matrix, and the weight of 1 kg at the tool


class Component(NamedTuple):
    """The lean's divergent component by a function of state, mass and push."""

    component: int  # its address, 0: there is none
    given: Floats  # (2 n + 3)
    found: Floats  # (2)


class Parameters(NamedTuple):
    """Where a solver's memory has the parameters of its model, from ``first`` to ``end``, and some of them; −1 for what it has not."""

    first: int
    end: int
    disturbance: int
    payload: int


@MODEL.step
def learn(
    model: Model, d: Disturbance, g: Gate, by: Inertia, p: Payload, lean: Lean, falls: Component, at: Parameters, weighs: bool,
    has_lean: bool, nu: int, rows: Floats, row: int, started: bool, t: float, h: float, forwards: bool,
) -> tuple[float, bool]:  # fmt: skip
    """Disturbance, payload (``weighs``: there is one) and ``lean`` (``has_lean``: there is one), with its component, after a state at t [s], h
    [s] after the one before (``started``: there was one), under the torques (nu) in a ``row``; ``forwards``: the solver gets them as its model's
    parameters, and zero for all others. Returns how much of a constant disturbance that can have learned, and whether all is
    finite: the solver gets nothing else."""
    n = d.size
    for i in range(nu):
        model.acted[i] = rows[row * nu + i]
    if not started:
        g.clock[Clock.NEW_UNTIL] = t + g.settings[Setting.LONGEST]
    for i in range(n):
        d.velocity[i] = model.state[n + i]
        if not started:
            g.speed[i] = model.state[n + i]
        model.trial[i], model.trial[n + i] = model.state[i], g.speed[i]
    simulate(model.memory, model.table, model.trial, model.acted, 1, h)
    by.places[0], by.places[1] = model.state.ctypes.data, by.inertial.ctypes.data
    call2(by.inertia, by.places.ctypes.data, by.places.ctypes.data + 8)
    for i in range(n):
        d.after[i] = model.trial[n + i]
    for i in range(n * n):
        d.mass[i] = by.inertial[i]
    learning = observe(d, g, t, h)
    if weighs:
        for i in range(n):
            p.weight[i] = by.inertial[n * n + i]
        update_mass(d, p, learning, h)
    if has_lean:
        lean_offsets(lean, d.force, model.state[2])
        if falls.component != 0:
            for i in range(2 * n):
                falls.given[i] = model.state[i]
            falls.given[2 * n], falls.given[2 * n + 1], falls.given[2 * n + 2] = p.load[Load.MASS], 0.0, 0.0
            by.places[0], by.places[1] = falls.given.ctypes.data, falls.found.ctypes.data
            call2(falls.component, by.places.ctypes.data, by.places.ctypes.data + 8)
            lean.leans[4], lean.leans[5] = falls.found[0] + lean.leans[0], falls.found[1] + lean.leans[1]
    finite = np.isfinite(p.load[Load.MASS])
    for i in range(n):
        finite = finite and np.isfinite(d.force[i])
    if not (finite and forwards):
        return learning, finite
    for i in range(at.first, at.end):
        model.memory[i] = 0.0
    for i in range(n):
        model.memory[at.disturbance + i] = d.force[i]
    if at.payload >= 0:
        model.memory[at.payload] = p.load[Load.MASS]
    return learning, finite


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
    approach(drives, rows, row - 1, blend)
    for i in range(size):
        feedforward[i] = plan.inputs[k * plan.nu + i]
        rows[row * size + i] = rows[(row - 1) * size + i] + drives.way[i]
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
