"""References that wait for the robot. Truth: closed forms of a clock that runs at a known rate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import wbmpc as wb
from clearing import keep_clear, reach_problem, write_arm
from wbmpc.mpc.reference_pacing import FALL, FREE, STANDING, PacedReferences

PERIOD = 0.04


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> wb.RobotModel:
    return wb.load_robot(write_arm(tmp_path_factory.mktemp("arm")))


def following(arm: wb.RobotModel, world: wb.Obstacles | None = None, speed: float = 0.1) -> wb.MPC:
    """An MPC whose end effector goes along y at ``speed`` [m/s] from where it is, for 4 s."""
    ocp = reach_problem(arm)
    if world is not None:
        keep_clear(ocp, wb.residuals.Clearance(arm, slots=1, margin=0.03))
    mpc = wb.MPC(ocp, rate=1.0 / PERIOD, obstacles=world)
    start, turn = arm.pose(arm.home)
    times = np.linspace(0.0, 4.0, 41)
    mpc.reference["end_effector"] = wb.Reference.poses(times, start + np.outer(speed * times, [0, 1, 0]), turn)
    mpc.reset(arm.home)
    return mpc


def test_who_follows_has_the_clock(arm: wb.RobotModel) -> None:
    mpc = following(arm)
    whole = mpc.reference["end_effector"]
    pace = PacedReferences(mpc)
    for k in range(1, 60):
        t = k * PERIOD
        pace.advance(t, whole.at(t)[:3] + [0.0, 0.0, 0.9 * FREE])
        assert pace.rate == 1.0 and pace.time == pytest.approx(t) and pace.delay == pytest.approx(0.0, abs=1e-12)
        for ahead in (0.0, 0.13, 1.0):
            np.testing.assert_allclose(mpc.reference["end_effector"].at(t + ahead), whole.at(t + ahead), atol=1e-9)


def test_a_robot_that_stands_stops_the_clock_and_lets_it_go_on(arm: wb.RobotModel) -> None:
    """Held where the path begins, its reference stops before it is STANDING away; the plan then sees a reference at rest."""
    mpc = following(arm)
    whole, pace = mpc.reference["end_effector"], PacedReferences(mpc)
    start = whole.at(0.0)[:3]
    for k in range(1, 200):
        pace.advance(k * PERIOD, start)
    t = 199 * PERIOD
    assert pace.waits and np.linalg.norm(whole.at(pace.time)[:3] - start) == pytest.approx(STANDING, abs=0.02)
    assert pace.missed(start) == pytest.approx(0.4)
    reference = mpc.reference["end_effector"]
    np.testing.assert_allclose(reference.at(t + 2.0), reference.at(t), atol=0.01)
    waited, reached = pace.delay, pace.time
    for k in range(200, 230):  # it is let go
        pace.advance(k * PERIOD, whole.at(pace.time)[:3])
    assert not pace.waits and pace.time > reached and pace.delay > waited
    assert pace.rate == 1.0


def test_what_is_ahead_comes_at_the_rate(arm: wb.RobotModel) -> None:
    """Half the rate: what is 1 s ahead on the path is planned in 2 s."""
    mpc = following(arm)
    whole, pace = mpc.reference["end_effector"], PacedReferences(mpc)
    behind = whole.at(0.0)[:3] - [0.5 * (FREE + STANDING), 0.0, 0.0]
    for k in range(1, round(0.5 / FALL / PERIOD) + 3):
        t = k * PERIOD
        pace.advance(t, behind + whole.at(pace.time)[:3] - whole.at(0.0)[:3])
    assert pace.rate == pytest.approx(0.5, abs=0.03)
    for ahead in (0.1, 1.0, 1.9):
        expected = whole.at(pace.time + pace.rate * ahead)
        np.testing.assert_allclose(mpc.reference["end_effector"].at(t + ahead), expected, atol=1e-9)


def test_plans_that_lack_clearance_slow_the_clock(arm: wb.RobotModel) -> None:
    """A wall that the arm's tip is in: the plan lacks its margin whatever it does."""
    world = wb.Obstacles()
    mpc = following(arm, world)
    pace = PacedReferences(mpc)
    tip = arm.pose(arm.home)[0]
    mpc.update(wb.Observation(0.0, arm.home))
    pace.advance(PERIOD, tip)
    assert pace.rate == 1.0
    world.set("wall", wb.shapes.Box((0.1, 1.0, 1.0)), position=tip + [0.02, 0.0, 0.0])
    for k in range(1, 12):
        mpc.update(wb.Observation(k * PERIOD, arm.home))
        pace.advance((k + 1) * PERIOD, mpc.reference["end_effector"].at((k + 1) * PERIOD)[:3])
    assert mpc.clearance.excess < -0.06 and pace.rate < 0.1


def test_a_path_is_needed(arm: wb.RobotModel, tmp_path: Path) -> None:
    ocp = wb.OptimalControlProblem(arm.dynamics(), 1.0, 10)
    ocp.add(wb.Cost("input", wb.residuals.Input(arm, reference=None), 1.0))
    with pytest.raises(wb.InputError, match="needs a reference 'end_effector'"):
        PacedReferences(wb.MPC(ocp))
