"""Stances of any legs and the tour that uses them. Truth: MuJoCo's bodies and centers of mass, SciPy's convex hulls, random stances,
differences of the way."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from scipy.spatial import ConvexHull

from effort import draws
from toys import robot
from wbmpc.errors import InputError
from wbmpc.log import Log
from wbmpc.robots import load_spec
from wbmpc.stability import best_stance
from wbmpc.stability.stances import APART, between
from wbmpc.studies.pankert2022.legs import LegsSettings, build, figures, legs_tour
from wbmpc.studies.pankert2022.mission import at_home

NAMES = ("pentapod-ur10", "telescope-ur10")
WIDTH = 0.32


class Standing:
    """A robot at home in MuJoCo, but for its legs."""

    def __init__(self, name: str) -> None:
        self.robot = robot(name)
        self.model = load_spec(self.robot.description).compile()
        self.data = mujoco.MjData(self.model)

    def put(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Wheel centers (n, 2), directions in which the wheels roll (n, 2), center of mass (2), in the body's frame."""
        for group in ("leg", "steer", "arm"):
            for joint, value in zip(self.robot.state.groups[group], state[self.robot.state[group]], strict=True):
                self.data.qpos[self.model.joint(joint).qposadr[0]] = value
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        body = self.data.body(self.robot.description.base.body)
        turn = body.xmat.reshape(3, 3)
        joints = [self.model.joint(w).id for w in self.robot.state.groups["wheel"]]
        wheels = [self.data.xpos[self.model.jnt_bodyid[j]] for j in joints]
        rolls = [np.cross(self.data.xaxis[j], [0.0, 0.0, 1.0]) for j in joints]
        inside = lambda points: (np.array(points) @ turn)[:, :2]
        return (
            inside([w - body.xpos for w in wheels]),
            inside(rolls),
            inside([self.data.subtree_com[0] - body.xpos])[0],
        )

    def margin(self, leg: np.ndarray) -> float:
        """Of the center of mass to the hull of the wheels."""
        wheels, _, com = self.put(at_home(self.robot, leg))
        return float(-np.max(ConvexHull(wheels).equations @ [*com, 1.0]))


@pytest.fixture(scope="module", params=NAMES)
def stood(request) -> tuple[Standing, np.ndarray, np.ndarray]:  # type: ignore[no-untyped-def]
    found = Standing(request.param)
    return found, best_stance(found.robot), best_stance(found.robot, WIDTH)


def test_no_random_stance_stands_better(stood) -> None:  # type: ignore[no-untyped-def]
    standing, wide, narrow = stood
    part, rng = standing.robot.state["leg"], np.random.default_rng(1)
    low, high = standing.robot.limits.state_lower[part], standing.robot.limits.state_upper[part]
    assert ((low <= wide) & (wide <= high) & (low <= narrow) & (narrow <= high)).all()
    best = max(standing.margin(rng.uniform(low, high)) for _ in range(draws(200, 2000)))
    assert standing.margin(wide) > max(best, standing.margin(narrow) + 0.1) - 0.005
    near = [narrow + rng.normal(0.0, 0.05 * (high - low)) for _ in range(draws(200, 2000))]
    feet = [(leg, standing.put(at_home(standing.robot, leg))[0]) for leg in np.clip(near, low, high)]
    within = [leg for leg, wheels in feet if np.abs(wheels[:, 1]).max() <= WIDTH]
    assert len(within) > 3
    # what the margin gains by legs that nearly touch does not count here
    assert standing.margin(narrow) > np.median([standing.margin(leg) for leg in within])


def test_a_stance_that_is_changed_is_not_what_the_next_one_gets(stood) -> None:  # type: ignore[no-untyped-def]
    standing, wide, _ = stood
    best_stance(standing.robot)[:] = 9.0
    assert (best_stance(standing.robot) == wide).all() and np.abs(wide).max() < 4.0


def test_the_narrow_stance_is_narrow_and_its_wheels_are_apart(stood) -> None:  # type: ignore[no-untyped-def]
    standing, _, narrow = stood
    wheels = standing.put(at_home(standing.robot, narrow))[0]
    assert np.abs(wheels[:, 1]).max() <= WIDTH + 1e-9
    gaps = np.linalg.norm(wheels[:, None] - wheels[None], axis=2)[np.triu_indices(len(wheels), 1)]
    assert gaps.min() >= APART * standing.robot.base.geometry.wheel_radius - 1e-9


