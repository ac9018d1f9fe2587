"""`swerve-wobble`: one wheel on a block, the stretched arm turns slowly (Pankert et al. 2022, section IV-A, Fig. 5 and 6)."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from pydantic import Field

from wbmpc.experiments.settings import Settings
from wbmpc.log import Log
from wbmpc.loop import Progress, part, watched
from wbmpc.model import RobotModel, load_robot
from wbmpc.plant import Perturbation, SwerveCommand, SwervePlant
from wbmpc.plant.world import GROUND
from wbmpc.result import Drawing, Metric, Plot, RunResult, Series
from wbmpc.stability import CONFIGURATIONS, StanceOf, Switch, assess, corners, draw, support_switches
from wbmpc.stability.geometry import Triangle

NAME = "swerve-wobble"
SUMMARY = "one wheel on a block, the stretched arm turns: who wobbles (Pankert et al. 2022, Fig. 5, 6)"

IDEALISATIONS = [
    "body, legs and arm are rigid, tyres are soft contacts: nothing swings after a switch as the real robot does",
    "the block is raised under the standing robot; the wheels' drives hold them still, the brakes are closed",
    "predictions know the block's height and the planned arm motion, not the plant: masses and centres of mass are nominal",
    "the gyro's bias is averaged over the rest before the motion",
]
#: Heights [m] of the block: the paper's and two that a floor may have.
HEIGHTS = (0.15, 0.02, 0.005)
#: The arm turns once in TURN [s], after it was raised with RAISE [m/s] and has stood for REST [s].
TURN, RAISE, REST = 60.0, 0.05, 2.0
#: A wheel that carries less than UNLOADED [N] for AWAY [s] has left the ground.
UNLOADED, AWAY = 5.0, 1.0
#: Cut-off [Hz] of the low-pass of the gyro in Fig. 6.
CUT_OFF = 20.0
SWITCH_NOTE = "the prediction is of the nominal robot, and the plant's centres of mass are up to 10 mm elsewhere"
#: Samples per second of the log.
RATE = 400


class SwerveWobbleSettings(Settings):
    """``heights`` [m] of the block under the left front wheel, the first one gives the rates; ``turn`` [s]."""

    plant: Perturbation = Perturbation()
    robot: str = "swerve-ur10"
    heights: tuple[float, ...] = HEIGHTS
    turn: float = Field(TURN, ge=20, le=600)


@dataclass(frozen=True)
class _Motion:
    """The arm: stretched and horizontal, its first joint from half a turn through one turn."""

    joints: int
    turn: float
    start: float

    def angles(self, t: np.ndarray) -> np.ndarray:
        """Angles (n, joints) [rad] at times t (n,) [s]; the speed rises within a second."""
        s = np.clip(t - self.start, 0.0, None)
        gone = np.where(s < 1.0, 0.5 * s * s, s - 0.5) * 2.0 * np.pi / self.turn
        out = np.zeros((t.size, self.joints))
        out[:, 0] = np.minimum(gone, 2.0 * np.pi) - np.pi
        return out

    @property
    def end(self) -> float:
        return self.start + self.turn + 0.5


def run(settings: SwerveWobbleSettings, seed: int, progress: Progress | None = None) -> RunResult:
    """All configurations and heights, each on its own plant of the same seed."""
    robot, log = load_robot(settings.robot), Log()
    stretched = _Motion(len(robot.input.groups["arm"]), settings.turn, 0.0).angles(np.zeros(1))[0]
    for name in CONFIGURATIONS:  # what this robot cannot do is said before anything is simulated
        assess(robot, name, arm=stretched)
    cases = [(name, height) for height in settings.heights for name in CONFIGURATIONS]
    predicted: dict[str, list[Switch]] = {}
    for k, (name, height) in enumerate(cases):
        motion = _Motion(len(robot.input.groups["arm"]), settings.turn, height / RAISE + REST)
        own = part(progress, k, len(cases), f"{name}, {1e3 * height:g} mm")
        _simulate(robot, settings, seed, name, height, motion, log, own)
        predicted[_key(name, height)] = predict(robot, name, height, motion)
    if progress is not None:
        progress(1.0, "")
    return RunResult(
        NAME, seed, True, "", _metrics(log, settings, predicted), None, log, _plots(robot, log, settings), IDEALISATIONS,
        settings.model_dump(mode="json"),
    )  # fmt: skip


def _key(name: str, height: float) -> str:
    return f"{name}_{1e3 * height:g}mm"


def _simulate(
    robot: RobotModel, settings: SwerveWobbleSettings, seed: int, name: str, height: float, motion: _Motion, log: Log,
    progress: Progress | None,
) -> None:  # fmt: skip
    """Raise the block under the left front wheel, then turn the arm; channels rate, gyro, force, zmp of this case."""
    start = assess(robot, name, arm=motion.angles(np.zeros(1))[0])
    x, y = start.stance.feet[corners(robot)["LF"]]

    def block(spec: mujoco.MjSpec) -> None:
        body = spec.worldbody.add_body(name="block", mocap=True, pos=[x, y, -0.5 * height - 1e-3])
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.15, 0.15, height / 2], friction=[0.8, 0.005, 1e-4],
            solref=[0.01, 1.0], rgba=[0.8, 0.5, 0.2, 1.0], **GROUND,
        )  # fmt: skip

    plant = SwervePlant(robot.description, robot.state.split(start.x), settings.plant, seed, edit=block)
    modules, key = robot.base.geometry.modules, _key(name, height)
    steps = round(1.0 / RATE / plant.timestep)
    with watched(plant, 1.0 / RATE, motion.end, progress) as tick:
        for k in range(round(motion.end * RATE)):
            t = k / RATE
            plant.data.mocap_pos[0, 2] = min(RAISE * t, height) - 0.5 * height
            measured = plant.measure()
            if t >= motion.start - REST + 0.5:
                truth = plant.truth()
                log.add(f"rate_{key}", t - motion.start, plant.data.qvel[3:5])
                log.add(f"gyro_{key}", t - motion.start, measured.gyro[:2])
                log.add(f"force_{key}", t - motion.start, truth.wheel_force)
            now, later = motion.angles(np.array([t, t + 1.0 / RATE]))
            arm = (later - now) * RATE + 2.0 * (now - measured.arm)
            command = SwerveCommand(np.zeros(modules), np.zeros(modules), arm, np.zeros(modules))
            tick(t, command)
            plant.step(command, steps)


def predict(robot: RobotModel, name: str, height: float, motion: _Motion) -> list[Switch]:
    """Support switches along the planned arm motion with a block of ``height`` [m] under the left front wheel.

    Times count from when the arm starts. A tilted wheel touches the ground with another point of its rim.
    """
    times = np.arange(motion.start, motion.end, 0.05)
    base = assess(robot, name)
    heights = np.zeros(len(base.stance.feet))
    heights[corners(robot)["LF"]] = height
    stance_of, states = StanceOf(robot), np.tile(base.x, (times.size, 1))
    states[:, robot.state["arm"]] = motion.angles(times)
    g, state = robot.base.geometry, robot.state
    heading = g.wheel_heading + g.leg_angles(base.x[state["leg"]]) + base.x[state["steer"]]
    along = np.stack([np.cos(heading), np.sin(heading)], axis=1)

    def stance(up: np.ndarray, triangle: Triangle) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        found = [stance_of(x, gravity=-9.81 * up) for x in states]
        feet = base.stance.feet - g.wheel_radius * (along @ up[:2])[:, None] * along
        return feet, np.array([s.zmp for s in found]), np.array([-s.force[2] for s in found])

    level = stance_of(states[0]).zmp
    switches = support_switches(times, base.stance.feet, heights, stance, UNLOADED, level)
    return [Switch(s.time - motion.start, s.before, s.after) for s in switches]


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


def _metrics(log: Log, settings: SwerveWobbleSettings, predicted: dict[str, list[Switch]]) -> dict[str, Metric]:
    true, imu, errors = {}, {}, []
    for name in CONFIGURATIONS:
        key = _key(name, settings.heights[0])
        t = log.times(f"rate_{key}")
        true[name] = float(np.linalg.norm(log.array(f"rate_{key}"), axis=1)[t >= 0.0].max())
        imu[name] = float(_filtered(log.array(f"gyro_{key}"), t < 0.0)[t >= 0.0].max())
    for height in settings.heights:
        for name in CONFIGURATIONS:
            key = _key(name, height)
            events = unloaded(log.times(f"force_{key}"), log.array(f"force_{key}"))
            errors.append(time_error(predicted[key], events))
    least = min(true["H"], true["X"]) / true["A"]
    return {
        **{f"roll_pitch_rate_max_{n}": Metric(v, "rad/s") for n, v in true.items()},
        **{f"imu_rate_max_{n}": Metric(v, "rad/s") for n, v in imu.items()},
        "roll_pitch_rate_ratio": Metric(least, "1", paper=10.0, least=1000.0),
        "support_switch_time_error_max": Metric(max(errors), "s", goal=0.2, goal_note=SWITCH_NOTE),
        "support_switches": Metric(float(sum(map(len, predicted.values()))), "1"),
    }


def _plots(robot: RobotModel, log: Log, settings: SwerveWobbleSettings) -> list[Plot | Drawing]:
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
    ]
    plots += [
        Plot(f"Wheel forces in {n}, {height}", "time [s]", "force [N]", f)
        for n, f in zip(CONFIGURATIONS, forces, strict=True)
    ]
    return plots + [_path(robot, n, settings) for n in CONFIGURATIONS]


def _path(robot: RobotModel, name: str, settings: SwerveWobbleSettings) -> Drawing:
    """The zero-moment point's way on level ground over the triangles (Fig. 5)."""
    motion = _Motion(len(robot.input.groups["arm"]), settings.turn, 0.0)
    stretched = assess(robot, name, arm=motion.angles(np.zeros(1))[0])
    stance_of, x = StanceOf(robot), stretched.x.copy()
    points = []
    for angles in motion.angles(np.linspace(0.0, motion.end, 121)):
        x[robot.state["arm"]] = angles
        points.append(stance_of(x).zmp)
    return Drawing(f"Zero-moment point in {name} (Fig. 5)", draw(stretched, np.array(points)))
