"""Hard bounds of the inputs in policies. Truth: a trolley's bounds as they were typed in, an affine law written out."""

from __future__ import annotations

import logging
import tracemalloc
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from realtime_toys import Force, Measured, ToyController, ToyRobot
from toys import Rows, ToyDynamics
from wbmpc.errors import InputError, NotFinite
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.policy import InputLimits, Policy
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.ocp import Constraint, Cost, Mode, ModeSchedule, OptimalControlProblem
from wbmpc.ocp.sets import Box, NonNegative
from wbmpc.runtime.clock import VirtualClock
from wbmpc.runtime.runner import RealTimeRunner
from wbmpc.runtime.safety import RealTimeSettings
from wbmpc.runtime.shared_memory import Mailbox, Sizes, TimedPolicy
from wbmpc.solver import ILQR, SLQ, SQP, InteriorPoint
from wbmpc.types import Observation

PERIOD, LOWER, UPPER = 1.0 / 400.0, -0.6, 0.9
#: From here the plan is far from its bounds: at them the gains of these inputs are nearly zero.
START = np.array([0.05, 0.0])


def trolley(*more: Constraint) -> OptimalControlProblem:
    """ẍ = u0 + u1 to the origin, LOWER ≤ u0 ≤ UPPER."""
    dynamics = ToyDynamics(2, 2, lambda x, u, w, m: ca.vertcat(x[1], u[0] + u[1]))
    ocp = OptimalControlProblem(dynamics, 1.0, 20)
    ocp.add(Cost("state", Rows(2, lambda s: s.x), [10.0, 1.0], at="path+terminal", terminal_weight=[50.0, 10.0]))
    ocp.add(Cost("input", Rows(2, lambda s: s.u), 0.1))
    ocp.add(Constraint("bounds", Rows(1, lambda s: s.u[0]), Box(LOWER, UPPER), hard=True))
    for constraint in more:
        ocp.add(constraint)
    return ocp


@pytest.fixture(scope="module")
def mpc() -> MPC:
    found = MPC(trolley(), rate=50.0, first_iterations=10)
    found.reset(START)
    return found


def test_after_a_push_the_policy_is_at_its_bound(mpc: MPC) -> None:
    """Only what has a bound is cut; what feedback asks for can be had too."""
    policy = mpc.update(Observation(0.0, START))
    for push in ([2.0, 8.0], [-2.0, -8.0], [0.0, 1e-3]):
        x = policy.x[0] + np.array(push)
        asked = policy.u[0] + policy.gain[0] @ (x - policy.x[0])
        previous = mpc.limits.count
        given = policy(0.0, x)
        np.testing.assert_allclose(policy.law(0.0, x), asked, atol=1e-12)
        np.testing.assert_allclose(given, [np.clip(asked[0], LOWER, UPPER), asked[1]], atol=1e-12)
        assert mpc.limits.count - previous == (not LOWER <= asked[0] <= UPPER) == (abs(push[1]) > 1.0)


def test_threads_and_policies_of_several_sizes_do_not_disturb_each_other() -> None:
    """Memory of evaluations is shared by all policies of a thread. Truth: the affine law written out."""
    rng = np.random.default_rng(3)

    def made(nx: int, nu: int) -> Policy:
        return Policy(np.arange(4.0), rng.normal(size=(4, nx)), rng.normal(size=(3, nu)), rng.normal(size=(3, nu, nx)))

    policies = [made(2, 1), made(5, 3), made(5, 3)]
    states = [[rng.normal(size=p.x.shape[1]) for _ in range(50)] for p in policies]

    def wrong(_: int) -> float:
        apart = 0.0
        for k in range(50):
            for p, xs in zip(policies, states, strict=True):
                apart = max(apart, np.abs(p.law(1.0, xs[k]) - (p.u[1] + p.gain[1] @ (xs[k] - p.x[1]))).max())
        return apart

    with ThreadPoolExecutor(4) as pool:
        assert max(pool.map(wrong, range(8))) < 1e-12


