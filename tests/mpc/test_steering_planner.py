"""Which way round wheels go. Truth: all ways tried one by one on short previews; rigid-body directions of wheels."""

from __future__ import annotations

import time
from itertools import product

import numpy as np
import pytest

from toys import robot
from wbmpc.bases.swerve.steering_planner import MOVING, NODES, STOP, SteeringGuess, plan_steering
from wbmpc.model.wheels import aligned_steering, wheel_velocities
from wbmpc.solver import Trajectory

MODEL = robot("swerve-ur10")
G, RATE = MODEL.base.geometry, 3.0
STATE = MODEL.state.split(MODEL.home)
LIMITS = tuple(getattr(MODEL.limits, f"state_{side}")[MODEL.state["steer"]] for side in ("lower", "upper"))


def planned(times: np.ndarray, twists: np.ndarray, steer: np.ndarray = STATE["steer"], limits=LIMITS):  # type: ignore[no-untyped-def]
    return plan_steering(G, STATE["leg"], steer, times, twists, limits, RATE)


def circling(rate: float, length: float, nodes: int = 51, speed: float = 0.2) -> tuple[np.ndarray, np.ndarray]:
    """The base goes round without turning: its wheels turn on and on."""
    t = np.linspace(0.0, length, nodes)
    return t, np.stack([speed * np.cos(rate * t), speed * np.sin(rate * t), 0.0 * t], axis=1)


def sides(steer: np.ndarray, twists: np.ndarray) -> float:
    """Largest share of a wheel's speed across its heading."""
    worst = 0.0
    for angles, twist in zip(steer, twists, strict=True):
        v = wheel_velocities(G, STATE["leg"], twist)
        heading = G.wheel_heading + STATE["leg"] + angles
        across = np.abs(v[:, 1] * np.cos(heading) - v[:, 0] * np.sin(heading))
        worst = max(worst, float(np.max(across / np.maximum(np.hypot(*v.T), 1e-9))))
    return worst


@pytest.mark.parametrize("rate", [0.4, -0.7])
def test_wheels_stay_in_their_range_and_stop_as_rarely_as_possible(rate: float) -> None:
    times, twists = circling(rate, 30.0, 151)
    plan = planned(times, twists)
    assert np.all((plan.steer >= LIMITS[0] - 1e-9) & (plan.steer <= LIMITS[1] + 1e-9))
    assert sides(plan.steer, twists) < 1e-9
    jumps = np.flatnonzero((np.abs(np.diff(plan.steer, axis=0)) > 1.0).any(axis=1)) + 1
    assert set(jumps) <= set(plan.stops)
    # the range is one turn and the wheels make |rate| · 30 rad: a stop for each whole turn at least, one for the start
    assert len(plan.stops) <= abs(rate) * 30.0 / (2.0 * np.pi) + 2


def brute_force(times: np.ndarray, twists: np.ndarray, limits) -> float:  # type: ignore[no-untyped-def]
    """Cheapest cost over all choices of the way round of every wheel at every node."""
    angles, speeds = [], []
    for twist in twists:
        v = wheel_velocities(G, STATE["leg"], twist)
        angles.append(np.arctan2(v[:, 1], v[:, 0]) - G.wheel_heading - STATE["leg"])
        speeds.append(np.hypot(*v.T).max())
    stop = [speeds[0], *np.minimum(speeds[1:], speeds[:-1])]
    # sets of stops, cheapest first; each wheel is free to choose at a stop, and goes on the nearer way elsewhere
    worker_commands = sorted(
        product([0, 1], repeat=len(times)),
        key=lambda s: sum((np.pi / RATE * c + STOP) * x for c, x in zip(stop, s, strict=True)),
    )
    for stops in worker_commands:
        if all(_possible(i, stops, angles, limits) for i in range(G.modules)):
            return float(sum((np.pi / RATE * c + STOP) * x for c, x in zip(stop, stops, strict=True)))
    raise AssertionError("there is always a way")


def _possible(i: int, stops: tuple[int, ...], angles: list[np.ndarray], limits) -> bool:  # type: ignore[no-untyped-def]
    now = {float(STATE["steer"][i])}
    for k, angle in enumerate(angles):
        ways = [angle[i] + m * np.pi for m in range(-4, 5)]
        inside = [w for w in ways if limits[0][i] - 1e-9 <= w <= limits[1][i] + 1e-9]
        near = {w for w in inside for a in now if abs(w - a) <= np.pi / 2}
        now = set(inside) if stops[k] else near
        if not now:
            return False
    return True


