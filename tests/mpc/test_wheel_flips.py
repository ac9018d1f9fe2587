"""Wheels that turn about while the base goes on. Truth: all moments tried one by one; rigid-body motion; finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from toys import robot
from wbmpc.bases.swerve.defaults import swerve_mpc
from wbmpc.ocp import Reference
from wbmpc.settings import MpcSettings
from wbmpc.solver import Trajectory
from wbmpc.studies.pankert2022.fixed_motions import SwerveFixedSettings
from wbmpc.studies.pankert2022.wheel_flip import EARLY, TURN, Turn, WheelFlipGuess, plan_turns
from wbmpc.types import Observation

MODEL = robot("swerve-fixed-ur10")
LIMITS, RATE = (-3.0, 3.0), 5.0
TIMES = np.linspace(0.0, 8.0, 81)
FREE = np.zeros(81, bool)


def turned(way: np.ndarray, turns: list[tuple[float, float]]) -> np.ndarray:
    """The wheel's angle with its turns."""
    return way + sum((Turn(0, *turn).by * Turn(0, *turn).share(TIMES) for turn in turns), np.zeros(len(way)))


def test_a_turn_keeps_to_the_limits_of_the_drives() -> None:
    t = np.linspace(0.9, 2.1, 4801)
    angle = -np.pi * Turn(0, 1.0, -np.pi).share(t)
    rate = np.gradient(angle, t)
    assert (angle[0], angle[-1]) == (0.0, pytest.approx(-np.pi))
    assert np.abs(rate).max() < MODEL.limits.input_upper[MODEL.input["steer"]].min()
    assert np.abs(np.gradient(rate, t))[2:-2].max() < 1.02 * MODEL.limits.input_rate[MODEL.input["steer"]].min()
    assert np.ptp(t[np.abs(rate) > 1e-6]) == pytest.approx(TURN, abs=1e-3)


def test_nothing_turns_without_a_reason() -> None:
    assert plan_turns(TIMES, 2.9 * np.sin(TIMES), 0.3 + 0.0 * TIMES, LIMITS, RATE, 0.2, FREE) == []


@pytest.mark.parametrize("end", [1.5, 1.57])
def test_nothing_turns_where_the_other_way_round_is_no_better(end: float) -> None:
    """Ranges of half a turn or less: straight sideways is outside both ways round."""
    way = np.full(81, 0.5 * np.pi)
    assert plan_turns(TIMES, way, np.full(81, 0.3), (-end, end), RATE, 0.2, FREE) == []


def test_a_wheel_turns_about_where_it_slips_least() -> None:
    """Every moment from which on the other way round is in the range is tried."""
    way, speeds = -1.0 + 0.7 * TIMES, 0.3 + 0.1 * np.cos(2.0 * TIMES)
    ((start, by),) = plan_turns(TIMES, way, speeds, LIMITS, RATE, 0.2, FREE)
    assert by == -np.pi
    costs = {}
    for t in TIMES:
        good = (way + by)[(t - 1e-9 <= TIMES) & (way <= LIMITS[1])]
        if t >= 0.2 and np.all(way[t - 1e-9 > TIMES] <= LIMITS[1]) and np.all(good >= LIMITS[0]):
            s = np.linspace(t, t + TURN, 2001)
            costs[float(t)] = float(np.trapezoid(np.interp(s, TIMES, speeds), s)) - EARLY * t
    assert len(costs) > 5
    assert costs[start] == pytest.approx(min(costs.values()), abs=1e-4)


@pytest.mark.parametrize("seed", range(6))
def test_wheels_stay_in_their_range(seed: int) -> None:
    rng = np.random.default_rng(seed)
    way = rng.uniform(-1.0, 1.0) + np.cumsum(0.1 * np.repeat(rng.uniform(-1.5, 1.5, 9), 9))
    turns = plan_turns(TIMES, way, np.full(81, 0.3), LIMITS, RATE, 0.2, FREE)
    assert bool(turns) == bool(np.abs(way).max() > 3.0)
    assert np.all(np.diff([start for start, _ in turns]) >= TURN - 1e-9)
    path = way.copy()
    for start, by in turns:
        path[np.searchsorted(TIMES, start - 1e-9) :] += by
    assert np.abs(path).max() <= 3.0 + 1e-9


def test_a_rest_is_used_and_another_wheels_turn_is_not() -> None:
    way, speeds = -1.0 + 0.7 * TIMES, np.where((TIMES > 3.5) & (TIMES < 5.0), 0.0, 0.3)
    ((start, _),) = plan_turns(TIMES, way, speeds, LIMITS, RATE, 0.2, FREE)
    assert 3.5 <= start <= 5.0 - TURN + 0.1
    busy = (TIMES > 4.0) & (TIMES < 7.0)
    ((start, _),) = plan_turns(TIMES, way, np.full(81, 0.3), LIMITS, RATE, 0.2, busy)
    assert not busy[np.searchsorted(TIMES, start - 1e-9)]


def test_a_range_that_ends_at_once_is_left_as_soon_as_possible() -> None:
    ((start, by),) = plan_turns(TIMES, 3.1 + 0.0 * TIMES, np.full(81, 0.3), LIMITS, RATE, 0.2, FREE)
    assert (start, by) == (pytest.approx(0.2), -np.pi)


