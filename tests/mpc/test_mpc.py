"""The receding horizon. Truth: the same problem solved by hand; what it promises about failures."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from toys import Rows, ToyDynamics, pendulum, robot
from wbmpc.bases.swerve.steering_planner import SteeringGuess
from wbmpc.errors import InputError, NotFinite, RunAborted
from wbmpc.model.robot import RobotModel
from wbmpc.model.wheels import wheel_velocities
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Cost, Mode, ModeSchedule, OptimalControlProblem, Reference
from wbmpc.solver import SQP, Solver, Trajectory
from wbmpc.solver.controller import STUCK
from wbmpc.solver.solution import COLUMNS
from wbmpc.solver.termination import DIVERGED, INPUT_INFEASIBLE
from wbmpc.types import Observation

REAL_TIME = SQP(iterations=1, compute_kkt=False, min_step=0.2, accept_min_step=True)
START = np.array([0.1, 0.3, 0.0, 0.0])


def make(guess=None, **settings) -> MPC:  # type: ignore[no-untyped-def]
    ocp: OptimalControlProblem = pendulum("interpreted").ocp
    mpc = MPC(ocp, REAL_TIME, 50.0, guess=guess, **settings)
    mpc.reference["state"] = Reference.constant(np.zeros(4))
    mpc.reset(np.zeros(4))
    return mpc


def test_first_policy_is_the_iterated_solution() -> None:
    mpc = make(first_iterations=60)
    policy = mpc.update(Observation(3.0, START))
    solver = Solver(mpc.ocp, SQP(iterations=200))
    solver.set_reference("state", Reference.constant(np.zeros(4)))
    solver.warm_start(np.zeros(4))
    found = solver.solve(START)
    np.testing.assert_allclose(policy.u, found.u, atol=1e-5)
    np.testing.assert_allclose(policy.times, 3.0 + found.times)
    np.testing.assert_allclose(policy.x[0], START, atol=1e-9)
    assert mpc.period == pytest.approx(0.02)


def test_iterations_of_the_first_plan_are_those_of_all_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    mpc, counts = make(first_iterations=4), []
    run = mpc.solver.iterate

    def counted(*given: Any) -> tuple[int, int]:
        counts.append(run(*given)[1])
        return 0, counts[-1]

    monkeypatch.setattr(mpc.solver, "iterate", counted)
    mpc.update(Observation(0.0, START))
    assert counts == [1] * 4 and mpc.solve_info["iterations"] == 4
    mpc.update(Observation(0.02, START))
    assert counts == [1] * 5 and mpc.solve_info["iterations"] == 1


@pytest.mark.parametrize("senseless", [0, -3, 2.5, np.nan, "many", True])
def test_first_iterations_are_checked(senseless: Any) -> None:
    with pytest.raises(InputError, match=r"mpc\.first_iterations: a whole number from 1 on is needed, got"):
        make(first_iterations=senseless)


def test_closed_loop_reaches_its_goal() -> None:
    """The model under the policy of every update comes to rest at the reference."""
    mpc = make()
    x, t = START.copy(), 0.0
    for _ in range(150):
        policy = mpc.update(Observation(t, x))
        for _ in range(2):
            x = mpc.solver.simulate(x, policy(t, x), 0.01)
            t += 0.01
    assert np.abs(x).max() < 0.02
    assert len(mpc.statistics.solve_times) == 149
    assert mpc.statistics.failures == 0


class Poison:
    """A guess beyond all bounds at the chosen updates: what is computed from it overflows."""

    def __init__(self, *times: float) -> None:
        self.times = times

    def __call__(self, t: float, x0: np.ndarray, trajectory: Trajectory) -> Trajectory | None:
        if not any(abs(t - bad) < 1e-9 for bad in self.times):
            return None
        return replace(trajectory, x=np.full_like(trajectory.x, 1e200))


def test_failed_solve_keeps_the_last_policy() -> None:
    mpc, healthy = make(Poison(0.04)), make()
    last = mpc.update(Observation(0.0, START))
    healthy.update(Observation(0.0, START))
    assert mpc.update(Observation(0.04, START)) is last
    assert mpc.statistics.failures == 1
    # the next update starts from the last plan, moved on by all the time since: as if the failed one had not been
    a, b = mpc.update(Observation(0.08, START)), healthy.update(Observation(0.08, START))
    np.testing.assert_array_equal(a.u, b.u)
    np.testing.assert_array_equal(a.x, b.x)
    assert np.isfinite(a.gain).all()


def test_failing_from_the_start_is_an_abort() -> None:
    """From the guess and from the state held: nobody can be in such a state."""
    mpc = make(Poison(0.0))
    with pytest.raises(RunAborted, match=r"first solve failed: .* not finite \(the dynamics at node 0\)"):
        mpc.update(Observation(0.0, np.full_like(START, 1e200)))


def test_a_guess_that_writes_into_its_state_changes_nothing_else() -> None:
    def wipe(t: float, x0: np.ndarray, trajectory: Trajectory) -> None:
        x0[:] = 0.0

    seen = np.array(START)
    mpc, untouched = make(wipe), make()
    for one in (mpc, untouched):
        one.reset(seen)
    plan = mpc.update(Observation(0.0, seen))
    np.testing.assert_array_equal(seen, START)
    np.testing.assert_array_equal(plan.x, untouched.update(Observation(0.0, seen)).x)


@pytest.mark.parametrize("wrong", [3.0, "zero", (1, 2)])
def test_a_guess_of_a_wrong_type_is_an_input_error(wrong: object) -> None:
    mpc = make()
    with pytest.raises(InputError, match=r"mpc\.guess: a function of t, x0 and the last trajectory is needed"):
        mpc.guess = wrong  # type: ignore[assignment]
    mpc.guess = lambda t, x0, trajectory: wrong  # type: ignore[assignment, return-value]
    with pytest.raises(InputError, match=rf"mpc\.guess: it must return a Trajectory, .*got {type(wrong).__name__}"):
        mpc.update(Observation(0.0, START))


@pytest.mark.parametrize("part", ["feedback gain", "planned state"])
def test_a_plan_that_is_not_finite_never_comes_into_force(part: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the solver's status says (which part it finds: tests/solver/test_trajectory.py)."""
    mpc = make()
    last = mpc.update(Observation(0.0, START))
    honest = mpc.solver.iterate

    def spoilt(*arguments):  # type: ignore[no-untyped-def]
        outcome = honest(*arguments)
        monkeypatch.setattr(mpc.solver, "non_finite_part", lambda: part)
        return outcome

    monkeypatch.setattr(mpc.solver, "iterate", spoilt)
    assert mpc.update(Observation(0.02, START)) is last
    assert (mpc.statistics.solves, mpc.statistics.failures) == (2, 1)
    assert mpc.fault == f"failed: the {part} is not finite"
    mpc.reset(START)
    with pytest.raises(RunAborted, match=r"the first solve failed: .*not finite"):
        mpc.update(Observation(0.04, START))


