"""Baselines and variants that do not get to the end are reported, and not compared with. Truth: endings and logs by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from toys import robot
from wbmpc import experiment
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.experiment import Outcome
from wbmpc.log import Log
from wbmpc.result import RunResult
from wbmpc.simulation.lockstep import Ending
from wbmpc.studies.minniti2019 import frequency as rezero_frequency
from wbmpc.studies.minniti2019 import taskspace as rezero_taskspace
from wbmpc.studies.pankert2022 import drive as swerve_drive
from wbmpc.studies.pankert2022 import fixed as swerve_fixed
from wbmpc.studies.pankert2022.drive_figures import metrics
from wbmpc.studies.pankert2022.drive_missions import SwerveDriveSettings, tour
from wbmpc.studies.pankert2022.fixed_motions import SwerveFixedSettings
from wbmpc.studies.pankert2022.mission_run import MissionRun

SWERVE, FIXED = robot("swerve-ur10"), robot("swerve-fixed-ur10")
FELL, ENDED = Ending("the robot fell at 3.50 s", fell=True), Ending("interrupted at 3.50 s", interrupted=True)
#: By how much the controllers of swerve-fixed are off [m].
OFF = dict(zip(swerve_fixed.CONTROLLERS, (1e-3, 2e-3, 4e-3), strict=True))
#: In the world by their squares [m²] times this [1/m]: another ratio, so that nobody takes one frame for the other.
WORLD = 4e3


LOST, STANDS = (
    Ending("stopped at 3.50 s: the encoder of arm_elbow stands still; motors off"),
    "the encoder of wheel_0 stands still",
)
BASELINE = ("baseline_position_error_rms", "baseline_yaw_error_rms", "baseline_leg_angle_error_rms")


def no_mpc(*_: Any, **__: Any) -> Any:
    """What a run needs of an MPC that is never asked."""
    figures = SimpleNamespace(solve_times=[], solves=0, failures=0, no_step=0)
    return SimpleNamespace(rate=50.0, statistics=figures, reference={}, reset=lambda *_: None)


def driven() -> Log:
    """Two seconds in which the MPC's base is off by 3 mm and the baseline's by 4 mm; in the world by 9 and 16 mm."""
    log, sizes = Log(), {"leg": 4, "leg_reference": 4, "brake": 4, "wheel_slip": 1, "wheel_force": 4}
    for name, off in (("tour", 3e-3), ("baseline", 4e-3)):
        for t in (0.0, 1.0, 2.0):
            for channel, size in {**sizes, "base_reference": 3, "drive_speed": 12, "wanted": SWERVE.input.size}.items():
                log.add(f"{name}.{channel}", t, np.zeros(size))
            log.add(f"{name}.base_odometry", t, np.array([off, 0.0, 0.0]))
            log.add(f"{name}.base", t, np.array([0.0, off**2 / 1e-3, 0.0]))
    return log


def test_the_figures_of_a_baseline_that_fell_are_infinite_and_there_is_no_ratio() -> None:
    found = {how: metrics(driven(), SWERVE, [], 0, None, how) for how in (Ending(), FELL, ENDED, None)}
    assert found[Ending()]["baseline_ratio"].value == pytest.approx(0.75)
    assert found[Ending()]["baseline_ratio_world"].value == pytest.approx(9 / 16)
    assert found[Ending()][BASELINE[0]].value == pytest.approx(4e-3)
    assert found[Ending()][f"{BASELINE[0]}_world"].value == pytest.approx(16e-3)
    assert [found[FELL][name].value for name in BASELINE] == [np.inf] * 3
    assert np.isnan(found[FELL]["baseline_ratio"].value)
    assert np.isnan(found[FELL]["baseline_ratio_world"].value) and found[FELL]["baseline_ratio_world"].met is False
    for how in (ENDED, None):  # what the user ended says nothing about the baseline
        assert not [name for name in found[how] if name.startswith("baseline")]
    assert all(m["base_position_error_rms"].value == pytest.approx(3e-3) for m in found.values())
    assert all(m["base_position_error_rms_world"].value == pytest.approx(9e-3) for m in found.values())


@pytest.mark.parametrize(("how", "goes_on"), [(FELL, True), (ENDED, False)])
def test_swerve_drive_reports_how_its_baseline_ended(
    how: Ending, goes_on: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    parts: list[str] = []
    planned = lambda self, name, *_, **__: (
        parts.append(name) or (Outcome(controller=SimpleNamespace(faults=[], holds=0), mpc=no_mpc()), None)
    )
    monkeypatch.setattr(MissionRun, "planned", planned)
    monkeypatch.setattr(experiment, "run_lockstep", lambda *_: how)
    for part in ("metrics", "plots"):
        monkeypatch.setattr(swerve_drive, part, lambda *_: {})
    result = swerve_drive.EXPERIMENT.run(SwerveDriveSettings(settle_time=0.0, calibration="none"), 0)
    # what the user ended was not found in the robot
    assert result.faults == ([f"baseline: {FELL.reason}; nothing is compared with it"] if how is FELL else [])
    assert result.reason == ("" if how is FELL else ENDED.reason)
    assert (result.completed, result.interrupted, "knock" in parts) == (goes_on, not goes_on, goes_on)


def test_a_real_fall_of_the_baseline_is_its_ending(monkeypatch: pytest.MonkeyPatch) -> None:
    """A plant that counts as fallen from its 20 ms on. The search of gains takes such a baseline for infinitely bad."""
    monkeypatch.setattr(SwervePlant, "fell", property(lambda plant: plant.time > 0.02))
    settings = SwerveDriveSettings(settle_time=0.0, calibration="none")
    mission, _ = tour(SWERVE, 0.1)
    bench = MissionRun.of(settings, SWERVE, 0)
    ending = swerve_drive._baseline(bench, settings, mission, 1.0).ending
    assert ending.fell and bench.log.times("baseline.base")[-1] < 0.03
    alone = swerve_drive.EXPERIMENT.run(settings.model_copy(update={"baseline_only": True}), 0)
    assert alone.outcome == "fell" and np.isinf(alone.metrics["baseline_position_error_rms"].value)


def fixed(monkeypatch: pytest.MonkeyPatch, who: str, how: Ending) -> RunResult:
    """`swerve-fixed` with controllers that are 1, 2 and 4 mm off, of which one ends after 0.3 s."""

    def drive(
        name: str, settings: Any, seed: int, robot: Any, motion: Any, known: Any, mpc: Any, log: Log, *_: Any
    ) -> Any:
        for t in np.arange(0.0, 0.3 if name == who else float(motion.path.times[-1]), 0.1):
            log.add(f"odometry_{name}", t, motion.path.pose(t) + [OFF[name], 0.0, 0.0])
            log.add(f"base_{name}", t, motion.path.pose(t) + [WORLD * OFF[name] ** 2, 0.0, 0.0])
            log.add(f"slip_{name}", t, 0.0)
            log.add(f"steer_{name}", t, np.zeros(4))
        return Outcome(how if name == who else Ending(), mpc=mpc)

    monkeypatch.setattr(swerve_fixed, "drive", drive)
    monkeypatch.setattr(swerve_fixed, "swerve_mpc", no_mpc)
    monkeypatch.setattr(swerve_fixed, "plots", lambda *_: [])
    return swerve_fixed.EXPERIMENT.run(
        SwerveFixedSettings(motions=("forward",), random_time=0.0, calibration="none"), 0
    )


@pytest.mark.parametrize("who", ["ik", "four_wheel", "mpc"])
def test_swerve_fixed_names_who_fell(who: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The MPC's run decides whether it completed."""
    result = fixed(monkeypatch, who, FELL)
    value = {name: metric.value for name, metric in result.metrics.items()}
    reported = f"{who}: the robot fell at 3.50 s"
    if who == "mpc":
        assert (result.completed, result.reason, result.faults) == (False, reported, [])
    else:
        assert (result.completed, result.reason, result.faults) == (
            True,
            "",
            [f"{reported}; nothing is compared with it"],
        )
    ratio = {"four_wheel": OFF["mpc"] / OFF["ik"], "ik": np.nan, "mpc": None}[who]
    assert value.get("tracking_error_ratio") == (ratio if ratio is None else pytest.approx(ratio, nan_ok=True))
    squared = ratio if ratio is None else pytest.approx(ratio**2, nan_ok=True)
    assert value.get("tracking_error_ratio_world") == squared
    assert who != "ik" or result.reached("tracking_error_ratio_world") is False
    for name, away in OFF.items():
        if name == who and who != "mpc":
            assert not [key for key in value if key.endswith(f"_{name}") or f"_{name}_" in key]
        else:  # the MPC's own part is kept, as in every run that ended early
            assert value[f"tracking_error_rms_{name}"] == pytest.approx(away)
            assert value[f"tracking_error_rms_world_{name}"] == pytest.approx(WORLD * away**2)