def test_a_state_of_another_shape_is_an_error_and_not_spread(mpc: MPC) -> None:
    """NumPy would take one number for all of a state, and plan and feedback would not say so."""
    policy = mpc.update(Observation(0.0, np.zeros(2)))
    for x in (1.0, np.ones(1), np.ones((2, 1)), np.ones((1, 2)), np.ones(0), np.ones(3)):
        for ask in (policy, policy.law):
            with pytest.raises(InputError, match=r"policy: a state of 2 numbers is needed, got shape"):
                ask(0.0, x)
    for ask in (policy.state, policy.feedforward, policy.planned, policy):
        for t in (np.nan, np.inf, -np.inf, 10**400):
            with pytest.raises(NotFinite, match="policy: time and state must be finite"):
                ask(t)
        for t in (None, "1.0", [0.0], 1j, np.zeros(2), ca.DM.zeros(2)):
            with pytest.raises(InputError, match="policy: a time in seconds is needed, got"):
                ask(t)  # type: ignore[arg-type]
    gain = np.broadcast_to([[1e200, -1e200]], policy.gain.shape)
    with pytest.raises(NotFinite, match="so far from the plan"):
        Policy(policy.times, policy.x, policy.u, gain, limits=policy.limits)(0.0, np.full(2, 1e200))


@pytest.mark.parametrize(
    "wrong",
    [
        {"gain": np.ones((2, 2, 3))}, {"gain": np.ones((4, 3, 2))}, {"x": np.ones((2, 3))}, {"times": np.arange(3.0)},
        {"u": np.ones((0, 2))}, {"active": np.ones((4, 1))}, {"limits": InputLimits(np.zeros(1), np.ones(1))},
    ],
)  # fmt: skip
def test_arrays_that_do_not_fit_are_an_error_and_not_read_beyond_their_end(wrong: dict[str, Any]) -> None:
    fine = Policy(np.arange(5.0), np.ones((5, 3)), np.ones((4, 2)), np.ones((4, 2, 3)))
    np.testing.assert_array_equal(fine(0.5, np.ones(3)), [1.0, 1.0])
    with pytest.raises(InputError, match=r"policy: .*needed"):
        replace(fine, **wrong)(3.5, np.zeros(3))


def test_bounds_in_any_spelling_but_not_soft_or_switched_ones() -> None:
    """Beside rows of several variables, and scaled; soft ones, ranges of states and bounds of one mode do not count."""
    mixed = Rows(3, lambda s: ca.vertcat(4.0 - 2.0 * s.u[1], 3.0 + s.u[0] - s.x[1], 0.5 * (s.u[1] + 3.0)))
    problem = trolley(
        Constraint("mixed", mixed, NonNegative(), hard=True),
        Constraint("soft", Rows(1, lambda s: s.u[0]), Box(-0.1, 0.1)),
        Constraint("range", Rows(1, lambda s: s.x[0]), Box(-5.0, 5.0), hard=True),
        Constraint("mode", Rows(1, lambda s: s.u[0]), Box(-0.1, 0.1), hard=True, modes=("narrow",)),
    )
    mpc = MPC(problem)
    mpc.set_schedule(ModeSchedule((Mode("wide"), Mode("narrow")), (9.0,)))
    np.testing.assert_allclose(mpc.limits.lower, [LOWER, -3.0])
    np.testing.assert_allclose(mpc.limits.upper, [UPPER, 2.0])


def test_rounding_is_cut_but_not_counted() -> None:
    limits = InputLimits(np.array([-2.0]), np.array([2.0]))
    np.testing.assert_array_equal(limits.hold(np.array([2.0 + 1e-12])), [2.0])
    assert limits.count == 0
    np.testing.assert_array_equal(limits.hold(np.array([-2.001])), [-2.0])
    assert limits.count == 1


def test_holding_keeps_no_memory(mpc: MPC) -> None:
    policy = mpc.update(Observation(1.0, START))
    x = policy.x[0] + [2.0, 8.0]
    tracemalloc.start()
    try:
        seen = []
        for _ in range(2):
            for _ in range(1000):
                policy(1.0, x)
            seen.append(tracemalloc.get_traced_memory()[0])
        assert seen[1] - seen[0] < 500  # numbers of the counters
    finally:
        tracemalloc.stop()


