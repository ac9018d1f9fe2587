"""Pushes, circle and whole-body square, shortened. Truth: figures computed once more from the log, geometry, the force of a push
over the robot's mass."""

from __future__ import annotations

import numpy as np
import pytest

from archives import without_units
from effort import thorough
from toys import robot
from wbmpc.registry import REGISTRY
from wbmpc.studies.minniti2019 import circle as rezero_circle
from wbmpc.studies.minniti2019 import wholebody as rezero_wholebody
from wbmpc.studies.minniti2019.circle import RezeroCircleSettings
from wbmpc.studies.minniti2019.push_settings import RezeroPushBallSettings, RezeroPushHandSettings
from wbmpc.studies.minniti2019.task import BENT_ARM
from wbmpc.studies.minniti2019.wholebody import RezeroWholebodySettings

BALL = robot("rezero")


def values(result) -> dict[str, float]:  # type: ignore[no-untyped-def]
    assert result.completed, result.reason
    assert all(len(s.x) == len(s.y) > 0 for p in result.plots for s in p.series)
    return {name: m.value for name, m in result.metrics.items()}


@pytest.mark.parametrize(
    ("held", "settle", "pause"), [pytest.param("ball", 1.5, 6.0, marks=thorough), ("hand", 0.5, 3.0)]
)
def test_a_push_moves_the_robot_and_it_comes_back(held: str, settle: float, pause: float) -> None:
    short = {"forces": (60.0,), "settle_time": settle, "pause": pause}
    kind = {"ball": RezeroPushBallSettings, "hand": RezeroPushHandSettings}[held]
    result = REGISTRY[f"rezero-push-{held}"].run(kind(**short), 0, None)
    m, log = values(result), result.log
    assert m["recovered"] == 1.0 and m["not_recovered"] == 0.0 and m["fell"] == 0.0
    t, state = log.times("state"), log.array("state")
    assert m["ball_travel_max"] == pytest.approx(np.hypot(state[:, 0], state[:, 1]).max())
    assert m["tilt_max"] == log.array("tilt").max()
    place = state[:, :2] if held == "ball" else log.array("hand") - log.array("hand")[0]
    at_rest = [(t >= end - 0.5) & (t < end) for end in (settle + pause, settle + 2.0 * pause)]
    away = max(float(np.linalg.norm(place[window], axis=1).max()) for window in at_rest)
    assert m["rest_error_world_max"] == pytest.approx(away, abs=0.015) and 0.0 < m["rest_error_max"] < 0.05
    # 60 N for 0.2 s give 12 N s: about 0.5 m/s for 25 kg, along x first and then along y
    speed = BALL.state["base_velocity"].start
    for k, axis in enumerate((0, 1)):
        now = np.argmin(np.abs(t - (settle + pause * k + 0.2)))
        assert 0.1 < state[now, speed + axis] < 0.9
        assert abs(state[now, speed + 1 - axis]) < 0.1
    assert without_units(log) == {"plan_violation"}  # of all constraints together
    # the joints as they are and as they were planned, inside of the limits of the robot's file
    (arm,) = (p for p in result.plots if p.title == "Joint positions: arm")
    assert [s.dashed for s in arm.series] == [False, True] * 3
    for line, rows in zip(arm.series[::2], state[:, BALL.state["arm"]].T, strict=True):
        np.testing.assert_allclose(line.y, np.degrees(np.interp(line.x, t, rows)), atol=1e-6)
    for line, limit in zip(arm.series[::2], BALL.limits.state_upper[BALL.state["arm"]], strict=True):
        assert line.limits is not None and line.limits[1] == pytest.approx(np.degrees(limit))
    (shown,) = (p for p in result.plots if p.title.startswith("Pushes"))
    assert [np.trapezoid(s.y, s.x) for s in shown.series] == pytest.approx([12.0, 12.0], rel=0.01)


@thorough
@pytest.mark.parametrize("controller", ["lqr", "scheduled-lqr"])
def test_regulators_stand_a_small_push_without_a_plan(controller: str) -> None:
    settings = RezeroPushBallSettings(forces=(40.0,), settle_time=0.5, pause=4.0, controller=controller)
    result = REGISTRY["rezero-push-ball"].run(settings, 0, None)
    m, log = values(result), result.log
    assert result.mpc is not None and result.mpc.solves == 0
    assert m["fell"] == 0.0 and m["not_recovered"] == 0.0
    t, torque, state = log.times("torque"), log.array("torque"), log.array("state")
    assert np.abs(torque[:, :3]).max() <= 4.0 + 1e-9
    start = BALL.state["base_velocity"].start
    assert state[np.argmin(np.abs(t - 0.7)), start] > 0.1  # it was pushed
    assert np.hypot(*state[t > 8.2, :2].T).max() < 0.06


def test_a_fall_is_foreseen_and_ends_with_motors_off() -> None:
    """180 N s, without room for a push that is felt: the robot falls, and the run ends before it has."""
    result = REGISTRY["rezero-push-hand"].run(
        RezeroPushHandSettings(forces=(900.0,), settle_time=0.5, controller={"estimator": {"expected_push_time": 0.0}}),
        0,
        None,
    )
    assert not result.completed and "will fall" in result.reason and "motors off" in result.reason
    assert result.metrics["fell"].value == 1.0
    tilt = result.log.array("tilt")
    assert 0.1 < tilt[-1] < 0.85 and len(tilt) > 0.5 * 400