@pytest.mark.parametrize("seed", range(12))
def test_no_other_choice_of_stops_is_cheaper(seed: int) -> None:
    rng = np.random.default_rng(seed)
    times = np.linspace(0.0, 4.0, 8)
    turn = np.cumsum(rng.uniform(-0.2, 1.1, 8)) + rng.uniform(-3, 3)
    size = rng.uniform(0.05, 0.3, 8)
    twists = np.stack([size * np.cos(turn), size * np.sin(turn), rng.uniform(-0.02, 0.02, 8)], axis=1)
    limits = (np.full(4, -2.2), np.full(4, 2.2))
    plan = planned(times, twists, limits=limits)
    speeds = [np.hypot(*wheel_velocities(G, STATE["leg"], t).T).max() for t in twists]
    stop = np.array([speeds[0], *np.minimum(speeds[1:], speeds[:-1])])
    ours = sum(np.pi / RATE * stop[k] + STOP for k in plan.stops)
    assert ours == pytest.approx(brute_force(times, twists, limits), rel=1e-9)
    assert np.all(np.abs(plan.steer) <= 2.2 + 1e-9)


def test_wheels_without_a_range_never_stop() -> None:
    """Three turns: every wheel follows its rigid-body direction without a jump. With one wheel that has a range, that one stops."""
    times, twists = circling(0.63, 30.0, 151)
    free = np.full(4, np.inf)
    plan = planned(times, twists, limits=(-free, free))
    assert plan.stops == () and sides(plan.steer, twists) < 1e-9
    assert np.abs(np.diff(plan.steer, axis=0)).max() == pytest.approx(0.63 * 30.0 / 150, rel=1e-6)
    free[2] = 3.14
    mixed = planned(times, twists, limits=(-free, free))
    assert mixed.stops and np.abs(mixed.steer[:, 2]).max() <= 3.14 + 1e-9
    np.testing.assert_allclose(mixed.steer[:, [0, 1, 3]], plan.steer[:, [0, 1, 3]])


def test_at_rest_wheels_turn_round_for_nothing() -> None:
    """A pause in the preview is where the wheels turn round, and not the fast part after it."""
    times, twists = circling(0.45, 12.0, 61)
    twists[18:23] = 0.0
    plan = planned(times, twists)
    assert plan.stops == ()
    assert np.all(np.abs(plan.steer) <= 3.14 + 1e-9)
    moving = np.hypot(*twists[:, :2].T) > MOVING
    assert sides(plan.steer[moving], twists[moving]) < 1e-9


def test_nothing_happens_without_a_reason() -> None:
    times = np.linspace(0.0, 10.0, 25)
    plan = planned(times, np.tile([0.2, 0.0, 0.0], (25, 1)))
    np.testing.assert_allclose(plan.steer, np.tile(STATE["steer"], (25, 1)), atol=1e-9)
    assert plan.stops == ()
    still = planned(times, np.zeros((25, 3)))
    np.testing.assert_allclose(still.steer, np.tile(STATE["steer"], (25, 1)), atol=1e-9)


def test_nearest_is_the_same_direction_on_the_planned_side() -> None:
    times, twists = circling(0.4, 20.0)
    plan = planned(times, twists)
    for k in (0, 13, 40):
        np.testing.assert_allclose(
            plan.nearest(times[k], plan.steer[k] + np.pi * np.array([1, -1, 2, 0])), plan.steer[k]
        )


def at_rest(x: np.ndarray, horizon: float, nodes: int = 121) -> Trajectory:
    """A plan in which nothing moves."""
    grid = np.linspace(0.0, horizon, nodes)
    return Trajectory(0.0, grid, np.tile(x, (nodes, 1)), np.zeros((nodes - 1, MODEL.input.size)))


TWIST, SWING = np.array([0.0, 0.15, 0.1]), np.array([0.2, -0.2, -0.2, 0.2])