def test_the_bounds_travel_with_the_policy(mpc: MPC) -> None:
    """As a message between processes does: the other side has no problem, only numbers."""
    policy = mpc.update(Observation(2.0, START))
    box = Mailbox(Sizes.of(mpc.ocp).policy())
    box.write(
        observed=0.0, valid_from=0.0, ready=0.0, observation=1, limit_violation=0.0, times=policy.times, x=policy.x, u=policy.u,
        gain=policy.gain, lower=mpc.limits.lower, upper=mpc.limits.upper, matrix=mpc.limits.matrix, offset=mpc.limits.offset,
        active=np.zeros((20, 0)),
    )  # fmt: skip
    taken = TimedPolicy.take(box)
    assert taken is not None and taken.limits is not None
    x = policy.x[0] + [2.0, 8.0]
    np.testing.assert_array_equal(taken(2.0, x), policy(2.0, x))
    assert taken(2.0, x)[0] == LOWER and taken.limits.count == 2


class Plain(ToyController):
    """Sends what the policy says, and does not count anything."""

    def __init__(self) -> None:
        super().__init__(PERIOD)
        del self.clamped
        self.sent: list[np.ndarray] = []
        self.asked: list[np.ndarray] = []

    def command(self, t: float, plans: PolicyQueue) -> Force:
        assert plans.current is not None
        self.sent.append(plans.current(t, self.measured.x))
        self.asked.append(plans.current.law(t, self.measured.x))
        return Force(np.array([self.sent[-1].sum()]))

    def _input(self, policy, t, x):  # type: ignore[no-untyped-def]
        return 0.0 if policy is None else float(policy(t, x).sum())


def test_the_runner_holds_the_bounds_and_counts(caplog: pytest.LogCaptureFixture) -> None:
    """A plant that is knocked by 1 m/s: commands stay inside, and the ticks at which they were cut are counted."""
    caplog.set_level(logging.CRITICAL + 1, "wbmpc")

    def knock(robot: ToyRobot) -> None:
        if robot.reads in (240, 305):
            robot.x = robot.x + np.array([0.0, 1.0])
            robot.frozen = Measured(robot.clock.now(), robot.x)
        else:
            robot.frozen = None

    clock, controller = VirtualClock(0.004), Plain()
    mpc = MPC(trolley(), rate=50.0, first_iterations=10)
    mpc.reset(START)
    report = RealTimeRunner(ToyRobot(clock, knock), controller, mpc, RealTimeSettings(), clock).run(2.0)
    asked, sent = np.array(controller.asked)[:, 0], np.array(controller.sent)[:, 0]
    outside = (asked > UPPER + 1e-8) | (asked < LOWER - 1e-8)
    assert sent.min() == LOWER and sent.max() <= UPPER
    assert 0 < report.clamped == outside.sum() < 20


# ---------------------------------------------------------------------- rows of several inputs, bounds of some modes
SUM = 1.2


def planes() -> OptimalControlProblem:
    """u0 + 2 u1 ≤ SUM always, |u1| ≤ 0.1 in mode "narrow", u0² + u1² ≤ 9 (curved: in the plan only)."""
    return trolley(
        Constraint("sum", Rows(1, lambda s: SUM - s.u[0] - 2.0 * s.u[1]), NonNegative(), hard=True),
        Constraint("mode", Rows(1, lambda s: s.u[1]), Box(-0.1, 0.1), hard=True, modes=("narrow",)),
        Constraint("disc", Rows(1, lambda s: 9.0 - s.u[0] ** 2 - s.u[1] ** 2), NonNegative(), hard=True),
        Constraint("with state", Rows(1, lambda s: 9.0 - s.u[0] - s.x[0]), NonNegative(), hard=True),
    )


