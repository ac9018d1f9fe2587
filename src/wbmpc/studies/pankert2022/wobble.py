"""`swerve-wobble`: one wheel on a block, the stretched arm turns slowly (Pankert et al. 2022, section IV-A, Fig. 5 and 6).

Before that the robot learns from three other turns how far its masses are from the model's.
"""

from __future__ import annotations

from typing import Literal

import mujoco
import numpy as np
from pydantic import Field

from wbmpc.bases.swerve.brake_monitor import BrakeFault, BrakeMonitor
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.estimation.mass_offset import MassOffset, Tipping, estimate_mass_offset
from wbmpc.experiments import Experiment
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.result import Drawing, Metric, Plot, RunResult, Series
from wbmpc.settings import Settings
from wbmpc.simulation.lockstep import Progress, part, watched
from wbmpc.simulation.perturbation import Perturbation
from wbmpc.simulation.world import GROUND
from wbmpc.stability import CONFIGURATIONS, StanceOf, Switch, assess, corners, draw
from wbmpc.studies.pankert2022.support_prediction import AWAY, RAISE, REST, UNLOADED, Case, Support, predict, tippings
from wbmpc.types import SwerveCommand

NAME = "swerve-wobble"
SUMMARY = "one wheel on a block, the stretched arm turns: who wobbles (Pankert et al. 2022, Fig. 5, 6)"

IDEALISATIONS = [
    "body, legs and arm are rigid, tyres are soft contacts: nothing swings after a switch as the real robot does",
    "the block is raised under the standing robot; the wheels' drives hold them still, the brakes are closed",
    "predictions know the block's height and the planned arm motion, not the plant: masses and centres of mass are nominal, "
    "shifted by what the gyro saw in three turns before",
    "the gyro's bias is averaged over the rest before the motion",
]
#: Heights [m] of the block: the paper's and two that a floor may have.
HEIGHTS = (0.15, 0.02, 0.005)
#: The arm turns once in TURN [s].
TURN = 60.0
Wheel = Literal["LF", "RF", "LB", "RB"]
#: The turns that come first, on a block of another height: (configuration, wheel on the block). Together they show what the
#: switches of H and X depend on: edges of two directions, and the arm at other angles to them.
CALIBRATION: tuple[tuple[Literal["H", "X", "A"], Wheel], ...] = (("H", "LF"), ("H", "RB"), ("X", "RB"))
CALIBRATION_HEIGHT, CALIBRATION_TURN = 0.10, 30.0
#: Cut-off [Hz] of the low-pass of the gyro in Fig. 6.
CUT_OFF = 20.0
SWITCH_NOTE = (
    "0.2 s are 2 to 3 mm of the zero-moment point; the plant's masses are ±5 %, its centres of mass ±10 mm elsewhere"
)
#: Samples per second of the log.
RATE = 400


class SwerveWobbleSettings(Settings):
    """``heights`` [m] of the block under the left front wheel, the first one gives the rates; ``turn`` [s].

    ``calibration``: the turns that come first, as (configuration, wheel on the block), each ``calibration_turn`` [s] long.
    """

    plant: Perturbation = Perturbation()
    robot: str = "swerve-ur10"
    heights: tuple[float, ...] = HEIGHTS
    turn: float = Field(TURN, ge=20, le=600)
    calibration: tuple[tuple[Literal["H", "X", "A"], Wheel], ...] = CALIBRATION
    calibration_turn: float = Field(CALIBRATION_TURN, ge=20, le=600)


