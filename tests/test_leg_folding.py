"""Hinged legs fold where it is narrow. Truth: distances of the robot's own file in MuJoCo; closed forms of ramps."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

import wbmpc as wb
from clearing import TrueDistance
from wbmpc.bases import base_type
from wbmpc.bases.swerve.leg_folding import (
    CHECK_INTERVAL,
    FOLDED_AHEAD,
    GAP,
    OPEN_AFTER,
    OPEN_BEFORE,
    SHARES,
    LegFolding,
)

SPEED, BEGIN, LONG, WIDTH = 0.25, 2.0, 1.5, 1.0
HALF = [0.5 * LONG, 0.1, 0.7]


@pytest.fixture(scope="module")
def robot() -> wb.RobotModel:
    return wb.load_robot("swerve-ur10")


def places(offset: float) -> list[np.ndarray]:
    middle = np.array([BEGIN + HALF[0], offset, HALF[2]])
    return [middle + [0.0, s * (0.5 * WIDTH + HALF[1]), 0.0] for s in (1.0, -1.0)]


def path(robot: wb.RobotModel, times: np.ndarray) -> np.ndarray:
    states = np.tile(robot.home, (len(times), 1))
    states[:, 0] = SPEED * times
    return states


def folding(robot: wb.RobotModel, offset: float | None = 0.0) -> tuple[LegFolding, Any]:
    """With what it uses of an MPC, in a corridor whose middle is ``offset`` [m] to the left of the base's way (None: without walls)."""
    world, times = wb.Obstacles(), np.linspace(0.0, 40.0, 401)
    for k, place in enumerate([] if offset is None else places(offset)):
        world.set(f"wall{k}", wb.shapes.Box(tuple(HALF)), position=place)
    references = {"state": wb.Reference(times, path(robot, times))}
    mpc: Any = SimpleNamespace(
        obstacles=world,
        reference=references,
        ocp=SimpleNamespace(horizon=4.0, terms={}),
        period=0.02,
        set_schedule=lambda s: None,
    )
    made = LegFolding(robot, mpc)

    def as_planned(copy: bool = True) -> Any:
        """Of legs that are where they were to be."""
        return SimpleNamespace(x=robot.home[None] if made._set is None else made._set.values[:1], grid=np.zeros(1))

    mpc.solver = SimpleNamespace(trajectory=as_planned)
    return made, mpc


def test_legs_fold_as_far_as_their_wheels_need(robot: wb.RobotModel) -> None:
    made, mpc = folding(robot)
    times = np.array([2.0, 8.0, 11.0])  # before; front legs inside; all inside
    states = path(robot, times)
    shares, off = made.needed(mpc.obstacles.snapshot(0.0), times, states)
    assert not shares[0].any() and not off.any()
    assert (shares[1, :2] > 0.3).all() and not shares[1, 2:].any() and (shares[2] > 0.3).all()
    truth = TrueDistance(robot, [(mujoco.mjtGeom.mjGEOM_BOX, HALF)] * 2)
    names = ("leg", "steer", "wheel")
    truth.own = [g for g in truth.own if truth.model.body(truth.model.geom_bodyid[g]).name.startswith(names)]
    wanted = robot.description.collision.margin + GAP
    leg, step = robot.state["leg"], SHARES[1]
    for share, enough in ((shares[2], True), (shares[2] - step, False)):
        x = states[2].copy()
        x[leg] += share * (made._narrow - x[leg])
        assert (truth(x, places(0.0)) >= wanted - 1e-6) == enough


@pytest.mark.parametrize("name", ["pentapod-ur10", "telescope-ur10"])
def test_legs_of_any_kind_fold(name: str) -> None:
    """Five legs that turn, four that slide: at home they are wider than the corridor, folded they keep what is asked for."""
    robot = wb.load_robot(name)
    made, mpc = folding(robot)
    times = np.array([2.0, 11.0])
    states = path(robot, times)
    shares, _ = made.needed(mpc.obstacles.snapshot(0.0), times, states)
    assert not shares[0].any() and shares[1].any()
    truth = TrueDistance(robot, [(mujoco.mjtGeom.mjGEOM_BOX, HALF)] * 2)
    truth.own = [
        g for g in truth.own if truth.model.body(truth.model.geom_bodyid[g]).name.startswith(("leg", "steer", "wheel"))
    ]
    wanted, leg, x = robot.description.collision.margin + GAP, robot.state["leg"], states[1].copy()
    assert truth(x, places(0.0)) < wanted
    x[leg] += shares[1] * (made._narrow - x[leg])
    assert truth(x, places(0.0)) >= wanted - 1e-6


