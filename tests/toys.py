"""Small problems with known answers, and calls of compiled code, for the tests of ocp, kernel, solver and mpc."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from wbmpc.bases.ball.defaults import RezeroCost, rezero_problem
from wbmpc.bases.swerve.defaults import SwerveCost, swerve_problem
from wbmpc.kernel.codegen_target import compile_module, load_object
from wbmpc.kernel.step import Backend, made_as
from wbmpc.model.ode import Ode
from wbmpc.model.robot import load_robot
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem, Reference, RelaxedBarrier, SmoothL1, residuals, sets
from wbmpc.settings import MpcSettings
from wbmpc.solver import SQP, Solver


class ToyDynamics(Ode):
    """ẋ = f(x, u, w, m) with numbered names."""

    def __init__(self, nx: int, nu: int, f: Callable[..., ca.SX], parameters: int = 0, mode: int = 0) -> None:
        names = lambda n: [str(i) for i in range(n)]
        super().__init__(
            {"x": names(nx)},
            {"u": names(nu)},
            lambda x, u, w=None, m=None: f(x, u, w, m),
            parameters={"w": names(parameters)} if parameters else {},
            mode={"m": names(mode)} if mode else {},
        )


Rows = residuals.Expression


@dataclass
class LinearQuadratic:
    """A random problem with linear dynamics, quadratic costs and ``ng`` equality rows C x + D u + e = 0.

    ``repeat`` equality rows appear twice: consistent, but the rows are dependent.
    """

    nx: int
    nu: int
    ng: int
    n: int = 6
    seed: int = 0
    repeat: int = 0
    softness: float = 0.0
    integrator: str = "rk2"

    def __post_init__(self) -> None:
        r = np.random.default_rng(self.seed)
        nx, nu, ng = self.nx, self.nu, self.ng
        self.a, self.b, self.c0 = r.normal(size=(nx, nx)), r.normal(size=(nx, nu)), r.normal(size=nx)
        self.rows, self.offset = r.normal(size=(nx + nu + 2, nx + nu)), r.normal(size=nx + nu + 2)
        self.weight = r.uniform(0.5, 2.0, nx + nu + 2)
        self.end_rows, self.end_offset = r.normal(size=(nx, nx)), r.normal(size=nx)
        # well conditioned by the inputs (ng ≤ nu), or the answer depends on the solver's small softness
        turn = np.linalg.qr(r.normal(size=(nu, nu)))[0][:, :ng].T * r.uniform(0.5, 2.0, (ng, 1))
        self.e_rows, self.e_offset = np.hstack([r.normal(size=(ng, nx)), turn]), r.normal(size=ng)
        again = np.arange(self.repeat) % max(ng, 1)
        self.e_rows = np.vstack([self.e_rows, self.e_rows[again]]) if self.repeat else self.e_rows
        self.e_offset = np.concatenate([self.e_offset, self.e_offset[again]]) if self.repeat else self.e_offset
        self.x0 = r.normal(size=nx)
        self.grid = np.concatenate([[0.0], np.cumsum(r.uniform(0.05, 0.2, self.n))])

    def problem(self) -> OptimalControlProblem:
        dm = ca.DM
        dynamics = ToyDynamics(self.nx, self.nu, lambda x, u, w, m: dm(self.a) @ x + dm(self.b) @ u + dm(self.c0))
        ocp = OptimalControlProblem(dynamics, 1.0, self.n, grid=self.grid, integrator=self.integrator)
        affine = lambda a, c: lambda s: dm(a) @ ca.vertcat(s.x, s.u) + dm(c)
        ocp.add(Cost("path", Rows(len(self.offset), affine(self.rows, self.offset)), list(self.weight)))
        ocp.add(Cost("end", Rows(self.nx, lambda s: dm(self.end_rows) @ s.x + dm(self.end_offset)), 3.0, at="terminal"))
        if len(self.e_offset):
            rows = Rows(len(self.e_offset), affine(self.e_rows, self.e_offset))
            ocp.add(Constraint("equal", rows, softness=self.softness))
        return ocp

    def discrete(self, h: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A, B, c of one Runge-Kutta step: the Taylor polynomial of exp(h A) of the integrator's order."""
        order = 2 if self.integrator == "rk2" else 4
        power, integral, a = np.eye(self.nx), np.zeros((self.nx, self.nx)), np.eye(self.nx)
        for k in range(1, order + 1):
            integral = integral + power * h / k
            power = power @ self.a * h / k
            a = a + power
        return a, integral @ self.b, integral @ self.c0

    def kkt(self, x0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Solution (x, u) of the dense KKT system, by least squares (dependent rows are allowed)."""
        n, nx, nz = self.n, self.nx, self.nx + self.nu
        size = n * nz + nx
        hessian, gradient = np.zeros((size, size)), np.zeros(size)
        left, right, relax = [], [], []
        first = np.zeros((nx, size))
        first[:, :nx] = np.eye(nx)
        left.append(first), right.append(x0), relax.append(np.zeros(nx))
        for k, h in enumerate(np.diff(self.grid)):
            z = slice(k * nz, (k + 1) * nz)
            hessian[z, z] += h * self.rows.T @ np.diag(self.weight) @ self.rows
            gradient[z] += h * self.rows.T @ (self.weight * self.offset)
            a, b, c = self.discrete(h)
            row = np.zeros((nx, size))
            row[:, k * nz : k * nz + nz] = np.hstack([-a, -b])
            row[:, (k + 1) * nz : (k + 1) * nz + nx] = np.eye(nx)
            left.append(row), right.append(c), relax.append(np.zeros(nx))
            row = np.zeros((len(self.e_offset), size))
            row[:, z] = self.e_rows
            left.append(row), right.append(-self.e_offset), relax.append(np.full(len(self.e_offset), self.softness))
        last = slice(n * nz, size)
        hessian[last, last] += 3.0 * self.end_rows.T @ self.end_rows
        gradient[last] += 3.0 * self.end_rows.T @ self.end_offset
        g, e = np.vstack(left), np.concatenate(right)
        whole = np.block([[hessian, g.T], [g, -np.diag(np.concatenate(relax))]])
        z = np.linalg.lstsq(whole, np.concatenate([-gradient, e]), rcond=1e-13)[0][:size]
        x = np.array([z[k * nz : k * nz + nx] for k in range(n + 1)])
        return x, np.array([z[k * nz + nx : (k + 1) * nz] for k in range(n)])


def pendulum(
    backend: str = "compiled", integrator: str = "rk2", n: int = 12, equality: bool = True, **sqp: object
) -> Solver:
    """A cart with a pendulum, two inputs tied by an equality, boxes on states and inputs, a general inequality."""

    def f(x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        s, c = ca.sin(x[1]), ca.cos(x[1])
        push = u[0] + m[0] * u[1] + w[0]
        acceleration = (push + s * (x[3] ** 2 + 9.81 * c) * 0.3) / (1.3 - 0.3 * c * c)
        return ca.vertcat(x[2], x[3], acceleration, -acceleration * c - 9.81 * s - 0.1 * x[3])

    dynamics = ToyDynamics(4, 2, f, parameters=1, mode=1)
    ocp = OptimalControlProblem(dynamics, 1.2, n, first_interval=0.6 * 1.2 / n, integrator=integrator)
    ocp.add(
        Cost(
            "state",
            Rows(4, lambda s: s.x - s.reference, 4),
            [5, 20, 1, 1],
            at="path+terminal",
            terminal_weight=[50, 80, 5, 5],
        )
    )
    ocp.add(Cost("input", Rows(2, lambda s: s.u), 0.02))
    ocp.add(Cost("tip", Rows(1, lambda s: s.x[0] + ca.sin(s.x[1])), 3.0, norm=SmoothL1(0.1)))
    if equality:
        ocp.add(Constraint("tied", Rows(1, lambda s: s.u[1] - 0.3 * ca.sin(s.x[1]) - 0.1 * s.u[0])))
    barrier = RelaxedBarrier(0.05, 0.1)
    ocp.add(
        Constraint(
            "speed", Rows(2, lambda s: s.x[2:4]), sets.Box([-2, -3], [2, np.inf]), at="path+terminal", penalty=barrier
        )
    )
    ocp.add(Constraint("force", Rows(1, lambda s: 2.0 * s.u[0] - 1.0), sets.Box(-15.0, 14.0), penalty=barrier))
    ocp.add(
        Constraint(
            "tip_range", Rows(1, lambda s: 1.5 - (s.x[0] + ca.sin(s.x[1])) ** 2), sets.NonNegative(), penalty=barrier
        )
    )
    solver = Solver(ocp, SQP(**{"iterations": 60, "backend": backend, **sqp}))
    times = np.array([0.0, 0.5, 1.0])
    solver.set_reference("state", Reference(times, np.array([[0.0, 0, 0, 0], [0.4, 0, 0.5, 0], [0.6, 0, 0, 0]])))
    solver.warm_start(np.zeros(4))
    return solver


def hardened_pendulum(settings: SQP | None = None, **kwargs: object) -> Solver:
    """The cart with the pendulum, its inequalities hard: boxes, a scaled box, a general row; at the path and the end."""
    base = pendulum(**kwargs)
    for name, term in base.ocp.terms.items():
        if isinstance(term, Constraint) and not term.equality:
            base.ocp.terms[name] = replace(term, hard=True)
    solver = Solver(base.ocp, settings or SQP(iterations=300))
    solver.set_reference("state", base.references["state"])
    return solver


@cache
def robot(name: str, **base: str):  # type: ignore[no-untyped-def]
    """A robot model, built once."""
    return load_robot(name, **base)


def made(backend: Backend | str, kind: Callable[..., Any], *args: object, **keys: object) -> Any:
    """What ``kind`` makes, with its steps compiled or interpreted."""
    with made_as(backend):  # type: ignore[arg-type]
        return kind(*args, **keys)


def compile_ir(ir: str) -> object:
    """Machine code of an LLVM module."""
    return load_object(compile_module(ir))


def call_scalar(address: int, arguments: list[np.ndarray], sizes: list[int]) -> list[np.ndarray]:
    """Call ``i32 f(double** arg, double** res)``; ``sizes`` of the outputs, which start as NaN."""
    outputs = [np.full(max(s, 1), np.nan) for s in sizes]
    inputs = [np.ascontiguousarray(np.append(a, 0.0), float) for a in arguments]
    pointer = lambda arrays: (ctypes.c_void_p * len(arrays))(*[a.ctypes.data for a in arrays])
    prototype = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p)
    prototype(address)(pointer(inputs), pointer(outputs))
    return [o[:s] for o, s in zip(outputs, sizes, strict=True)]


def call_lanes(
    address: int, arguments: list[np.ndarray], sizes: list[int], shared: tuple[int, ...] = ()
) -> list[np.ndarray]:
    """Call a function of eight nodes: arguments (8, n), or (n,) when shared; results (8, size), which start as NaN."""
    turned = [np.append(a, 0.0) if i in shared else np.ascontiguousarray(a.T) for i, a in enumerate(arguments)]
    inputs = [aligned_copy(a) if a.size else aligned(8) for a in turned]
    outputs = [aligned_copy(np.full((max(s, 1), 8), np.nan)) for s in sizes]
    pointer = lambda arrays: (ctypes.c_void_p * len(arrays))(*[a.ctypes.data for a in arrays])
    prototype = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p)
    prototype(address)(pointer(inputs), pointer(outputs))
    return [o[:s].T.copy() for o, s in zip(outputs, sizes, strict=True)]


def call_pointers(address: int, *arrays: np.ndarray) -> None:
    """Call ``void f(ptr, …)``."""
    ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * len(arrays))(address)(*[a.ctypes.data for a in arrays])


def aligned(count: int) -> np.ndarray:
    """Zeros whose first element is at a multiple of 64 bytes, as compiled code needs."""
    raw = np.zeros(count + 8)
    start = (-raw.ctypes.data % 64) // 8
    return raw[start : start + count]


def aligned_copy(array: np.ndarray) -> np.ndarray:
    """The same numbers, 64-byte aligned."""
    out = aligned(array.size).reshape(array.shape)
    out[:] = array
    return out


def swerve_solver(n: int = 15, horizon: float = 6.0, first: float = 0.05, **sqp: object) -> Solver:
    """The swerve experiments' problem; the end effector is to follow a sine that moves, the base its mean line."""
    model = robot("swerve-ur10")
    settings = MpcSettings(horizon=horizon, intervals=n, first_interval=first)
    solver = Solver(swerve_problem(model, settings, SwerveCost()), SQP(**{"iterations": 300, **sqp}))
    t = np.linspace(0.0, 2.0 * horizon, 400)
    along = 0.2 * np.where(t < 2.0, t * t / 4.0, t - 1.0)
    position, quaternion = model.pose(model.home)
    path = np.stack([position[0] + along, position[1] + 0.1 * np.sin(2.0 * along), 0 * t + position[2]], axis=1)
    solver.set_reference("end_effector", Reference.poses(t, path, quaternion))
    states, inputs = np.tile(model.home, (t.size, 1)), np.zeros((t.size, model.input.size))
    states[:, 0], inputs[:, 0] = along, 0.2 * np.clip(t / 2.0, 0.0, 1.0)
    solver.set_reference("state", Reference(t, states))
    solver.set_reference("input", Reference(t, inputs))
    solver.warm_start(model.home)
    return solver


def rezero_solver(n: int = 15, step: float = 0.1, **sqp: object) -> Solver:
    """The ball robot's problem: the end effector is to go ``step`` [m] forward."""
    model = robot("rezero")
    settings = MpcSettings(horizon=0.05 * n, intervals=n, first_interval=0.0, barrier_mu=1e-2)
    solver = Solver(rezero_problem(model, settings, RezeroCost()), SQP(**{"iterations": 300, **sqp}))
    home, torque = model.base.numeric.equilibrium(model.home[model.state["arm"]])
    position, quaternion = model.pose(home)
    solver.set_reference("end_effector", Reference.poses([0.0], [position + np.array([step, 0.0, 0.0])], quaternion))
    solver.set_reference("body", Reference.constant(home))
    solver.set_reference("twist", Reference.constant(np.zeros(6)))
    solver.set_reference("torque", Reference.constant(torque))
    solver.warm_start(home, torque)
    return solver


def random_stage(solver: Solver, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """A state near the middle of the ranges, an input, node and constant parameters with unit quaternions."""
    problem = solver.problem
    d = problem.ocp.dynamics
    x, u = 0.6 * rng.normal(size=problem.nx), 0.6 * rng.normal(size=problem.nu)
    for q in d.unit_quaternions:
        x[q : q + 4] /= np.linalg.norm(x[q : q + 4])
    p = 0.5 * rng.normal(size=problem.node.size)
    if "reference.end_effector" in problem.node.slices:
        start = problem.node.slices["reference.end_effector"].start
        p[start + 3 : start + 7] /= np.linalg.norm(p[start + 3 : start + 7])
    p[problem.node.slices["mode"]] = rng.integers(0, 2, d.mode.size)
    w = solver.constants.copy()
    w[problem.constant.slices["parameters"]] = rng.normal(size=d.parameters.size)
    return x, u, p, w