def run(settings: SwerveWobbleSettings, seed: int, progress: Progress | None = None) -> RunResult:
    """The calibration, then all configurations and heights, each on its own plant of the same seed."""
    robot, log = load_robot(settings.robot), Log()
    first = [
        Case(name, CALIBRATION_HEIGHT, settings.calibration_turn, wheel, f"calibration_{k}_")
        for k, (name, wheel) in enumerate(settings.calibration)
    ]
    cases = [Case(name, height, settings.turn) for height in settings.heights for name in CONFIGURATIONS]
    for case in cases[: len(CONFIGURATIONS)]:  # what this robot cannot do is said before anything is simulated
        assess(robot, case.configuration, arm=case.arm(np.zeros(1), len(robot.input.groups["arm"]))[0])
    faults: list[str] = []
    for k, case in enumerate([*first, *cases]):
        what = ("calibration: " if case in first else "") + f"{case.configuration}, {1e3 * case.height:g} mm"
        own = part(progress, k, len(first) + len(cases), what)
        faults += [f"{what}: {fault}" for fault in _simulate(robot, settings, seed, case, case in cases, log, own)]
    seen = [tipping for case in first for tipping in _seen(robot, case, log)]
    offset = estimate_mass_offset(seen)
    supports = [Support(robot, case) for case in cases]
    nominal, told = ([predict(support, o) for support in supports] for o in (None, offset))
    if progress is not None:
        progress(1.0, "")
    metrics = {**_rates(log, settings), **_switches(log, cases, nominal, told), **_offset(seen, offset)}
    return RunResult(
        NAME, seed, True, "", metrics, None, log, _plots(robot, log, settings, cases, nominal, told), IDEALISATIONS,
        settings.model_dump(mode="json"), faults=faults,
    )  # fmt: skip


def _seen(robot: RobotModel, case: Case, log: Log) -> list[Tipping]:
    """What the gyro saw of one case."""
    t, gyro = log.times(f"gyro_{case.key}"), log.array(f"gyro_{case.key}")
    return tippings(Support(robot, case), t, gyro - gyro[t < 0.0].mean(axis=0))


def _simulate(
    robot: RobotModel, settings: SwerveWobbleSettings, seed: int, case: Case, judged: bool, log: Log,
    progress: Progress | None,
) -> list[BrakeFault]:  # fmt: skip
    """Raise the block under its wheel, then turn the arm; channel gyro of this case, and if it is ``judged`` the truth: rate and
    force. Brakes that did not hold."""
    joints, height = len(robot.input.groups["arm"]), case.height
    start = assess(robot, case.configuration, arm=case.arm(np.zeros(1), joints)[0])
    x, y = start.stance.feet[corners(robot)[case.wheel]]

    def block(spec: mujoco.MjSpec) -> None:
        body = spec.worldbody.add_body(name="block", mocap=True, pos=[x, y, -0.5 * height - 1e-3])
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.15, 0.15, height / 2], friction=[0.8, 0.005, 1e-4],
            solref=[0.01, 1.0], rgba=[0.8, 0.5, 0.2, 1.0], **GROUND,
        )  # fmt: skip

    plant = SwervePlant(robot.description, robot.state.split(start.x), settings.plant, seed, edit=block)
    modules, key = robot.base.geometry.modules, case.key
    steps = round(1.0 / RATE / plant.timestep)
    monitor, still = BrakeMonitor(robot.state.groups["leg"]), np.zeros(modules)
    with watched(plant, 1.0 / RATE, case.end, progress) as tick:
        for k in range(round(case.end * RATE)):
            t = k / RATE
            plant.data.mocap_pos[0, 2] = min(RAISE * t, height) - 0.5 * height
            measured = plant.measure()
            monitor.update(t, measured.leg, still, still)
            if t >= case.start - REST + 0.5:
                log.add(f"gyro_{key}", t - case.start, measured.gyro[:2])
                if judged:
                    log.add(f"rate_{key}", t - case.start, plant.data.qvel[3:5])
                    log.add(f"force_{key}", t - case.start, plant.truth().wheel_force)
            now, later = case.arm(np.array([t, t + 1.0 / RATE]), joints)
            arm = (later - now) * RATE + 2.0 * (now - measured.arm)
            command = SwerveCommand(still, still, arm, still)
            tick(t, command)
            plant.step(command, steps)
    return monitor.real


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
        lost = set(switch.before) - set(switch.after)
        errors.append(abs(switch.time - when) if lost == {wheel} else float("inf"))
    return max(errors)