def test_swerve_fixed_that_the_user_ends_in_a_baseline(monkeypatch: pytest.MonkeyPatch) -> None:
    """It says nothing about the baseline."""
    result = fixed(monkeypatch, "ik", ENDED)
    assert (result.completed, result.interrupted, result.reason) == (False, True, f"ik: {ENDED.reason}")
    assert not result.faults and "tracking_error_ratio" not in result.metrics


def ball_runs(module: Any, monkeypatch: pytest.MonkeyPatch, **endings: Ending) -> RunResult:
    """Runs of a ball robot that end so; the end effector moves by 0.04 m at 2.5 s and by 0.2 at 3 s; each has one fault of an encoder."""

    def drive(name: str, settings: Any, seed: int, log: Log, *_: Any) -> Any:
        turn = np.array([1.0, 0.0, 0.0, 0.0])
        torque = {"plain": 1.0, "shaped": 0.25, "mpc": 1.0, "taskspace": 2.0}[name] * np.ones(6)
        for k, t in enumerate((0.0, 2.0, 2.5, 3.0, 3.5)):
            end_effector = [0.2 * (t >= 3.0) + 0.04 * (t == 2.5), 0.0, 0.0]
            rows = {
                "state": np.zeros(16),
                "hand": end_effector,
                "hand_quaternion": turn,
                "tilt": 0.1,
                "torque": k * torque,
            }
            rows |= {"wanted": np.r_[np.zeros(3), turn], "acting": torque, "asked": np.zeros(6)}
            for channel, row in rows.items():
                log.add(f"{channel}_{name}", t, row[:3] if module is rezero_frequency and channel == "wanted" else row)
        found = SimpleNamespace(faults=[STANDS], monitor=SimpleNamespace(faults=[STANDS]))
        return Outcome(endings.get(name, Ending()), found.faults, found, no_mpc())

    monkeypatch.setattr(module, "drive", drive)
    monkeypatch.setattr(module, "plots", lambda *_: [])
    kind = {rezero_frequency: "RezeroFrequencySettings", rezero_taskspace: "RezeroTaskspaceSettings"}[module]
    result: RunResult = module.EXPERIMENT.run(getattr(module, kind)(), 0)
    return result


