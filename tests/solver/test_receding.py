"""Shift, sampling and policy. Truth: polynomials, NumPy's and SciPy's interpolation, the plan itself."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from toys import Rows, ToyDynamics, pendulum, robot
from wbmpc.model.ode import Ode
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.policy import Policy
from wbmpc.ocp import Constraint, Cost, Mode, ModeSchedule, OptimalControlProblem, Reference, residuals, sets
from wbmpc.solver import SQP, InteriorPoint, Solver, Status
from wbmpc.solver.memory_layout import ROW_L, ROWS, N
from wbmpc.solver.receding import align, make_tables, sample_all, shift, shift_multipliers
from wbmpc.types import Observation


def shifted(solver: Solver, delta: float) -> None:
    """From 0 s."""
    moved(solver, delta, delta)


def moved(solver: Solver, t: float, delta: float) -> None:
    """By ``delta`` to ``t`` [s]."""
    if solver.settings.backend == "interpreted":
        solver._backend.twin._shift(solver.data.tables(), t, delta)
        solver._backend.twin._shift_multipliers(delta)
    else:
        tables = solver.data.tables()
        align(solver.ws.memory, solver.ws.table, *tables, t)
        shift_multipliers(solver.ws.memory, solver.ws.table, delta)
        shift(solver.ws.memory, solver.ws.table, *tables, t, delta)


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
@pytest.mark.parametrize("delta", [0.013, 0.2, 0.55, 5.0])
def test_shift_of_a_linear_trajectory(backend: str, delta: float) -> None:
    """States are linear between nodes, inputs between the middles of the intervals; the ends hold."""
    solver = pendulum(backend)
    grid = solver.ws.grid
    x = lambda t: np.outer(t, [1.0, -2.0, 0.5, 3.0]) + [0.1, 0.2, 0.3, 0.4]
    u = lambda t: np.outer(t, [4.0, -1.0]) + [1.0, 2.0]
    middle = 0.5 * (grid[1:] + grid[:-1])
    solver.warm_start(x(grid), u(middle))
    shifted(solver, delta)
    np.testing.assert_allclose(solver.ws.x, x(np.minimum(grid + delta, grid[-1])), atol=1e-12)
    np.testing.assert_allclose(solver.ws.u, u(np.minimum(middle + delta, middle[-1])), atol=1e-12)


@pytest.mark.parametrize(("backend", "aligned"), [("compiled", False), ("compiled", True), ("interpreted", False)])
def test_shift_does_not_mix_modes(backend: str, aligned: bool) -> None:
    """Inputs that an equality of each mode fixes to its number are one of these numbers, where the grid follows events that of their mode."""
    ocp = OptimalControlProblem(
        ToyDynamics(1, 1, lambda x, u, w, m: u), 2.0, 20, first_interval=0.02, align_events=aligned, modes=("a", "b")
    )
    ocp.add(Cost("input", Rows(1, lambda s: s.u)))
    solver = Solver(ocp, SQP.real_time(backend=backend))
    events = np.array([0.31, 0.77, 1.6])
    solver.set_schedule(ModeSchedule(tuple(Mode("ab"[k % 2]) for k in range(4)), tuple(events)))
    of = lambda t: np.searchsorted(events, t + 1e-9, side="right").astype(float)
    solver.iterate(np.zeros(1))
    for k in range(1, 60):
        t = 0.03 * k
        solver.warm_start(np.zeros(1), of(t - 0.03 + solver.ws.grid[:-1])[:, None])
        moved(solver, t, 0.03)
        u = solver.ws.u[:, 0]
        if aligned:
            np.testing.assert_array_equal(u, of(t + solver.ws.grid[:-1]))
        assert set(u) <= {0.0, 1.0, 2.0, 3.0}


def test_shift_of_a_cubic_is_as_good_as_linear_interpolation() -> None:
    solver = pendulum()
    grid = solver.ws.grid
    x = np.stack([grid**3, grid**2, 1 - grid, np.sin(grid)], axis=1)
    solver.warm_start(x)
    shifted(solver, 0.07)
    want = np.stack([np.interp(grid + 0.07, grid, c) for c in x.T], axis=1)
    np.testing.assert_allclose(solver.ws.x, want, atol=1e-13)


@pytest.mark.parametrize("n", [1, 2])
def test_shift_of_short_horizons(n: int) -> None:
    solver = pendulum(n=n)
    grid = solver.ws.grid
    solver.warm_start(np.outer(grid, np.ones(4)), np.arange(2.0 * n).reshape(n, 2))
    shifted(solver, 0.05)
    np.testing.assert_allclose(solver.ws.x[:, 0], np.minimum(grid + 0.05, grid[-1]))
    assert np.isfinite(solver.ws.u).all()


def quaternions() -> np.ndarray:
    """Five rotations in w, x, y, z order with arbitrary signs; steps below 0.6 rad and one of zero."""
    angles = np.array([0.0, 0.5, 0.5, 1.0, 0.6])
    q = Rotation.from_rotvec(np.outer(angles, [0.6, 0.0, 0.8])).as_quat()[:, [3, 0, 1, 2]]
    return q * np.array([1, -1, 1, 1, -1])[:, None]


TIMES = np.array([0.1, 0.4, 0.5, 0.9, 1.1])


def sampled(
    reference: Reference, t0: float = 0.0, term: str = "end_effector", schedule: ModeSchedule | None = None
) -> np.ndarray:
    model = robot("rezero")
    ocp = OptimalControlProblem(model.dynamics(), 1.3, 40)
    ocp.add(Cost("end_effector", residuals.FramePose(model, "tool")))
    ocp.add(Cost("twist", residuals.FrameTwist(model, "tool")))
    solver = SOLVER.setdefault("s", Solver(ocp, SQP(iterations=1)))
    tables = make_tables(solver.problem, {term: reference}, schedule or ModeSchedule((Mode("m"),)))
    sample_all(solver.ws.memory, solver.ws.table, *tables, t0)
    return solver.ws.p[:, solver.problem.node.slices[f"reference.{term}"]].copy()


SOLVER: dict[str, Solver] = {}
GRID = np.linspace(0.0, 1.3, 41)


def test_linear_reference_is_numpys_interpolation() -> None:
    values = np.random.default_rng(0).normal(size=(5, 6))
    for t0 in (0.0, 0.37, 2.0):
        got = sampled(Reference(TIMES, values), t0, "twist")
        want = np.stack([np.interp(t0 + GRID, TIMES, c) for c in values.T], axis=1)
        np.testing.assert_allclose(got, want, atol=1e-13)


def test_pose_reference_is_close_to_slerp() -> None:
    positions = np.random.default_rng(1).normal(size=(5, 3))
    got = sampled(Reference.poses(TIMES, positions, quaternions()))
    want = np.stack([np.interp(GRID, TIMES, c) for c in positions.T], axis=1)
    np.testing.assert_allclose(got[:, :3], want, atol=1e-13)
    np.testing.assert_allclose(np.linalg.norm(got[:, 3:], axis=1), 1.0, atol=1e-14)
    slerp = Slerp(TIMES, Rotation.from_quat(quaternions()[:, [1, 2, 3, 0]]))(np.clip(GRID, 0.1, 1.1))
    error = (Rotation.from_quat(got[:, [4, 5, 6, 3]]) * slerp.inv()).magnitude()
    # normalized linear interpolation lags by at most about 0.016 θ³ between samples, and is exact at samples and middles
    assert error.max() < 0.02 * 0.5**3
    at = np.isclose(GRID[:, None], [0.1, 0.25, 0.4, 0.45, 0.5, 0.7, 0.9, 1.0, 1.1], atol=1e-3).any(axis=1)
    assert sampled(Reference.poses(TIMES, positions, quaternions()), 0.25)[0, 3:] @ slerp_at(0.25) > 1.0 - 1e-12
    assert error[~at].max() > 0.0


def slerp_at(t: float) -> np.ndarray:
    q = Slerp(TIMES, Rotation.from_quat(quaternions()[:, [1, 2, 3, 0]]))(t).as_quat()[[3, 0, 1, 2]]
    return q * np.sign(q[0])


@pytest.mark.parametrize("kind", ["hold", "pose_hold"])
def test_hold(kind: str) -> None:
    if kind == "hold":
        values = np.random.default_rng(0).normal(size=(5, 6))
        got = sampled(Reference(TIMES, values, "hold"), 0.0, "twist")
    else:
        reference = Reference.poses(TIMES, np.arange(15.0).reshape(5, 3), quaternions(), hold=True)
        values, got = reference.values, sampled(reference)
    index = np.clip(np.searchsorted(TIMES, GRID + 1e-9, side="right") - 1, 0, 4)
    np.testing.assert_array_equal(got, values[index])


def test_hold_forgives_rounding() -> None:
    """A sample at 3 · 0.1 s (a little more than 0.3) holds at 0.3 s already."""
    assert 3 * 0.1 > 0.3
    got = sampled(Reference([0.0, 3 * 0.1], [[1.0] * 6, [2.0] * 6], "hold"), 0.3, "twist")
    np.testing.assert_array_equal(got, 2.0)


def test_a_jump_between_two_samples_of_the_same_time() -> None:
    reference = Reference([0.0, 0.65, 0.65, 1.0], [[0.0] * 6, [1.0] * 6, [5.0] * 6, [5.0] * 6])
    got = sampled(reference, 0.0, "twist")[:, 0]
    np.testing.assert_allclose(got[GRID < 0.64], GRID[GRID < 0.64] / 0.65, atol=1e-12)
    np.testing.assert_array_equal(got[GRID > 0.651], 5.0)


def test_the_twin_samples_the_same() -> None:
    a, b = pendulum(), pendulum("interpreted")
    for s in (a, b):
        s.iterate(np.zeros(4), 0.3)
    np.testing.assert_allclose(a.ws.p, b.ws.p, rtol=0, atol=1e-15)


def test_modes_change_at_the_event() -> None:
    """A node exactly on the event has the new mode; the absolute time decides, not the place on the horizon."""
    ocp = OptimalControlProblem(ToyDynamics(1, 1, lambda x, u, w, m: u, mode=1), 1.0, 10)
    ocp.add(Cost("all", Rows(1, lambda s: s.x), modes=("b",)))
    solver = Solver(ocp, SQP(iterations=1, compute_kkt=False), use_cache=False)
    solver.set_schedule(ModeSchedule((Mode("a", {"m": [3.0]}), Mode("b", {"m": [4.0]})), (10.3,)))
    for t0, first in ((10.0, 3), (10.1, 2), (10.25, 1), (10.3, 0), (9.0, 11), (12.0, 0)):
        solver.iterate(np.zeros(1), t0)
        want = np.where(np.arange(11) >= first, 4.0, 3.0)
        np.testing.assert_array_equal(solver.ws.p[:, 0], want)
        np.testing.assert_array_equal(solver.ws.p[:, 1], want - 3.0)


# ---------------------------------------------------------------------- policy
def plan() -> Policy:
    r = np.random.default_rng(5)
    times = 2.0 + np.array([0.0, 0.1, 0.3, 0.6])
    return Policy(times, r.normal(size=(4, 3)), r.normal(size=(3, 2)), r.normal(size=(3, 2, 3)))


def test_policy_on_its_plan_is_the_plan() -> None:
    p = plan()
    for k, t in enumerate((2.0, 2.05, 2.1, 2.2, 2.3, 2.59)):
        u = p.u[[0, 0, 1, 1, 2, 2][k]]
        np.testing.assert_allclose(p(t, p.state(t)), u, atol=1e-14)
        np.testing.assert_array_equal(p(t), u)
        np.testing.assert_array_equal(p.feedforward(t), u)


def test_policy_interpolates_states_and_applies_its_gain() -> None:
    p = plan()
    np.testing.assert_allclose(p.state(2.15), 0.75 * p.x[1] + 0.25 * p.x[2], atol=1e-14)
    off = np.array([0.1, -0.2, 0.3])
    np.testing.assert_allclose(p(2.15, p.state(2.15) + off), p.u[1] + p.gain[1] @ off, atol=1e-14)


def test_policy_holds_beyond_its_ends() -> None:
    p = plan()
    assert p.end == pytest.approx(2.6)
    np.testing.assert_array_equal(p.state(0.0), p.x[0])
    np.testing.assert_array_equal(p.state(9.0), p.x[-1])
    np.testing.assert_array_equal(p.feedforward(0.0), p.u[0])
    np.testing.assert_array_equal(p.feedforward(9.0), p.u[-1])


def test_feed_forward_is_a_copy() -> None:
    p = plan()
    p.feedforward(2.0)[:] = 99.0
    assert np.abs(p.u).max() < 50.0


class Cone(Rows):
    """Rows whose reference is the last command of the first input."""

    @property
    def last_inputs(self) -> list[int]:
        return [0]


def steps(rate: float) -> Callable[[residuals.Symbols], ca.SX]:
    """By how much the input is inside of what may have changed since the last command, on both sides."""
    change = lambda s: ca.vertcat(s.reference[0] - s.u[0], s.u[0] - s.reference[0])
    return lambda s: (change(s) + rate * s.reference[1]) / 12.0


def swing(backend: str) -> Solver:
    """A pendulum in real time whose limits of torque and speed are active for a while."""
    dynamics = Ode({"x": ["q", "v"]}, {"u": ["t"]}, lambda x, u: ca.vertcat(x[1], u - 4.0 * ca.sin(x[0])))
    ocp = OptimalControlProblem(dynamics, 1.0, 20)
    ocp.add(Cost("goal", Rows(2, lambda s: ca.vertcat(s.x[0] - 1.5, s.x[1])), 10.0, at="path+terminal"))
    ocp.add(Cost("torque", Rows(1, lambda s: s.u), 0.01))
    ocp.add(Constraint("bounds", Rows(1, lambda s: s.u), sets.Box(-6.0, 6.0), hard=True))
    ocp.add(Constraint("speed", Rows(1, lambda s: s.x[1:]), sets.Box(-1.5, 1.5), hard=True, at="path+terminal"))
    ocp.add(Constraint("rate", Cone(2, steps(20.0), reference=2), sets.NonNegative(), hard=True, slack=1e4))
    solver = Solver(ocp, SQP.real_time(10, backend=backend))
    solver.set_reference("rate", Reference([0.0, 1.0], [[-3.0, 0.05], [-3.0, 1.05]]))
    solver.warm_start(np.zeros(2))
    return solver


def multipliers(solver: Solver) -> np.ndarray:
    """Of the path's rows (N, rows), as a view of the compiled solver's memory or a copy of the twin's."""
    if solver.settings.backend == "interpreted":
        return np.array([r.l for r in solver._backend.twin.own[:-1]])
    m, o = solver.ws.memory, solver.ws.table
    n, rows = int(o[N]), int(o[ROWS])
    return np.asarray(m[o[ROW_L] : o[ROW_L] + n * rows].reshape(n, rows)[:, : len(solver.problem.path.rows)])


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
@pytest.mark.parametrize("delta", [0.013, 0.2, 0.55, 5.0])
def test_multipliers_move_with_the_plan(backend: str, delta: float) -> None:
    """NumPy's interpolation over the nodes that have inputs: a limit that is active until some time stays so until then. After a pause of a
    whole horizon, 1 s, they stay, and so do those of rows that follow the last command."""
    solver = swing(backend)
    solver.solve(np.array([0.2, 0.1]))
    before, times = multipliers(solver).copy(), solver.ws.grid[:-1]
    assert np.ptp(before, axis=0).max() > 0.1
    shifted(solver, delta)
    moved = delta if delta < 1.0 else 0.0
    want = np.stack([np.interp(times + moved, times, c) for c in before.T], axis=1)
    cone = [r.name.startswith("rate") for r in solver.problem.path.rows]
    want[:, cone] = before[:, cone]
    assert sum(cone) == 2 and np.ptp(before[:, cone], axis=0).max() > 0.1
    np.testing.assert_allclose(multipliers(solver), want, rtol=1e-12, atol=1e-14)