def test_a_solve_that_diverged_is_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    mpc = make()
    last = mpc.update(Observation(0.0, START))
    honest = mpc.solver.iterate
    monkeypatch.setattr(mpc.solver, "iterate", lambda *a: (DIVERGED, honest(*a)[1]))
    assert mpc.update(Observation(0.02, START)) is last
    assert mpc.statistics.failures == 1


def test_solves_without_a_step_are_counted() -> None:
    """A solver that may not force its step, from a guess where the line search cannot win."""
    mpc = make()
    for k in range(5):
        mpc.update(Observation(0.02 * k, START))
    assert (mpc.statistics.solves, mpc.statistics.no_step, mpc.statistics.failed_share) == (5, 0, 0.0)
    honest = mpc.solver.iterate

    def stuck(*arguments):  # type: ignore[no-untyped-def]
        out = honest(*arguments)
        mpc.solver.log[:, COLUMNS["alpha"]] = 0.0
        return out

    mpc.solver.iterate = stuck  # type: ignore[method-assign]
    for k in range(5, 10):
        mpc.update(Observation(0.02 * k, START))
    assert (mpc.statistics.solves, mpc.statistics.no_step, mpc.statistics.failed_share) == (10, 5, 0.5)


def test_reset_forgets() -> None:
    mpc = make()
    first = mpc.update(Observation(0.0, START))
    mpc.update(Observation(0.5, -START))
    mpc.reset(np.zeros(4))
    again = mpc.update(Observation(0.0, START))
    np.testing.assert_array_equal(first.u, again.u)


