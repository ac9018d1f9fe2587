"""`swerve-fixed`, shortened. Truth: MuJoCo's physics; made-up logs of bases that stop."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from wbmpc.bases.swerve.estimator import EstimatorSettings
from wbmpc.bases.swerve.messages import SwerveMeasurement
from wbmpc.compare import Run, _components
from wbmpc.errors import InputError
from wbmpc.log import Log
from wbmpc.model.robot import load_robot
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.studies.base_path import Segment
from wbmpc.studies.pankert2022 import fixed, fixed_motions
from wbmpc.studies.pankert2022.fixed_figures import standstill
from wbmpc.studies.pankert2022.fixed_motions import Motion, SwerveFixedSettings


@pytest.fixture(scope="module")
def result():  # type: ignore[no-untyped-def]
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(fixed_motions.SEGMENTS, "sideways", Segment((0.0, 0.4, 0.0), 3.5))
        return fixed.EXPERIMENT.run(
            SwerveFixedSettings(motions=("sideways",), random_time=0.0, settle_time=0.5, calibration="none"), 3
        )


def test_all_controllers_drive(result) -> None:  # type: ignore[no-untyped-def]
    assert result.reason == ""
    m = {name: metric.value for name, metric in result.metrics.items()}
    assert 1e-5 < m["tracking_error_rms_mpc"] < 0.006
    assert 1e-5 < m["tracking_error_rms_ik"] < 0.03
    assert m["tracking_error_rms_four_wheel"] > 0.2  # it cannot move sideways
    assert m["tracking_error_rms_mpc_sideways"] == pytest.approx(
        m["tracking_error_rms_mpc"], rel=0.2
    )  # the only motion
    assert m["longest_standstill"] < 0.5


def test_every_channel_says_its_units(result) -> None:  # type: ignore[no-untyped-def]
    """In `log plot` and `compare`: one for each component."""
    log = result.log
    run = Run(Path(), {}, {n: log.array(n) for n in log.channels}, labels=log.names, units=log.units)
    for channel in log.channels:
        names, units = _components(run, channel)
        assert len(names) == len(units) == run.log[channel].shape[1] and all(units), channel
    assert log.units["steer_mpc"] == ("rad",) * 4 and log.units["wheel_ik"] == ("rad/s",) * 4


def test_the_bases_really_move(result) -> None:  # type: ignore[no-untyped-def]
    """1 m sideways in the world, not only in the odometry."""
    for name in ("mpc", "ik"):
        np.testing.assert_allclose(result.log.array(f"base_{name}")[-1], [0.0, 1.0, 0.0], atol=0.03)
        steer = result.log.array(f"steer_{name}")
        assert np.abs(steer).max() < 3.15
        assert np.abs(np.diff(steer, axis=0)).max() < 0.2  # turned, not jumped


def test_a_base_whose_reference_rests_holds_still_in_the_world(result) -> None:  # type: ignore[no-untyped-def]
    """By the physics, whatever the odometry says: before the start, and in the last second."""
    for name in ("mpc", "ik"):
        t, pose = result.log.times(f"base_{name}"), result.log.array(f"base_{name}")
        for rest in (t < 0.7, t > t[-1] - 1.0):
            assert rest.sum() > 50
            assert np.ptp(pose[rest, :2], axis=0).max() < 5e-4 and np.ptp(pose[rest, 2]) < 1e-3


def test_the_figures_are_those_of_the_record(result) -> None:  # type: ignore[no-untyped-def]
    """Truth: the sideways motion integrated from its twist by hand, 0.4 m/s with ramps of 1 s from 1 to 4.5 s, against where the base
    was in the world, and against where the odometry had it."""
    m = {name: metric.value for name, metric in result.metrics.items()}
    grid = np.linspace(0.0, 10.0, 10_001)
    ramp = lambda t: 0.5 - 0.5 * np.cos(np.pi * np.clip(t, 0.0, 1.0))
    speed = 0.4 * (ramp(grid - 1.0) - ramp(grid - 3.5))
    way = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * 1e-3)])
    for name in ("mpc", "ik"):
        found = {}
        for channel, ending in (("base", "_world"), ("odometry", "")):
            t, pose = result.log.times(f"{channel}_{name}"), result.log.array(f"{channel}_{name}")
            off = np.hypot(pose[:, 0], pose[:, 1] - np.interp(t, grid, way))
            found[channel] = float(np.sqrt(np.mean(off**2)))
            assert m[f"tracking_error_rms{ending}_{name}"] == pytest.approx(found[channel], abs=2e-5)
        assert abs(found["base"] - found["odometry"]) > 1e-4  # uncalibrated: nobody takes one for the other


@pytest.mark.parametrize("stopped", [0.0, 1.5])
def test_standstill_is_seen(stopped: float) -> None:
    motion = Motion.of(SwerveFixedSettings(motions=("forward",), random_time=0.0), 0)
    log, pose = Log(), np.zeros(3)
    for t in np.arange(0.0, 8.0, 0.01):
        moves = not 3.0 <= t < 3.0 + stopped
        pose = pose + moves * 0.01 * motion.path.twist(t)
        log.add("base_mpc", t, pose.copy())
    # in the first ramp the base is asked to move before it has come 0.1 s far
    assert standstill(log, "mpc", motion) == pytest.approx(max(stopped - 0.1, 0.0), abs=0.12)


@pytest.mark.parametrize("name", ["ik", "four_wheel"])
def test_hinged_legs_stay_where_they_are(name: str) -> None:
    """Of a robot whose legs could swing: the baselines leave them closed. Truth: rolling straight ahead, legs at home."""
    settings = SwerveFixedSettings(motions=("forward",), random_time=0.0)
    motion, robot = Motion.of(settings, 0), load_robot("swerve-ur10")
    controller = fixed.CONTROLLERS[name](robot, np.zeros(3), 0.0025, settings, motion, EstimatorSettings())
    home = robot.state.split(robot.home)
    controller.measure(SwerveMeasurement(0.0, home["leg"], home["steer"], np.zeros(4), home["arm"]))
    command = controller.command(3.0, PolicyQueue())  # in the midst of the motion
    assert not command.brake.any() and np.isfinite(command.wheel).all() and np.isfinite(command.steer).all()


def test_another_base_is_rejected() -> None:
    with pytest.raises(InputError, match="type 'ball'"):
        fixed.EXPERIMENT.run(SwerveFixedSettings(robot="rezero"), 0)
