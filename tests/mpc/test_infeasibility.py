"""Equalities that contradict each other, in an MPC. Truth: no number is both 1 and 2; where only one row counts, u = 1."""

from __future__ import annotations

import logging

import casadi as ca
import numpy as np
import pytest

from realtime_toys import START, ToyController, ToyRobot
from toys import Rows, ToyDynamics
from wbmpc.errors import RunAborted
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Constraint, Cost, Mode, ModeSchedule, OptimalControlProblem
from wbmpc.runtime.clock import VirtualClock
from wbmpc.runtime.runner import RealTimeRunner
from wbmpc.runtime.safety import RealTimeSettings
from wbmpc.solver import SQP, Solver, Status
from wbmpc.types import Observation

#: From this time [s] on the second row counts too.
LATER = 2.0


def contradictory(size: float = 1.0, softness: float = 0.0) -> OptimalControlProblem:
    """ẍ = u0 + u1 + u2; u0 = ``size``, and in mode "both" u0 = 2 ``size`` too."""
    dynamics = ToyDynamics(2, 3, lambda x, u, w, m: ca.vertcat(x[1], ca.sum1(u)))
    ocp = OptimalControlProblem(dynamics, 1.0, 20)
    ocp.add(Cost("state", Rows(2, lambda s: s.x), [10.0, 1.0], at="path+terminal", terminal_weight=[50.0, 10.0]))
    ocp.add(Cost("input", Rows(3, lambda s: s.u), 0.1))
    ocp.add(Constraint("one", Rows(1, lambda s: s.u[0] - size)))
    ocp.add(Constraint("two", Rows(1, lambda s: s.u[0] - 2.0 * size), modes=("both",), softness=softness))
    return ocp


def make(size: float = 1.0, event: float = LATER, softness: float = 0.0) -> MPC:
    mpc = MPC(contradictory(size, softness), rate=50.0, first_iterations=10)
    mpc.set_schedule(ModeSchedule((Mode("one"), Mode("both")), (event,)))
    mpc.reset(START)
    return mpc


class Summing(ToyController):
    """The trolley is pushed by all three inputs together."""

    def _input(self, policy, t, x):  # type: ignore[no-untyped-def]
        return 0.0 if policy is None else float(policy(t, x).sum())

    def command(self, t, plans):  # type: ignore[no-untyped-def]
        self.measured_input = plans.current(t)
        return super().command(t, plans)


@pytest.mark.parametrize("size", [1.0, 300.0])
def test_a_contradiction_is_a_failed_solve_that_names_its_row(size: float, caplog: pytest.LogCaptureFixture) -> None:
    mpc = make(size)
    with caplog.at_level(logging.WARNING, "wbmpc"):
        for k in range(150):
            t = 0.02 * k
            policy = mpc.update(Observation(t, START))
            if t < LATER - 1e-9:
                assert not mpc.fault
                np.testing.assert_allclose(policy(t)[0], size, rtol=1e-6)
                last = policy
            else:
                assert policy is last and mpc.fault.startswith("failed: the planned inputs miss an equality")
                assert "one.all[0]" in mpc.fault or "two.all[0]" in mpc.fault
    assert mpc.statistics.failures == 50
    reported = [r.getMessage() for r in caplog.records]
    assert len(reported) == 1 and reported[0].startswith("MPC at 2.000 s: failed: the planned inputs miss an equality")


def test_from_the_start_it_is_rejected() -> None:
    with pytest.raises(RunAborted, match="the first solve failed: the planned inputs miss an equality"):
        make(event=-1.0).update(Observation(0.0, START))


def test_a_soft_term_is_no_contradiction() -> None:
    mpc = make(softness=0.01)
    for k in range(150):
        mpc.update(Observation(0.02 * k, START))
    assert mpc.statistics.failures == 0


def test_what_the_solver_says() -> None:
    solver = Solver(contradictory(), SQP.real_time())
    solver.set_schedule(ModeSchedule((Mode("both"),)))
    found = solver.solve(START)
    assert found.status is Status.EQUALITY_INFEASIBLE and not found.usable
    assert "% of the row's size, at the first input" in str(found)


def test_the_runner_stops_after_the_last_policys_horizon(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL + 1, "wbmpc")
    clock = VirtualClock()
    runner = RealTimeRunner(ToyRobot(clock), Summing(1.0 / 400.0), make(event=1.0), RealTimeSettings(), clock)
    report = runner.run(3.0)
    assert runner.stopped and report.failures > 40
    assert report.state.startswith("stopped at 1.9"), report.state  # the last good solve is that of 0.98 s, for 1 s
    assert "solves failed, the last one: failed: the planned inputs miss an equality (" in report.state