#: By name: rows of inputs, whether a policy can hold them, and where that is so the input at which the row ends as seen from 0.
HELD = {
    "square": (lambda s: 25.0 - s.u[0] ** 2, 0, False),
    "two sides": (lambda s: 5.0 - ca.fabs(s.u[0]), 0, False),
    "saturation": (lambda s: 0.9 - ca.tanh(s.u[0]), 0, False),
    "disc": (lambda s: 9.0 - ca.sumsqr(s.u), 0, False),
    "product": (lambda s: 1.0 - s.u[0] * s.u[1], 0, False),
    "around a sine": (lambda s: 5.0 - s.u[0] + ca.sin(s.reference), 1, False),
    "around a reference": (lambda s: 5.0 - s.u[0] + 2.0 * s.reference, 1, True),
    "plane": (lambda s: 5.0 - s.u[0] - 2.0 * s.u[1], 0, True),
    "square in disguise": (lambda s: 5.0 - s.u[0] * ((s.u[0] + 1.0) - s.u[0]), 0, True),
    "with a state": (lambda s: 5.0 - s.u[0] * s.x[0], 0, True),
}


@pytest.mark.parametrize("name", HELD)
@pytest.mark.parametrize("modes", [None, ("narrow",)])
def test_rows_that_no_policy_can_hold_are_an_error_that_names_them(name: str, modes: tuple[str, ...] | None) -> None:
    """Truth: whether the row's slope by the inputs and references is a constant, by hand."""
    row, width, held = HELD[name]
    ocp = trolley(Constraint("row", Rows(1, row, width), NonNegative(), hard=True, modes=modes))
    interpreted = SQP.real_time(backend="interpreted")
    if held:
        MPC(ocp, interpreted)
        return
    with pytest.raises(InputError, match=r"hard row 'row.all\[0\]' limits inputs .*plan_only_limits=True"):
        MPC(ocp, interpreted)
    MPC(ocp, interpreted, plan_only_limits=True)


@pytest.fixture(scope="module")
def several() -> MPC:
    found = MPC(planes(), rate=50.0, first_iterations=10, plan_only_limits=True)
    found.set_schedule(ModeSchedule((Mode("wide"), Mode("narrow")), (0.5,)))
    found.reset(START)
    return found


def slacks(u: np.ndarray, narrow: bool) -> np.ndarray:
    """As typed in above; bounds of u0 last."""
    return np.array(
        [
            SUM - u[0] - 2.0 * u[1],
            0.1 - u[1] if narrow else 1.0,
            0.1 + u[1] if narrow else 1.0,
            u[0] - LOWER,
            UPPER - u[0],
        ]
    )


@pytest.mark.parametrize("t", [0.0, 0.7])
def test_feedback_is_scaled_back_to_rows_of_several_inputs(several: MPC, t: float) -> None:
    """By as little as holds them, and each time is counted; a push that asks for nothing outside is left alone."""
    policy, narrow, cut = several.update(Observation(0.0, START)), t > 0.5, 0
    k = int(np.searchsorted(policy.times, t + 1e-9, side="right")) - 1
    for push in ([2.0, 8.0], [-2.0, -8.0], [-0.3, -0.5], [0.0, 1e-4]):
        x = policy.state(t) + np.array(push)
        own = 0.1 if narrow else np.inf  # a bound of a mode cuts its input alone, as one that always counts
        asked = np.clip(policy.law(t, x), [LOWER, -own], [UPPER, own])
        outside = slacks(asked, narrow).min() < -1e-9
        previous, given = several.limits.count, policy(t, x)
        assert slacks(given, narrow).min() > -1e-9
        assert several.limits.count - previous == (outside or not np.allclose(asked, policy.law(t, x)))
        cut += not np.allclose(given, policy.law(t, x))
        shares = (given - policy.u[k])[asked != policy.u[k]] / (asked - policy.u[k])[asked != policy.u[k]]
        np.testing.assert_allclose(shares, shares[0], rtol=1e-9)  # along the line from the plan
        if outside:
            assert slacks(given, narrow).min() < 1e-9 and 0.0 <= shares[0] < 1.0  # not more than needed
        else:
            np.testing.assert_array_equal(given, asked)
    assert cut >= 1


def test_the_plan_itself_is_not_cut(several: MPC) -> None:
    policy = several.update(Observation(0.0, START))
    previous = several.limits.count
    for t in np.linspace(0.0, 1.0, 30):
        np.testing.assert_array_equal(policy(t), policy.feedforward(t))
        x, u = policy.planned(t)
        np.testing.assert_array_equal(x, policy.state(t))
        np.testing.assert_array_equal(u, policy.feedforward(t))
    assert several.limits.count == previous


