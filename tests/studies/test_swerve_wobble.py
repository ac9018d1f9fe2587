"""`swerve-wobble`, shortened. Truth: the physics' own wheel forces; a robot on an even floor does not rock."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from effort import thorough
from wbmpc.bases.swerve.perturbation import SwervePerturbation
from wbmpc.model.robot import load_robot
from wbmpc.studies.pankert2022 import wobble as swerve_wobble
from wbmpc.studies.pankert2022.mass_offset import MassOffset, estimate_mass_offset
from wbmpc.studies.pankert2022.support_prediction import Case, Support, predict, tippings
from wbmpc.studies.pankert2022.support_switches import Switch
from wbmpc.studies.pankert2022.wobble import SwerveWobbleSettings
from wbmpc.studies.pankert2022.wobble_figures import time_error, unloaded


@pytest.fixture(scope="module")
def result():  # type: ignore[no-untyped-def]
    """A plant like the model but for its centers of mass and its gyro, after one turn that shows them."""
    plant = SwervePerturbation.none(com_offset=0.01, gyro_noise=2e-4, gyro_bias=0.01)
    settings = SwerveWobbleSettings(
        heights=(0.02,), turn=20.0, plant=plant, calibration=(("H", "LF"),), calibration_turn=20.0
    )
    return swerve_wobble.EXPERIMENT.run(settings, 2)


@thorough
def test_only_the_a_configuration_does_not_wobble(result) -> None:  # type: ignore[no-untyped-def]
    m = {name: metric.value for name, metric in result.metrics.items()}
    assert min(m["roll_pitch_rate_max_H"], m["roll_pitch_rate_max_X"]) > 0.03
    assert m["roll_pitch_rate_max_A"] < 3e-4
    # the gyro sees the same spikes within its noise
    for name in "HX":
        assert m[f"imu_rate_max_{name}"] == pytest.approx(m[f"roll_pitch_rate_max_{name}"], rel=0.5)


@thorough
def test_predicted_switches_are_those_of_the_physics(result) -> None:  # type: ignore[no-untyped-def]
    assert result.metrics["support_switches"].value == 4.0  # two in H, two in X, none in A
    assert result.metrics["support_switch_time_error_max"].value < 0.06
    for name, count in {"H": 2, "X": 2, "A": 0}.items():
        force = result.log.array(f"force_{name}_20mm")
        events = unloaded(result.log.times(f"force_{name}_20mm"), force)
        assert len(events) == count
        # the raised wheel and the opposite one carry all the time
        assert force[:, [0, 3]].min() > 50.0 or name != "A"


@thorough
def test_a_turn_before_shows_the_masses(result) -> None:  # type: ignore[no-untyped-def]
    m = {name: metric.value for name, metric in result.metrics.items()}
    assert m["calibration_tippings"] == 2.0
    assert m["support_switch_time_error_max"] < 0.4 * m["support_switch_time_error_nominal_max"] < np.inf
    # it is learned from the gyro alone: nothing of the physics' truth is recorded of that turn
    assert [name for name in result.log.channels if "calibration" in name] == ["gyro_calibration_0_H_100mm"]


@pytest.mark.parametrize("wheel", ["LF", "RB"])
def test_rockings_tell_the_offset_that_made_them(wheel: str) -> None:
    """Rates of a body that falls onto the foot it switches to, at the times that an offset of 4 and 2 mm predicts."""
    offset = MassOffset(np.array([0.002, -0.004]), np.array([0.0, 0.002]), np.eye(4), 4)
    support = Support(load_robot("swerve-ur10"), Case("H", 0.02, 60.0, wheel))
    t = np.arange(-1.0, 60.0, 0.0025)
    gyro = np.zeros((t.size, 2))
    switches = [replace(s, time=s.time + 0.25) for s in predict(support, offset)]  # the 5 N are gone 0.25 s later
    for s in switches:
        edge = np.diff(support.feet[sorted(set(s.previous) & set(s.after))], axis=0)[0]
        (onto,) = set(s.after) - set(s.previous)
        sinks = (
            edge[0] * support.feet[onto][1] - edge[1] * support.feet[onto][0]
        )  # (ω x r) along z with ω along the edge
        rate = 0.05 * (np.cosh(3.0 * np.clip(t - s.time, 0.0, 0.8)) - 1.0) * (t < s.time + 0.8)
        gyro -= np.sign(sinks) * np.outer(rate, edge / np.linalg.norm(edge))
    seen = tippings(support, t, gyro)
    assert len(seen) == len(switches) == 2
    found = estimate_mass_offset(seen)
    for a, b in zip(predict(support, found), switches, strict=True):
        assert a.time + 0.25 == pytest.approx(b.time, abs=0.02)
    nominal = predict(support)
    assert max(abs(a.time + 0.25 - b.time) for a, b in zip(nominal, switches, strict=True)) > 0.2


def test_a_wheel_that_bounces_has_not_left_the_ground() -> None:
    t = np.arange(0.0, 10.0, 0.01)
    force = np.full((t.size, 4), 100.0)
    force[(t > 2.0) & (t < 2.2), 1] = 0.0
    force[t > 5.0, 2] = 1.0
    assert unloaded(t, force) == [(pytest.approx(5.01), 2)]


def test_switches_count_only_if_they_are_the_same() -> None:
    switch = Switch(5.0, (0, 2, 3), (0, 1, 3))
    assert time_error([switch], [(5.3, 2)]) == pytest.approx(0.3)
    assert time_error([switch], [(5.3, 1)]) == np.inf
    assert time_error([switch], []) == np.inf
    assert time_error([], []) == 0.0