def test_observations_are_checked() -> None:
    mpc = make()
    mpc.update(Observation(1.0, START))
    for observation, message in (
        (Observation(1.1, np.zeros(3)), "4 numbers are needed"),
        (Observation(1.1, np.array([0, 0, np.nan, 0])), "'x.2' is not finite"),
        (Observation(1.1, [0, 0, np.nan, 0]), "'x.2' is not finite"),  # type: ignore[arg-type]
        (Observation(np.nan, START), "time must be finite, got nan"),
        (Observation(np.inf, START), "time must be finite, got inf"),
        (Observation(0.9, START), "time went back from 1.0000 to 0.9000"),
    ):
        with pytest.raises(InputError, match=message):
            mpc.update(observation)
    with pytest.raises(InputError, match=r"mpc\.rate"):
        MPC(mpc.ocp, REAL_TIME, 0.0)
    with pytest.raises(InputError, match=r"mpc\.rate"):
        MPC(mpc.ocp, REAL_TIME, np.inf)
    with pytest.raises(InputError, match=r"observation: .*numbers? (is|are) needed"):
        Observation(0.0, "abc")  # type: ignore[arg-type]
    for x, u, message in (
        (np.array([0, np.nan, 0, 0]), None, "reset: 'x.1' is not finite"),
        (np.zeros(3), None, "reset: (4 )?numbers are needed"),
        (np.zeros(4), np.array([np.inf, 0.0]), "reset: 'u.0' is not finite"),
        ("abc", None, "reset: (4 )?numbers are needed"),
    ):
        with pytest.raises(InputError, match=message):
            mpc.reset(x, u)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"did you mean 'state'\?"):
        mpc.reference["stat"] = Reference.constant(np.zeros(4))
    with pytest.raises(InputError, match=r"did you mean 'state'\?"):
        mpc.reference["stat"]
    assert list(mpc.reference) == ["state"]
    assert "state" in mpc.reference and "end_effector" not in mpc.reference
    np.testing.assert_array_equal(mpc.reference["state"].values, np.zeros((1, 4)))


# ---------------------------------------------------------------------- steering guess
def swerve_plan(n: int = 240) -> tuple[RobotModel, Trajectory]:
    model = robot("swerve-ur10")
    x, u = np.tile(model.home, (n + 1, 1)), np.zeros((n, model.input.size))
    return model, Trajectory(0.0, np.linspace(0.0, 6.0, n + 1), x, u)


@pytest.mark.parametrize("twist", [(0.0, 0.2, 0.0), (0.15, -0.15, 0.0), (0.0, 0.0, 0.3), (0.1, 0.1, 0.2)])
def test_guess_steers_first_then_rolls(twist: tuple[float, float, float]) -> None:
    model, plan = swerve_plan()
    preview = lambda t, pose: np.tile(twist, (len(t), 1))
    found = SteeringGuess(model, preview)(0.0, model.home, plan)
    assert found is not None
    plan = found
    base, steer, wheel = (plan.u[:, model.input[g]] for g in ("base", "steer", "wheel"))
    moving = np.abs(base).max(axis=1) > 1e-9
    assert moving.any() and not moving[0]
    first = int(np.argmax(moving))
    assert moving[first:].all()
    np.testing.assert_allclose(base[first:], np.tile(twist, (moving.sum(), 1)))
    assert np.abs(steer).max() <= model.limits.input_upper[model.input["steer"]].min()
    assert np.abs(wheel[:first]).max() < 1e-9
    # wheels stand along the velocity of their axes, and turn as fast as that rolls (rigid-body motion)
    g = model.base.geometry
    for k in range(first + 1, len(base)):
        x = plan.x[k]
        v = wheel_velocities(g, x[model.state["leg"]], twist)
        heading = g.wheel_heading + x[model.state["leg"]] + x[model.state["steer"]]
        along = v[:, 0] * np.cos(heading) + v[:, 1] * np.sin(heading)
        side = v[:, 1] * np.cos(heading) - v[:, 0] * np.sin(heading)
        assert np.abs(side).max() < 0.03 * np.abs(along).max()
        np.testing.assert_allclose(wheel[k] * g.wheel_radius, along, atol=1e-9)
    # states follow the inputs
    x = plan.x[:, model.state["steer"]]
    np.testing.assert_allclose(np.diff(x, axis=0), steer * np.diff(plan.grid)[:, None], atol=1e-12)


