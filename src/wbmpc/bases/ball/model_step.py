"""What a ball robot's controller makes of a new state by its model, compiled: see :class:`wbmpc.bases.ball.model_steps.ModelSteps`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wbmpc.bases.ball.compilation import MODEL
from wbmpc.bases.ball.disturbance_step import Clock, Disturbance, Gate, Setting, observe
from wbmpc.bases.ball.lean_step import Lean, lean_offsets
from wbmpc.bases.ball.payload_step import Load, Payload, update_mass
from wbmpc.kernel.ir import Floats, Integers, PointerCall
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


@MODEL.step
def accelerate(model: Model, nx: int, at: int, m: int, acceleration: Floats, h: float) -> None:
    """Mean ``acceleration`` (m) over h [s] of the state's speeds from ``at`` on."""
    for i in range(nx):
        model.trial[i] = model.state[i]
    simulate(model.memory, model.table, model.trial, model.acted, 1, h)
    for i in range(m):
        acceleration[i] = (model.trial[at + i] - model.state[at + i]) / h


class Component(NamedTuple):
    """The lean's divergent component by a function of state, mass and push."""

    component: int  # its address, 0: there is none
    given: Floats  # (2 n + 3)
    found: Floats  # (2)


class Parameters(NamedTuple):
    """Where a solver's memory has the ``count`` parameters of its model, and what is learned; −1 for what it has not."""

    first: int
    count: int
    disturbance: int
    push: int
    payload: int


@MODEL.step
def learn(
    model: Model, d: Disturbance, g: Gate, by: Inertia, p: Payload, lean: Lean, falls: Component, where: Parameters, weighs: bool,
    leaning: bool, started: bool, t: float, h: float, tells: bool, more_x: float, more_y: float,
) -> tuple[float, bool]:  # fmt: skip
    """Disturbance, payload (``weighs``: there is one) and ``lean`` (``leaning``: there is one), with its component, after a state at t [s], h [s] after the one before
    (``started``: there was one); ``tells``: the model is told of them, with ``more`` of a push. Returns how much of a constant
    disturbance that can have learned, and whether all is finite; the model is not told else."""
    n, finite = d.size, True
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
    if leaning:
        lean_offsets(lean, d.force, model.state[2])
        if falls.component != 0:
            for i in range(2 * n):
                falls.given[i] = model.state[i]
            falls.given[2 * n], falls.given[2 * n + 1], falls.given[2 * n + 2] = p.load[Load.MASS], 0.0, 0.0
            by.places[0], by.places[1] = falls.given.ctypes.data, falls.found.ctypes.data
            call2(falls.component, by.places.ctypes.data, by.places.ctypes.data + 8)
            lean.leans[6], lean.leans[7] = falls.found[0] + lean.leans[0], falls.found[1] + lean.leans[1]
    for i in range(n):
        finite = finite and np.isfinite(d.force[i])
    x, y, mass = lean.leans[4] + more_x, lean.leans[5] + more_y, p.load[Load.MASS]
    finite = finite and np.isfinite(x) and np.isfinite(y) and np.isfinite(mass)
    if finite and tells:
        for i in range(where.first, where.first + where.count):
            model.memory[i] = 0.0
        for i in range(n):
            model.memory[where.disturbance + i] = d.force[i]
        if where.push >= 0:
            model.memory[where.push], model.memory[where.push + 1] = x, y
        if where.payload >= 0:
            model.memory[where.payload] = mass
    return learning, finite