def test_the_base_moves_aside_where_its_body_needs_it(robot: wb.RobotModel) -> None:
    """The body is 0.8 m wide: in the middle of a wall's gap of 1 m, 0.1 m are left; 0.08 m off only 0.02 m."""
    made, mpc = folding(robot, 0.08)
    times = np.array([2.0, 11.0])
    _, off = made.needed(mpc.obstacles.snapshot(0.0), times, path(robot, times))
    assert not off[0].any() and off[1, 1] == 0.0 and 0.03 <= off[1, 0] <= 0.08


def test_legs_fold_in_a_corridor_that_turns_off_from_the_way(robot: wb.RobotModel) -> None:
    """By 5 degrees, 6 cm wider than the body: as the reference lies the body overlaps both walls, turned and aside it passes."""
    made, mpc = folding(robot, None)
    at = [np.array([BEGIN + HALF[0], s * (0.43 + HALF[1]), HALF[2]]) for s in (1.0, -1.0)]
    for k, place in enumerate(at):
        mpc.obstacles.set(f"wall{k}", wb.shapes.Box(tuple(HALF)), position=place)
    x = robot.home.copy()
    x[:3] = BEGIN + HALF[0], 0.1, 0.087
    truth = TrueDistance(robot, [(mujoco.mjtGeom.mjGEOM_BOX, HALF)] * 2)
    names = ("body", "base", "leg", "steer", "wheel")
    truth.own = [g for g in truth.own if truth.model.body(truth.model.geom_bodyid[g]).name.startswith(names)]
    assert truth(x, at) < 0.0
    shares, off = made.needed(mpc.obstacles.snapshot(0.0), np.zeros(1), x[None])
    x = made._moved(x[None], off)[0]
    leg = robot.state["leg"]
    x[leg] += shares[0] * (made._narrow - x[leg])
    assert truth(x, at) > 0.5 * robot.description.collision.margin


def test_legs_fold_for_where_a_reference_leads_that_waits(robot: wb.RobotModel) -> None:
    """What they are in the way of makes it wait: it never leads there before they fold."""
    made, mpc = folding(robot)
    running = mpc.reference["state"]
    before = 7.0  # the front legs are inside, the back ones are not
    mpc.reference["state"] = wb.Reference(np.array([0.0]), path(robot, np.array([before])))
    made.update(0.0, wb.Reference(running.times - before, running.values))
    assert made._ahead is not None
    shares = made._ahead[1]
    assert (shares.max(axis=0) > 0.3).all()
    late, other = folding(robot)
    other.reference["state"] = wb.Reference(np.array([0.0]), path(robot, np.array([before])))
    late.update(0.0)
    assert late._ahead is not None and not late._ahead[1][:, 2:].any()


def test_where_the_body_does_not_pass_nothing_folds(robot: wb.RobotModel) -> None:
    """A pillar in the middle of the way, and a person who crosses it."""
    made, mpc = folding(robot, None)
    pillar = wb.shapes.Cylinder((0, 0, 0), (0, 0, 1.5), 0.1)
    mpc.obstacles.set("pillar", pillar, position=(2.0, 0.0, 0.0))
    times = np.array([8.0, 8.0])
    shares, off = made.needed(mpc.obstacles.snapshot(0.0), times, path(robot, times))
    assert not shares.any() and not off.any()
    mpc.obstacles.set("pillar", pillar, position=(1.75, 0.7, 0.0), velocity=(0.0, 0.01, 0.0), seen=0.0)
    shares, _ = made.needed(mpc.obstacles.snapshot(0.0), np.array([4.0]), path(robot, np.array([4.0])))
    made.update(0.0)
    assert shares.any() and not made.brakes.commanded(4.0).any()


