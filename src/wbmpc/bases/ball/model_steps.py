"""The compiled part of a ball robot's controller that asks the model, in one call for each new state."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.ball.compilation import MODEL
from wbmpc.bases.ball.disturbance import Clock, Disturbance, DisturbanceObserver, Gate, Setting, observe
from wbmpc.bases.ball.model import ball_base
from wbmpc.bases.ball.payload import PayloadEstimator
from wbmpc.bases.ball.payload_step import Payload, update_mass
from wbmpc.constants import GRAVITY
from wbmpc.errors import UnsupportedOperation
from wbmpc.kernel.function import CompiledFunction
from wbmpc.kernel.ir import Floats, Integers, PointerCall
from wbmpc.kernel.step import Backend, bind
from wbmpc.model.robot import RobotModel
from wbmpc.solver import Solver
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


@MODEL.step
def learn(
    model: Model, d: Disturbance, g: Gate, by: Inertia, p: Payload, weighs: bool, started: bool, t: float, h: float
) -> float:
    """Disturbance and payload (``weighs``: there is one) after a state at t [s], h [s] after the one before (``started``: there was one);
    returns how much of a constant disturbance that can have learned."""
    n = d.size
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
    return learning


class ModelSteps:
    """The model of a ``robot`` as a ``solver`` integrates it, for controllers whose model is that alone. ``backend``: machine code, or the
    same source as ordinary Python.

    Its arrays are the solver's, the observer's and the payload's own: it changes them as these do by themselves.
    """

    def __init__(
        self, robot: RobotModel, solver: Solver, observer: DisturbanceObserver | None, payload: PayloadEstimator | None,
        backend: Backend = "compiled",
    ) -> None:  # fmt: skip
        nx, nu = solver.problem.nx, solver.problem.nu
        joints = robot.state["arm_velocity"]
        m = joints.stop - joints.start
        self._solver, self._observer = solver, observer
        self._state, self._acted, self.acceleration = np.zeros(nx), np.zeros(nu), np.zeros(m)
        own = {
            "state": self._state, "acted": self._acted, "trial": np.zeros(nx), "acceleration": self.acceleration,
        } | solver.integrator  # fmt: skip
        self._accelerate = bind(accelerate, own, backend, nx=nx, at=joints.start, m=m)
        if observer is not None:
            n = ball_base(robot).nq
            weighing = {name: np.zeros(n) for name in ("weight", "model", "believed", "apart")}
            weighing |= {"load": np.zeros(1), "rule": np.zeros(1)}
            if payload is not None:
                weighing |= payload.bound(observer.arrays)
            inertial = {"inertial": np.zeros(n * n + n), "places": np.zeros(2, np.int64)}
            self._inertia = _inertia(robot)
            constants = {
                "size": n, "gates": observer.gate.size, "inertia": self._inertia.address, "weighs": payload is not None,
            }  # fmt: skip
            self._learn = bind(learn, own | observer.arrays | weighing | inertial, backend, **constants)

    @classmethod
    def of(
        cls, robot: RobotModel, solver: Solver, observer: DisturbanceObserver | None, payload: PayloadEstimator | None
    ) -> ModelSteps | None:
        """None where the solver is interpreted, has other states and inputs than the robot, or the model cannot be compiled."""
        if not isinstance(solver, Solver) or solver.settings.backend == "interpreted":
            return None
        if solver.problem.nx != robot.state.size or robot.state.size != 2 * ball_base(robot).nq:
            return None
        try:
            return cls(robot, solver, observer, payload)
        except UnsupportedOperation:
            return None

    def accelerations(self, x: Array, u: Array, h: float) -> Array:
        """Of the arm (m) [rad/s²] in the state x (nx) under the torques u (nu), mean over h [s]; a view that the next call changes."""
        self._state[:], self._acted[:] = x, u
        with self._solver.exclusive:
            self._accelerate(h)
        return self.acceleration

    def learn(self, t: float, x: Array, u: Array, h: float) -> None:
        """As :meth:`DisturbanceObserver.update` and :meth:`PayloadEstimator.observe` after it."""
        observer = self._observer
        assert observer is not None
        self._state[:], self._acted[:] = x, u
        with self._solver.exclusive:
            observer.learning = self._learn(observer.started, t, h)
        observer.started = True


def _inertia(robot: RobotModel) -> CompiledFunction:
    """Mass matrix (n n) by rows and weight (n) of 1 kg at the tool, of the coordinates (n)."""
    base = ball_base(robot)
    q = ca.SX.sym("q", base.nq)
    mass, weight = base.mass_matrix(q), base.tool_force(q, ca.SX([0, 0, -GRAVITY]))
    return CompiledFunction(ca.Function("inertia", [q], [ca.densify(ca.vertcat(ca.vec(mass.T), weight))]))
