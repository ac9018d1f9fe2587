"""Hard boxes around a reference in policies, through the public interface. Truth: the bounds as they were typed in, and the
reference's own value at that time."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import wbmpc as wb
from wbmpc.runtime.clock import VirtualClock
from wbmpc.runtime.shared_memory import Board, Mailbox, Sizes, TimedPolicy
from wbmpc.runtime.worker import NUMBERS, RECORDS, WORKER_COMMANDS, Worker

FORCE = 5.0
UPRIGHT = np.array([0.0, np.pi, 0.0, 0.0])
START = np.array([0.0, np.pi + 0.02, 0.0, 0.0])
PUSHED = [np.array([0.0, angle, 0.0, rate]) for angle, rate in ((0.3, 2.0), (-0.3, -2.0), (0.05, 0.2), (0.0, 1e-3))]


def cart_pole(x: ca.SX, u: ca.SX) -> ca.SX:
    """Cart of 1 kg, pole of 0.1 kg at 0.5 m; the angle is π upright."""
    s, c = ca.sin(x[1]), ca.cos(x[1])
    mass = 1.0 + 0.1 * s**2
    cart = (u[0] + 0.1 * s * (0.5 * x[3] ** 2 + 9.81 * c)) / mass
    pole = (-u[0] * c - 0.05 * x[3] ** 2 * c * s - 1.1 * 9.81 * s) / (0.5 * mass)
    return ca.vertcat(x[2], x[3], cart, pole)


def problem(box: wb.sets.Box | None = None, modes: tuple[str, ...] | None = None) -> wb.OptimalControlProblem:
    dynamics = wb.Ode({"x": ["cart", "angle", "cart_rate", "angle_rate"]}, {"u": ["force"]}, cart_pole)
    ocp = wb.OptimalControlProblem(dynamics, horizon=1.0, intervals=25)
    error = wb.residuals.Expression(4, lambda s: s.x - UPRIGHT)
    ocp.add(wb.Cost("state", error, [1.0, 10.0, 0.1, 0.1], at="path+terminal", terminal_weight=[10.0, 100.0, 1.0, 1.0]))
    ocp.add(wb.Cost("effort", wb.residuals.Expression(1, lambda s: s.u), 0.01))
    box = wb.sets.Box(-FORCE, FORCE) if box is None else box
    ocp.add(wb.Constraint("limit", wb.residuals.Input(dynamics), box, hard=True, modes=modes))
    return ocp


def policies(mpc: wb.MPC, count: int = 3) -> list[wb.Policy]:
    mpc.reset(START)
    found, x = [], START
    for k in range(count):
        found.append(mpc.update(wb.Observation(0.02 * k, x)))
        x = found[-1].state(0.02 * (k + 1))
    return found


@pytest.fixture(scope="module")
def plain() -> wb.MPC:
    return wb.MPC(problem(), rate=50.0)


def test_a_cart_pole_never_gets_more_than_its_limit_whatever_feedback_asks_for(plain: wb.MPC) -> None:
    """No reference is set: it is zero."""
    cut = 0
    for policy in policies(plain):
        for t in np.linspace(policy.times[0] - 0.01, policy.end + 0.1, 40):
            assert abs(policy(t)[0]) <= FORCE
            for push in PUSHED:
                x = policy.state(t) + push
                asked = policy.law(t, x)[0]
                np.testing.assert_allclose(policy(t, x), [np.clip(asked, -FORCE, FORCE)], atol=1e-12)
                cut += abs(asked) > FORCE
    assert cut > 50 and plain.limits.count == cut


REFERENCES = {
    "constant": wb.Reference.constant([1.5]),
    "ramp": wb.Reference(np.array([0.0, 5.0]), np.array([[-2.0], [8.0]])),
    "bends": wb.Reference(np.array([0.013, 0.171, 0.183, 0.6]), np.array([[-2.0], [4.0], [1.0], [1.0]])),
    "jumps": wb.Reference(
        np.array([0.0, 0.2, 0.2, 0.25, 0.25, 1.0]), np.array([[0.0], [1.0], [-3.0], [0.0], [4.0], [2.0]])
    ),
    "hold": wb.Reference(np.array([0.0, 0.2, 0.21, 0.4]), np.array([[-1.0], [1.0], [3.0], [0.5]]), "hold"),
}


@pytest.mark.parametrize("reference", REFERENCES.values(), ids=REFERENCES)
def test_the_box_moves_with_its_reference_at_every_time(plain: wb.MPC, reference: wb.Reference) -> None:
    """Also between the nodes of the plan, and just before and after what bends or jumps there; and no tighter than what the
    reference does in the interval."""
    plain.reference["limit"] = reference
    seen = set()
    for policy in policies(plain):
        for begin, end in zip(policy.times, policy.times[1:]):
            knots = [s for s in reference.times if begin < s <= end + 1e-9]
            at = [
                begin,
                end - 1e-6,
                *np.linspace(begin, end, 5)[1:-1],
                *(s + e for s in knots for e in (-1e-6, 1e-6) if begin < s + e < end),
            ]
            middles = [reference.at(t)[0] for t in at]
            for t, middle in zip(at, middles):
                assert abs(policy(t)[0] - middle) <= FORCE + 1e-9
                for push in PUSHED:
                    x = policy.state(t) + push
                    given, asked = policy(t, x)[0], policy.law(t, x)[0]
                    assert abs(given - middle) <= FORCE + 1e-9
                    if not knots:
                        assert given == pytest.approx(np.clip(asked, middle - FORCE, middle + FORCE), abs=1e-9)
                    elif given != pytest.approx(asked, abs=1e-9):
                        assert max(middles) - FORCE - np.ptp(middles) <= given <= min(middles) + FORCE + np.ptp(middles)
                    seen.add(round(abs(given - middle), 6))
    assert FORCE in seen


def test_a_jump_beyond_the_width_of_the_box_keeps_the_upper_bounds(plain: wb.MPC) -> None:
    """14 N where the box is 10 N wide: no input is in both, and never more than the smaller upper bound is given in that interval."""
    plain.reference["limit"] = wb.Reference(np.array([0.0, 0.21]), np.array([[-5.0], [9.0]]), "hold")
    for policy in policies(plain, 1):
        (k,) = np.flatnonzero((policy.times[:-1] < 0.21) & (policy.times[1:] > 0.21))
        for t in np.linspace(policy.times[k], policy.times[k + 1], 9)[:-1]:
            assert all(policy(t, policy.state(t) + push)[0] <= 1e-9 for push in PUSHED)


def test_a_tighter_fixed_bound_and_a_mode_beside_it() -> None:
    """The reference is 3 N: [−2, 8] N by the tracked box, in the mode "careful" only; at most 4 N always."""
    ocp = problem(modes=("careful",))
    ocp.add(
        wb.Constraint("least", wb.residuals.Input(ocp.dynamics, reference=None), wb.sets.Box(-20.0, 4.0), hard=True)
    )
    mpc = wb.MPC(ocp, rate=50.0)
    mpc.reference["limit"] = wb.Reference.constant([3.0])
    mpc.set_schedule(wb.ModeSchedule((wb.Mode("careful"), wb.Mode("free")), (0.5,)))
    (policy,) = policies(mpc, 1)
    for t in (0.1, 0.3, 0.45, 0.6, 0.9):
        lower = -2.0 if t < 0.5 else -20.0
        for push in PUSHED:
            asked = policy.law(t, policy.state(t) + push)[0]
            assert policy(t, policy.state(t) + push)[0] == pytest.approx(np.clip(asked, lower, 4.0), abs=1e-9)


def test_rows_of_several_inputs_around_references_scale_feedback_back() -> None:
    """|u0 + u1 − r| ≤ 1 with the reference r = 0.25: what feedback adds is scaled, in both inputs alike."""
    dynamics = wb.Ode({"x": ["p", "v"]}, {"u": ["a", "b"]}, lambda x, u: ca.vertcat(x[1], u[0] + 2.0 * u[1]))
    ocp = wb.OptimalControlProblem(dynamics, horizon=1.0, intervals=20)
    ocp.add(wb.Cost("state", wb.residuals.Expression(2, lambda s: s.x), [10.0, 1.0], at="path+terminal"))
    ocp.add(wb.Cost("effort", wb.residuals.Expression(2, lambda s: s.u), 0.1))
    both = wb.residuals.Expression(1, lambda s: s.u[0] + s.u[1] - s.reference, reference=1)
    ocp.add(wb.Constraint("both", both, wb.sets.Box(-1.0, 1.0), hard=True))
    mpc = wb.MPC(ocp, rate=50.0)
    mpc.reference["both"] = wb.Reference.constant([0.25])
    mpc.reset(np.array([0.05, 0.0]))
    policy = mpc.update(wb.Observation(0.0, np.array([0.05, 0.0])))
    for push in ([2.0, 8.0], [-2.0, -8.0]):
        x = policy.x[0] + push
        asked, given = policy.law(0.0, x) - policy.u[0], policy(0.0, x) - policy.u[0]
        assert abs(abs(policy(0.0, x).sum() - 0.25) - 1.0) < 1e-9 and not abs(policy.law(0.0, x).sum() - 0.25) <= 1.0
        np.testing.assert_allclose(given[0] * asked[1], given[1] * asked[0], atol=1e-9)


@pytest.mark.parametrize("row", [0, 2, 3, 5])
def test_the_box_moves_with_a_part_of_a_pose_at_every_time(row: int) -> None:
    """Between nodes and samples, where positions are on lines and quaternions on arcs. Truth: the reference's own value."""
    ocp, rng = problem(), np.random.default_rng(row)
    part = wb.residuals.Expression(1, lambda s: s.u[0] - 3.0 * s.reference[row], reference=7)
    ocp.add(wb.Constraint("part", part, wb.sets.Box(-2.0, 2.0), hard=True))
    times = np.linspace(-0.1, 1.2, 9)
    turns = rng.normal(size=(9, 4)) * 0.3 + [1.0, 0.0, 0.0, 0.0]
    positions = np.cumsum(rng.uniform(-0.3, 0.3, (9, 3)), axis=0)
    poses = wb.Reference.poses(times, positions, turns / np.linalg.norm(turns, axis=1)[:, None])
    mpc = wb.MPC(ocp, rate=50.0)
    mpc.reference["part"] = poses
    reached = 0.0
    for policy in policies(mpc):
        for t in np.linspace(policy.times[0], policy.end - 1e-6, 200):
            for push in PUSHED:
                off = policy(t, policy.state(t) + push)[0] - 3.0 * poses.at(t)[row]
                assert abs(off) <= 2.0 + 1e-9, (t, push)
                reached = max(reached, abs(off))
    assert reached > (1.9 if row < 3 else 1.0)  # arcs are bounded by their length


def test_moving_bounds_reach_the_control_thread() -> None:
    """Written by the runner's worker, read as the control thread or process does."""
    mpc, ramp = wb.MPC(problem(), rate=50.0), wb.Reference(np.array([0.0, 5.0]), np.array([[-2.0], [8.0]]))
    mpc.reference["limit"] = ramp
    sizes, clock = Sizes.of(mpc.ocp), VirtualClock()
    observations, answers = Mailbox(sizes.observation()), Mailbox(sizes.policy())
    mpc.reset(START)
    worker = Worker(mpc, observations, answers, Board(NUMBERS, RECORDS, 8), Board(WORKER_COMMANDS), clock, 0.0)
    observations.write(observed=0.0, valid_from=0.0, t=0.0, x=START, parameters=np.zeros(0))
    loop = worker.loop()
    next(loop), next(loop)
    policy = TimedPolicy.take(answers)
    assert policy is not None
    for t in (0.0, 0.1, 0.77):
        for push in PUSHED[:2]:
            x = policy.state(t) + push
            assert policy(t, x)[0] - ramp.at(t)[0] == pytest.approx(FORCE * np.sign(policy(t, x)[0] - ramp.at(t)[0]))