def test_brakes_are_open_while_legs_turn_no_faster_than_they_can(robot: wb.RobotModel) -> None:
    made, mpc = folding(robot)
    leg, limit = robot.state["leg"], robot.limits.input_upper[robot.input["leg"]]
    period, angles, is_open = 0.2, [], []
    whole = mpc.reference["state"]
    for k in range(150):
        mpc.reference["state"] = whole  # as who paces references does
        made.update(k * period)
        angles.append(mpc.reference["state"].at(k * period)[leg])
        is_open.append(made.brakes.commanded(k * period) > 0.5)
    rates, brakes = np.diff(angles, axis=0) / period, np.array(is_open)
    assert (np.abs(rates) <= limit + 1e-9).all()
    turning = np.abs(rates) > 0.02
    assert turning.any(axis=0).all() and brakes[1:][turning].all() and brakes[:-1][turning].all()
    reach = round((max(OPEN_BEFORE, OPEN_AFTER) + 2.0 * CHECK_INTERVAL) / period) + 2
    for i in range(4):
        near = np.convolve(turning[:, i], np.ones(2 * reach + 1), "same") > 0
        assert not brakes[1:, i][~near].any() and not brakes[-1, i]
    np.testing.assert_allclose([angles[0], angles[-1]], np.tile(robot.home[leg], (2, 1)), atol=1e-6)
    narrowest = np.abs(np.array(angles) - robot.home[leg]).max(axis=0)
    assert (narrowest > 0.3).all()


def test_legs_are_folded_before_they_have_to_be(robot: wb.RobotModel) -> None:
    """Of what has time enough to fold, everything is folded that long before its place needs it."""
    made, mpc = folding(robot)
    made.update(0.0)
    assert made._ahead is not None
    times, planned, _ = made._ahead
    shares, _ = made.needed(mpc.obstacles.snapshot(0.0), times, path(robot, times))
    late = times >= times[0] + 5.0
    assert shares[late].any()
    for t, share in zip(times[late], shares[late], strict=True):
        early = planned[np.abs(times - (t - FOLDED_AHEAD)) < 1e-6][0]
        assert (early >= share - 1e-9).all(), t


def test_the_brake_of_a_leg_that_lags_waits_for_it(robot: wb.RobotModel) -> None:
    """One back leg stays 8 degrees behind: its brake alone is open after the others have closed, until it has arrived."""
    made, mpc = folding(robot, None)
    for k, side in enumerate((1.0, -1.0)):  # 6 m long: all legs are inside from 11 s to 24 s
        wall, place = wb.shapes.Box((3.0, *HALF[1:])), (BEGIN + 3.0, side * (0.5 * WIDTH + HALF[1]), HALF[2])
        mpc.obstacles.set(f"wall{k}", wall, position=place)
    running, leg, as_planned, late = mpc.reference["state"], robot.state["leg"], mpc.solver.trajectory, np.zeros(4)

    def behind(copy: bool = True) -> Any:
        x = as_planned().x.copy()
        x[0, leg] += late * np.sign(robot.home[leg])
        return SimpleNamespace(x=x, grid=np.zeros(1))

    def follow(begin: float, end: float) -> np.ndarray:
        for t in np.arange(begin, end, CHECK_INTERVAL):
            mpc.reference["state"] = running
            made.update(float(t))
        return made.brakes.commanded(end) > 0.5

    mpc.solver.trajectory, late[3] = behind, np.radians(8.0)
    np.testing.assert_array_equal(follow(0.0, 14.0), [False, False, False, True])
    late[3] = 0.0
    assert not follow(14.0, 16.0).any()


def test_without_obstacles_nothing_changes(robot: wb.RobotModel) -> None:
    made, mpc = folding(robot, None)
    made.update(0.0)
    np.testing.assert_array_equal(mpc.reference["state"].at(3.0)[robot.state["leg"]], robot.home[robot.state["leg"]])
    assert not made.brakes.commanded(0.0).any() and not made.brakes.commanded(4.0).any()


def test_bases_of_one_shape_have_nothing_to_fold() -> None:
    robot, mpc = (
        wb.load_robot("differential-ur10"),
        SimpleNamespace(obstacles=wb.Obstacles(), reference={"state": None}),
    )
    assert base_type("differential").reshaping(robot, mpc, None) is None  # type: ignore[arg-type]


def test_events_of_brakes_are_replaced_from_a_time_on(robot: wb.RobotModel) -> None:
    made, _ = folding(robot, None)
    made.brakes.set(1.0, [1, 1, 0, 0])
    made.brakes.set(5.0, [1, 1, 1, 1])
    made.brakes.replace([(2.0, [0, 0, 1, 1]), (3.0, [0, 0, 0, 0])])
    found = [made.brakes.commanded(t).tolist() for t in (2.0, 3.0, 6.0)]
    assert found == [[0, 0, 1, 1], [0, 0, 0, 0], [0, 0, 0, 0]]
    for events in ([], [(2.0, [0] * 4), (2.0, [1] * 4)], [(np.inf, [0] * 4)]):
        with pytest.raises(wb.InputError, match="events in the order"):
            made.brakes.replace(events)