def trolley(settings: SQP) -> Solver:
    """A mass that goes home with limits of force and speed."""
    dynamics = Ode({"x": ["q", "v"]}, {"u": ["f"]}, lambda x, u: ca.vertcat(x[1], u))
    ocp = OptimalControlProblem(dynamics, 2.0, 40)
    ocp.add(Cost("goal", Rows(2, lambda s: s.x), [10.0, 0.1], at="path+terminal"))
    ocp.add(Cost("force", Rows(1, lambda s: s.u), 0.01))
    ocp.add(Constraint("bounds", Rows(1, lambda s: s.u), sets.Box(-6.0, 6.0), hard=True))
    ocp.add(Constraint("speed", Rows(1, lambda s: s.x[1:]), sets.Box(-1.5, 1.5), hard=True, at="path+terminal"))
    solver = Solver(ocp, settings)
    solver.warm_start(np.array([-1.0, 0.0]))
    return solver


@pytest.mark.parametrize("barrier", [1e-3, 1e-5])
def test_ticks_with_active_limits_take_one_iteration(barrier: float) -> None:
    """Force and speed are at their limits for a while, and the trolley is pushed. Truth: the converged plan of every state."""
    solver = trolley(SQP.real_time(interior_point=InteriorPoint("real_time", barrier)))
    exact = trolley(SQP())
    x, h, saturated = np.array([-1.0, 0.0]), float(solver.ws.grid[1]), 0
    for _ in range(10):
        solver.iterate(x)
    for k in range(1, 40):
        x = solver.simulate(x, solver.ws.u[0], h)
        x[1] -= 1.0 if k == 20 else 0.0
        solver.iterate(x, k * h, h)
        assert solver.effort.directions == 1, k
        found = exact.solve(x)
        assert found.status is Status.CONVERGED
        assert abs(solver.ws.u[0] - found.u[0]) < 0.05 * 12.0, k
        saturated += abs(found.u[0, 0]) > 5.9
    assert saturated > 2