def test_rows_travel_with_the_policy(several: MPC) -> None:
    policy = several.update(Observation(0.0, START))
    sizes = Sizes.of(several.ocp)
    assert sizes.rows == 3 and sizes == Sizes.of(several.ocp, several.solver.problem)
    box = Mailbox(sizes.policy())
    box.write(
        observed=0.0, valid_from=0.0, ready=0.0, observation=1, limit_violation=0.0, times=policy.times, x=policy.x, u=policy.u,
        gain=policy.gain, lower=several.limits.lower, upper=several.limits.upper, matrix=several.limits.matrix,
        offset=several.limits.offset, active=policy.active,
    )  # fmt: skip
    taken = TimedPolicy.take(box)
    assert taken is not None and taken.limits is not None
    for t in (0.0, 0.7):
        x = policy.state(t) + [-2.0, -8.0]
        np.testing.assert_array_equal(taken(t, x), policy(t, x))
    assert taken.limits.count == 2


def test_a_plan_at_its_row_gives_nothing_and_one_beyond_is_not_made_worse() -> None:
    limits = InputLimits(np.full(2, -9.0), np.full(2, 9.0), np.array([[-1.0, -1.0]]), np.array([1.0]))
    for planned in ([0.5, 0.5], [0.5, 0.5005]):
        np.testing.assert_array_equal(limits.hold(np.array([3.0, 0.5]), np.array(planned)), planned)
        inside = np.array([0.2, 0.2])
        np.testing.assert_array_equal(limits.hold(inside.copy(), np.array(planned)), inside)
    np.testing.assert_allclose(limits.hold(np.array([2.0, 0.0]), np.zeros(2)), [1.0, 0.0])
    assert limits.count == 3


def test_a_bound_of_a_mode_holds_where_the_plan_itself_is_beyond_it() -> None:
    """Its row counts in one mode alone, so that it is no bound of the table. Truth: by hand."""
    limits = InputLimits(np.full(2, -9.0), np.full(2, 9.0), np.array([[-2.0, 0.0]]), np.array([1.0]))
    planned = np.array([0.5004, 3.0])
    np.testing.assert_array_equal(limits.hold(planned.copy()), [0.5, 3.0])
    np.testing.assert_array_equal(limits.hold(np.array([0.7, 4.0]), planned), [0.5, 4.0])
    np.testing.assert_array_equal(limits.hold(planned.copy(), active=np.zeros(1)), planned)
    assert limits.count == 2


def test_a_row_takes_feedback_from_the_inputs_that_it_couples_alone() -> None:
    """Rows u0 + u1 ≤ 1 and u1 + u2 ≤ 1 couple three inputs; u3 has a row of its own, u4 none. Truth: by hand."""
    rows = -np.array([[1.0, 1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 2.0, 0.0]])
    limits = InputLimits(np.full(5, -9.0), np.full(5, 9.0), rows, np.ones(3))
    np.testing.assert_allclose(limits.hold(np.array([4.0, 0.0, 0.4, 0.3, 7.0]), np.zeros(5)), [1.0, 0.0, 0.1, 0.3, 7.0])
    np.testing.assert_allclose(limits.hold(np.array([0.4, 0.0, 0.4, 2.0, 7.0]), np.zeros(5)), [0.4, 0.0, 0.4, 0.5, 7.0])


def test_inputs_of_a_plan_beyond_its_bounds_are_cut_after_the_rows() -> None:
    limits = InputLimits(np.full(2, -1.0), np.full(2, 1.0), np.array([[-1.0, -1.0]]), np.zeros(1))
    np.testing.assert_array_equal(limits.hold(np.array([3.0, 3.0]), np.array([1.7, -1.7])), [1.0, -1.0])