def _filtered(gyro: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Size (k,) [rad/s] of rates (k, 2) less their mean at rest, through a low-pass of second order."""
    from scipy.signal import butter, lfilter

    b, a = butter(2, CUT_OFF, fs=RATE)
    return np.asarray(np.linalg.norm(lfilter(b, a, gyro - gyro[rest].mean(axis=0), axis=0), axis=1))


def _key(name: str, height: float) -> str:
    return Case(name, height, TURN).key


def _rates(log: Log, settings: SwerveWobbleSettings) -> dict[str, Metric]:
    true, imu = {}, {}
    for name in CONFIGURATIONS:
        key = _key(name, settings.heights[0])
        t = log.times(f"rate_{key}")
        true[name] = float(np.linalg.norm(log.array(f"rate_{key}"), axis=1)[t >= 0.0].max())
        imu[name] = float(_filtered(log.array(f"gyro_{key}"), t < 0.0)[t >= 0.0].max())
    least = min(true["H"], true["X"]) / true["A"]
    return {
        **{f"roll_pitch_rate_max_{n}": Metric(v, "rad/s") for n, v in true.items()},
        **{f"imu_rate_max_{n}": Metric(v, "rad/s") for n, v in imu.items()},
        "roll_pitch_rate_ratio": Metric(least, "1", paper=10.0, least=1000.0),
    }


def _happened(log: Log, case: Case) -> list[tuple[float, int]]:
    return unloaded(log.times(f"force_{case.key}"), log.array(f"force_{case.key}"))


def _switches(log: Log, cases: list[Case], nominal: list[list[Switch]], told: list[list[Switch]]) -> dict[str, Metric]:
    """How far the predictions are off, with what the calibration told and without."""
    happened = [_happened(log, case) for case in cases]
    worst, without = (
        max(time_error(p, events) for p, events in zip(way, happened, strict=True)) for way in (told, nominal)
    )
    return {
        "support_switch_time_error_max": Metric(worst, "s", goal=0.2, goal_note=SWITCH_NOTE),
        "support_switch_time_error_nominal_max": Metric(without, "s"),
        "support_switches": Metric(float(sum(map(len, told))), "1"),
    }


def _offset(seen: list[Tipping], offset: MassOffset) -> dict[str, Metric]:
    """What the calibration found: how many tippings, and the offset of the zero-moment point."""
    return {
        "calibration_tippings": Metric(float(len(seen)), "1"),
        "mass_offset_base": Metric(float(np.linalg.norm(offset.base)), "m"),
        "mass_offset_arm": Metric(float(np.linalg.norm(offset.arm)), "m"),
    }


def _plots(
    robot: RobotModel, log: Log, settings: SwerveWobbleSettings, cases: list[Case], nominal: list[list[Switch]],
    told: list[list[Switch]],
) -> list[Plot | Drawing]:  # fmt: skip
    key = {n: _key(n, settings.heights[0]) for n in CONFIGURATIONS}
    rates, gyros, forces = [], [], []
    for n in CONFIGURATIONS:
        t = log.times(f"rate_{key[n]}")
        rates.append(Series(n, t, np.linalg.norm(log.array(f"rate_{key[n]}"), axis=1)))
        gyros.append(Series(n, t, _filtered(log.array(f"gyro_{key[n]}"), t < 0.0)))
        forces.append([Series(w, t, log.array(f"force_{key[n]}")[:, i]) for w, i in corners(robot).items()])
    height = f"{100 * settings.heights[0]:g} cm block"
    plots: list[Plot | Drawing] = [
        Plot(f"Roll-pitch rate, {height}, true (Fig. 6)", "time [s]", "rate [rad/s]", rates),
        Plot(f"Roll-pitch rate, {height}, gyro (Fig. 6)", "time [s]", "rate [rad/s]", gyros),
        _lateness(log, cases, nominal, told),
    ]
    plots += [
        Plot(f"Wheel forces in {n}, {height}", "time [s]", "force [N]", f)
        for n, f in zip(CONFIGURATIONS, forces, strict=True)
    ]
    return plots + [_path(robot, n, settings) for n in CONFIGURATIONS]


def _lateness(log: Log, cases: list[Case], nominal: list[list[Switch]], told: list[list[Switch]]) -> Plot:
    """Predicted less real times of all switches, one after the other; cases in which others happened are left out."""
    series = []
    for name, way in (("nominal masses", nominal), ("after the calibration", told)):
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


EXPERIMENT = Experiment(NAME, SUMMARY, SwerveWobbleSettings, run)
