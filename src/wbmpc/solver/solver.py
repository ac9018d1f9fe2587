"""The solver that users hold: one problem, one algorithm, its memory and its warm start."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from operator import is_
from typing import TYPE_CHECKING, Literal

import numpy as np

from wbmpc.checks import absolute_time, not_negative, real_numbers
from wbmpc.errors import InputError, SolveFailed, UnsupportedOperation, unknown_name
from wbmpc.interrupts import Interruptible
from wbmpc.ocp import ModeSchedule, OptimalControlProblem, Reference, Transcription
from wbmpc.ocp.problem import check_problem
from wbmpc.ocp.terms import Weight
from wbmpc.solver.certificate import Checks
from wbmpc.solver.diagnostics import diagnose
from wbmpc.solver.events import check_events, events_without_node
from wbmpc.solver.guards import Exclusive
from wbmpc.solver.hessian import HessianSwitch, exact_from_start
from wbmpc.solver.horizon_data import HorizonData
from wbmpc.solver.memory_layout import SETTINGS, StateField
from wbmpc.solver.results import SolverResults
from wbmpc.solver.settings import SLQ, SQP, check_settings_type
from wbmpc.solver.simulation_arguments import SIMULATED, simulation_arguments
from wbmpc.solver.solution import COLUMNS, Solution, Status
from wbmpc.solver.violations import violation_message
from wbmpc.solver.warm_start import start_from
from wbmpc.solver.workspace import LOG

if TYPE_CHECKING:
    from wbmpc.kernel import Kernel
    from wbmpc.solver.backends import Backend

_LOG = logging.getLogger("wbmpc")
_STATUS = (
    Status.CONVERGED, Status.ITERATION_LIMIT, Status.LINE_SEARCH_FAILED, Status.NOT_FINITE, Status.DIVERGED,
    Status.INPUT_INFEASIBLE, Status.EQUALITY_INFEASIBLE,
)  # fmt: skip


@cache
def _warn(why: str) -> None:
    """Once for each problem's reason."""
    _LOG.warning("%s: CasADi's interpreter evaluates the whole problem, thousands of times slower", why)


