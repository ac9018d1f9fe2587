"""Both experiments, shortened: they run through, their figures are of the right size, and they repeat bit by bit."""

from __future__ import annotations

import signal
from pathlib import Path

import numpy as np
import pytest

from archives import check_steps, check_track, without_units
from effort import thorough
from toys import robot
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.registry import REGISTRY
from wbmpc.robots import load_description
from wbmpc.simulation.any_perturbation import AnyPerturbation
from wbmpc.studies.minniti2019.steps import RezeroStepsSettings
from wbmpc.studies.pankert2022.track_references import SwerveTrackSettings, TrackReferences

TRACK = SwerveTrackSettings(periods=1, settle_time=1.0, calibration="none")
STEPS = RezeroStepsSettings(hold_time=3.5, settle_time=1.5, final_hold_time=0.0)
SHORT = RezeroStepsSettings(hold_time=1.5, settle_time=0.5, final_hold_time=0.0, preview=False)


@pytest.fixture(scope="module")
def track():  # type: ignore[no-untyped-def]
    return REGISTRY["swerve-track"].run(TRACK, 0, None)


@pytest.fixture(scope="module")
def steps():  # type: ignore[no-untyped-def]
    return REGISTRY["rezero-steps"].run(STEPS, 0, None)


def check_statistics(result) -> None:  # type: ignore[no-untyped-def]
    assert result.completed, result.reason
    assert result.reason == ""
    assert 0.0 < result.mpc.solve_ms["median"] <= result.mpc.solve_ms["p95"] <= result.mpc.solve_ms["max"]
    assert all(np.isfinite(m.value) for m in result.metrics.values())
    assert result.mpc.solves > 100
    assert result.mpc.failed_share == 0.0
    for plot in result.plots:
        for series in plot.series:
            assert len(series.x) == len(series.y) > 0, plot.title


