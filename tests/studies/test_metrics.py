"""The figures of a run. Truth: logs written by formula, whose rise times, steady errors and drifts are known."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from archives import without_units
from toys import robot
from wbmpc.bases.swerve.wheel_calibration import WheelCalibration
from wbmpc.log import Log
from wbmpc.ocp import Reference
from wbmpc.registry import REGISTRY
from wbmpc.result import Metric
from wbmpc.studies.minniti2019 import step_figures
from wbmpc.studies.minniti2019 import steps as rezero_steps
from wbmpc.studies.minniti2019.step_goals import STEPS
from wbmpc.studies.minniti2019.steps import RezeroStepsSettings
from wbmpc.studies.pankert2022 import track_figures
from wbmpc.studies.pankert2022.track_references import SwerveTrackSettings, TrackReferences

BALL = robot("rezero")


def rotations(quaternions: np.ndarray) -> Rotation:
    return Rotation.from_quat(np.roll(np.atleast_2d(quaternions), -1, axis=1))


# ---------------------------------------------------------------------- rezero-steps
def stepping(settings: RezeroStepsSettings, constants, offsets, turns, heading=None) -> dict[str, float]:  # type: ignore[no-untyped-def]
    """Metrics of an end effector that goes to pose i exponentially with ``constants[i]`` [s], and comes to rest ``offsets[i]`` [m]
    beside it, turned by the vector ``turns[i]`` [rad]; an estimator, if there is one, believes all turned by ``heading`` [rad]."""
    schedule, log, lead = rezero_steps.Schedule.of(settings, BALL), Log(), settings.lead
    times = np.arange(0.0, schedule.duration, 0.005)
    index = np.maximum(np.searchsorted(schedule.times - lead, times + 1e-9, side="right") - 1, 0)
    for i in range(index.max() + 1):
        now, old = times[index == i], max(i - 1, 0)
        share = (
            np.clip(1.0 - np.exp(-(now - schedule.times[i] + lead) / constants[i]), 0.0, 1.0) if i else 1.0 + 0.0 * now
        )
        places = (
            schedule.positions[old] + share[:, None] * (schedule.positions[i] - schedule.positions[old]) + offsets[i]
        )
        between = Slerp([0.0, 1.0], rotations(schedule.quaternions[[old, i]]))(share)
        spins = np.roll((Rotation.from_rotvec(turns[i]) * between).as_quat(), 1, axis=1)
        for t, place, spin in zip(now, places, spins, strict=True):
            log.add("hand", t, place)
            log.add("hand_quaternion", t, spin)
            if heading is not None:
                believed = Rotation.from_rotvec([0.0, 0.0, heading]) * rotations(spin)[0]
                log.add("hand_quaternion_estimated", t, np.roll(believed.as_quat(), 1))
    for t in times:
        log.add("tilt", t, 0.1 * np.sin(t))
        log.add("state", t, np.zeros(2 * 8))  # three joints: the other three torques are the wheels'
        log.add("torque", t, [1.0, -2.5 if t > 3.0 else 0.0, 0.5, 9.0, 9.0, 9.0])
    assert len(schedule.times) == len(STEPS) + 3
    return {n: m.value for n, m in step_figures.metrics(log, schedule, settings, fell=False).items()}


@pytest.mark.parametrize("preview", [True, False])
def test_metrics_of_steps_with_known_errors(preview: bool) -> None:
    settings = RezeroStepsSettings(preview=preview)
    poses = len(STEPS) + 3
    constants, offsets, turns = np.full(poses, 0.1), np.zeros((poses, 3)), np.zeros((poses, 3))
    constants[4], offsets[6], turns[7] = 0.4, [0.003, 0.0, -0.004], [0.0, 0.02, 0.0]
    turns[len(STEPS) + 1] = [0.0, 0.0, -0.3]
    m = stepping(settings, constants, offsets, turns)
    assert m["rise_time_max"] == pytest.approx(0.4 * np.log(9.0), abs=0.006)  # 10 to 90 % of an exponential
    assert m["steady_position_error_world_max"] == m["steady_position_error_max"]
    if (
        preview
    ):  # it leaves a whole horizon before it is asked to, and is where it should not be in all of the last second
        assert m["steady_position_error_max"] > 0.2 and m["steady_orientation_error_max"] > 0.3
    else:
        assert m["steady_position_error_max"] == pytest.approx(0.005, rel=2e-3)
        assert m["steady_orientation_error_max"] == pytest.approx(0.02, rel=2e-3)
        assert m["unreachable_rotation_error"] == pytest.approx(0.3, rel=1e-3)
    assert m["tilt_max"] == pytest.approx(0.1, rel=1e-4)
    assert m["wheel_torque_max"] == 2.5  # of the wheels, not of the arm
    assert m["fell"] == 0.0


def test_the_last_second_of_a_hold_is_the_steady_one() -> None:
    """0.2 m, with a time constant of 1 s: the mean of the exponential from 4 to 5 s after the step."""
    poses = len(STEPS) + 3
    constants = np.full(poses, 0.1)
    constants[1] = 1.0
    m = stepping(RezeroStepsSettings(), constants, np.zeros((poses, 3)), np.zeros((poses, 3)))
    assert m["steady_position_error_max"] == pytest.approx(0.2 * (np.exp(-4.0) - np.exp(-5.0)), rel=0.01)


def test_a_wrong_heading_turns_the_hand_in_the_world_not_in_the_estimated_frame() -> None:
    poses = len(STEPS) + 3
    turns = np.tile([0.0, 0.0, 0.03], (poses, 1))
    m = stepping(RezeroStepsSettings(), np.full(poses, 0.1), np.zeros((poses, 3)), turns, heading=-0.03)
    assert m["steady_orientation_error_max"] < 1e-6
    assert m["steady_orientation_error_world_max"] == pytest.approx(0.03)


def test_the_roll_about_the_forearm_is_distinguished() -> None:
    """The end effector's z axis is the forearm; at home, where the first pose is, it points where the arm's chain puts it."""
    poses = len(STEPS) + 3
    settings = RezeroStepsSettings()
    schedule = rezero_steps.Schedule.of(settings, BALL)
    axes = [rotations(q)[0].as_matrix() for q in schedule.quaternions]
    turns = np.array([0.03 * a[:, 2] + 0.004 * a[:, 0] for a in axes])
    m = stepping(settings, np.full(poses, 0.1), np.zeros((poses, 3)), turns)
    assert m["steady_orientation_error_max"] == pytest.approx(np.hypot(0.03, 0.004), rel=1e-3)
    assert m["steady_orientation_error_arm_max"] == pytest.approx(0.004, rel=1e-2)


def test_a_step_that_stays_short_has_no_rise_time() -> None:
    poses = len(STEPS) + 3
    constants = np.full(poses, 0.1)
    constants[2] = 10.0  # 40 % after 5 s
    m = stepping(RezeroStepsSettings(), constants, np.zeros((poses, 3)), np.zeros((poses, 3)))
    assert m["rise_time_max"] == np.inf
    assert m["steady_position_error_max"] > 0.1


# ---------------------------------------------------------------------- swerve-track
TRACK = SwerveTrackSettings(periods=1)


def tracking(
    estimated: np.ndarray, world: np.ndarray, drift: float, settings: SwerveTrackSettings = TRACK
) -> dict[str, Metric]:
    """Metrics of an end effector beside its reference by ``estimated`` and ``world`` (3) [m] from 2 s on (ten times that before),
    and odometries that end ``drift``, 2 drift and 3 drift [m] off."""
    references, log = TrackReferences(settings, robot("swerve-ur10")), Log()
    for t in np.arange(0.0, references.duration, 0.02):
        reference, gone = references.end_effector(np.array([t]))[0], references.base(np.array([t]))[0][0]
        factor, share = (10.0 if t < 2.0 else 1.0), t / references.duration
        pose = np.array([gone, 0.0, 0.0])
        log.add("hand", t, reference + factor * world)
        log.add("hand_odometry", t, reference + factor * estimated)
        log.add("hand_reference", t, reference)
        log.add("hand_rotation", t, factor * 0.01)
        log.add("hand_rotation_world", t, factor * 0.02)
        log.add("base", t, pose)
        for k, name in enumerate(("base_odometry", "base_wheels", "base_release"), start=1):
            log.add(name, t, pose + share * k * drift * np.array([0.6, 0.8, 7.0]))
        log.add("wheel_slip", t, factor * np.array([0.01, 0.02, 0.03, 0.0]))
    return track_figures.metrics(log, references)


def values(metrics: dict[str, Metric]) -> dict[str, float]:
    return {name: m.value for name, m in metrics.items()}


@pytest.mark.parametrize(
    ("changes", "end_effector", "base"),
    [
        ({}, 20.53, 15.96),
        ({"variant": "vertical"}, 20.53, 15.96),
        ({"variant": "peaks"}, None, 15.96),
        ({"variant": {"kind": "horizontal", "amplitude": 0.3}}, None, 15.96),
        ({"periods": 1}, None, None),
    ],
)
def test_the_papers_lengths_stand_beside_its_path_only(
    changes: dict[str, Any], end_effector: float | None, base: float | None
) -> None:
    m = tracking(np.zeros(3), np.zeros(3), 0.0, SwerveTrackSettings(**{"speed": 0.8, **changes}))
    assert (m["path_length"].paper, m["base_path_length"].paper) == (end_effector, base)
    if end_effector is not None:
        assert m["path_length"].value == pytest.approx(end_effector, rel=1e-3)


def test_metrics_of_a_track_with_known_errors() -> None:
    m = values(tracking(np.array([0.0, 0.0, 0.003]), np.array([0.003, 0.004, 0.012]), drift=0.02))
    assert m["hand_error_mean_odometry"] == pytest.approx(0.003)
    assert m["hand_error_max_odometry"] == pytest.approx(0.003)
    assert m["hand_error_mean_nearest"] == pytest.approx(0.003, rel=1e-3)  # across the plane of the path
    assert m["hand_error_mean_world"] == pytest.approx(0.013)
    assert m["hand_orientation_error_max"] == pytest.approx(0.01)
    assert m["hand_orientation_error_max_world"] == pytest.approx(0.02)
    assert m["hand_error_max_world"] == pytest.approx(0.013)
    assert m["path_length"] == pytest.approx(20.53 / 6, rel=1e-3)
    assert m["base_path_length"] == pytest.approx(15.96 / 6, rel=1e-6)
    assert m["wheel_slip_max"] == pytest.approx(0.03)
    for k, name in enumerate(
        ("odometry_drift_ratio", "odometry_drift_ratio_wheels", "odometry_drift_ratio_release"), 1
    ):
        assert m[name] == pytest.approx(k * 0.02 / (15.96 / 6), rel=2e-3)


def test_an_error_along_the_path_is_not_one_to_its_nearest_point() -> None:
    """An end effector 1 cm ahead along x is 1 cm off in time, but nearer to the path."""
    m = values(tracking(np.array([0.01, 0.0, 0.0]), np.zeros(3), drift=0.0))
    assert m["hand_error_mean_odometry"] == pytest.approx(0.01)
    assert 0.004 < m["hand_error_mean_nearest"] < 0.009
    assert m["odometry_drift_ratio"] == 0.0


def test_the_hand_makes_up_for_wheels_that_are_smaller_than_described() -> None:
    """Truth: a base whose wheels are 0.3 mm smaller stands 0.3 mm lower, and its end effector has to reach as much higher."""
    swerve = robot("swerve-ur10")
    geometry = swerve.base.geometry
    known = replace(WheelCalibration.unknown(geometry), wheel_radius=np.full(4, geometry.wheel_radius - 3e-4))
    assert known.rise(geometry) == pytest.approx(-3e-4)
    given: dict[str, Reference] = {}
    mpc = SimpleNamespace(reference=given, ocp=SimpleNamespace(dynamics=swerve.dynamics()))
    references = TrackReferences(TRACK, swerve)
    references.set(mpc, swerve.home, -known.rise(geometry))  # type: ignore[arg-type]
    t = np.array([3.0])
    height = given["end_effector"].at(3.0)[2]
    assert height - references.end_effector(t)[0, 2] == pytest.approx(3e-4, abs=1e-6)


def test_every_channel_of_the_stances_has_units() -> None:
    stances = REGISTRY["swerve-stability"]
    assert without_units(stances.run(stances.config_type(), 0, None).log) == set()