def test_wheels_keep_their_directions_in_another_stance(stood) -> None:  # type: ignore[no-untyped-def]
    """A leg that slides does not turn its wheel, one on a hinge does."""
    standing, wide, narrow = stood
    first, second = (standing.put(at_home(standing.robot, leg))[1] for leg in (wide, narrow))
    assert np.abs(np.sum(first * second, axis=1)) == pytest.approx(np.ones(len(first)), abs=1e-9)


def test_wheels_roll_along_the_way_of_the_tour(stood) -> None:  # type: ignore[no-untyped-def]
    """Truth: MuJoCo's wheels, whose centers are moved along the references of base and legs."""
    standing, _, _ = stood
    robot = standing.robot
    mission, h = legs_tour(robot, WIDTH, 0.1), 1e-4
    whole = np.arange(0.0, 64.0, 0.05)
    steer = mission.steer(robot, whole)
    checked = 0
    for k in range(100, whole.size, 37):
        t, places = float(whole[k]), []
        for now in (t - h, t + h):
            state = robot.home.copy()
            state[robot.state["leg"]], state[robot.state["steer"]] = mission.leg(now)[0][0], steer[k]
            wheels, rolls, _ = standing.put(state)
            x, y, yaw = mission.base(now)[0][0]
            c, s = np.cos(yaw), np.sin(yaw)
            turn = np.array([[c, -s], [s, c]])
            places.append(wheels @ turn.T + [x, y])
        velocity = (places[1] - places[0]) / (2.0 * h)
        aside = np.abs(velocity[:, 0] * (rolls @ turn.T)[:, 1] - velocity[:, 1] * (rolls @ turn.T)[:, 0])
        moving = np.linalg.norm(velocity, axis=1) > 0.02
        checked += int(moving.sum())
        assert (aside[moving] < 0.01 * np.linalg.norm(velocity, axis=1)[moving]).all(), t
    assert checked > 50


def test_brakes_are_open_exactly_while_legs_move(stood) -> None:  # type: ignore[no-untyped-def]
    standing, wide, narrow = stood
    mission = legs_tour(standing.robot, WIDTH, 0.1)
    mission.check(standing.robot.base.geometry)
    t = np.arange(0.0, 65.0, 0.01)
    legs, rates = mission.leg(t)
    times, states = (np.array(c) for c in zip(*mission.brakes, strict=True))
    index = np.searchsorted(times, t + 1e-9) - 1
    is_open = (index >= 0) & (states[np.maximum(index, 0)] > 0.5)
    assert not np.abs(rates[~is_open]).any()
    assert np.mean(np.abs(rates[is_open]).max(axis=1) > 0.0) > 0.8
    at = lambda when: legs[int(np.searchsorted(t, when))]
    for when, stance in ((10.0, narrow), (30.0, wide), (39.5, narrow), (53.0, wide), (64.0, narrow)):
        assert at(when) == pytest.approx(stance, abs=1e-9)


def test_the_figures_are_distances_of_the_feet() -> None:
    """A sliding leg that is 10 mm too long while its brake is open, one of four; a leg that stays 4 mm too short when it is closed."""
    telescope, log = robot("telescope-ur10"), Log()
    for k in range(100):
        want = np.full(4, 0.1)
        legs, is_open = want.copy(), k < 50
        legs[1] += 0.010 if is_open else 0.0
        legs[2] -= 0.0 if is_open else 0.004
        for name, value in (("leg", legs), ("leg_reference", want), ("brake", np.full(4, float(is_open)))):
            log.add(f"tour.{name}", 0.01 * k, value)
    found = figures(log, telescope)
    assert found["foot_error_rms"].value == pytest.approx(0.010 / 2.0)
    assert found["foot_error_end"].value == pytest.approx(0.004)
    y = 0.255 + (0.06 + 0.11) * np.sqrt(0.5)
    assert found["stance_width_max"].value == pytest.approx(2.0 * y, abs=1e-3)


def test_distances_of_lines_on_paper() -> None:
    a, b = np.array([[0.0, 0.0]] * 3), np.array([[1.0, 0.0]] * 3)
    c, d = np.array([[0.5, -1.0], [2.0, 1.0], [0.2, 0.3]]), np.array([[0.5, 1.0], [2.0, -1.0], [0.9, 0.7]])
    assert between(a, b, c, d) == pytest.approx([0.0, 1.0, 0.3])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"robot": "swerve-fixed-ur10"}, "has fixed legs"),
        ({"robot": "telescope-ur10", "half_width": 0.2}, "within 0.2 m"),
        ({"robot": "differential-ur10"}, "valid: swerve"),
    ],
)
def test_what_has_no_stances_is_rejected(changes: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        build(LegsSettings.model_validate(changes), 0)