def test_swerve_follows_its_path(track, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    check_statistics(track)
    assert without_units(track.log) == {"plan_violation"}  # of all constraints together
    check_track(track, tmp_path)
    m = {name: metric.value for name, metric in track.metrics.items()}
    assert 1e-4 < m["hand_error_mean_odometry"] < 0.005
    assert m["hand_error_mean_odometry"] < m["hand_error_max_odometry"] < 0.03
    assert 1e-4 < m["hand_error_mean_nearest"] < m["hand_error_mean_odometry"] + 1e-6
    assert 1e-4 < m["hand_error_mean_world"] < 0.1
    assert 1e-4 < m["odometry_drift_ratio"] < 0.02
    assert 1e-4 < m["odometry_drift_ratio_wheels"] < 0.05
    assert 1e-4 < m["wheel_slip_max"] < 0.5
    assert m["path_length"] == pytest.approx(20.53 / 6, rel=0.02)
    assert m["base_path_length"] == pytest.approx(15.96 / 6, rel=0.15)
    assert 1e-3 < m["hand_orientation_error_max"] < 0.1
    speeds = next(p for p in track.plots if p.title == "Joint speeds over their limits")
    assert [s.name for s in speeds.series] == ["leg", "steer", "wheel", "arm"]
    assert all(s.y.min() >= 0.0 and s.y.max() < 110.0 for s in speeds.series)  # %
    assert all(s.y.max() > 1.0 for s in speeds.series[1:])
    assert track.mpc.rate_hz == 50.0


def test_the_figures_of_the_track_are_those_of_its_record(track) -> None:  # type: ignore[no-untyped-def]
    """Truth: MuJoCo's kinematics of the recorded joints on the recorded and on the estimated base; sums written out."""
    log, m = track.log, {name: metric.value for name, metric in track.metrics.items()}
    mujoco = SwervePlant(load_description("swerve-ur10"), None, AnyPerturbation.none(), settle=0.0)

    def end_effector(state: np.ndarray, base: np.ndarray) -> np.ndarray:
        mujoco.arrange(np.concatenate([base, state[3:]]))
        return mujoco.truth().tool

    rows = range(0, len(log.array("hand")), 20)
    for name, base in (("hand", "base"), ("hand_odometry", "base_odometry")):
        found = np.array([end_effector(log.array("state")[k], log.array(base)[k]) for k in rows])
        # the base tilts and sinks into its tires
        assert np.linalg.norm(found - log.array(name)[rows], axis=1).max() < 0.006
    # the end effector comes to the start of the sine first; errors count from 2 s after that
    approach = TrackReferences(TRACK, robot("swerve-ur10")).approach.duration
    late, means = log.times("hand") >= approach + 2.0, []
    for name, ending in (("hand", "world"), ("hand_odometry", "odometry")):
        off = np.sqrt(((log.array(name) - log.array("hand_reference")) ** 2).sum(axis=1))[late]
        means.append(off.mean())
        found = m[f"hand_error_mean_{ending}"], m[f"hand_error_max_{ending}"]
        assert found == pytest.approx((off.mean(), off.max()), rel=1e-9)
    assert abs(means[0] - means[1]) > 1e-5  # nobody takes one for the other
    base = log.array("base")
    way = sum(float(np.hypot(*step)) for step in np.diff(base[:, :2], axis=0))
    for name, ending in (("odometry", ""), ("wheels", "_wheels"), ("release", "_release")):
        apart = float(np.hypot(*(log.array(f"base_{name}")[-1] - base[-1])[:2]))
        assert m[f"odometry_drift_ratio{ending}"] == pytest.approx(apart / way, rel=1e-9)


@thorough
def test_rezero_takes_its_steps(steps, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    check_statistics(steps)
    check_steps(steps, tmp_path)
    m = {name: metric.value for name, metric in steps.metrics.items()}
    assert m["fell"] == 0.0
    assert 1e-4 < m["steady_position_error_max"] < 0.015
    assert 0.3 < m["rise_time_max"] < 1.3
    assert 0.05 < m["tilt_max"] < 0.35
    assert 0.5 < m["wheel_torque_max"] <= 4.0 + 1e-9
    assert 1e-3 < m["steady_orientation_error_max"] < 0.5
    assert 0.1 < m["unreachable_rotation_error"] < np.pi / 6 + 0.1
    (turns,) = (p for p in steps.plots if "orientation against home" in p.title)
    before_it_leaves = (
        STEPS.settle_time + 7 * STEPS.hold_time - STEPS.lead - 0.2
    )  # the seventh step is 30 degrees about the vertical
    at = {s.name: float(np.interp(before_it_leaves, s.x, s.y)) for s in turns.series}
    assert at["about z, reference"] == pytest.approx(30.0) and at["about x, reference"] == pytest.approx(0.0, abs=1e-9)
    assert at["about z"] == pytest.approx(30.0, abs=3.0) and abs(at["about y"]) < 3.0


def repeats(first, settings, share: float) -> None:  # type: ignore[no-untyped-def]
    """The same run once more, ended by Ctrl-C after a ``share`` of it: every number that is logged until then is the same."""

    def pressed(fraction: float, note: str) -> None:
        if fraction > share:
            signal.raise_signal(signal.SIGINT)

    again = REGISTRY[first.experiment].run(settings, 0, pressed)
    assert again.interrupted and again.log.channels == first.log.channels
    for name in first.log.channels:
        rows, times = again.log.array(name), again.log.times(name)
        assert 0.9 * share < len(rows) / len(first.log.times(name)) < 1.2 * share, name
        np.testing.assert_array_equal(times, first.log.times(name)[: len(times)])
        np.testing.assert_array_equal(rows, first.log.array(name)[: len(rows)])


def test_same_seed_same_bits(track) -> None:  # type: ignore[no-untyped-def]
    repeats(track, TRACK, 0.1)


@thorough
def test_another_seed_another_run(track) -> None:  # type: ignore[no-untyped-def]
    other = REGISTRY["swerve-track"].run(TRACK, 1, None)
    assert other.completed
    value = lambda r: r.metrics["hand_error_mean_odometry"].value
    assert value(other) != value(track)
    assert value(other) < 0.008


@thorough
def test_rezero_without_preview_repeats() -> None:
    first = REGISTRY["rezero-steps"].run(SHORT, 0, None)
    check_statistics(first)
    assert first.metrics["fell"].value == 0.0
    repeats(first, SHORT, 0.3)


def test_registry_is_complete() -> None:
    assert set(REGISTRY) >= {"swerve-track", "rezero-steps"}
    for name, experiment in REGISTRY.items():
        assert experiment.name == name
        assert experiment.summary
        with pytest.raises(ValueError, match="extra"):
            experiment.config_type(no_such_key=1)