def test_a_row_at_its_limit_leaves_a_pole_its_balance() -> None:
    """A base whose two drives are at the sum's limit, a pole on an input of its own, pushed: it comes back under feedback alone."""
    system = ToyDynamics(3, 3, lambda x, u, w, m: ca.vertcat(u[0] + u[1], x[2], 16.0 * x[1] + u[2]))
    ocp = OptimalControlProblem(system, 2.0, 50)
    ocp.add(Cost("error", Rows(3, lambda s: s.x - np.array([5.0, 0.0, 0.0])), [10.0, 10.0, 1.0], at="path+terminal"))
    ocp.add(Cost("effort", Rows(3, lambda s: s.u), 0.01))
    ocp.add(Constraint("sum", Rows(1, lambda s: s.u[0] + s.u[1]), Box(-1.0, 1.0), hard=True))
    mpc = MPC(ocp, rate=50.0)
    policy = mpc.update(Observation(0.0, np.zeros(3)))
    x, t = np.array([-0.3, 0.0, 0.1]), 0.0
    for _ in range(200):
        u = policy(t, x)
        assert u[0] + u[1] <= 1.0 + 1e-6
        x, t = mpc.solver.simulate(x, u, 0.005), t + 0.005
    assert policy.limits is not None and policy.limits.count > 50
    assert abs(x[1]) < 1e-3


def test_rows_count_on_the_grid_that_the_solver_refines() -> None:
    """Twice as fine as the problem's: the policy and which rows count in which mode, as typed in above."""
    mpc = MPC(planes(), SLQ.real_time(step=0.025, backend="interpreted"), first_iterations=1, plan_only_limits=True)
    mpc.set_schedule(ModeSchedule((Mode("wide"), Mode("narrow")), (0.5,)))
    mpc.reset(START)
    policy = mpc.update(Observation(0.0, START))
    assert policy.active is not None and policy.active.shape == (40, 3) == (
        len(policy.u),
        Sizes.of(mpc.solver.ocp).rows,
    )
    np.testing.assert_array_equal(policy.active.sum(axis=1), [1.0] * 20 + [3.0] * 20)
    for t in (0.0, 0.7):
        assert slacks(policy(t, policy.state(t) + [-2.0, -8.0]), t > 0.5).min() > -1e-9


@pytest.mark.parametrize(
    "settings", [SQP(), ILQR(), SQP(compute_kkt=False), SQP(interior_point=InteriorPoint("real_time"))]
)
def test_settings_under_which_missed_limits_are_not_reported_are_rejected(settings: SQP) -> None:
    with pytest.raises(InputError, match=r"valid: (SQP|ILQR)\.real_time"):
        MPC(trolley(), settings)


def test_terms_that_come_too_late_are_rejected_by_name(mpc: MPC) -> None:
    solver, late = mpc.solver, Constraint("late", Rows(1, lambda s: s.u[1]), Box(-0.1, 0.1), hard=True)
    solver.ocp.add(late)
    with pytest.raises(InputError, match="term 'late': added, replaced or removed after"):
        solver.solve(START)
    with pytest.raises(InputError, match="term 'late': added, replaced or removed after"):
        mpc.update(Observation(100.0, START))
    del solver.ocp.terms["late"]
    previous = solver.ocp.terms["bounds"]
    solver.ocp.terms["bounds"] = late
    with pytest.raises(InputError, match="term 'late'"):
        solver.iterate(START)
    solver.ocp.terms["bounds"] = previous
    solver.iterate(START)


def test_rows_that_share_inputs_are_one_group() -> None:
    """Truth: a walk from row to row over inputs that both depend on."""
    rng = np.random.default_rng(7)
    for _ in range(40):
        r, nu = rng.integers(1, 9), rng.integers(1, 10)
        matrix = rng.normal(size=(r, nu)) * (rng.random((r, nu)) < 0.25)
        bounds, offset = rng.normal(size=(2, nu)), rng.normal(size=r)
        parts = np.split(InputLimits(*bounds, matrix, offset).table, np.cumsum([nu, nu, r * nu, r, r * nu]))
        for found, given in zip(parts, (*bounds, matrix.ravel(), offset), strict=False):
            np.testing.assert_array_equal(found, given)
        own = [set(np.flatnonzero(row)) for row in matrix]
        for row in range(r):
            there, inputs = {row}, own[row]
            while more := {k for k in range(r) if own[k] & inputs} - there:
                there, inputs = there | more, inputs.union(*(own[k] for k in more))
            assert set(np.flatnonzero(parts[4].reshape(r, nu)[row])) == inputs
            assert parts[5][row] == (next(iter(own[row])) if len(own[row]) == 1 else -1.0)
