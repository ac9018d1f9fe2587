"""The compiled part of a ball robot's controller: what it makes of a new state and of a policy by its model, in one call each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from wbmpc.arrays import Array
from wbmpc.bases.ball.compilation import MODEL
from wbmpc.bases.ball.disturbance import Clock, Disturbance, DisturbanceObserver, Gate, Setting, observe
from wbmpc.bases.ball.fall_detection import FallPredictor
from wbmpc.bases.ball.lean_control import Lean, LeanControl, lean_offsets
from wbmpc.bases.ball.model import ball_base
from wbmpc.bases.ball.payload import PayloadEstimator
from wbmpc.bases.ball.payload_step import Load, Payload, update_mass
from wbmpc.bases.ball.sent_torques import SentTorques
from wbmpc.bases.ball.torque_limits import TorqueLimits, Torques, approach, limit_torques
from wbmpc.constants import GRAVITY
from wbmpc.errors import UnsupportedOperation
from wbmpc.kernel.function import CompiledFunction
from wbmpc.kernel.ir import Floats, Integers, PointerCall
from wbmpc.kernel.step import Step, bind
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.policy import Policy
from wbmpc.solver import Solver
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


class Loads(NamedTuple):
    """What acts on a robot besides its model: a disturbance, and a payload."""

    disturbance: Disturbance
    gate: Gate
    payload: Payload
    weighs: bool  # whether there is a payload


class Leans(NamedTuple):
    """How far a robot leans under these, with its divergent component."""

    offsets: Lean
    falls: Component
    has_lean: bool  # whether there is a lean


@MODEL.step
def learn(
    model: Model, loads: Loads, lean: Leans, by: Inertia, at: Parameters, nu: int, rows: Floats, row: int, started: bool,
    t: float, h: float, forwards: bool,
) -> tuple[float, bool]:  # fmt: skip
    """``loads`` and ``lean`` after a state at t [s], h [s] after the one before (``started``: there was one), under the torques (nu) in a
    ``row``; ``forwards``: the solver gets them as its model's parameters, and zero for all others. Returns how much of a constant
    disturbance that can have learned, and whether all is finite: the solver gets nothing else."""
    n, force, load, leans = loads.disturbance.size, loads.disturbance.force, loads.payload.load, lean.offsets.leans
    given, found = lean.falls.given, lean.falls.found
    for i in range(nu):
        model.acted[i] = rows[row * nu + i]
    if not started:
        loads.gate.clock[Clock.NEW_UNTIL] = t + loads.gate.settings[Setting.LONGEST]
    for i in range(n):
        loads.disturbance.velocity[i] = model.state[n + i]
        if not started:
            loads.gate.speed[i] = model.state[n + i]
        model.trial[i], model.trial[n + i] = model.state[i], loads.gate.speed[i]
    simulate(model.memory, model.table, model.trial, model.acted, 1, h)
    by.places[0], by.places[1] = model.state.ctypes.data, by.inertial.ctypes.data
    call2(by.inertia, by.places.ctypes.data, by.places.ctypes.data + 8)
    for i in range(n):
        loads.disturbance.after[i] = model.trial[n + i]
    for i in range(n * n):
        loads.disturbance.mass[i] = by.inertial[i]
    learning = observe(loads.disturbance, loads.gate, t, h)
    if loads.weighs:
        for i in range(n):
            loads.payload.weight[i] = by.inertial[n * n + i]
        update_mass(loads.disturbance, loads.payload, learning, h)
    if lean.has_lean:
        lean_offsets(lean.offsets, force, model.state[2])
        if lean.falls.component != 0:
            for i in range(2 * n):
                given[i] = model.state[i]
            given[2 * n], given[2 * n + 1], given[2 * n + 2] = load[Load.MASS], 0.0, 0.0
            by.places[0], by.places[1] = given.ctypes.data, found.ctypes.data
            call2(lean.falls.component, by.places.ctypes.data, by.places.ctypes.data + 8)
            leans[4], leans[5] = found[0] + leans[0], found[1] + leans[1]
    finite = np.isfinite(load[Load.MASS])
    for i in range(n):
        finite = finite and np.isfinite(force[i])
    if not (finite and forwards):
        return learning, finite
    for i in range(at.first, at.end):
        model.memory[i] = 0.0
    for i in range(n):
        model.memory[at.disturbance + i] = force[i]
    if at.payload >= 0:
        model.memory[at.payload] = load[Load.MASS]
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
    plan: Plan, drives: Torques, x: Floats, feedforward: Floats, rows: Floats, row: int, blend: float, t: float,
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
    plan: Plan, drives: Torques, model: Model, feedforward: Floats, rows: Floats, blend: float, t: float, h: float,
) -> bool:  # fmt: skip
    """:func:`follow` in the first two ``rows``, and what the model makes of the state ``trial`` in h [s]."""
    if not follow(plan, drives, model.trial, feedforward, rows, 1, blend, t):
        return False
    for i in range(drives.size):
        rows[i] = rows[drives.size + i]
        model.acted[i] = rows[i]
    simulate(model.memory, model.table, model.trial, model.acted, 1, h)
    return True


class Learning(NamedTuple):
    """What learns with a new state; None for what there is not."""

    observer: DisturbanceObserver | None = None
    payload: PayloadEstimator | None = None
    lean: LeanControl | None = None
    fall_predictor: FallPredictor | None = None


class ModelSteps:
    """The model of a ``robot`` as a ``solver`` integrates it, for controllers whose model is that alone: under torques within ``limits``, which
    drives follow as ``sent`` has it every ``period`` [s].

    Its arrays are the solver's and those of the parts of ``learning``: it changes them as these do by themselves. Nothing is found where
    something is not finite, or has other sizes: who asks part by part gets the error.
    """

    def __init__(
        self, robot: RobotModel, solver: Solver, limits: TorqueLimits, sent: SentTorques, period: float, learning: Learning,
    ) -> None:  # fmt: skip
        self._solver, self._sent, self._period, self._observer = solver, sent, period, learning.observer
        n, nx, nu = solver.ocp.intervals, solver.problem.nx, solver.problem.nu
        self._plan = np.zeros(n + 1), np.zeros((n + 1, nx)), np.zeros((n, nu)), np.zeros((n, nu, nx))
        self._policy: Policy | None = None  # whose plan that is
        a = dict(zip(("times", "states", "inputs", "gains"), (each.reshape(-1) for each in self._plan), strict=True))
        a |= {name: np.zeros(size) for name, size in {"state": nx, "acted": nu, "trial": nx, "feedforward": nu}.items()}
        a |= solver.integrator | limits.arrays | {name: np.zeros(1) for name in ("limits", "active", "moving")}
        a["rows"] = sent.rows.reshape(-1)
        self._arrays, self._next, sizes = a, np.zeros(2 * nu), {"nx": nx, "nu": nu}
        law = {**sizes, "r": 0, "moves": 0, "blend": sent.blend, **limits.constants}
        self._through = bind(through, a, **sizes)
        self._act = bind(act, a, **law)
        self._foresee = bind(foresee, a | {"rows": self._next}, **law)
        if learning.observer is not None:
            self._learn = self._bind_learning(robot, learning.observer, *learning[1:])

    def _bind_learning(
        self, robot: RobotModel, observer: DisturbanceObserver, payload: PayloadEstimator | None, lean: LeanControl | None,
        fall_predictor: FallPredictor | None,
    ) -> Step:  # fmt: skip
        n = observer.size
        names = ("weight", "model", "believed", "apart", "load", "spreads", "shift", "whole", "heading", "leans")
        a: dict[str, NDArray[Any]] = {name: np.zeros(max(n, 6)) for name in names} | observer.arrays
        a |= {"inertial": np.zeros(n * n + n), "given": np.zeros(2 * n + 3), "found": np.zeros(2)}
        a["places"] = np.zeros(2, np.int64)
        if payload is not None:
            a |= payload.bound(observer.arrays)
        if lean is not None:
            a |= lean.arrays
        self._leans = a["leans"][: 4 if fall_predictor is None else 6]
        self._inertia = _inertia(robot)
        constants = {
            "nu": self._next.size // 2,
            "size": n,
            "gates": observer.gate.size,
            "inertia": self._inertia.address,
        }
        constants |= {"weighs": payload is not None, "has_lean": lean is not None}
        constants["component"] = 0 if fall_predictor is None else fall_predictor.component.address
        places = _places(self._solver)
        self._push, self._lean = places.pop("push"), lean
        return bind(learn, self._arrays | a, **constants, **places)

    @classmethod
    def of(
        cls,
        robot: RobotModel,
        solver: object,
        limits: TorqueLimits,
        sent: SentTorques,
        period: float,
        learning: Learning,
    ) -> ModelSteps | None:
        """None where the solver is interpreted, has other states and inputs than the robot, or the model cannot be compiled."""
        if not isinstance(solver, Solver) or solver.settings.backend == "interpreted":
            return None
        size = 2 * ball_base(robot).nq
        if (solver.problem.nx, robot.state.size, solver.problem.nu) != (size, size, limits.limit.size):
            return None
        try:
            return cls(robot, solver, limits, sent, period, learning)
        except UnsupportedOperation:
            return None

    def learn(
        self, t: float, x: Array, row: int, h: float, forwards: bool = False, pushed: Sequence[float] = (0.0, 0.0)
    ) -> tuple[list[float], bool]:
        """As :meth:`DisturbanceObserver.update` under the torques in a ``row`` of those that were sent, :meth:`PayloadEstimator.observe`
        after it, and :meth:`LeanControl.leans`, which it returns; with a fall_predictor, the divergent component (2) [m] that counts after it.
        And whether the solver has got all of it as its model's parameters, with the room (2) [m] for what has ``pushed`` the robot: it
        does if this ``forwards`` it, and all is finite."""
        observer, m = self._observer, self._arrays["memory"]
        assert observer is not None
        self._arrays["state"][:] = x
        with self._solver.exclusive:
            observer.learning, finite = self._learn(row, observer.started, t, h, forwards)
            leans, forwarded = self._leans.tolist(), finite and forwards
            if forwarded and self._push >= 0:
                right, left = (0.0, 0.0) if self._lean is None else self._lean.center(leans, float(x[2]))
                m[self._push], m[self._push + 1] = pushed[0] + right, pushed[1] + left
        observer.started = True
        return leans, forwarded

    def _take(self, policy: Policy) -> bool:
        """Whether the plan of a ``policy`` is one that fits: it is here then."""
        n, (times, states, inputs, gains) = len(policy.u), self._plan
        own, given = (
            (times[: n + 1], states[: n + 1], inputs[:n], gains[:n]),
            (policy.times, policy.x, policy.u, policy.gain),
        )
        for mine, its in zip(own, given, strict=True):
            if mine.shape != its.shape or not n:
                return False
        for mine, its in zip(own, given, strict=True):
            mine[:] = its
        self._policy = policy
        return True

    def through(self, x: Array, rows: slice) -> Array | None:
        """The state (nx) after ``x`` under these rows of the torques that were sent, each for a period."""
        a = self._arrays
        if x.shape != a["state"].shape:
            return None
        a["state"][:] = x
        with self._solver.exclusive:
            known = self._through(rows.start, rows.stop - rows.start, self._period)
        return a["trial"].copy() if known else None

    def act(self, policy: Policy, t: float, x: Array, late: int) -> tuple[Array, Array, Array] | None:
        """Torques (nu) [N m] of a ``policy`` at time t [s], when they act, for a state x (nx) that is so many ticks ``late``, without and
        with feedback, and within limits, which go to the drives."""
        a, sent = self._arrays, self._sent
        if (policy is not self._policy and not self._take(policy)) or x.shape != a["state"].shape:
            return None
        a["state"][:] = x
        row, count = sent.begin(), late + sent.dead
        with self._solver.exclusive:
            known = self._act(len(policy.u), row - count, count, row, t, self._period)
        if not known:
            return None
        sent.end()
        return a["feedforward"].copy(), a["torque"].copy(), a["out"].copy()

    def foresee(self, policy: Policy, t: float, x: Array, torque: Array) -> tuple[Array, Array] | None:
        """State (nx) and torques (nu) of the drives a period after these under a ``policy`` at time t [s]."""
        trial, nu = self._arrays["trial"], torque.size
        if policy is not self._policy and not self._take(policy):
            return None
        trial[:], self._next[:nu] = x, torque
        with self._solver.exclusive:
            known = self._foresee(len(policy.u), t, self._period)
        return (trial.copy(), self._next[:nu].copy()) if known else None


def _places(solver: Solver) -> dict[str, int]:
    """:class:`~wbmpc.bases.ball.model_steps.Parameters` of a ``solver``, and where its ``push`` is."""
    groups, part = solver.ocp.dynamics.parameters, solver.problem.constant.slices["parameters"]
    first = (solver.constants.ctypes.data - solver.integrator["memory"].ctypes.data) // 8 + part.start
    learned = ("disturbance", "push", "payload")
    at = {name: first + groups[name].start if name in groups else -1 for name in learned}
    return {"first": first, "end": first + groups.size, **at}


def _inertia(robot: RobotModel) -> CompiledFunction:
    """Mass matrix (n n) by rows and weight (n) of 1 kg at the tool, of the coordinates (n)."""
    base = ball_base(robot)
    q = ca.SX.sym("q", base.nq)
    mass, weight = base.mass_matrix(q), base.tool_force(q, ca.SX([0, 0, -GRAVITY]))
    return CompiledFunction(ca.Function("inertia", [q], [ca.densify(ca.vertcat(ca.vec(mass.T), weight))]))
