"""The lockstep loop: plant, controller and MPC in virtual time, with a modelled computation delay. Repeatable."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from wbmpc.errors import InputError, RunAborted
from wbmpc.mpc import MPC, Agent, Plans

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Timing:
    """Whole numbers of physics steps: of a controller tick, of an MPC period, of the computation delay (in ticks)."""

    period: float
    steps: int
    mpc_every: int
    delay: int

    @classmethod
    def of(cls, timestep: float, control_rate: float, mpc_rate: float, delay: float) -> Timing:
        """Check rates [Hz] and delay [s] against the physics step [s]."""
        steps = _whole("control.rate", 1.0 / control_rate, timestep, "physics steps")
        period = steps * timestep
        every = _whole("mpc.rate", 1.0 / mpc_rate, period, "controller periods")
        return cls(period, steps, every, _whole("mpc.delay", delay, period, "controller periods", least=0))


def _whole(key: str, length: float, unit: float, name: str, least: int = 1) -> int:
    count = round(length / unit)
    if count < least or abs(length - count * unit) > 1e-9:
        raise InputError(f"{key}: {length * 1e3:g} ms is not a whole number of {name} of {unit * 1e3:g} ms")
    return count


def run_lockstep(
    plant: Any,
    agent: Agent,
    mpc: MPC,
    timing: Timing,
    duration: float,
    record: Callable[[float, Any, Plans], None],
    progress: Progress | None = None,
) -> str:
    """Run for ``duration`` [s]; returns an empty string, or why the run ended early.

    ``record(t, command, plans)`` is called at every tick, with the plant as it is before the command acts.
    """
    plans, ticks = Plans(), round(duration / timing.period)
    for i in range(ticks):
        t = i * timing.period
        agent.measure(plant.measure())
        plans.activate(t)
        if i % timing.mpc_every == 0:
            until = t + timing.delay * timing.period
            try:
                plans.add(until, mpc.update(agent.predict(t, until, plans)))
            except RunAborted as error:
                return str(error)
            plans.activate(t)
        command = agent.command(t, plans)
        record(t, command, plans)
        plant.step(command, timing.steps)
        if plant.fell:
            return f"the robot fell at {t:.2f} s"
        if progress is not None and i % 40 == 0:
            progress((i + 1) / ticks, f"{t:.1f} of {duration:.1f} s")
    if progress is not None:
        progress(1.0, f"{duration:.1f} s")
    return ""
