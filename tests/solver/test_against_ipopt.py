"""Optimal trajectories of both robots. Truth: IPOPT on the same discretization, from a start that is not optimal."""

from __future__ import annotations

import ipopt
import numpy as np
import pytest

from effort import thorough
from toys import pendulum, rezero_solver, robot, swerve_solver
from wbmpc.ocp import (
    Constraint,
    Cost,
    Mode,
    ModeSchedule,
    OptimalControlProblem,
    Reference,
    RelaxedBarrier,
    residuals,
    sets,
)
from wbmpc.solver import SQP, Solver, Status
from wbmpc.solver.driver import backward
from wbmpc.solver.workspace import BLOCKS, OFFSETS


def compare(solver: Solver, x0: np.ndarray, tolerance: float = 1e-6, near: bool = False):  # type: ignore[no-untyped-def]
    """``near``: IPOPT starts from the found solution with noise, where it fails from afar (it still has to agree)."""
    x_start, u_start = solver.ws.x.copy(), solver.ws.u.copy()
    found = solver.solve(x0)
    assert found.status is Status.CONVERGED, found
    assert found.iterations > 2  # the start is not the optimum
    if near:
        r = np.random.default_rng(0)
        x_start, u_start = (v + 0.02 * r.normal(size=v.shape) for v in (found.x, found.u))
    solver.warm_start(x_start, u_start)
    x, u, cost = ipopt.solve(solver, x0)
    assert np.abs(found.x - x).max() < tolerance
    assert np.abs(found.u - u).max() < tolerance
    assert found.cost == pytest.approx(cost, rel=1e-7, abs=1e-7)
    return found


@pytest.mark.parametrize("integrator", ["rk2", "rk4"])
def test_toy(integrator: str) -> None:
    compare(pendulum(integrator=integrator, iterations=300), np.array([0.2, 0.5, 0.3, -0.4]))


@thorough
def test_swerve_follows_a_moving_hand_reference() -> None:
    model = robot("swerve-ur10")
    solver = swerve_solver()
    x0 = model.home.copy()
    x0[model.state["arm"]] += [0.05, -0.05, 0.05, 0.1, -0.1, 0.1]
    found = compare(solver, x0)
    assert np.hypot(*(found.x[-1, :2] - x0[:2])) > 0.5


@thorough
def test_rezero_step_of_the_hand() -> None:
    model = robot("rezero")
    x0 = model.home.copy()
    x0[model.state["base_velocity"].start] = 0.05
    compare(rezero_solver(), x0)


def brakes_solver(modes: ModeSchedule, n: int = 15) -> Solver:
    solver = swerve_solver(n, horizon=3.0, first=0.1)
    model = robot("swerve-ur10")
    t = np.array([0.0, 10.0])
    states = np.tile(model.home, (2, 1))
    states[1, 0] = 2.0
    states[:, model.state["leg"]] += [0.2, -0.2, -0.2, 0.2]
    solver.set_reference("state", Reference(t, states))
    solver.set_weight("state", {"base": [1, 1, 5], "leg": 5.0, "arm": 0.05})
    solver.set_schedule(modes)
    return solver


def test_brakes_open_in_the_middle_of_the_horizon() -> None:
    closed, opened = Mode("closed", {"brake": [0, 0, 0, 0]}), Mode("open", {"brake": [1, 1, 1, 1]})
    model = robot("swerve-ur10")
    solver = brakes_solver(ModeSchedule((closed, opened, closed), (0.8, 2.0)))
    # wheel speeds have a weight of 1e-3: the optimum is flat in them
    found = compare(solver, model.home, 2e-5, near=True)
    leg = found.x[:, model.state["leg"]]
    change = np.abs(np.diff(leg, axis=0)).max(axis=1)
    is_open = (found.times[:-1] >= 0.8 - 1e-9) & (found.times[:-1] < 2.0 - 1e-9)
    assert is_open.any() and not is_open.all()
    assert change[~is_open].max() < 1e-9
    assert change[is_open].max() > 0.02
    assert np.abs(found.u[~is_open][:, model.input["leg"]]).max() < 1e-7


def test_one_open_brake_moves_one_leg() -> None:
    closed, opened = Mode("closed"), Mode("LF", {"brake": [1, 0, 0, 0]})
    model = robot("swerve-ur10")
    found = brakes_solver(ModeSchedule((closed, opened), (0.5,))).solve(model.home)
    moved = np.abs(np.diff(found.x[:, model.state["leg"]], axis=0)).max(axis=0)
    assert moved[0] > 1e-3
    assert moved[1:].max() < 1e-9


