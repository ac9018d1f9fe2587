"""The compiled part of a ball robot's controller that asks the model, in one call for each new state."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.bases.ball.disturbance import DisturbanceObserver
from wbmpc.bases.ball.fall_detection import FallPredictor
from wbmpc.bases.ball.lean_control import LeanControl
from wbmpc.bases.ball.model import ball_base
from wbmpc.bases.ball.model_step import Parameters, accelerate, learn
from wbmpc.bases.ball.payload import PayloadEstimator
from wbmpc.constants import GRAVITY
from wbmpc.errors import UnsupportedOperation
from wbmpc.kernel.function import CompiledFunction
from wbmpc.kernel.step import Backend, bind
from wbmpc.model.robot import RobotModel
from wbmpc.solver import Solver

Array = NDArray[np.float64]


class ModelSteps:
    """The model of a ``robot`` as a ``solver`` integrates it, for controllers whose model is that alone. ``backend``: machine code, or the
    same source as ordinary Python.

    Its arrays are the solver's, the observer's and the payload's own: it changes them as these do by themselves.
    """

    def __init__(
        self, robot: RobotModel, solver: Solver, observer: DisturbanceObserver | None, payload: PayloadEstimator | None,
        lean: LeanControl | None = None, forecast: FallPredictor | None = None, backend: Backend = "compiled",
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
            leaning = {name: np.zeros(8) for name in ("shift", "whole", "heading", "leans")} if lean is None else lean.arrays
            self._leans = leaning["leans"][: 6 if forecast is None else 8]
            leaning |= {"given": np.zeros(nx + 3), "found": np.zeros(2)}
            inertial = {"inertial": np.zeros(n * n + n), "places": np.zeros(2, np.int64)}
            self._inertia = _inertia(robot)
            constants = {
                "size": n,
                "gates": observer.gate.size,
                "inertia": self._inertia.address,
                "weighs": payload is not None,
                "leaning": lean is not None,
                "component": 0 if forecast is None else forecast.component.address,
                **({"spare": 0.0} if lean is None else lean.constants),
                **_places(solver),
            }
            self._learn = bind(learn, own | observer.arrays | weighing | leaning | inertial, backend, **constants)

    @classmethod
    def of(
        cls, robot: RobotModel, solver: Solver, observer: DisturbanceObserver | None, payload: PayloadEstimator | None,
        lean: LeanControl | None, forecast: FallPredictor | None,
    ) -> ModelSteps | None:  # fmt: skip
        """None where the solver is interpreted, has other states and inputs than the robot, or the model cannot be compiled."""
        if not is_compiled_model(robot, solver):
            return None
        try:
            return cls(robot, solver, observer, payload, lean, forecast)
        except UnsupportedOperation:
            return None

    def accelerations(self, x: Array, u: Array, h: float) -> Array:
        """Of the arm (m) [rad/s²] in the state x (nx) under the torques u (nu), mean over h [s]; a view that the next call changes."""
        self._state[:], self._acted[:] = x, u
        with self._solver.exclusive:
            self._accelerate(h)
        return self.acceleration

    def learn(self, t: float, x: Array, u: Array, h: float, tells: bool = False, more: ArrayLike = (0.0, 0.0)) -> list[float] | None:
        """As :meth:`DisturbanceObserver.update`, :meth:`PayloadEstimator.observe` after it, and :meth:`LeanControl.leans`, which it returns
        (with a forecast: the divergent component (2) [m] that counts after it);
        None where something is not finite. ``tells``: the solver is told of them then, with ``more`` (2) [m] of a push."""
        observer = self._observer
        assert observer is not None
        self._state[:], self._acted[:] = x, u
        with self._solver.exclusive:
            observer.learning, finite = self._learn(observer.started, t, h, tells, *more)
        observer.started = True
        return self._leans.tolist() if finite else None


def is_compiled_model(robot: RobotModel, solver: object) -> bool:
    """Whether a ``solver`` is compiled, and has the states of the ``robot`` alone and the torques of its drives."""
    if not isinstance(solver, Solver) or solver.settings.backend == "interpreted":
        return False
    return solver.problem.nx == robot.state.size == 2 * ball_base(robot).nq


def _places(solver: Solver) -> dict[str, int]:
    """:class:`Parameters` of a ``solver``."""
    groups, part = solver.ocp.dynamics.parameters, solver.problem.constant.slices["parameters"]
    start = (solver.constants.ctypes.data - solver.integrator["memory"].ctypes.data) // 8 + part.start
    learned = {name: start + groups[name].start if name in groups else -1 for name in Parameters._fields[2:]}
    return {"first": start, "count": groups.size, **learned}


def _inertia(robot: RobotModel) -> CompiledFunction:
    """Mass matrix (n n) by rows and weight (n) of 1 kg at the tool, of the coordinates (n)."""
    base = ball_base(robot)
    q = ca.SX.sym("q", base.nq)
    mass, weight = base.mass_matrix(q), base.tool_force(q, ca.SX([0, 0, -GRAVITY]))
    return CompiledFunction(ca.Function("inertia", [q], [ca.densify(ca.vertcat(ca.vec(mass.T), weight))]))