def reconfiguring(speed: float = 1.0) -> Trajectory:
    """A plan in which the base drives at ``speed`` times TWIST and legs swing, and wheels roll as both move them (rigid-body motion)."""
    plan = at_rest(MODEL.home, 3.0)
    legs = STATE["leg"] + SWING * plan.grid[:, None]
    plan.x[:, MODEL.state["leg"]], plan.u[:, MODEL.input["leg"]] = legs, SWING
    plan.u[:, MODEL.input["base"]] = speed * TWIST
    v = np.array([wheel_velocities(G, leg, TWIST, SWING) for leg in legs])
    angle = np.arctan2(v[..., 1], v[..., 0]) - G.wheel_heading - legs
    plan.x[:, MODEL.state["steer"]] = np.unwrap((angle + np.pi) % (2.0 * np.pi) - np.pi, axis=0)
    return plan


def test_a_plan_that_reconfigures_its_legs_on_the_way_is_left_as_it_is() -> None:
    """Its wheels point up to 0.7 rad off where the base alone would move them, and follow all the same."""
    plan = reconfiguring()
    before, x = (plan.x.copy(), plan.u.copy()), plan.x[0].copy()
    alone = np.array([np.arctan2(*wheel_velocities(G, STATE["leg"], TWIST)[i, ::-1]) for i in range(4)])
    both = np.array([np.arctan2(*wheel_velocities(G, STATE["leg"], TWIST, SWING)[i, ::-1]) for i in range(4)])
    assert np.abs(alone - both).max() > 0.6
    guess = SteeringGuess(MODEL, lambda t, pose: np.tile(TWIST, (len(t), 1)))
    assert guess(0.0, x, plan) is None
    np.testing.assert_array_equal(plan.x, before[0])
    np.testing.assert_array_equal(plan.u, before[1])


def test_a_plan_that_turns_back_passes_through_rest_and_is_left_as_it_is() -> None:
    """Its first speed is zero because it changes its sign there. One that stands for good is written anew. Truth: the plan before."""
    ahead = wheel_velocities(G, STATE["leg"], np.array([1.0, 0.0, 0.0]))
    for slope in (-0.5, 0.0):
        x = MODEL.home.copy()
        steer = np.arctan2(ahead[:, 1], ahead[:, 0]) - G.wheel_heading - STATE["leg"]
        x[MODEL.state["steer"]] = (steer + np.pi / 2) % np.pi - np.pi / 2
        plan = at_rest(x, 6.0)
        plan.u[:, MODEL.input["base"].start] = np.maximum(slope * plan.grid[:-1], -0.2)
        preview = lambda t, pose, slope=slope: np.tile([-0.2, 0.0 if slope else 0.2, 0.0], (len(t), 1))
        found = SteeringGuess(MODEL, preview)(0.0, x, plan)
        assert (found is None) == (slope < 0.0)


def test_a_guess_from_rest_rolls_as_base_and_legs_move_the_wheels() -> None:
    plan = reconfiguring(speed=0.0)
    x = MODEL.home.copy()
    found = SteeringGuess(MODEL, lambda t, pose: np.tile(TWIST, (len(t), 1)))(0.0, x, plan)
    assert found is not None
    plan = found
    base, leg, rates = (plan.u[:, MODEL.input[g]] for g in ("base", "leg", "steer"))
    moves = np.flatnonzero(np.abs(base).max(axis=1) > 0.0)
    assert 0 < moves[0] < 60 and np.all(np.diff(moves) == 1) and moves[-1] == len(base) - 1
    assert not leg[: moves[0]].any()  # legs wait for their wheels too
    np.testing.assert_allclose(
        np.diff(plan.x[:, MODEL.state["leg"]], axis=0), leg * np.diff(plan.grid)[:, None], atol=1e-12
    )
    assert np.abs(rates).max() <= MODEL.limits.input_upper[MODEL.input["steer"]].min()
    for k in moves[1:]:
        angles = plan.x[k, MODEL.state["leg"]]
        v = wheel_velocities(G, angles, TWIST, SWING)
        heading = G.wheel_heading + angles + plan.x[k, MODEL.state["steer"]]
        assert np.abs(v[:, 1] * np.cos(heading) - v[:, 0] * np.sin(heading)).max() < 0.005
        along = v[:, 0] * np.cos(heading) + v[:, 1] * np.sin(heading)
        np.testing.assert_allclose(plan.u[k, MODEL.input["wheel"]] * G.wheel_radius, along, atol=1e-4)