def test_a_force_beyond_all_leans_is_learned_reported_and_ends_the_run() -> None:
    """90 N for good: 1.3 times what the wheels can hold (90 N x 0.125 m against 8.6 N m at the ball)."""
    settings = RezeroPushHandSettings(forces=(90.0,), push_duration=5.0, settle_time=0.5)
    result = REGISTRY["rezero-push-hand"].run(settings, 0, None)
    # which of its reasons comes first (2 m/s, a lean that wheels cannot stop, an arm that its body holds) rounding decides
    assert not result.completed and result.reason.endswith("motors off")
    assert result.metrics["fell"].value == 1.0 and result.outcome == "fell"
    assert any("pushes the robot away" in fault for fault in result.faults)
    log = result.log
    force, t = log.array("disturbance")[:, 0], log.times("disturbance")
    assert force[t > 1.2].max() == pytest.approx(90.0, rel=0.2) and np.abs(force[t < 0.95]).max() < 10.0


def test_circle_path_is_a_circle_from_rest_to_rest() -> None:
    s = RezeroCircleSettings(radius=0.2, lap_time=4.0, rounds=2, settle_time=1.0)
    t = np.arange(0.0, 14.0, 0.001)
    path = rezero_circle.ball_path(s, t)
    centered = path - [0.0, 0.2]
    np.testing.assert_allclose(np.hypot(*centered.T), 0.2, atol=1e-12)
    speed = np.linalg.norm(np.gradient(path, t, axis=0), axis=1)
    assert speed[t < 0.99].max() < 1e-9 and speed[t > 10.1].max() < 1e-9
    np.testing.assert_allclose(speed[(t > 2.1) & (t < 8.9)], 0.2 * 2.0 * np.pi / 4.0, rtol=1e-3)
    turned = np.unwrap(np.arctan2(centered[:, 1], centered[:, 0]))
    assert turned[-1] - turned[0] == pytest.approx(4.0 * np.pi, abs=1e-9)
    assert np.abs(np.gradient(speed, t)).max() < 1.1 * 0.2 * 2.0 * np.pi / 4.0


def test_hand_stays_inside_its_reach_on_the_circle() -> None:
    """85 % of 0.6 m from the shoulder, at the place of the ball that is farthest from the end effector."""
    home = BALL.base.numeric.equilibrium(BENT_ARM)[0]
    end_effector = BALL.pose(home)[0]
    shoulder = np.array([0.0, 0.0, 0.5])
    path = rezero_circle.ball_path(RezeroCircleSettings(), np.arange(0.0, 25.0, 0.01))
    distance = np.linalg.norm(end_effector - shoulder - np.c_[path, 0.0 * path[:, 0]], axis=1)
    assert 0.3 < distance.max() < 0.85 * 0.6


@thorough
def test_hand_stays_while_the_ball_drives_round() -> None:
    result = REGISTRY["rezero-circle"].run(RezeroCircleSettings(rounds=1, settle_time=2.0), 0, None)
    m, log = values(result), result.log
    use = log.times("state") >= 2.0
    end_effector = BALL.pose(BALL.base.numeric.equilibrium(BENT_ARM)[0])[0]
    felt = np.linalg.norm(log.array("hand_estimated")[use] - end_effector, axis=1)
    assert m["hand_error_rms"] == pytest.approx(np.sqrt(np.mean(felt**2)))
    assert 1e-4 < m["hand_error_rms"] < 0.01
    assert np.ptp(log.array("state")[use, 1]) == pytest.approx(0.3, rel=0.15)
    assert m["ball_error_rms"] < 0.06


@thorough
def test_unknown_load_leaves_no_offset() -> None:
    result = REGISTRY["rezero-wholebody"].run(RezeroWholebodySettings(settle_time=6.0, hold_time=2.0), 0, None)
    m, log = values(result), result.log
    ball = log.array("estimate")[:, :2]  # the whole run, in which the load is weighed
    assert m["ball_error_rms_wholebody"] == pytest.approx(np.sqrt(np.mean(np.sum(ball**2, axis=1))))
    assert 1e-4 < m["steady_hand_error_max"] < 0.006
    assert m["steady_ball_offset_max"] < 0.0032
    assert m["ball_error_rms_world"] < 0.0102
    assert 0.0 < m["feedback_share"] < 0.3
    joint, ratio = (p for p in result.plots if "Fig. 7" in p.title)
    whole, forward, back = (s.y for s in joint.series)
    np.testing.assert_allclose(forward + back, whole, atol=1e-9)
    large = np.abs(whole) > 1.0
    assert large.mean() > 0.5
    np.testing.assert_allclose(ratio.series[0].y[large], 100.0 * np.abs(back / whole)[large])


def test_the_square_has_sides_of_25_cm() -> None:
    times, places = rezero_wholebody.end_effector_path(RezeroWholebodySettings(), np.array([0.3, 0.0, 0.5]))
    assert np.ptp(places, axis=0) == pytest.approx([0.0, 0.25, 0.25])
    assert np.all(np.diff(times) >= 0.0)
