"""What a ball robot's controller makes of a new state by its model, compiled: see :class:`wbmpc.bases.ball.model_steps.ModelSteps`.

``memory`` and ``table`` are the solver's, whose integrator and parameters the model has; ``state`` (nx), ``acted`` (nu): the state and
the torques that acted there; ``trial`` (nx): room for another state.
"""

from __future__ import annotations

from wbmpc.bases.ball.compilation import MODEL
from wbmpc.bases.ball.payload_step import update_mass
from wbmpc.estimation.disturbance_step import Clock, Setting, observe
from wbmpc.kernel.ir import Floats, Integers, PointerCall
from wbmpc.solver.receding import simulate

call2 = PointerCall(2)


@MODEL.step
def accelerate(
    nx: int, at: int, m: int, memory: Floats, table: Integers, state: Floats, acted: Floats, trial: Floats, acceleration: Floats,
    h: float,
) -> None:  # fmt: skip
    """Mean ``acceleration`` (m) over h [s] of the state's speeds from ``at`` on."""
    for i in range(nx):
        trial[i] = state[i]
    simulate(memory, table, trial, acted, 1, h)
    for i in range(m):
        acceleration[i] = (trial[at + i] - state[at + i]) / h


@MODEL.step
def learn(
    n: int, gates: int, memory: Floats, table: Integers, state: Floats, acted: Floats, trial: Floats, velocity: Floats, speed: Floats,
    after: Floats, mass: Floats, force: Floats, gate: Floats, felt: Floats, mean: Floats, innovation: Floats, clock: Floats,
    settings: Floats, inertia: int, places: Integers, inertial: Floats, weighs: bool, weight: Floats, model: Floats, believed: Floats,
    apart: Floats, load: Floats, rule: Floats, started: bool, t: float, h: float,
) -> float:  # fmt: skip
    """Disturbance and payload after the ``state`` at t [s], h [s] after the one before (``started``: there was one); returns how much of a
    constant disturbance that can have learned. ``inertia``: address of a function of the n coordinates whose results, ``inertial``,
    are the mass matrix and the weight of 1 kg at the tool."""
    if not started:
        clock[Clock.NEW_UNTIL] = t + settings[Setting.LONGEST]
    for i in range(n):
        velocity[i] = state[n + i]
        if not started:
            speed[i] = state[n + i]
        trial[i], trial[n + i] = state[i], speed[i]
    simulate(memory, table, trial, acted, 1, h)
    places[0], places[1] = state.ctypes.data, inertial.ctypes.data
    call2(inertia, places.ctypes.data, places.ctypes.data + 8)
    for i in range(n):
        after[i] = trial[n + i]
    for i in range(n * n):
        mass[i] = inertial[i]
    learning = observe(
        size=n, gates=gates, velocity=velocity, speed=speed, after=after, mass=mass, force=force, gate=gate, felt=felt, mean=mean,
        innovation=innovation, clock=clock, settings=settings, t=t, h=h,
    )  # fmt: skip
    if weighs:
        for i in range(n):
            weight[i] = inertial[n * n + i]
        update_mass(
            n=n, velocity=velocity, after=after, innovation=innovation, mass=mass, force=force, weight=weight, model=model,
            believed=believed, apart=apart, load=load, rule=rule, learning=learning, h=h,
        )  # fmt: skip
    return learning