@pytest.mark.parametrize(("how", "falls"), [(Ending(), 0.0), (LOST, 0.0), (FELL, 1.0)])
def test_rezero_taskspace_reports_how_its_baseline_ended(
    how: Ending, falls: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = ball_runs(rezero_taskspace, monkeypatch, taskspace=how)
    value = {name: metric.value for name, metric in result.metrics.items()}
    reported = [f"taskspace: {how.reason}; nothing is compared with it"] if how.reason else []
    assert result.completed and result.faults == [f"mpc: {STANDS}", f"taskspace: {STANDS}", *reported]
    assert value["hand_error_integral_mpc"] == pytest.approx(0.17) and value["encoder_faults"] == 2.0
    assert value["hand_error_integral_taskspace"] == (np.inf if reported else pytest.approx(0.17))
    assert (
        value.get("torque_squared_ratio") == (None if reported else pytest.approx(4.0))
        and value["falls_taskspace"] == falls
    )


def test_rezero_taskspace_names_an_mpc_that_ends_early(monkeypatch: pytest.MonkeyPatch) -> None:
    result = ball_runs(rezero_taskspace, monkeypatch, mpc=LOST)
    assert not result.completed and result.reason == f"mpc: {LOST.reason}"
    assert np.isinf(result.metrics["hand_error_integral_mpc"].value) and "torque_squared_ratio" not in result.metrics
    pressed = ball_runs(rezero_taskspace, monkeypatch, taskspace=ENDED)
    assert pressed.interrupted and pressed.reason == f"taskspace: {ENDED.reason}"
    assert pressed.metrics["hand_error_integral_taskspace"].value == pytest.approx(0.17)


@pytest.mark.parametrize("who", ["plain", "shaped", ""])
def test_rezero_frequency_names_who_ended_early(who: str, monkeypatch: pytest.MonkeyPatch) -> None:
    result = ball_runs(rezero_frequency, monkeypatch, **({who: LOST} if who else {}))
    assert result.reason == (f"{who}: {LOST.reason}" if who else "") and result.completed == (not who)
    assert result.faults == [f"plain: {STANDS}", f"shaped: {STANDS}"] and result.metrics["encoder_faults"].value == 2.0
    ratios = {
        name: result.metrics[name].value for name in ("torque_error_ratio", "rise_time_ratio") if name in result.metrics
    }
    assert ratios.keys() == (set() if who else {"torque_error_ratio", "rise_time_ratio"})
    assert ratios == {} or (ratios["torque_error_ratio"], ratios["rise_time_ratio"]) == pytest.approx((0.25, 1.0))
    assert result.metrics["torque_error_rms_plain"].value == pytest.approx(1.0)
