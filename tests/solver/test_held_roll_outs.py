"""Inputs of roll-outs in real time within straight hard rows. Truth: the limits themselves; the interpreted twin.

Feedback around a plan that a push has made worthless asks for many times the limit.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from effort import some
from toys import Rows, ToyDynamics
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem, sets
from wbmpc.solver import ILQR, SLQ, SQP, Solver, Status
from wbmpc.types import Observation

LIMIT, RANGE = 4.0, 8.0
TOLERANCE = 1e-3 * RANGE


def swing_up(*limits: Constraint, n: int = 30) -> OptimalControlProblem:
    """A pendulum, hanging at 0, to be turned up by a motor that is too weak to lift it directly."""
    dynamics = ToyDynamics(2, 1, lambda x, u, w, m: ca.vertcat(x[1], -9.81 * ca.sin(x[0]) + u[0]))
    ocp = OptimalControlProblem(dynamics, 2.0, n)
    ocp.add(Cost("up", Rows(2, lambda s: s.x - ca.DM([np.pi, 0.0])), [5.0, 0.5], at="path+terminal"))
    ocp.add(Cost("motor", Rows(1, lambda s: s.u), 0.05))
    for limit in limits:
        ocp.add(limit)
    return ocp


def motor(bound: float = LIMIT) -> Constraint:
    return Constraint("motor limit", Rows(1, lambda s: s.u), sets.Box(-bound, bound), hard=True)


def at_least(name: str, f, **more: object) -> Constraint:  # type: ignore[no-untyped-def]
    return Constraint(name, Rows(1, f), sets.NonNegative(), hard=True, **more)  # type: ignore[arg-type]


def pushed(rng: np.random.Generator, x: np.ndarray) -> np.ndarray:
    return x + rng.normal(size=2) * [0.5, 3.0]  # type: ignore[no-any-return]


@pytest.mark.parametrize("algorithm", [ILQR, SLQ])
@pytest.mark.parametrize("iterations", [1, 3])
@pytest.mark.parametrize("seed", range(3))
def test_no_plan_is_outside_after_pushes(algorithm: type[SQP], iterations: int, seed: int) -> None:
    mpc, rng, x = (
        MPC(swing_up(motor()), algorithm.real_time(iterations), rate=50.0),
        np.random.default_rng(seed),
        np.zeros(2),
    )
    mpc.reset(x)
    used = 0.0
    for i in range(100):
        x = pushed(rng, x) if i % 20 == 10 else x
        policy = mpc.update(Observation(0.02 * i, x))
        assert not mpc.fault
        used = max(used, float(np.abs(policy.u).max()))
        assert used <= LIMIT + TOLERANCE
        x = mpc.solver.simulate(x, policy.u[0], 0.02)
    assert used > 0.99 * LIMIT  # what the limit allows is used


def test_a_row_of_two_inputs_is_held_too() -> None:
    """|u₁ + u₂| ≤ 4 is no bound of a variable."""
    dynamics = ToyDynamics(2, 2, lambda x, u, w, m: ca.vertcat(x[1], -9.81 * ca.sin(x[0]) + u[0] + 2 * u[1]))
    ocp = OptimalControlProblem(dynamics, 2.0, 30)
    ocp.add(Cost("up", Rows(2, lambda s: s.x - ca.DM([np.pi, 0.0])), [5.0, 0.5], at="path+terminal"))
    ocp.add(Cost("motors", Rows(2, lambda s: s.u), 0.05))
    ocp.add(Constraint("sum", Rows(1, lambda s: s.u[0] + s.u[1]), sets.Box(-LIMIT, LIMIT), hard=True))
    solver, rng = Solver(ocp, ILQR.real_time()), np.random.default_rng(1)
    for _ in range(20):
        found = solver.solve(pushed(rng, np.zeros(2)))
        assert found.usable and not found.detail
        assert np.abs(found.u.sum(axis=1)).max() <= LIMIT + TOLERANCE


@pytest.mark.parametrize("algorithm", some([ILQR, SLQ], [0]))
def test_same_plans_as_the_twin(algorithm: type[SQP]) -> None:
    """With a bound, a row of state and input, and a limit of the state alone."""
    plans = []
    settings = {"step": 0.15} if algorithm is SLQ else {}
    for backend in ("compiled", "interpreted"):
        moving = at_least("moving", lambda s: 9.0 - s.x[1] - 0.5 * s.u[0])
        speed = Constraint("speed", Rows(1, lambda s: s.x[1]), sets.Box(-6.0, 6.0), hard=True)
        solver = Solver(swing_up(motor(), moving, speed, n=8), algorithm.real_time(2, backend=backend, **settings))
        rng = np.random.default_rng(2)
        found = [solver.solve(pushed(rng, np.zeros(2))) for _ in range(3)]
        plans.append(np.concatenate([np.append(f.x.ravel(), f.u.ravel()) for f in found]))
        assert max(np.abs(f.u).max() for f in found) > 0.99 * LIMIT
    np.testing.assert_allclose(*plans, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_limits_that_contradict_each_other_are_reported(backend: str) -> None:
    problem = swing_up(motor(), at_least("more", lambda s: s.u[0] - 5.0), n=8)
    found = Solver(problem, ILQR.real_time(backend=backend)).solve(np.zeros(2))
    assert found.status is Status.INPUT_INFEASIBLE and not found.usable
    assert "motor limit" in found.detail or "more" in found.detail


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_a_limit_of_the_speed_that_the_input_hardly_moves_takes_nothing_from_the_motor(backend: str) -> None:
    """At 9 rad/s the input that would meet 6 − ω − u/1000 ≥ 0 is −3000: its slack gives way, the motor's limit does not."""
    speed = at_least("speed", lambda s: 6.0 - s.x[1] - 1e-3 * s.u[0])
    found = Solver(swing_up(motor(), speed), ILQR.real_time(backend=backend)).solve(np.array([0.0, 9.0]))
    assert found.usable and np.abs(found.u).max() <= LIMIT + TOLERANCE


def test_a_measured_state_far_off_is_no_way_out() -> None:
    """The second solve starts where the first one's feedback asks for thousands."""
    solver = Solver(swing_up(motor()), ILQR.real_time())
    solver.solve(np.zeros(2))
    found = solver.solve(np.array([300.0, -200.0]))
    assert np.abs(found.u).max() <= LIMIT + TOLERANCE
