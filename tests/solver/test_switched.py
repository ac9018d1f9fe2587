"""Switched systems: nodes on events, jumps of the state, references that jump. Truth: closed forms, IPOPT, differences."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from toys import Rows, ToyDynamics
from wbmpc.errors import InputError
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Constraint, Cost, Mode, ModeSchedule, OptimalControlProblem, Reference
from wbmpc.solver import ILQR, SQP, Solver, Status
from wbmpc.solver.receding import align
from wbmpc.solver.riccati import backward
from wbmpc.types import Observation


class Ball(ToyDynamics):
    """Height and speed of a ball with a vertical thrust; an event with mode value 1 is an impact that keeps 0.8 of the speed
    and turns it round, and squeezes the height a little."""

    def __init__(self) -> None:
        super().__init__(2, 1, lambda x, u, w, m: ca.vertcat(x[1], u[0] - 9.81), mode=1)

    def jump(self, x: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        hit = ca.vertcat(0.9 * ca.sin(x[0]) + 0.1 * x[0] * x[1], -0.8 * x[1])
        return ca.if_else(m[0] > 0.5, hit, x)


UP, DOWN = Mode("up", {"m": [1.0]}), Mode("down")


def ball(align_events: bool = True, n: int = 10, solver: SQP | None = None) -> Solver:
    ocp = OptimalControlProblem(Ball(), 1.0, n, align_events=align_events)
    ocp.add(Cost("height", Rows(2, lambda s: s.x - s.reference, 2), [20.0, 1.0], at="path+terminal"))
    ocp.add(Cost("thrust", Rows(1, lambda s: s.u), 0.01))
    made = Solver(ocp, solver or SQP(iterations=100), use_cache=False)
    made.set_reference("height", Reference.constant([1.0, 0.0]))
    made.set_schedule(ModeSchedule((DOWN, UP), (0.437,)))
    return made


def grid_for(base: np.ndarray, events: list[float], t0: float) -> np.ndarray:
    ocp = OptimalControlProblem(
        ToyDynamics(1, 1, lambda x, u, w, m: u), base[-1], len(base) - 1, grid=base, align_events=True
    )
    ocp.add(Cost("u", Rows(1, lambda s: s.u)))
    solver = GRIDS.setdefault(len(base), Solver(ocp, SQP(iterations=1)))
    solver.set_schedule(ModeSchedule((Mode("default"),) * (len(events) + 1), tuple(events)))
    align(solver.ws.memory, solver.ws.table, *solver.data.tables(), t0)
    return solver.ws.grid.copy()


GRIDS: dict[int, Solver] = {}


@settings(max_examples=80, deadline=None)
@example([0.0002, 0.0625], 0.0)  # the first one, just behind the start, has a node too
@given(st.lists(st.floats(-0.5, 2.5), min_size=0, max_size=5, unique=True), st.floats(0.0, 1.0))
def test_nodes_on_events(events: list[float], t0: float) -> None:
    events = sorted(events)
    if any(np.diff(events) <= 1e-3):
        return
    base = np.linspace(0.0, 2.0, 21)
    grid = grid_for(base, events, t0)
    assert np.all(np.diff(grid) > 1e-9)
    assert grid[0] == 0.0 and grid[-1] == 2.0
    inside = [e - t0 for e in events if 1e-3 < e - t0 < 1.999]
    for e in inside:
        assert np.abs(grid - e).min() < 1e-12
    counted = [e - t0 for e in events if 1e-6 < e - t0 < 2.0 - 1e-6]
    apart = [e for e in counted if e < 1.95 and all(abs(e - f) > 0.11 for f in counted if f != e)]
    moved = np.abs(grid - base).max()
    assert moved < 0.11 or len(apart) < len(counted)


def test_an_event_ends_an_interval_and_the_state_jumps() -> None:
    solver = ball()
    found = solver.solve(np.array([1.0, 0.0]))
    assert found.status is Status.CONVERGED, found
    k = int(np.argmin(np.abs(found.times - 0.437)))
    assert found.times[k] == pytest.approx(0.437, abs=1e-12)
    # the interval before it, integrated exactly (constant acceleration), then the impact
    h, u = found.times[k] - found.times[k - 1], found.u[k - 1, 0]
    height = found.x[k - 1, 0] + h * found.x[k - 1, 1] + 0.5 * h * h * (u - 9.81)
    speed = found.x[k - 1, 1] + h * (u - 9.81)
    want = [0.9 * np.sin(height) + 0.1 * height * speed, -0.8 * speed]
    np.testing.assert_allclose(found.x[k], want, atol=1e-7)
    assert speed < -0.1  # it was falling
    # everywhere else there is no jump
    for j in range(len(found.u)):
        if j != k - 1:
            h = found.times[j + 1] - found.times[j]
            assert found.x[j + 1, 1] == pytest.approx(found.x[j, 1] + h * (found.u[j, 0] - 9.81), abs=1e-7)


def test_optimum_with_a_jump_against_ipopt() -> None:
    solver = ball()
    found = solver.solve(np.array([1.0, 0.0]))
    n, t = 10, found.times
    x, u = ca.SX.sym("x", 2, n + 1), ca.SX.sym("u", n)
    cost, rows = 10 * (x[0, n] - 1) ** 2 + 0.5 * x[1, n] ** 2, [x[:, 0] - ca.DM([1.0, 0.0])]
    jump = ca.Function("jump", [x[:, 0]], [Ball().jump(x[:, 0], ca.SX(0, 1), ca.DM([1.0]))])
    for k in range(n):
        h = t[k + 1] - t[k]
        cost += h * (10 * (x[0, k] - 1) ** 2 + 0.5 * x[1, k] ** 2 + 0.005 * u[k] ** 2)
        end = ca.vertcat(x[0, k] + h * (x[1, k] + 0.5 * h * (u[k] - 9.81)), x[1, k] + h * (u[k] - 9.81))
        rows.append(x[:, k + 1] - (jump(end) if abs(t[k + 1] - 0.437) < 1e-9 else end))
    program = {"x": ca.vertcat(ca.vec(x), u), "f": cost, "g": ca.vertcat(*rows)}
    options = {"ipopt.print_level": 0, "print_time": 0, "ipopt.tol": 1e-10, "ipopt.sb": "yes"}
    answer = np.array(ca.nlpsol("s", "ipopt", program, options)(x0=0, lbg=0, ubg=0)["x"]).ravel()
    np.testing.assert_allclose(found.x, answer[: 2 * n + 2].reshape(n + 1, 2), atol=1e-6)
    np.testing.assert_allclose(found.u.ravel(), answer[2 * n + 2 :], atol=1e-5)
    single = ball(solver=ILQR(iterations=200)).solve(np.array([1.0, 0.0]))
    np.testing.assert_allclose(single.u, found.u, atol=1e-4)


def test_sensitivity_through_a_jump_is_the_derivative() -> None:
    """Gaps by differences of the node before the event: b(x + δ) − b(x) = [A B] δ."""
    solver = ball()
    rng = np.random.default_rng(0)
    solver.iterate(np.array([1.0, 0.0]))
    k = int(np.argmin(np.abs(solver.ws.grid - 0.437))) - 1
    solver.warm_start(rng.normal(size=(11, 2)), rng.normal(size=(10, 1)))
    s = solver.kernel.sizes

    def block() -> np.ndarray:
        backward(solver.ws.memory, solver.ws.table, True)
        from wbmpc.solver.memory_layout import AB

        start = solver.ws.table[AB] + k * (s.nx + 1) * s.lz
        return solver.ws.memory[start : start + s.nx * s.lz].reshape(s.nx, s.lz).copy()

    middle = block()
    for i, array, column in ((0, solver.ws.x, 0), (1, solver.ws.x, 1), (0, solver.ws.u, s.first)):
        e = 1e-6
        array[k, i] += e
        high = block()
        array[k, i] -= 2 * e
        low = block()
        array[k, i] += e
        np.testing.assert_allclose((high - low)[:, s.nx] / (2 * e), middle[:, column], atol=1e-7)


def test_without_alignment_the_event_falls_between_nodes() -> None:
    assert np.abs(ball(False).solve(np.array([1.0, 0.0])).times - 0.437).min() > 0.02


def test_shift_across_a_moving_grid_keeps_a_linear_plan() -> None:
    """The nodes move onto the event, which comes nearer: a plan that is linear in time stays it."""
    ocp = OptimalControlProblem(ToyDynamics(1, 1, lambda x, u, w, m: u), 1.0, 10, align_events=True)
    ocp.add(Cost("u", Rows(1, lambda s: s.u - s.reference, 1)))
    ocp.add(Constraint("tie", Rows(1, lambda s: s.u - s.reference, 1)))
    solver = Solver(ocp, SQP(iterations=1, compute_kkt=False, accept_min_step=True))
    for name in ("u", "tie"):
        solver.set_reference(name, Reference.constant([0.7]))
    solver.set_schedule(ModeSchedule((Mode("default"),) * 2, (0.53,)))
    t = 0.0
    for k in range(30):
        solver.iterate(np.array([0.7 * t]), t, 0.0 if k == 0 else 0.01)
        if k:
            np.testing.assert_allclose(solver.ws.x[:, 0], 0.7 * (t + solver.ws.grid), atol=1e-9)
            assert np.abs(solver.ws.grid + t - 0.53).min() < 1e-12
        t += 0.01


def test_the_cost_counts_every_interval_once() -> None:
    """Intervals that end with a jump too: the sum written out."""
    found = ball().solve(np.array([1.5, 0.0]), 0.0)
    off, h = found.x - [1.0, 0.0], np.diff(found.times)
    state = 20.0 * off[:, 0] ** 2 + off[:, 1] ** 2
    path = h @ (state[:-1] + 0.01 * found.u[:, 0] ** 2)
    assert found.cost == pytest.approx(0.5 * (path + state[-1]), rel=1e-9)


def test_events_in_the_last_interval_get_nodes_too() -> None:
    grid = grid_for(np.linspace(0.0, 2.0, 21), [1.91, 1.95, 1.99], 0.0)
    for event in (1.91, 1.95, 1.99):
        assert np.abs(grid - event).min() < 1e-12
    assert np.all(np.diff(grid) > 1e-3)


def test_more_events_than_nodes_are_rejected() -> None:
    solver = ball(n=3)
    solver.set_schedule(ModeSchedule((DOWN, UP, DOWN, UP), (0.2, 0.4, 0.6)))
    with pytest.raises(InputError, match="3 events within the horizon, but 2 inner nodes"):
        solver.solve(np.array([1.0, 0.0]))


def test_events_of_a_state_that_jumps_need_intervals_of_their_own() -> None:
    """An interval of a fixed grid applies one jump: two events within it are rejected, counted in flight, and named."""
    solver = ball(False)
    close = ModeSchedule((DOWN, UP, DOWN, UP), (0.31, 0.32, 0.55))
    solver.set_schedule(close)
    with pytest.raises(InputError, match=r"events at 0.31 and 0.32 s can fall .* valid: align_events=True"):
        solver.solve(np.array([1.0, 0.0]))
    # truth: by hand, intervals of 0.1 s; an event on a node ends the interval before it
    lost = {0.0: 1, 0.015: 0, 0.02: 1, 0.315: 0, -0.69: 0, -0.61: 1}
    solver.data.schedule = ModeSchedule((DOWN, UP, DOWN), (0.31, 0.32))
    for t0, count in lost.items():
        assert solver.events_without_node(t0) == count, t0
    solver.data.schedule = ModeSchedule((DOWN, UP, DOWN), (0.3, 0.35))
    assert solver.events_without_node(0.0) == 0
    mpc = MPC(solver.ocp, rate=10.0)
    mpc.set_schedule(ModeSchedule((DOWN, UP, DOWN), (0.3, 0.4)))
    with pytest.raises(InputError, match=r"events at 0.31 and 0.32 s"):
        mpc.set_schedule(close)
    mpc.solver.set_schedule(close)
    mpc.update(Observation(0.0, np.array([1.0, 0.0])))
    assert mpc.solve_info["events_without_node"] == 1
