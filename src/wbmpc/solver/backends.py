"""What a solver runs on: machine code, or the interpreted twin. Both own the memory ``ws`` and iterate from the state ``x0`` (nx), which
the solver writes."""

from __future__ import annotations

import ctypes
from typing import Any, Protocol

import numpy as np

from wbmpc.interrupts import Interruptible
from wbmpc.kernel import Kernel
from wbmpc.model.numeric import Reentrant
from wbmpc.ocp import Transcription
from wbmpc.solver.receding import TableAddresses, Tables, forget, receding_solve
from wbmpc.solver.reference_solver import InterpretedSolver
from wbmpc.solver.settings import SQP
from wbmpc.solver.simulation import Simulation
from wbmpc.solver.workspace import make_workspace


class Backend(Protocol):
    """What :class:`wbmpc.solver.solver.Solver` asks of both."""

    ws: Any
    x0: np.ndarray

    def run(self, tables: Tables, t0: float, delta: float) -> tuple[int, int]:
        """See :meth:`Solver.iterate`."""

    def simulate(self, x: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
        """State (nx) after k times h [s] from x (nx) under inputs (k, nu), k up to ``SIMULATED``."""

    def reset(self) -> None:
        """Slacks and multipliers start anew."""


class Compiled:
    """Machine code ``kernel`` of a problem, with the settings ``numbers``; iterations go to ``log``. All addresses are looked up once: a call
    then costs microseconds."""

    def __init__(self, kernel: Kernel, problem: Transcription, numbers: np.ndarray, log: np.ndarray) -> None:
        self.ws, self.x0 = make_workspace(kernel, problem), np.zeros(problem.nx)
        own = {"m": self.ws.memory, "o": self.ws.table}
        self.simulate = Reentrant(lambda: Simulation(own, problem.nx, problem.nu))
        self._entry, self._out, self._tables = receding_solve.pointer, (ctypes.c_int64 * 2)(), TableAddresses()
        self._arrays = (self.ws.memory, self.ws.table, self.x0, numbers, log)  # whose addresses these are
        self._memory, self._table, *rest = (a.ctypes.data for a in self._arrays)
        self._after = (*rest, ctypes.addressof(self._out))

    def run(self, tables: Tables, t0: float, delta: float) -> tuple[int, int]:
        """See :class:`Backend`."""
        self._entry(self._memory, self._table, *self._tables.of(tables), t0, delta, *self._after)
        return self._out[0], self._out[1]

    def reset(self) -> None:
        """See :class:`Backend`."""
        forget(self.ws.memory, self.ws.table)


class Interpreted:
    """The interpreted twin; signals end it between two iterations."""

    def __init__(self, problem: Transcription, settings: SQP, log: np.ndarray) -> None:
        self.twin, self._settings, self._log = InterpretedSolver(problem), settings, log
        self.ws, self.x0, self.reset = self.twin.ws, np.zeros(problem.nx), self.twin.reset

    def run(self, tables: Tables, t0: float, delta: float) -> tuple[int, int]:
        """See :class:`Backend`."""
        with Interruptible() as signals:
            return self.twin.run(tables, t0, delta, self.x0, self._settings, self._log, signals.check)

    def simulate(self, x: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
        """See :class:`Backend`."""
        with Interruptible():
            for row in u:
                x = self.twin.simulate(x, row, h)
        return x