@dataclass
class Solver(SolverResults):
    """A problem ``ocp`` bound to a solver with ``settings``: owns the kernel, the memory and the warm start.

    ``ocp``: the problem; ``settings`` of the solver; ``use_cache``: whether machine code is kept on the disk. For one thread at a time:
    who calls it while another thread is in it gets :class:`SolverBusy`.
    """

    ocp: OptimalControlProblem
    settings: SQP = field(default_factory=SQP)
    use_cache: bool = True

    def __post_init__(self) -> None:
        check_problem("solver", self.ocp)
        check_settings_type("solver", self.settings)
        #: who is in the memory; also for who reads a plan from it after the solve
        self.exclusive = Exclusive("the solver")
        with Interruptible():
            self._make()

    def _make(self) -> None:
        self._given_grid = self.ocp.grid
        if isinstance(self.settings, SLQ):
            self.ocp = self.ocp.refined(self.settings.step)
        self.problem = Transcription(self.ocp, exact_from_start(self.ocp, self.settings))
        self._terms = tuple(self.ocp.terms.values())
        self.kernel = self._build()
        self.data = HorizonData(self.problem, self.exclusive)
        self.log = np.zeros((self.settings.max_iterations, len(LOG)))
        self.numbers = self.settings.numbers()
        self._backend = self._make_backend()
        self.ws, self.x0 = self._backend.ws, self._backend.x0
        self.hessian = HessianSwitch(self)

    def _build(self) -> Kernel | None:
        """The machine code; None for the interpreted twin, which also steps in for operations that cannot be compiled."""
        if self.settings.backend == "interpreted":
            return None
        from wbmpc.kernel import build_kernel
        from wbmpc.solver.reference_solver import lacking

        try:
            return build_kernel(self.problem, self.use_cache)
        except UnsupportedOperation as error:
            missing = lacking(self.problem, self.settings)
            if missing:
                raise UnsupportedOperation(f"{error}, and the interpreted twin has no {missing}") from None
            _warn(str(error))
            self.settings = replace(self.settings, backend="interpreted")
            return None

    def _make_backend(self) -> Backend:
        from wbmpc.solver.backends import Compiled, Interpreted

        if self.kernel is None:
            return Interpreted(self.problem, self.settings, self.log)
        return Compiled(self.kernel, self.problem, self.numbers, self.log)

    # ------------------------------------------------------------------ data
    @property
    def references(self) -> Mapping[str, Reference]:
        """The references that are set, by the names of their terms."""
        return self.data.references

    @property
    def schedule(self) -> ModeSchedule:
        """The modes over absolute time."""
        return self.data.schedule

    def set_reference(self, name: str, reference: Reference) -> None:
        """Set the reference of the term ``name``."""
        self.data.set_reference(name, reference)

    def set_schedule(self, schedule: ModeSchedule) -> None:
        """Set the modes over absolute time."""
        self.data.set_schedule(schedule)

    def set_weight(self, name: str, weight: Weight, at: Literal["path", "terminal"] = "path") -> None:
        """Change a cost's weight (one number, one per row, or by the residual's groups) without compiling."""
        key = f"{at}.{name}"
        costs = [k for k in self.problem.constant.slices if k != "parameters"]
        if key not in costs:
            raise unknown_name("weight", key, costs)
        rows = self.ocp.term(name).expand(weight)  # type: ignore[union-attr]
        with self.exclusive:
            self.ws.w[self.problem.constant.slices[key]] = rows

    def set_parameters(self, values: Mapping[str, np.ndarray] | np.ndarray) -> None:
        """Set the model's parameters (constant over the horizon): by group, or the whole vector."""
        part = self.problem.constant.slices["parameters"]
        vector = (
            self.ocp.dynamics.parameters.vector(values)
            if isinstance(values, Mapping)
            else real_numbers("parameters", values)
        )
        if vector.shape != (part.stop - part.start,) or not all(map(math.isfinite, vector.tolist())):
            raise InputError(f"parameters: {part.stop - part.start} finite numbers are needed, got {vector}")
        with self.exclusive:
            self.ws.w[part] = vector

    def warm_start(self, x: np.ndarray, u: np.ndarray | None = None) -> None:
        """Initial trajectories: x (nx,) or (N + 1, nx); u (nu,) or (N, nu), zero when left out.

        Where the solver refines the grid (:class:`SLQ`), trajectories on the problem's own grid are taken too: states are
        linear between its nodes, inputs hold over its intervals. Raises :class:`InputError` for other shapes, and
        :class:`NotFinite` for numbers that are not finite; the trajectories then stay as they were.
        """
        with self.exclusive.between("Solver.warm_start"):
            start_from(self, x, u)

    @contextmanager
    def barrier(self, value: float) -> Iterator[None]:
        """Context manager: solves in it have a barrier parameter of at least ``value`` (compiled back end only). They are of this thread
        alone: others get :class:`SolverBusy` meanwhile. Raises :class:`InputError` for a value that is negative or not finite."""
        not_negative("barrier", value=value)
        places = [SETTINGS.index(n) for n in ("initial_barrier", "max_barrier", "barrier", "min_barrier")]
        with self.exclusive:
            numbers = self.numbers.copy()
            try:
                self.numbers[places] = np.maximum(numbers[places], value)
                yield
            finally:
                self.numbers[:] = numbers

    def reset(self) -> None:
        """Discard slacks and multipliers: the next solve initializes them (a warm start changes the trajectories alone)."""
        with self.exclusive.between("Solver.reset"):
            self._backend.reset()

    def node_times(self, t0: float) -> np.ndarray:
        """Times (N + 1) [s] of the nodes of a solve that starts at ``t0`` [s], from its start: events move them (``align_events``)."""
        from wbmpc.solver.receding import node_times

        return node_times(self.ocp.grid, self.ocp.align_events, self.data.tables(), t0)

    # ------------------------------------------------------------------ solve
    def iterate(self, x0: np.ndarray, t0: float = 0.0, delta: float = 0.0) -> tuple[int, int]:
        """What a control loop calls: shift the last solution by ``delta`` [s], sample references and modes from ``t0`` [s] on, iterate in the
        solver's memory from ``x0`` (nx), contiguous and finite, which is not checked. Returns a code for :meth:`status` and how many
        iterations it took, for :meth:`solution`. Neither retries, certifies nor compiles, as :meth:`solve` does."""
        with self.exclusive:
            self._check_terms()
            self.t0, self.x0[:] = t0, x0
            return self._backend.run(self.data.tables(), t0, delta)

    def _check_terms(self) -> None:
        """Raise :class:`InputError` if the problem's terms are no longer those that the solver was made of."""
        built, now = self._terms, self.ocp.terms.values()
        if len(built) == len(now) and all(map(is_, built, now)):
            return
        kept = set(map(id, built)) & set(map(id, now))
        changed = next((t.name for t in (*now, *built) if id(t) not in kept), built[0].name)
        raise InputError(
            f"term '{changed}': added, replaced or removed after the solver was made, which knows nothing of it; valid: a new"
            " Solver or MPC"
        )

    def simulate(self, x: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
        """State (nx) after h [s] from x (nx) under the input u (nu), with the solver's integrator and the present parameters; after k times h
        under inputs (k, nu), one after the other. Raises :class:`InputError` for other shapes or a step below 0, :class:`NotFinite`."""
        x, u, h = simulation_arguments(self.ocp.dynamics, x, u, h)
        rows, end = u if u.ndim == 2 else u[None], x
        for k in range(0, len(rows), SIMULATED):
            with self.exclusive:
                end = self._backend.simulate(end, rows[k : k + SIMULATED], h)
        return x.copy() if end is x else end

    def solve(self, x0: np.ndarray, t0: float = 0.0, *, throw: bool = False) -> Solution:
        """Solve from the current guess for the initial state ``x0`` (nx,) at time ``t0`` [s].

        With ``throw`` a solve that does not converge raises :class:`SolveFailed` with the solution's message. Raises
        :class:`SolverBusy` while another thread is in the solver, or this one, of which a signal's handler solves too.
        """
        x0 = self._start_state(x0)
        t0 = absolute_time("start of the horizon", t0)
        check_events(self, t0)
        solution = self.exclusive.once("Solver.solve", self._solve, (x0, t0))
        if throw and solution.status not in (Status.CONVERGED, Status.RELAXED):
            raise SolveFailed(str(solution))
        return solution

    def _solve(self, start: tuple[np.ndarray, float]) -> Solution:
        with Interruptible(), self.hessian:
            began = time.perf_counter()
            status, count = self._run_warm_or_cold(*start)
            solution = self.solution(status, count, time.perf_counter() - began)
            if self.settings.compute_kkt or not solution.usable or solution.status is Status.LINE_SEARCH_FAILED:
                solution = diagnose(self, solution)
        return solution

    def _run_warm_or_cold(self, x0: np.ndarray, t0: float) -> tuple[int, int]:
        """Iterate; where slacks and multipliers of the last solution were kept and that failed, once more without them."""
        warm = self.ws.state[StateField.CONVERGED] > 0.0
        start = (self.ws.x.copy(), self.ws.u.copy()) if warm else None
        status, count = self.hessian.run(x0, t0)
        if start is not None and self.status(status) is not Status.CONVERGED:
            self.ws.x[:], self.ws.u[:] = start
            self._backend.reset()
            status, count = self.hessian.run(x0, t0)
        return status, count

    def events_without_node(self, t0: float) -> int:
        """By how many the events within a horizon from ``t0`` [s] outnumber the inner nodes, where the grid follows the schedule.

        The last ones then wait until the horizon has moved on: a plan changes their modes at a later node, or misses short ones.
        Where the grid does not follow, and the state jumps at events: how many jumps are lost, as an interval applies one.
        """
        return events_without_node(self, t0)

    def _start_state(self, x0: np.ndarray) -> np.ndarray:
        """``x0`` as (nx) finite numbers."""
        nx = self.problem.nx
        x0 = np.ascontiguousarray(real_numbers("initial state", x0))
        if x0.shape != (nx,):
            raise InputError(f"initial state: {nx} numbers are needed, got shape {x0.shape}")
        if (bad := np.flatnonzero(~np.isfinite(x0))).size:
            raise InputError(f"initial state: '{self.ocp.dynamics.state.names[int(bad[0])]}' is not finite")
        return x0

    def certified_solution(self, status: int, count: int, elapsed: float) -> Solution:
        """The solution of the last :meth:`iterate`, which took ``elapsed`` [s], with violations by name and the cause of a failure."""
        with self.exclusive, Interruptible():
            return diagnose(self, self.solution(status, count, elapsed))

    @cached_property
    def checks(self) -> Checks:
        """How far every constraint is from being met: functions of the problem."""
        return Checks(self.problem)

    @cached_property
    def violation(self) -> Solver:
        """Minimizes what this problem's constraints miss: see :mod:`wbmpc.solver.infeasibility`."""
        from wbmpc.solver.infeasibility import violation_solver

        return violation_solver(self)

    @staticmethod
    def status(code: int) -> Status:
        """What a status code of :meth:`iterate` means."""
        return _STATUS[code]

    def solution(self, status: int, count: int, elapsed: float) -> Solution:
        """The solution of the last :meth:`iterate`, which took ``elapsed`` [s]."""
        row = self.log[count - 1]
        return Solution(
            status=self.status(status),
            times=self.ws.grid.copy(),
            x=self.ws.x.copy(),
            u=self.ws.u.copy(),
            gain=self.ws.k[:, :, : self.problem.nx].copy(),
            iterations=count,
            cost=float(self.ws.state[StateField.COST]),
            violation=float(self.ws.state[StateField.VIOLATION]),
            kkt=float(row[COLUMNS["kkt"]]),
            solve_time=elapsed,
            log=self.log[:count].copy(),
            detail=self.violation_message(self.status(status)),
        )

    def violation_message(self, status: Status) -> str:
        """The equality of the first input, or the hard row, that the last plan violates most; empty where none is violated.

        Equalities and states are checked in real time, rows of inputs there and where inputs are held within them (nonlinear rows).
        """
        return violation_message(self, status)