def test_guess_comes_once_per_standstill() -> None:
    model, plan = swerve_plan()
    guess = SteeringGuess(model, lambda t, pose: np.tile([0.0, 0.2, 0.0], (len(t), 1)))
    guess(0.0, model.home, plan)
    plan.u[:] = 0.0
    assert guess(0.1, model.home, plan) is None  # done: not again at the same standstill
    plan.u[0, 1] = 0.2
    assert guess(0.2, model.home, plan) is None  # moving: nothing to guess
    plan.u[0, 1] = 0.0
    found = guess(0.3, model.home, plan)
    assert found is not None and np.abs(found.u).max() > 0.1  # at rest again: armed again


def test_a_plan_that_is_stuck_at_the_end_of_a_range_is_written_on_with_a_stop() -> None:
    """The direction turns at 0.7 rad/s; the plan follows until its wheels are at their ends, and stays there."""
    model, plan = swerve_plan()
    part, g = model.state["steer"], model.base.geometry
    begin = 0.0
    turned = lambda t: 0.7 * (t - begin)
    around = lambda t, pose: 0.2 * np.stack([np.cos(turned(t)), np.sin(turned(t)), 0.0 * t], axis=1)
    high = model.limits.state_upper[part]
    target = model.home[part] + 0.7 * plan.grid[:, None]
    plan.x[:, part], plan.u[:, model.input["base"]] = np.minimum(target, high), around(plan.grid[:-1], None)
    previous, guess = plan.x.copy(), SteeringGuess(model, around)
    found = guess(0.0, model.home, plan)
    assert found is not None
    plan = found
    stuck = int(np.argmax((target > high).any(axis=1)))
    assert 0 < stuck < 200
    # a direction is lost at 0.3 rad; nothing is touched long before
    assert np.array_equal(plan.x[: stuck - 30], previous[: stuck - 30])
    steer, base = plan.x[:, part], plan.u[:, model.input["base"]]
    assert np.all((steer >= model.limits.state_lower[part] - 1e-9) & (steer <= high + 1e-9))
    rolls = np.hypot(*base[:, :2].T) > 1e-9
    stop = np.flatnonzero(~rolls)
    # one stop, no longer than half a turn takes, after which wheels roll along the velocity of their axes
    assert np.all(np.diff(stop) == 1) and 0.5 < (stop[-1] - stop[0]) * 6.0 / 240 < 1.5
    for k in range(stop[-1] + 1, 240):
        v = wheel_velocities(g, plan.x[k, model.state["leg"]], base[k])
        heading = g.wheel_heading + plan.x[k, model.state["leg"]] + steer[k]
        assert np.abs(v[:, 1] * np.cos(heading) - v[:, 0] * np.sin(heading)).max() < 0.05 * 0.2
    begin = 0.7  # the same motion from later on, as for a plan that was shifted
    assert guess(0.7, model.home, plan) is None  # it can go on as it is


def test_guess_waits_for_a_motion() -> None:
    model, plan = swerve_plan()
    later = lambda t, pose: np.where(t[:, None] > 5.0, [[0.0, 0.2, 0.0]], 0.0)
    guess = SteeringGuess(model, later)
    assert guess(0.0, model.home, plan) is None
    found = guess(4.5, model.home, plan)
    assert found is not None and np.abs(found.u).max() > 0.1


def test_a_plan_that_no_solve_can_go_on_from_is_given_up() -> None:
    """Both the iterate and the last good plan are at 1e200: a resumed solve overflows, one from the observation does not."""
    mpc = make()
    policy = mpc.update(Observation(0.0, START))
    policy.x[:] = 1e200
    mpc.solver.warm_start(policy.x, policy.u)
    for k in (1, 2):
        assert mpc.update(Observation(0.02 * k, START)) is policy and mpc.fault
    fresh = mpc.update(Observation(0.06, START))
    assert not mpc.fault and fresh is not policy and mpc.statistics.failures == 2
    assert np.abs(fresh.x).max() < 10.0


def reject(mpc: MPC, monkeypatch: pytest.MonkeyPatch, spoil: Any = lambda: None) -> None:
    """Solves as they are, said to miss a hard limit; ``spoil`` what they leave."""
    honest = mpc.solver.iterate

    def missed(*arguments):  # type: ignore[no-untyped-def]
        _, count = honest(*arguments)
        spoil()
        return INPUT_INFEASIBLE, count

    monkeypatch.setattr(mpc.solver, "iterate", missed)


