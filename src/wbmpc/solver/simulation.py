"""What a system does under inputs, by the solver's integrator."""

from __future__ import annotations

import numpy as np

from wbmpc.arrays import Array
from wbmpc.kernel.step import Memory, bind
from wbmpc.solver.receding import simulate
from wbmpc.solver.simulation_arguments import SIMULATED


class Simulation:
    """``simulation(x, u, h)``: the state (nx) after k times h [s] from x under inputs (k, nu), of :data:`SIMULATED` at most. It has a place
    of its own for both; ``memory`` is the solver's, for what only one call of compiled code works with."""

    def __init__(self, memory: Memory, nx: int, nu: int) -> None:
        self._x, self._u = np.zeros(nx), np.zeros(SIMULATED * nu)
        self._run = bind(simulate, {**memory, "x": self._x, "u": self._u})

    def __call__(self, x: Array, u: Array, h: float) -> Array:
        self._x[:] = x
        self._u[: u.size] = u.reshape(-1)
        self._run(len(u), h)
        return self._x.copy()
