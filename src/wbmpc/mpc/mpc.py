"""Receding-horizon control: shift, sample the references, iterate, hand out a policy."""

from __future__ import annotations

import logging
import time
from bisect import bisect_right

import numpy as np

from wbmpc.checks import LATEST, absolute_time, real_number, real_numbers, whole_number
from wbmpc.clearance.rows import Clearance
from wbmpc.errors import InputError, NotFinite, RunAborted
from wbmpc.interrupts import Interruptible
from wbmpc.logs import RateLimit
from wbmpc.mpc.checks import PlanCheck, check_events_fit, check_limits, check_settings, check_vector
from wbmpc.mpc.clearance import ClearanceRows
from wbmpc.mpc.display import Described
from wbmpc.mpc.guess import Bound, Guess, check_found, check_guess
from wbmpc.mpc.input_rows import InputRows
from wbmpc.mpc.path import PathProgress
from wbmpc.mpc.policy import Policy
from wbmpc.mpc.references import References
from wbmpc.mpc.statistics import Statistics
from wbmpc.obstacles.world import Obstacles
from wbmpc.ocp import ModeSchedule, OptimalControlProblem, Reference
from wbmpc.ocp.problem import SystemDynamics
from wbmpc.ocp.symbols import FollowsLastInput
from wbmpc.solver import SQP, Solver, Status
from wbmpc.solver.simulation_arguments import simulation_arguments
from wbmpc.solver.solution import COLUMNS
from wbmpc.solver.warm_start import restart_from, start_from, take_as_result
from wbmpc.types import Observation

_LOG = logging.getLogger("wbmpc")
#: A status code of the solver for a plan that is used.
_USABLE = 1


