"""Planned states outside hard limits, in real time. Truth: the limits as they were typed in, looked at in the plans themselves;
where a limit can be held, a trolley's brake: it stops from speed v within v / a seconds."""

from __future__ import annotations

import logging

import casadi as ca
import numpy as np
import pytest

from effort import some
from realtime_toys import ToyController, ToyRobot
from toys import Rows, ToyDynamics
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.policy import Policy
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem
from wbmpc.ocp.sets import Box
from wbmpc.runtime.clock import VirtualClock
from wbmpc.runtime.runner import RealTimeRunner
from wbmpc.runtime.safety import RealTimeSettings
from wbmpc.solver import SQP, InteriorPoint, Solver, Status
from wbmpc.types import Observation

FASTEST, HARDEST = 0.5, 2.0
RANGE = 2.0 * FASTEST


def trolley(backend: str = "compiled", at: str = "path+terminal") -> OptimalControlProblem:
    """ẍ = u to the origin, |ẋ| ≤ FASTEST, |u| ≤ HARDEST."""
    ocp = OptimalControlProblem(ToyDynamics(2, 1, lambda x, u, w, m: ca.vertcat(x[1], u[0])), 1.0, 20)
    ocp.add(Cost("state", Rows(2, lambda s: s.x), [10.0, 1.0], at="path+terminal", terminal_weight=[50.0, 10.0]))
    ocp.add(Cost("input", Rows(1, lambda s: s.u), 0.1))
    ocp.add(Constraint("force", Rows(1, lambda s: s.u), Box(-HARDEST, HARDEST), hard=True))
    ocp.add(Constraint("speed", Rows(1, lambda s: s.x[1]), Box(-FASTEST, FASTEST), hard=True, at=at))  # type: ignore[arg-type]
    return ocp


def outside(x: np.ndarray) -> float:
    """Of planned states (N + 1, 2) from node 1 on, as a share of the range; 0 up to 0.1 %."""
    share = float((np.abs(x[1:, 1]) - FASTEST).max() / RANGE)
    return share if share > 1e-3 else 0.0


def drive(mpc: MPC, speed: float, steps: int = 60) -> list[Policy]:
    """At rest for 10 steps, then the trolley is knocked to ``speed``."""
    x, policies = np.zeros(2), []
    mpc.reset(x)
    for k in range(steps):
        x = x + np.array([0.0, speed]) * (k == 10)
        policies.append(mpc.update(Observation(0.02 * k, x)))
        x = mpc.solver.simulate(x, policies[-1].u[0], 0.02)
    return policies


@pytest.mark.parametrize("at", ["path", "terminal", "path+terminal"])
def test_plans_outside_are_counted_and_named(at: str) -> None:
    """1.5 m/s: the force brings it back within 0.5 s; at the end of the horizon it never was outside."""
    mpc = MPC(trolley(at=at))
    policies = drive(mpc, 1.5)
    found = np.array([outside(p.x[-2:] if at == "terminal" else p.x) for p in policies])
    np.testing.assert_allclose([p.limit_violation for p in policies], found, atol=1e-12)
    s = mpc.statistics
    assert s.limit_violations == (found > 0.0).sum() and s.worst_limit_violation == found.max()
    assert (s.limit_violations == 0) == (at == "terminal")
    if s.limit_violations:
        assert 15 <= s.limit_violations <= 35 and found.argmax() == 10
        start = f"hard limit missed: speed.all[0] <= 0.5 by {RANGE * found.max():.3g} at node 1, where its slack gives way, at 0.2"
        assert s.worst_limit_violation_message.startswith(start)
        assert "speed.all[0] <= 0.5" in mpc.limit_violation_message() or mpc.limit_violation == 0.0


def test_none_is_counted_where_all_are_inside() -> None:
    mpc = MPC(trolley())
    policies = drive(mpc, 0.45)
    assert mpc.statistics.limit_violations == 0 and all(p.limit_violation == 0.0 for p in policies)
    assert max(np.abs(p.x[:, 1]).max() for p in policies) < FASTEST + 1e-3


