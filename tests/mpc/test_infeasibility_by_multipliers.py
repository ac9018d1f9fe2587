"""Equalities with multipliers that contradict each other or limits, in an MPC. Truth: no number is 1 and 2 at once, nothing that
stands moves on, a spring rests at force by stiffness; and what is only not reached yet, or after a push, is no contradiction."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from toys import Rows, ToyDynamics
from wbmpc.errors import RunAborted
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import AugmentedLagrangian, Constraint, Cost, Mode, ModeSchedule, OptimalControlProblem, Reference
from wbmpc.ocp.sets import Box, NonNegative
from wbmpc.types import Observation

AL = AugmentedLagrangian(1e3)
row = lambda f: Rows(1, f)


def problem(*terms: Constraint) -> OptimalControlProblem:
    """ẍ = u0 + u1 + u2 to the origin."""
    ocp = OptimalControlProblem(ToyDynamics(2, 3, lambda x, u, w, m: ca.vertcat(x[1], ca.sum1(u))), 1.0, 20)
    ocp.add(Cost("state", Rows(2, lambda s: s.x), [10.0, 1.0], at="path+terminal", terminal_weight=[50.0, 10.0]))
    ocp.add(Cost("input", Rows(3, lambda s: s.u), 0.1))
    for term in terms:
        ocp.add(term)
    return ocp


def pair(make, **more) -> list[Constraint]:  # type: ignore[no-untyped-def]
    """make(s) = 1, always; and = 2, in mode "both"."""
    return [
        Constraint("one", row(lambda s: make(s) - 1.0), **more),
        Constraint("two", row(lambda s: make(s) - 2.0), modes=("both",), **more),
    ]


BOTH = {"modes": ("both",)}
CONTRADICTIONS = {
    "input": pair(lambda s: s.u[0], penalty=AL),
    "several inputs": [
        *pair(lambda s: s.u[0] + s.u[1], penalty=AL),
        Constraint("hard", row(lambda s: s.u[0] - s.u[2])),
    ],
    "state": pair(lambda s: s.x[1]),
    "end": pair(lambda s: s.x[0], at="terminal"),
    "path and end": [
        Constraint("still", row(lambda s: s.x[1]), at="path+terminal"),
        Constraint("there", row(lambda s: s.x[0] - 2.0), at="terminal", **BOTH),  # type: ignore[arg-type]
    ],
    "bounds": [
        Constraint("over", row(lambda s: s.u[0] - 2.0), NonNegative(), penalty=AL),
        Constraint("under", row(lambda s: 1.0 - s.u[0]), NonNegative(), penalty=AL, **BOTH),  # type: ignore[arg-type]
    ],
    "hard equality": [
        Constraint("one", row(lambda s: s.u[0] - 1.0)),
        Constraint("two", row(lambda s: s.u[0] - 2.0), penalty=AL, **BOTH),  # type: ignore[arg-type]
    ],
}


def run(mpc: MPC, steps: int, push: float = 0.0, noise: float = 1e-3) -> list[str]:
    """Closed loop; the fault of every update. A push at 1 s."""
    rng, x, faults = np.random.default_rng(0), np.array([0.1, 0.0]), []
    for k in range(steps):
        policy = mpc.update(Observation(0.02 * k, x))
        faults.append(mpc.fault)
        x = mpc.solver.simulate(x, policy(0.02 * k), 0.02) + noise * rng.normal(size=2)
        x[1] += push * (k == 50)
    return faults


def make(terms: list[Constraint], event: float = 1.5) -> MPC:
    mpc = MPC(problem(*terms), rate=50.0, plan_only_limits=True)
    mpc.set_schedule(ModeSchedule((Mode("one"), Mode("both")), (event,)))
    mpc.reset(np.array([0.1, 0.0]))
    return mpc


@pytest.mark.parametrize("name", CONTRADICTIONS)
def test_a_contradiction_is_a_failed_solve_that_names_a_row(name: str) -> None:
    mpc = make(CONTRADICTIONS[name])
    faults = run(mpc, 95)
    # the horizon of 1 s sees it from 0.5 s on; all of it is in mode "both" from 1.5 s on, and ten solves later it is reported
    assert not any(faults[:25]) and all(faults[85:]), [bool(f) for f in faults]
    assert faults[-1].startswith("failed: the planned inputs miss an equality (")
    names = [t.name for t in CONTRADICTIONS[name]]
    assert any(f"({n}.all[0] by " in faults[-1] for n in names) and "cannot be met together with others" in faults[-1]
    assert mpc.statistics.failures == sum(map(bool, faults))


def test_from_the_start_it_is_rejected() -> None:
    with pytest.raises(RunAborted, match="the first solve failed: the planned inputs miss an equality"):
        make(CONTRADICTIONS["end"], event=-1.0).update(Observation(0.0, np.zeros(2)))


def test_afterwards_all_is_well() -> None:
    """When the contradiction ends the plan is at once what it would have been: multipliers did not run away meanwhile."""
    terms = CONTRADICTIONS["input"]
    mpc = MPC(problem(*terms), rate=50.0)
    mpc.set_schedule(ModeSchedule((Mode("one"), Mode("both"), Mode("one")), (1.0, 3.0)))
    mpc.reset(np.array([0.1, 0.0]))
    faults = run(mpc, 180, noise=0.0)
    assert any(faults) and not any(faults[155:])
    policy = mpc.update(Observation(3.6, np.zeros(2)))
    np.testing.assert_allclose(policy.u[:, 0], 1.0, atol=1e-3)


LEGITIMATE = {
    "end beyond reach": [
        Constraint("force", Rows(3, lambda s: s.u), Box(-0.2, 0.2), hard=True),
        Constraint("there", row(lambda s: s.x[0] - 3.0), at="terminal"),
    ],
    "place on the path, forces end": [
        Constraint("force", Rows(3, lambda s: s.u), Box(-2.0, 2.0), hard=True),
        Constraint("here", row(lambda s: s.x[0])),
    ],
    "place on the path": [Constraint("here", row(lambda s: s.x[0]))],
    "speed on the path and end": [
        Constraint("still", row(lambda s: s.x[1]), at="path+terminal"),
        Constraint("twice", row(lambda s: 2.0 * s.x[1]), at="path+terminal"),
    ],
}


FORCE = Constraint("force", Rows(3, lambda s: s.u), Box(-0.5, 0.5), hard=True)
BEYOND = {
    "input": (FORCE, Constraint("one", row(lambda s: s.u[0] - 1.0), penalty=AL, **BOTH)),
    "bound": (FORCE, Constraint("one", row(lambda s: s.u[0] - 1.0), NonNegative(), penalty=AL, **BOTH)),
    "sum": (
        Constraint("force", row(lambda s: s.u[0] + s.u[1]), Box(-0.5, 0.5), hard=True),
        Constraint("one", row(lambda s: 3.0 * (s.u[0] + s.u[1]) - 6.0), penalty=AL, **BOTH),
    ),
    "disc": (
        Constraint("force", row(lambda s: 0.25 - ca.sumsqr(s.u)), NonNegative(), hard=True),
        Constraint("one", row(lambda s: s.u[0] - 1.0), penalty=AL, **BOTH),
    ),
}


@pytest.mark.parametrize("name", BEYOND)
def test_inputs_beyond_their_limits_are_rejected_and_both_are_named(name: str) -> None:
    """A row of inputs alone: no motion will ever meet it, so ten solves are enough."""
    mpc = make(list(BEYOND[name]))
    faults = run(mpc, 95)
    assert not any(faults[:25]) and all(faults[85:]), [bool(f) for f in faults]
    assert "(one.all[0] by " in faults[-1] and "it cannot be met together with 'force.all[0]" in faults[-1], faults[-1]


def spring(*terms: Constraint) -> OptimalControlProblem:
    """ẍ = u0 + u1 + u2 − 4 x − 2 ẋ: the forces of FORCE hold it at 0.375 at most."""
    f = lambda x, u, w, m: ca.vertcat(x[1], ca.sum1(u) - 4.0 * x[0] - 2.0 * x[1])
    ocp = OptimalControlProblem(ToyDynamics(2, 3, f), 1.0, 20)
    ocp.add(Cost("input", Rows(3, lambda s: s.u), 0.1))
    for term in terms:
        ocp.add(term)
    return ocp


@pytest.mark.parametrize("at", ["path", "terminal"])
def test_a_place_beyond_reach_for_good_is_rejected_at_rest(at: str) -> None:
    mpc = MPC(spring(FORCE, Constraint("there", row(lambda s: s.x[0] - 1.0), at=at)), rate=50.0)
    mpc.reset(np.zeros(2))
    faults = run(mpc, 280, noise=0.0)
    reported = [f for f in faults if f]  # until the plan that is kept ends, and the spring moves again
    assert not any(faults[:100]) and len(reported) >= 30, [bool(f) for f in faults]
    assert all("(there.all[0] by " in f and "with 'force.all[" in f for f in reported)


def test_a_place_within_reach_is_not() -> None:
    mpc = MPC(spring(FORCE, Constraint("there", row(lambda s: s.x[0] - 0.35), at="terminal")), rate=50.0)
    mpc.reset(np.zeros(2))
    assert not any(run(mpc, 200, push=-1.0))


@pytest.mark.parametrize("name", LEGITIMATE)
def test_what_is_only_out_of_reach_is_none(name: str) -> None:
    mpc = MPC(problem(*LEGITIMATE[name]), rate=50.0)
    mpc.reset(np.array([0.1, 0.0]))
    assert not any(run(mpc, 120, push=1.0))


def test_a_goal_that_moves_is_none() -> None:
    goal = Constraint("goal", Rows(1, lambda s: s.x[0] - s.reference, 1), at="terminal")
    mpc = MPC(problem(goal), rate=50.0)
    t = np.arange(0.0, 5.0, 0.02)
    mpc.reference["goal"] = Reference(t, np.where(t % 1.0 < 0.5, 1.0, -1.0)[:, None])
    mpc.reset(np.array([0.1, 0.0]))
    assert not any(run(mpc, 120, push=1.0))