class MPC(Described):
    """Receding-horizon control: solves one problem repeatedly, starting from the shifted last solution. A first solve that diverges from what
    :meth:`reset` or the guess gave is repeated from the state held.

    ``ocp``: the problem. ``solver``: real-time settings, :meth:`SQP.real_time` (also of ILQR and SLQ); default: one iteration. ``rate``
    [Hz] of updates. ``first_iterations``: number of solver calls for the first plan, each with the iterations of ``solver``.
    ``guess``: see :class:`Guess`. ``plan_only_limits``: hard rows of the inputs alone that are not linear (|u|² ≤ r², a box around a
    nonlinear function of a reference) are allowed although only plans satisfy them: the feedback of a policy may violate them, and the user
    has to limit it. ``obstacles`` for the problem's :class:`wbmpc.residuals.Clearance`; they may change between any two updates. After a
    failed solve the last policy stays, and the next solve starts as :meth:`recover` describes. A plan that would come much too close to an
    obstacle within the stopping time is replaced by one that stops (docs/how-to/obstacles.md).

    To read: ``reference`` by the name of its term (to set, too); ``path``: progress along a path; ``limits``: bounds and straight hard
    rows of the inputs, which all policies hold; ``statistics`` of all solves; ``fault``: why the last update produced no plan, or ``""``;
    ``events_without_node``: number of events within the last horizon without a node of their own; ``extended``: whether the last update
    took more than twice the iterations asked for, see :class:`wbmpc.mpc.statistics.Statistics`.
    """

    def __init__(
        self, ocp: OptimalControlProblem, solver: SQP | None = None, rate: float = 50.0, *, first_iterations: int = 30,
        guess: Guess | None = None, plan_only_limits: bool = False, obstacles: Obstacles | None = None,
    ) -> None:  # fmt: skip
        if real_number("mpc.rate", rate) <= 0.0:
            raise InputError(f"mpc.rate: must be positive, got {rate}")
        self.first_iterations = whole_number("mpc.first_iterations", first_iterations, 1)
        settings = SQP.real_time() if solver is None else solver
        check_settings(ocp, settings)
        self.ocp, self.rate = ocp, float(rate)
        with Interruptible():
            self.solver = Solver(ocp, settings)
            self._clear = ClearanceRows(ocp, self.solver, obstacles)
            terms = {t.name: t.residual for t in ocp.terms.values()}
            self._follow_last = {n: r.last_inputs for n, r in terms.items() if isinstance(r, FollowsLastInput)}
            if not plan_only_limits:
                check_limits(self.solver, self._follow_last)
            self._input_rows = InputRows(self.solver)
            #: what is followed, where the problem has progress along a path: see :class:`wbmpc.mpc.path.PathProgress`
            self.path = PathProgress(ocp, self.solver, self._input_rows.limits)
        self.reference = References(self.solver)
        self.statistics = Statistics()
        #: bounds and straight hard rows of the inputs, which all policies hold
        self.limits = self.path.limits
        self.guess = guess
        self._policy: Policy | None = None
        self._t: float | None = None
        self._outcome = (0, 0, 0.0)
        self._iterations = 0  # of all calls of the solver for the last plan
        #: why the last pass gave no plan; empty when it did
        self.fault = ""
        #: events within the last pass's horizon that got no node of their own: see :meth:`Solver.events_without_node`
        self.events_without_node = 0
        #: whether the last pass took more than twice the iterations asked for
        self.extended = False
        self._reported = False
        self._lines = RateLimit()
        self._plan_check = PlanCheck(self.solver, self._lines)

    @property
    def guess(self) -> Guess | None:
        """Initial guess of solves: see :class:`Guess`; None: the last plan."""
        return self._guess

    @guess.setter
    def guess(self, guess: Guess | None) -> None:
        check_guess(guess)
        self._guess = guess
        if isinstance(guess, Bound):
            guess.bind(self)

    @property
    def obstacles(self) -> Obstacles | None:
        """The obstacles that plans avoid; None: there are none."""
        return self._clear.obstacles

    @property
    def dynamics(self) -> SystemDynamics:
        """The model whose states are observed and whose inputs policies have: the problem's, without a path (:class:`wbmpc.WithPath`)."""
        return self.path.dynamics  # type: ignore[no-any-return]

    def simulate(self, x: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
        """State (nx) of ``dynamics`` after h [s] from x (nx) under its input u (nu), or after k times h under inputs (k, nu): see
        :meth:`Solver.simulate`."""
        if not self.path.active:
            return self.solver.simulate(x, u, h)
        x, u, h = simulation_arguments(self.path.dynamics, x, u, h)
        return self.solver.simulate(self.path.wide(x), self.path.wide_input(u), h)[: np.size(x)]

    @property
    def period(self) -> float:
        """Time between two updates [s]."""
        return 1.0 / self.rate

    def set_schedule(self, schedule: ModeSchedule) -> None:
        """Set the modes over absolute time. Raises :class:`InputError`, and keeps the previous schedule, if the grid follows events
        (``align_events``) and any
        horizon to come has more of them than inner nodes; or if it does not, the state jumps at events, and two to come are
        closer together than the longest interval: plans would apply one jump for both.
        """
        check_events_fit(self.solver, schedule, -np.inf if self._t is None else self._t)
        self.solver.set_schedule(schedule)

    def reset(self, x: np.ndarray, u: np.ndarray | None = None) -> None:
        """Forget the last plan; start from ``x`` (nx) and ``u`` (nu) held, or from trajectories (N + 1, nx), (N, nu).

        Raises :class:`InputError` naming the entry that is not finite, and :class:`SolverBusy` in the middle of an update, as of a
        signal's handler.
        """
        d = self.path.dynamics
        for names, value in ((d.state.names, x), (d.input.names, u)):
            if value is not None or names is d.state.names:
                for row in np.atleast_2d(real_numbers("reset", value)):
                    check_vector("reset", names, row)
        with self.solver.exclusive.between("MPC.reset"):
            restart_from(self.solver, self.path.wide(x), None if u is None else self.path.wide_input(u))
            self._t, self._policy = None, None

    def update(self, observation: Observation) -> Policy:
        """A new policy from the observation. Raises :class:`RunAborted` if there has never been a usable one, and
        :class:`SolverBusy` while another thread is in this MPC, a guess of its own or a signal's handler."""
        return self.solver.exclusive.once("MPC.update", self._update, observation)

    def _update(self, observation: Observation) -> Policy:
        started = self._t is not None
        usable = self._advance(observation)
        self.statistics.solves += 1
        self.statistics.extended += int(self.extended)
        if started:
            self.statistics.solve_times.append(self.solve_time)
        if not usable:
            return self._fall_back(observation)
        solution = self.solver.solution(*self._outcome)
        stuck = solution.log[-1, COLUMNS["alpha"]] == 0.0 and solution.status is not Status.CONVERGED
        self.statistics.no_step += int(stuck)
        if self.limit_violation:
            self.statistics.count_limit_violation(self.limit_violation, f"{solution.detail}, at {observation.t:.3f} s")
        mismatch = self.solver.initial_state_mismatch
        if mismatch:
            self.statistics.count_initial_state_mismatch(mismatch)
        limits = self._input_rows.limits
        self._policy = Policy.of(
            solution, observation.t, limits, self.limit_violation, *self.input_rows(), self.clearance
        )
        return self.path.own_policy(self._policy)

    def input_rows(self) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Of the rows of ``limits`` in each interval of the last plan: which count, (N, r), 1 or 0, None without rows; and their
        offsets at its beginning and end, (N, 2, r), None where they do not move."""
        return self._input_rows.of_plan(self._t or 0.0)

    @property
    def limit_violation(self) -> float:
        """How far the states of the last plan are outside hard limits: see :attr:`Solver.limit_violation`."""
        return self.solver.limit_violation

    def limit_violation_message(self) -> str:
        """A message that names the row, node and amount of that, and says whether the row's slack gives way."""
        return self.solver.violation_message(self.solver.status(self._outcome[0]))

    @property
    def plan_start(self) -> float | None:
        """When [s] the last plan begins; None: there is none yet."""
        return self._t

    @property
    def solve_time(self) -> float:
        """Duration [s] of the last pass of the solver."""
        return self._outcome[2]

    @property
    def clearance(self) -> Clearance:
        """The pair with the largest margin violation in the last plan, where the problem has clearance constraints."""
        return self._clear.last

    def evades(self, times: np.ndarray, states: np.ndarray) -> bool:
        """Whether states (n, nx of the problem) at ``times`` (n) [s] avoid the moving obstacles, as known at the last update."""
        return self._clear.evades(times, states)

    @property
    def solve_info(self) -> dict[str, float]:
        """Of the last plan: iterations in all, whether these are more than twice those asked for, cost, constraint violation,
        optimality, solve time [s]; where the grid follows events or the state jumps at them, how many found no node."""
        count = self._outcome[1]
        row = self.solver.log[max(count, 1) - 1]
        found = {name: float(row[COLUMNS[name]]) for name in ("cost", "violation", "kkt")}
        if self.ocp.align_events or self.solver.problem.jumps:
            found["events_without_node"] = float(self.events_without_node)
        if self._clear.active and np.isfinite(self.clearance.distance):
            found["clearance"] = self.clearance.distance
        own = {"iterations": float(self._iterations), "extended": float(self.extended)}
        return {"solve_time": self.solve_time, **own, **found}

    def advance(self, observation: Observation) -> bool:
        """Solve in the solver's memory, without copying the result. Returns whether it is a valid plan from ``observation.t`` on; if not,
        ``fault`` holds the reason, and :meth:`recover` goes back to the last good plan.
        """
        return self.solver.exclusive.once("MPC.update", self._advance, observation)

    def _advance(self, observation: Observation) -> bool:
        self._check(observation)
        delta = 0.0 if self._t is None else observation.t - self._t
        x0 = np.ascontiguousarray(self.path.wide(observation.x, delta), float)
        passes = self.first_iterations if self._t is None else 1
        self._iterations, start = 0, (observation.t, x0, delta, passes)
        self._pass(*start)
        if self._t is None and self._plan_check.broken(self._outcome[0]):
            restart_from(self.solver, x0)
            guess, self._guess = self._guess, None  # it, or what reset gave, leads beyond all bounds
            try:
                self._pass(*start)
            finally:
                self._guess = guess
        self.extended = self._t is not None and self._iterations > 2 * self.solver.settings.iterations
        self._t = observation.t
        self._count_events(observation.t)
        self.fault = self._plan_check.fault(observation.t, self._outcome[0])
        return not self.fault

    def _pass(self, t: float, x0: np.ndarray, delta: float, passes: int) -> None:
        """``passes`` calls of the solver; a plan that stops is the result where no other is clear of obstacles."""
        if self._follow_last:
            self._continue_from(t, delta)
        if self._clear.active:
            self._solve_clear(t, x0, delta, passes)
        else:
            self._solve(t, x0, delta, passes)

    def _solve(self, t: float, x0: np.ndarray, delta: float, passes: int) -> None:
        """``passes`` calls of the solver, the first one from the last plan, ``delta`` [s] old, or what the guess makes of it."""
        status, count, elapsed = 0, 0, 0.0
        for k in range(passes):
            start = time.perf_counter()
            if k == 0:
                self._apply_guess(t, x0, t - delta)
            if self.path.active:
                self.path.refresh(t, delta if k == 0 else 0.0)
            if self._clear.active:
                self._clear.refresh(t, delta if k == 0 else 0.0)
            status, count = self.solver.iterate(x0, t, delta if k == 0 else 0.0)
            self._iterations += count
            elapsed = time.perf_counter() - start
            self.path.begun()
        self._outcome = (status, count, elapsed)

    def _solve_clear(self, t: float, x0: np.ndarray, delta: float, passes: int) -> None:
        """Solve with clearance rows; a plan that stops is the result where no other is clear."""
        run = lambda old, n: self._solve(t, x0, old, n)
        unusable = lambda: bool(self._plan_check.reason(self._outcome[0]))
        cause = self._clear.solve(t, x0, None if self._t is None else delta, passes, run, unusable)
        if cause is not None:
            self._outcome = (_USABLE, *self._outcome[1:])
            self.statistics.braking_plans += 1
            self._lines.log(_LOG, logging.WARNING, "clearance", f"MPC at {t:.3f} s: the robot brakes: {cause}")
        elif self._clear.search_is_due(t):
            plan, outcome = self.solver.trajectory(), self._outcome
            if not self._clear.search(t, x0, plan, run, unusable):
                take_as_result(self.solver, plan.x, plan.u)
                self._outcome = outcome
            self._clear.measure(t)

    def _apply_guess(self, t: float, x0: np.ndarray, start: float) -> None:
        """``start`` [s]: of the last plan."""
        if self._guess is None:
            return
        with self.solver.exclusive.lent():
            found = self._guess(t, x0.copy(), self.solver.trajectory(start))
        if found is None:
            return
        check_found(found)
        try:
            start_from(self.solver, found.x, found.u)
        except NotFinite as error:  # the last plan is the better start
            self._lines.log(_LOG, logging.WARNING, "guess", f"MPC at {t:.3f} s: the initial guess is not used: {error}")

    def _count_events(self, t: float) -> None:
        """A robot in motion is not stopped for events that find no node, but it is said, once, and shown in ``solve_info``."""
        self.events_without_node = self.solver.events_without_node(t)
        if self.events_without_node and not self._reported:
            self._reported = True
            consequence = "events more than inner nodes: plans see the last modes late or not at all"
            if not self.ocp.align_events:
                consequence = (
                    "jumps lost, of events within one interval: the grid has to follow them (align_events=True)"
                )
            _LOG.warning("mode schedule: from %.3f s on, %d %s", t, self.events_without_node, consequence)

    def _continue_from(self, t: float, delta: float) -> None:
        """The input that is active until ``t`` [s], ``delta`` after the last plan's start, is what the next plan starts from. (That which the
        last plan has from ``t`` on is one change ahead already: with it every update would change the command twice as fast.)"""
        plan, horizon = self.solver.trajectory(copy=False), self.ocp.horizon
        k = max(bisect_right(plan.grid, delta - 1e-9) - 1, 0)  # type: ignore[type-var]
        current = plan.u[min(k, len(plan.u) - 1)]
        since = max(delta, self.period)
        for name, inputs in self._follow_last.items():
            last = current[inputs]
            values = np.empty((2, last.size + 1))
            values[:, :-1], values[0, -1], values[1, -1] = last, since, since + horizon
            make = Reference.unchecked if np.isfinite(values).all() else Reference  # which raises
            self.solver.set_reference(name, make(np.array([t, t + horizon]), values))

    def resume(self, x: np.ndarray, u: np.ndarray, t: float) -> None:
        """Go on from a plan x (N + 1, nx), u (N, nu) whose horizon starts at ``t`` [s]: the next update shifts it."""
        with self.solver.exclusive.between("MPC.resume"):
            self._resume(x, u, t)

    def _resume(self, x: np.ndarray, u: np.ndarray, t: float) -> None:
        restart_from(self.solver, x, u)
        self._t = t

    def recover(self, observation: Observation, x: np.ndarray, u: np.ndarray, t: float) -> None:
        """After a pass without a plan: the next one starts from the last good plan, x (N + 1, nx), u (N, nu) from ``t`` [s] on.

        An iterate that only violates an equality, as after a change of mode, is kept, because it needs more iterations. From the fourth
        consecutive pass without a plan on, one that violates a hard limit is kept too; it is not used as a plan until it satisfies the
        limit.
        A plan from which two passes in a row ended with numbers that are not finite is discarded: the next one starts from
        the observation.
        """
        with self.solver.exclusive.between("MPC.recover"):
            self._recover(observation, x, u, t)

    def _recover(self, observation: Observation, x: np.ndarray, u: np.ndarray, t: float) -> None:
        from wbmpc.solver.controller import RESTART, RESUME

        after = self._plan_check.recovery(self._outcome[0])
        if after == RESTART:
            self._restart(observation)
        elif after == RESUME:
            self._resume(x, u, t)

    def _restart(self, observation: Observation) -> None:
        """The next plan starts from the observation alone."""
        restart_from(self.solver, self.path.wide(observation.x))
        self._t = None

    def _check(self, observation: Observation) -> None:
        if not abs(observation.t) <= LATEST:
            absolute_time("observation", observation.t)
        check_vector("observation", self.path.dynamics.state.names, observation.x)
        if self._t is not None and observation.t < self._t:
            raise InputError(f"observation: time went back from {self._t:.4f} to {observation.t:.4f} s")

    def _fall_back(self, observation: Observation) -> Policy:
        """Keep the last policy, valid for its horizon."""
        self.statistics.failures += 1
        last = self._policy
        if last is None:
            found = self.solver.certified_solution(*self._outcome)
            if self._plan_check.broken(self._outcome[0]):
                self._restart(observation)
            detail = f" ({found.detail})" if found.detail else ""
            raise RunAborted(f"the first solve {found.status.value if found.detail else self.fault}{detail}")
        self._recover(observation, last.x, last.u, float(last.times[0]))
        return self.path.own_policy(last)