def test_a_quick_turn_of_the_direction_is_seen_the_way_it_goes() -> None:
    """By 2.4 rad within 0.6 s, the wheels follow round and not back by the rest of half a turn. Truth: the direction itself."""

    def direction(t: np.ndarray) -> np.ndarray:
        return -1.2 + 2.4 * np.clip((t - 4.0) / 0.6, 0.0, 1.0)

    def preview(t: np.ndarray, pose: np.ndarray) -> np.ndarray:
        return 0.3 * np.stack([np.cos(direction(t)), np.sin(direction(t)), 0.0 * t], axis=1)

    start = (direction(np.zeros(1)) - G.wheel_heading - STATE["leg"]) % np.pi - np.pi  # room for the turn in the range
    x = MODEL.home.copy()
    x[MODEL.state["steer"]] = start
    plan = SteeringGuess(MODEL, preview).plan(0.0, 10.0, x, at_rest(x, 10.0))
    np.testing.assert_allclose(plan.steer, start + direction(plan.times)[:, None] + 1.2, atol=1e-9)
    assert plan.stops == ()


def test_it_is_quick() -> None:
    """About 0.12 ms of processor time; the bound leaves room for a slower machine, and for one that does other things too."""
    times, twists = circling(0.4, 10.0, NODES)
    best = np.inf
    for _ in range(50):
        start = time.process_time()
        planned(times, twists)
        best = min(best, time.process_time() - start)
    assert best < 1e-3


# ---------------------------------------------------------------------- alignment
@pytest.mark.parametrize("seed", range(6))
def test_aligned_wheels_have_a_common_center(seed: int) -> None:
    """The side-slip rows of the aligned angles have a twist in their null space; angles that had one stay."""
    rng = np.random.default_rng(seed)
    steer = rng.uniform(-1.5, 1.5, 4)
    rows = lambda a: np.array([
        np.array([-np.sin(h), np.cos(h), np.cos(h) * s[0] + np.sin(h) * s[1]])
        for h, s in zip(G.wheel_heading + STATE["leg"] + a, G.steer_axes(STATE["leg"]), strict=True)
    ])  # fmt: skip
    aligned = aligned_steering(G, STATE["leg"], steer)
    assert np.linalg.svd(rows(steer))[1][-1] > 1e-2
    assert np.linalg.svd(rows(aligned))[1][-1] < 1e-9
    assert np.abs(aligned - steer).max() <= np.pi / 2 + 1e-9
    np.testing.assert_allclose(aligned_steering(G, STATE["leg"], aligned), aligned, atol=1e-6)


class Walled:
    """Stands for an MPC: beyond ``wall`` [m] along x something moves."""

    def __init__(self, wall: float) -> None:
        self.wall = wall

    def evades(self, times: np.ndarray, states: np.ndarray) -> bool:
        return bool(states[:, MODEL.state["base"]][:, 0].max() < self.wall)


@pytest.mark.parametrize("wall", [0.2, 100.0])
def test_a_guess_does_not_run_into_what_moves(wall: float) -> None:
    """A plan at rest gets the motion that is foreseen, or, where that runs into something, its wheels' turn alone; a plan that moves is left."""
    sideways = np.array([0.3, 0.3, 0.0])
    x, rests = MODEL.home.copy(), at_rest(MODEL.home, 6.0)

    def guess() -> SteeringGuess:
        made = SteeringGuess(MODEL, lambda t, pose: np.tile(sideways, (len(t), 1)))
        made.bind(Walled(wall))  # type: ignore[arg-type]
        return made

    found = guess()(0.0, x, rests)
    assert found is not None
    base, steer = found.u[:, MODEL.input["base"]], found.x[:, MODEL.state["steer"]]
    assert (np.abs(base).max() > 0.2) == (wall > 6.0)
    v = wheel_velocities(G, x[MODEL.state["leg"]], sideways)
    heading = G.wheel_heading + x[MODEL.state["leg"]] + steer[-1]
    assert np.abs(v[:, 1] * np.cos(heading) - v[:, 0] * np.sin(heading)).max() < 0.01
    moving = at_rest(MODEL.home, 6.0)
    moving.u[10:, MODEL.input["base"]] = [0.0, -0.2, 0.0]  # its own way, later
    assert (guess()(0.0, x, moving) is None) == (wall < 6.0)
