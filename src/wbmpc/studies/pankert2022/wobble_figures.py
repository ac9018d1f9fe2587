"""What `swerve-wobble` predicts, measures and draws."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from wbmpc.bases.swerve.configurations import CONFIGURATIONS, corners
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.result import Drawing, Metric, Plot, Series
from wbmpc.stability import StanceOf, assess, draw
from wbmpc.studies.pankert2022.mass_offset import MassOffset, Tipping, estimate_mass_offset
from wbmpc.studies.pankert2022.support_prediction import AWAY, UNLOADED, Case, Support, predict, tippings
from wbmpc.studies.pankert2022.support_switches import Switch

if TYPE_CHECKING:
    from wbmpc.studies.pankert2022.wobble import SwerveWobbleSettings

#: The arm turns once in TURN [s].
TURN = 60.0
#: Cut-off [Hz] of the low-pass of the gyro in Fig. 6.
CUT_OFF = 20.0
SWITCH_NOTE = (
    "0.2 s are 2 to 3 mm of the zero-moment point; the plant's masses are ±5 %, its centers of mass ±10 mm elsewhere"
)
#: Samples per second of the log.
RATE = 400


@dataclass(frozen=True)
class Predictions:
    """What the calibration saw and found, and by case the switches that are predicted without it and with it."""

    seen: list[Tipping]
    offset: MassOffset
    nominal: list[list[Switch]]
    calibrated: list[list[Switch]]

    @classmethod
    def of(cls, robot: RobotModel, log: Log, first: list[Case], cases: list[Case]) -> Predictions:
        """From the record of the ``first`` cases, for the others."""
        seen = [tipping for case in first for tipping in _seen(robot, case, log)]
        offset = estimate_mass_offset(seen)
        supports = [Support(robot, case) for case in cases]
        nominal, calibrated = ([predict(support, o) for support in supports] for o in (None, offset))
        return cls(seen, offset, nominal, calibrated)


def _seen(robot: RobotModel, case: Case, log: Log) -> list[Tipping]:
    """What the gyro saw of one case."""
    t, gyro = log.times(f"gyro_{case.key}"), log.array(f"gyro_{case.key}")
    return tippings(Support(robot, case), t, gyro - gyro[t < 0.0].mean(axis=0))


def metrics(log: Log, height: float, cases: list[Case], predictions: Predictions) -> dict[str, Metric]:
    """Rates on the block of the first ``height`` [m], errors of the predicted switches, what the calibration found."""
    found = _switches(log, cases, predictions.nominal, predictions.calibrated)
    return {**_rates(log, height), **found, **_offset(predictions.seen, predictions.offset)}


def unloaded(t: np.ndarray, force: np.ndarray) -> list[tuple[float, int]]:
    """(time [s], wheel) of every wheel that leaves the ground: its force (k, n) [N] falls below 5 N and stays there."""
    events = []
    for wheel in range(force.shape[1]):
        low = force[:, wheel] < UNLOADED
        starts = np.flatnonzero(low[1:] & ~low[:-1]) + 1
        for i in starts:
            if t[-1] - t[i] >= AWAY and low[i : i + round(AWAY / (t[1] - t[0]))].all():
                events.append((float(t[i]), wheel))
    return sorted(events)


def time_error(predicted: list[Switch], events: list[tuple[float, int]]) -> float:
    """Largest time [s] between predicted switches and what happened, in order; infinite unless they are the same ones."""
    if len(predicted) != len(events):
        return float("inf")
    errors = [0.0]
    for switch, (when, wheel) in zip(predicted, events, strict=True):
        lost = set(switch.previous) - set(switch.after)
        errors.append(abs(switch.time - when) if lost == {wheel} else float("inf"))
    return max(errors)


def _filtered(gyro: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Size (k,) [rad/s] of rates (k, 2) less their mean at rest, through a low-pass of second order."""
    from scipy.signal import butter, lfilter

    b, a = butter(2, CUT_OFF, fs=RATE)
    return np.asarray(np.linalg.norm(lfilter(b, a, gyro - gyro[rest].mean(axis=0), axis=0), axis=1))


def _key(name: str, height: float) -> str:
    return Case(name, height, TURN).key


def _rates(log: Log, height: float) -> dict[str, Metric]:
    true, imu = {}, {}
    for name in CONFIGURATIONS:
        key = _key(name, height)
        t = log.times(f"rate_{key}")
        true[name] = float(np.linalg.norm(log.array(f"rate_{key}"), axis=1)[t >= 0.0].max())
        imu[name] = float(_filtered(log.array(f"gyro_{key}"), t < 0.0)[t >= 0.0].max())
    minimum = min(true["H"], true["X"]) / true["A"]
    return {
        **{f"roll_pitch_rate_max_{n}": Metric(v, "rad/s") for n, v in true.items()},
        **{f"imu_rate_max_{n}": Metric(v, "rad/s") for n, v in imu.items()},
        "roll_pitch_rate_ratio": Metric(minimum, "1", paper=10.0, least=1000.0),
    }