def quaternion_solver(orientation: str, n: int = 12) -> Solver:
    """End effector, input and joint terms only, so that both bases mean the same; rk4 makes both integrators exact enough."""
    model = robot("swerve-ur10", orientation=orientation)
    ocp = OptimalControlProblem(model.dynamics(), 1.5, n, integrator="rk4")
    ocp.add(Cost("end_effector", residuals.FramePose(model, model.tool), [100.0] * 3 + [20.0] * 3, at="path+terminal"))
    ocp.add(
        Cost(
            "joints",
            residuals.State(model, ["leg", "steer", "arm"]),
            {"leg": 1.0, "steer": 0.1, "arm": 0.5},
            at="path+terminal",
        )
    )
    weights = {"base": 0.5, "leg": 1.0, "steer": 0.05, "wheel": 0.001, "arm": 0.1}
    ocp.add(Cost("input", residuals.Input(model), weights))
    ocp.add(Constraint("rolling", residuals.Rolling(model)))
    ocp.add(Constraint("brakes", residuals.LockedJoints(model)))
    box = sets.Box(model.limits.input_lower, model.limits.input_upper)
    ocp.add(Constraint("speeds", residuals.Input(model, reference=None), box, penalty=RelaxedBarrier(1e-3, 0.02)))
    solver = Solver(ocp, SQP(iterations=300))
    position, quaternion = model.pose(model.home)
    solver.set_reference("end_effector", Reference.poses([0.0], [position + np.array([0.4, 0.2, 0.05])], quaternion))
    parts = [model.home[model.state[g]] for g in ("leg", "steer", "arm")]
    solver.set_reference("joints", Reference.constant(np.concatenate(parts)))
    solver.warm_start(model.home, np.eye(1, model.input.size).ravel() * 0.2)
    return solver


def test_quaternion_base_has_the_same_optimum() -> None:
    flat, full = quaternion_solver("yaw"), quaternion_solver("quaternion")
    yaw, quaternion = robot("swerve-ur10", orientation="yaw"), robot("swerve-ur10", orientation="quaternion")
    a, b = flat.solve(yaw.home), full.solve(quaternion.home)
    assert a.status is Status.CONVERGED
    assert b.status is Status.CONVERGED, b
    assert a.cost == pytest.approx(b.cost, rel=1e-5)
    for group in ("leg", "steer", "wheel", "arm"):
        assert np.abs(a.x[:, yaw.state[group]] - b.x[:, quaternion.state[group]]).max() < 1e-5
    assert np.abs(a.u - b.u).max() < 1e-5 * (1.0 + np.abs(a.u).max())
    base = b.x[:, quaternion.state["base"]]
    np.testing.assert_allclose(base[:, :2], a.x[:, :2], atol=1e-5)
    np.testing.assert_allclose(2.0 * np.arctan2(base[:, 6], base[:, 3]), a.x[:, 2], atol=1e-5)
    assert np.abs(a.x[-1, 2]) > 1e-3  # it does turn
    assert np.abs(np.linalg.norm(base[:, 3:], axis=1) - 1.0).max() < 1e-9


@pytest.mark.parametrize("kind", ["rk2", "rk4", "quaternion"])
def test_linearized_dynamics_are_the_derivative_of_the_step(kind: str) -> None:
    """[A B] of the first interval against differences of the simulated step, unit quaternions included."""
    r = np.random.default_rng(2)
    solver = quaternion_solver("quaternion") if kind == "quaternion" else pendulum(integrator=kind)
    nx, nu, h = solver.problem.nx, solver.problem.nu, solver.ws.grid[1]
    u = r.normal(size=nu)
    x = 0.3 * r.normal(size=nx)
    if kind == "quaternion":
        x[2:7], u[:3] = [0.3, np.cos(0.4), 0.0, 0.0, np.sin(0.4)], [1.0, -0.5, 4.0]
    solver.warm_start(x, u)
    backward(solver.ws.memory, solver.ws.table, True)
    s, start = solver.kernel.sizes, solver.ws.table[OFFSETS + BLOCKS.index("ab")]
    ab = solver.ws.memory[start : start + nx * s.lz].reshape(nx, s.lz)
    columns = []
    for d in 1e-6 * np.eye(nx + nu):
        high, low = (solver.simulate(x + sign * d[:nx], u + sign * d[nx:], h) for sign in (1, -1))
        columns.append((high - low) / 2e-6)
    got = np.hstack([ab[:, :nx], ab[:, s.first : s.first + nu]])
    np.testing.assert_allclose(got, np.array(columns).T, atol=1e-7)


def test_quaternion_norm_does_not_drift_in_simulation() -> None:
    model = robot("swerve-ur10", orientation="quaternion")
    solver = quaternion_solver("quaternion")
    solver.iterate(model.home)
    x, u = model.home.copy(), np.zeros(model.input.size)
    u[:3] = [0.5, 0.1, 0.9]
    for _ in range(1000):
        x = solver.simulate(x, u, 0.02)
        assert abs(np.linalg.norm(x[3:7]) - 1.0) < 1e-9
    angle = 0.9 * 20.0
    np.testing.assert_allclose(np.abs(x[3:7]), np.abs([np.cos(angle / 2), 0, 0, np.sin(angle / 2)]), atol=1e-6)
    # a constant twist drives a circle: the same place as the exact exponential
    s, c = np.sin(angle) / 0.9, (1.0 - np.cos(angle)) / 0.9
    np.testing.assert_allclose(x[:2], [0.5 * s - 0.1 * c, 0.5 * c + 0.1 * s], atol=1e-5)