def test_the_twin_takes_as_many_iterations() -> None:
    """The same counts of a trolley that is pushed, in two programs."""
    solvers, x, found = (
        [trolley(SQP.real_time(backend=b)) for b in ("compiled", "interpreted")],
        np.array([-1.0, 0.0]),
        [],
    )
    h = float(solvers[0].ws.grid[1])
    for k in range(30):
        x = x + np.array([0.3, 2.5]) * (k == 5) + np.array([0.1, -1.2]) * (k == 15)
        found.append([s.iterate(x, k * h, h)[1] for s in solvers])
        x = solvers[0].simulate(x, solvers[0].ws.u[0], h)
    assert all(one == other for one, other in found) and max(one for one, _ in found) > 2


def test_one_iteration_a_tick_is_enough_beside_a_limit_of_the_rate() -> None:
    """A sine is followed by an input that may change so fast since the last command. Truth: the converged plan of the same rows."""
    plans = {}
    for iterations in (1, 30):
        ocp = OptimalControlProblem(Ode({"x": ["q"]}, {"u": ["v"]}, lambda x, u: u), 2.0, 20, first_interval=0.02)
        ocp.add(Cost("goal", Rows(1, lambda s: s.x - s.reference, reference=1), 1000.0, at="path+terminal"))
        ocp.add(Cost("speed", Rows(1, lambda s: s.u), 0.1))
        ocp.add(Constraint("rate", Cone(2, steps(4.0), reference=2), sets.NonNegative(), hard=True, slack=1e6))
        mpc = MPC(ocp, SQP.real_time(iterations, interior_point=InteriorPoint("real_time", 3e-3)), rate=50.0)
        t = np.linspace(0.0, 5.0, 501)
        mpc.reference["goal"] = Reference(t, 0.3 * np.sin(2.0 * t)[:, None])
        mpc.reset(np.zeros(1))
        x, errors = np.zeros(1), []
        for k in range(100):
            policy = mpc.update(Observation(0.02 * k, x))
            x = mpc.simulate(x, policy.u[0], 0.02)
            errors.append(x[0] - 0.3 * np.sin(2.0 * 0.02 * (k + 1)))
        plans[iterations] = np.abs(errors[20:]).mean()
    assert plans[1] < 1.2 * plans[30]