def _happened(log: Log, case: Case) -> list[tuple[float, int]]:
    return unloaded(log.times(f"force_{case.key}"), log.array(f"force_{case.key}"))


def _switches(
    log: Log, cases: list[Case], nominal: list[list[Switch]], calibrated: list[list[Switch]]
) -> dict[str, Metric]:
    """How far the predictions are off, with the calibration and without it."""
    happened = [_happened(log, case) for case in cases]
    worst, without = (
        max(time_error(p, events) for p, events in zip(way, happened, strict=True)) for way in (calibrated, nominal)
    )
    return {
        "support_switch_time_error_max": Metric(worst, "s", goal=0.2, goal_note=SWITCH_NOTE),
        "support_switch_time_error_nominal_max": Metric(without, "s"),
        "support_switches": Metric(float(sum(map(len, calibrated))), "1"),
    }


def _offset(seen: list[Tipping], offset: MassOffset) -> dict[str, Metric]:
    """What the calibration found: how many tippings, and the offset of the zero-moment point."""
    return {
        "calibration_tippings": Metric(float(len(seen)), "1"),
        "mass_offset_base": Metric(float(np.linalg.norm(offset.base)), "m"),
        "mass_offset_arm": Metric(float(np.linalg.norm(offset.arm)), "m"),
    }


def plots(
    robot: RobotModel, log: Log, settings: SwerveWobbleSettings, cases: list[Case], predictions: Predictions
) -> list[Plot | Drawing]:
    """Rates and forces of the first height, how far predicted switches are off, and the way of the zero-moment point."""
    nominal, calibrated = predictions.nominal, predictions.calibrated
    key = {n: _key(n, settings.heights[0]) for n in CONFIGURATIONS}
    rates, gyros, forces = [], [], []
    for n in CONFIGURATIONS:
        t = log.times(f"rate_{key[n]}")
        rates.append(Series(n, t, np.degrees(np.linalg.norm(log.array(f"rate_{key[n]}"), axis=1))))
        gyros.append(Series(n, t, np.degrees(_filtered(log.array(f"gyro_{key[n]}"), t < 0.0))))
        forces.append([Series(w, t, log.array(f"force_{key[n]}")[:, i]) for w, i in corners(robot).items()])
    height = f"{100 * settings.heights[0]:g} cm block"
    plots: list[Plot | Drawing] = [
        Plot(f"Roll-pitch rate, {height}, true (Fig. 6)", "time [s]", "rate [°/s]", rates),
        Plot(f"Roll-pitch rate, {height}, gyro (Fig. 6)", "time [s]", "rate [°/s]", gyros),
        _lateness(log, cases, nominal, calibrated),
    ]
    plots += [
        Plot(f"Wheel forces in {n}, {height}", "time [s]", "force [N]", f)
        for n, f in zip(CONFIGURATIONS, forces, strict=True)
    ]
    return plots + [_path(robot, n, settings) for n in CONFIGURATIONS]


def _lateness(log: Log, cases: list[Case], nominal: list[list[Switch]], calibrated: list[list[Switch]]) -> Plot:
    """Predicted less real times of all switches, one after the other; cases in which others happened are left out."""
    series = []
    for name, way in (("nominal masses", nominal), ("after the calibration", calibrated)):
        errors: list[float] = []
        for case, switches in zip(cases, way, strict=True):
            events = _happened(log, case)
            known = np.isfinite(time_error(switches, events))
            errors += [s.time - when if known else np.nan for s, (when, _) in zip(switches, events, strict=False)]
        series.append(Series(name, np.arange(1.0, len(errors) + 1.0), np.array(errors)))
    heights = ", ".join(dict.fromkeys(f"{1e3 * case.height:g}" for case in cases))
    label = f"support switches in their order: blocks of {heights} mm, in each {', '.join(CONFIGURATIONS)}"
    return Plot("Support switches, predicted less real time", label, "time [s]", series)


def _path(robot: RobotModel, name: str, settings: SwerveWobbleSettings) -> Drawing:
    """The zero-moment point's way on level ground over the triangles (Fig. 5)."""
    case, joints = Case(name, 0.0, settings.turn), len(robot.input.groups["arm"])
    stretched = assess(robot, name, arm=case.arm(np.zeros(1), joints)[0])
    stance_of, x = StanceOf(robot), stretched.x.copy()
    points = []
    for angles in case.arm(np.linspace(case.start, case.end, 121), joints):
        x[robot.state["arm"]] = angles
        points.append(stance_of(x).zmp)
    return Drawing(f"Zero-moment point in {name} (Fig. 5)", draw(stretched, np.array(points)))