@pytest.mark.parametrize("speed", some([0.7, 1.5, -3.0], [1]))
def test_plans_start_where_the_robot_is(speed: float) -> None:
    """Outside the limit too: steps from a plan that is inside were cut again and again, and for 0.1 s plans started inside."""
    solvers = [Solver(trolley(), SQP.real_time(backend=name)) for name in ("compiled", "interpreted")]
    for k, x in enumerate(([0.0, 0.0], [0.0, 0.0], [0.0, speed], [0.02 * speed, 0.98 * speed])):
        for s in solvers:
            s.iterate(np.array(x), 0.02 * k, 0.02 if k else 0.0)
    first, twin = (s.trajectory() for s in solvers)
    assert np.abs(first.x[0] - x).max() < 0.05 * abs(speed)
    assert first.u[0, 0] * np.sign(speed) < 0.95 * -HARDEST  # it brakes
    near = 1e-9 if abs(speed) < 2.0 else 2e-3  # six times the limit: roundings grow, and differ among processors
    np.testing.assert_allclose(twin.x, first.x, atol=near)
    np.testing.assert_allclose(solvers[1].limit_violation, solvers[0].limit_violation, atol=near)


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_the_message_of_a_solve(backend: str) -> None:
    solver = Solver(trolley(), SQP.real_time(5, backend=backend))
    for _ in range(3):
        found = solver.solve(np.array([0.0, -1.5]))
    assert found.status is Status.ITERATION_LIMIT and found.usable
    assert solver.limit_violation == pytest.approx(outside(found.x), abs=1e-12) and solver.limit_violation > 0.4
    assert "hard limit missed: speed.all[0] >= -0.5 by 0.9" in str(
        found
    ) and "node 1, where its slack gives way" in str(found)


NEVER_MORE = SQP.real_time(interior_point=InteriorPoint("real_time", max_extra_iterations=0))


def test_plans_that_start_elsewhere_are_counted() -> None:
    """Without further iterations steps from inside the limit are cut, and plans begin short of the speed that it was knocked to."""
    mpc, x, found = MPC(trolley(), NEVER_MORE), np.zeros(2), []
    mpc.reset(x)
    for k in range(60):
        x = x + np.array([0.0, 1.5]) * (k == 10)
        policy = mpc.update(Observation(0.02 * k, x))
        found.append(float((np.abs(policy.x[0] - x) / (1.0 + np.abs(x))).max()))
        x = mpc.solver.simulate(x, policy.u[0], 0.02)
    counted = np.array(found) > 1e-3
    assert mpc.statistics.initial_state_mismatches == counted.sum() > 0 and not counted[:10].any()
    assert mpc.statistics.worst_initial_state_mismatch == pytest.approx(max(found), abs=1e-12) and max(found) > 0.05
    whole = MPC(trolley())
    drive(whole, 1.5)
    assert whole.statistics.initial_state_mismatches == 0 and whole.statistics.worst_initial_state_mismatch == 0.0


@pytest.mark.parametrize("settings", [None, NEVER_MORE])
def test_updates_that_cost_more_than_twice_as_much_say_so(settings: SQP | None) -> None:
    """Truth: linearizations of each, counted by the solver; the first plan does not count."""
    mpc, x, said, counted = MPC(trolley(), settings, first_iterations=10), np.zeros(2), [], []
    mpc.reset(x)
    for k in range(60):
        x = x + np.array([0.0, 1.5]) * (k == 10)
        policy = mpc.update(Observation(0.02 * k, x))
        said.append(mpc.solve_info["extended"])
        counted.append(k > 0 and mpc.solver.effort.directions > 2)
        x = mpc.solver.simulate(x, policy.u[0], 0.02)
    assert said == counted and mpc.statistics.extended == sum(counted)
    assert counted[10] == (settings is None)


def runner_of(settings: SQP | None = None) -> tuple[RealTimeRunner, list[float]]:
    """Real time on a virtual clock, knocked after 0.96 s; and how far policies in force pass limits, at every tick."""

    def knock(robot: ToyRobot) -> None:
        if robot.reads == 240:
            robot.x = robot.x + np.array([0.0, 1.5])

    clock = VirtualClock(0.004)
    mpc = MPC(trolley(), settings, rate=50.0, first_iterations=10)
    start = np.array([0.05, 0.0])
    mpc.reset(start)
    runner = RealTimeRunner(ToyRobot(clock, knock, x=start), ToyController(1.0 / 400.0), mpc, RealTimeSettings(), clock)
    seen: list[float] = []
    runner.watch = lambda t, late, plans: seen.append(plans.current.limit_violation)  # type: ignore[union-attr,func-returns-value]
    return runner, seen


def test_the_runner_reports_violations(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL + 1, "wbmpc")
    runner, seen = runner_of()
    report = runner.run(2.0)
    assert not runner.stopped and 15 <= report.limit_violations <= 40
    assert report.worst_limit_violation == max(seen) > 0.3
    assert report.worst_limit_violation_message.startswith("hard limit missed: speed.all[0] <= 0.5 by ")
    assert f"{report.limit_violations} plans outside hard limits, worst " in str(report)
    assert report.initial_state_mismatches == 0 and "start elsewhere" not in str(report)


def test_the_runner_reports_plans_that_start_elsewhere(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL + 1, "wbmpc")
    report = runner_of(NEVER_MORE)[0].run(2.0)
    assert report.initial_state_mismatches >= 20 and 0.05 < report.worst_initial_state_mismatch < 1.0
    assert f"{report.initial_state_mismatches} plans start elsewhere, worst by " in str(report)