def test_rejected_again_and_again_the_next_solve_goes_on_from_its_own_iterate(monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot that leant on a locked door fell: 60 rejection in a row, each from the same plan, with no new feedback."""
    mpc, left = make(), []
    last = mpc.update(Observation(0.0, START))
    with monkeypatch.context() as m:
        reject(mpc, m, lambda: left.append(mpc.solver.trajectory().x))
        for k in range(1, STUCK + 2):
            assert mpc.update(Observation(0.02 * k, START + 0.3)) is last  # none of them is used
            assert np.abs(left[-1] - last.x).max() > 0.01
            held = left[-1] if k >= STUCK else last.x
            np.testing.assert_array_equal(mpc.solver.trajectory().x, held, err_msg=f"rejection {k}")
    fresh = mpc.update(Observation(0.02 * k + 0.02, START + 0.3))
    assert not mpc.fault and fresh is not last and mpc.statistics.failures == STUCK + 1
    reject(mpc, monkeypatch)
    assert mpc.update(Observation(0.02 * k + 0.04, START)) is fresh  # a new row of them
    np.testing.assert_array_equal(mpc.solver.trajectory().x, fresh.x)


def test_what_is_not_finite_is_never_gone_on_from(monkeypatch: pytest.MonkeyPatch) -> None:
    mpc = make()
    last = mpc.update(Observation(0.0, START))
    bad = iter([*[False] * STUCK, True])
    spoil = lambda: monkeypatch.setattr(mpc.solver, "non_finite_part", lambda: "planned state" if next(bad) else "")
    reject(mpc, monkeypatch, spoil)
    for k in range(1, STUCK + 2):
        assert mpc.update(Observation(0.02 * k, START)) is last
    np.testing.assert_array_equal(mpc.solver.trajectory().x, last.x)


def test_a_policy_rejects_what_is_not_finite() -> None:
    policy = make().update(Observation(0.0, START))
    for t, x in ((np.nan, START), (0.0, START * np.nan)):
        with pytest.raises(NotFinite):
            policy(t, x)


def blinking(*events: float) -> ModeSchedule:
    """A mode of its own after each event."""
    return ModeSchedule(tuple(Mode(str(k), {"m": [k % 2]}) for k in range(len(events) + 1)), events)


def follower(align: bool = True) -> MPC:
    """1 s in 4 intervals: 3 inner nodes."""
    dynamics = ToyDynamics(1, 1, lambda x, u, w, m: u * m[0], mode=1)
    ocp = OptimalControlProblem(dynamics, 1.0, 4, align_events=align)
    ocp.add(Cost("state", Rows(1, lambda s: s.x - 1.0), 10.0, at="path+terminal"))
    ocp.add(Cost("input", Rows(1, lambda s: s.u), 0.1))
    mpc = MPC(ocp, rate=10.0)
    mpc.reset(np.zeros(1))
    return mpc


def test_a_schedule_that_never_fits_is_rejected_and_the_old_one_stays() -> None:
    mpc, fits = follower(), blinking(0.2, 0.5, 0.8, 1.3)
    mpc.set_schedule(fits)
    with pytest.raises(
        InputError, match=r"4 events from 5.1 to 5.9 s are within one horizon, but it has 3 inner nodes"
    ):
        mpc.set_schedule(blinking(0.2, 5.1, 5.2, 5.5, 5.9))
    assert mpc.solver.schedule is fits
    mpc.set_schedule(blinking(0.2, 0.5, 0.8, 1.2))  # a whole horizon from first to last: no plan has both inside
    mpc.update(Observation(6.0, np.zeros(1)))
    mpc.set_schedule(blinking(0.2, 5.1, 5.2, 5.5, 5.9))  # that is over
    follower(align=False).set_schedule(blinking(0.1, 0.2, 0.3, 0.4, 0.5))


def test_events_without_a_node_do_not_stop_the_mpc_but_are_reported(caplog: pytest.LogCaptureFixture) -> None:
    mpc, events = follower(), (0.1, 0.25, 0.45, 0.6, 0.75, 0.9)
    mpc.solver.set_schedule(blinking(*events))
    counted = []
    with caplog.at_level(logging.WARNING, "wbmpc"):
        for k in range(10):
            mpc.update(Observation(0.1 * k, np.zeros(1)))
            counted.append(mpc.solve_info["events_without_node"])
    # truth: events strictly within (t, t + 1), less 3
    assert counted == [max(sum(e > 0.1 * k + 1e-6 for e in events) - 3, 0) for k in range(10)]
    assert counted[0] == 3 and counted[-1] == 0
    assert [r.getMessage()[:30] for r in caplog.records] == ["mode schedule: from 0.000 s on,"[:30]]