def wheel_slips(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Sideways speeds (4) [m/s] of the contacts, by complex numbers."""
    g, (vx, vy, w) = MODEL.base.geometry, u[MODEL.input["base"]]
    axles = g.hinge @ [1, 1j] + g.leg_length * np.exp(1j * g.leg_heading)
    heading = np.exp(1j * (g.wheel_heading + x[MODEL.state["steer"]]))
    return np.asarray(np.imag((vx + 1j * vy + 1j * w * axles) * np.conj(heading)))


@pytest.mark.parametrize(("wheel", "side"), [(0, -1.0), (1, 1.0)])
def test_a_plan_that_reverses_a_wheel_on_the_other_side_is_led_back(wheel: int, side: float) -> None:
    """Back, forward, slowly to one side: no wheel has to turn about, but one of the plan does, and leaves its range."""
    grid, h = np.linspace(0.0, 10.0, 51), 0.2
    motion = lambda t: 0.3 * np.clip(t - 3.0, -1.0, 1.0) * np.exp(0.8j * side * np.clip((t - 4.0) / 2.0, 0.0, 1.0))
    twists = lambda t: np.stack([motion(t).real, motion(t).imag, 0.0 * t], axis=1)
    x, u = np.tile(MODEL.home, (51, 1)), np.zeros((50, MODEL.input.size))
    veer = 0.8 * side * np.clip((grid - 4.0) / 2.0, 0.0, 1.0)
    forward = (0.5 * np.pi - MODEL.base.geometry.wheel_heading) % np.pi - 0.5 * np.pi
    x[:, MODEL.state["steer"]] = forward + veer[:, None]
    u[:, MODEL.input["base"]] = twists(grid[:-1])
    sound, first = x.copy(), MODEL.state["steer"].start + wheel
    guess = WheelFlipGuess(MODEL, lambda t, _: twists(t))
    plan = Trajectory(0.0, grid, x, u)
    assert guess(0.0, x[0].copy(), plan) is None
    assert np.array_equal(x, sound)  # a sound plan is left alone
    x[:, first] += side * np.pi * np.clip((grid - 2.7) / 0.6, 0.0, 1.0)
    guess = WheelFlipGuess(MODEL, lambda t, _: twists(t))
    assert guess(0.0, x[0].copy(), plan) is plan
    assert guess.turns == ()
    assert np.abs(x[:, first]).max() < 3.0
    late = np.flatnonzero(grid[:-1] > 3.5)
    assert max(np.abs(wheel_slips(x[k], u[k])[wheel]) for k in late) < 0.01
    heading = np.exp(1j * (MODEL.base.geometry.wheel_heading[wheel] + x[late, first]))
    rolled = (motion(grid[late]) * heading.conj()).real / MODEL.base.geometry.wheel_radius
    assert u[late, MODEL.input["wheel"].start + wheel] == pytest.approx(rolled, abs=0.02)
    assert u[late, MODEL.input["steer"].start + wheel] == pytest.approx(np.diff(x[:, first])[late] / h)
    assert np.array_equal(np.delete(x, first, axis=1), np.delete(sound, first, axis=1))


def test_a_base_that_goes_round_does_not_stop_for_its_wheels() -> None:
    """0.3 m/s round and round without turning: every wheel comes to the end of its range. The plan is followed exactly."""
    t = np.linspace(0.0, 20.0, 801)
    rising, phase = np.clip(0.5 * (t - 1.5), 0.0, 1.0), 1.1 * t
    twists = 0.3 * rising[:, None] * np.stack([np.cos(phase), np.sin(phase), 0.0 * t], axis=1)
    poses = np.vstack([np.zeros(3), np.cumsum(0.5 * (twists[1:] + twists[:-1]) * t[1], axis=0)])
    preview = lambda s, _: np.stack([np.interp(s, t, twists[:, i]) for i in range(3)], axis=1)
    guess = WheelFlipGuess(MODEL, preview)
    mpc = swerve_mpc(MODEL, MpcSettings(), SwerveFixedSettings().cost, guess, allow_side_slip=True)
    for name, group, values in (("state", "base", poses), ("input", "base", twists)):
        layout, home = (MODEL.state, MODEL.home) if name == "state" else (MODEL.input, np.zeros(MODEL.input.size))
        table = np.tile(home, (t.size, 1))
        table[:, layout[group]] = values
        mpc.reference[name] = Reference(t, table)
    position, orientation = MODEL.pose(MODEL.home)
    mpc.reference["end_effector"] = Reference.poses(np.zeros(1), position[None], orientation[None])
    mpc.reset(MODEL.home)
    x, turned_about = MODEL.home.copy(), set()
    for k in range(450):
        now = 0.02 * k
        policy = mpc.update(Observation(now, x))
        turns = {turn.wheel for turn in guess.turns if turn.start - 0.2 < now < turn.end + 0.1}
        turned_about |= turns
        asked = np.array([np.interp(now, t, poses[:, i]) for i in range(2)])
        assert np.hypot(*(x[:2] - asked)) < 0.012
        assert np.abs(x[MODEL.state["steer"]]).max() < 3.15
        rolling = [i for i in range(4) if i not in turns]
        assert np.abs(wheel_slips(policy.x[0], policy.u[0])[rolling]).max() < 0.01
        x = policy.state(now + 0.02).copy()
    assert turned_about == {0, 1, 2, 3}
