"""`swerve-plaster`: the hand sprays a wall in long lines while the base drives along it (Pankert et al. 2022, section IV-D)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import mujoco
import numpy as np
from pydantic import Field, model_validator

from wbmpc import lie
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.defaults import StateCost, SwerveCost, closed_brakes, swerve_mpc
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.errors import RunAborted
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Reference
from wbmpc.result import Metric, Plot, RunResult, Series
from wbmpc.settings import ExperimentSettings, LocalisationSettings, finished
from wbmpc.simulation.lockstep import Progress, Timing, run_lockstep
from wbmpc.simulation.world import GROUND
from wbmpc.studies.pankert2022.calibrate import calibrated, swerve_robot
from wbmpc.studies.pankert2022.track import HAND_ORIENTATION, in_frame, stand_still
from wbmpc.studies.paths import Approach

NAME = "swerve-plaster"
SUMMARY = "five lines of 3.5 m on a wall, ten times, over cables and bumps (Pankert et al. 2022, section IV-D)"

IDEALISATIONS = [
    "the wall is exact and where the plan has it; what is sprayed stays where it hits, as a cone of constant rate",
    "the distance sensor's beam is the tool's axis; its noise is independent; the LIDAR's too",
    "the contact points lie under the steer axes; tyres are soft contacts, not a tyre model; the floor's bumps are smooth",
    "the computation takes a constant 10 ms; the arm's encoder offsets are not calibrated",
]
#: Lines [m]: length, distance, lowest; the wall's place and the hand's distance from it [m]; the hand ahead of the base at the
#: start of a line [m].
LENGTH, APART, LOWEST, WALL, STANDOFF, AHEAD = 3.5, 0.15, 0.60, 0.75, 0.10, -0.10
LINES = 5
#: Largest accelerations [m/s²] along the path and in its corners (half circles): 2 m/s² is the bound.
ALONG, ACROSS = 1.5, 1.6
#: Share of the hand's way along the wall that the base makes.
BASE_SHARE = 0.85
#: The hand stops at this distance [m] from the wall, by a switch of its own.
NEAREST = 0.03
#: Noise [m] and rate [Hz] of the distance sensor; what it says nothing of has these deviations [m, rad].
DISTANCE_NOISE, DISTANCE_RATE, UNKNOWN = 0.002, 50.0, (10.0, 10.0)
#: Spray: radius of the cone on the wall over its distance, step of the grid [m], thinnest coat that is no gap [share of mean].
CONE, GRID, GAP = 2.0, 0.025, 0.7
#: Ends of lines that are not judged, where the hand slows down to turn [m].
ENDS = 0.45
#: Cables (x) [m] of 10 mm height, bumps (x, y) [m] of 10 mm.
CABLES, CABLE_RADIUS, BUMPS, BUMP_HEIGHT, BUMP_RADIUS = (0.9, 2.6), 0.005, ((0.6, 0.5), (1.9, -0.5)), 0.010, 0.30
#: A hand asked to move at twice the second [m/s] that moves slower than it for the first [s] has stopped.
STOP_TIME, STOP_SPEED = 0.3, 0.1


class SwervePlasterSettings(ExperimentSettings):
    """``passes`` over the five lines at ``speed`` [m/s]; ``sensors``: LIDAR and wall distance (b), or odometry only (a);
    ``terrain``: cables and bumps; ``calibration``, ``rest``, ``drive_lag``: as in swerve-track."""

    cost: SwerveCost = SwerveCost(state=StateCost(position=20.0, yaw=100.0))
    robot: str = "swerve-ur10"
    passes: int = Field(10, ge=1, le=50)
    speed: float = Field(0.7, gt=0.05, le=0.9)
    sensors: bool = True
    terrain: bool = True
    calibration: str = "drive"
    localisation: LocalisationSettings = LocalisationSettings()
    rest: float = Field(20.0, ge=0, le=120)
    drive_lag: float = Field(0.020, ge=0, le=0.5)

    @model_validator(mode="after")
    def _read(self) -> Self:
        """A localisation that neither the passes nor a reference drive have is refused."""
        if not self.sensors and self.calibration != "drive":
            self.refuse_unread("without sensors or calibration=drive", "localisation")
        return self


@dataclass(frozen=True)
class Lines:
    """Lines up and down the wall, joined by half circles, run back on every second pass. Starts at ``start`` [s]."""

    passes: int
    speed: float
    start: float

    @cached_property
    def _curve(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Arc length (n,), places (n, 2) along the wall and up [m], largest speed (n,) of one pass."""
        places, top = [], []
        radius, corner = 0.5 * APART, np.sqrt(ACROSS * 0.5 * APART)
        turn = np.linspace(0.0, np.pi, 60)[1:-1]
        for k in range(LINES):
            way = np.linspace(0.0, LENGTH, 701)[:: 1 if k % 2 == 0 else -1]
            places += [np.stack([way, np.full(way.size, k * APART)], axis=1)]
            top += [np.full(way.size, self.speed)]
            if k < LINES - 1:
                side = 1.0 if k % 2 == 0 else -1.0
                arc = [way[-1] + side * radius * np.sin(turn), k * APART + radius * (1.0 - np.cos(turn))]
                places += [np.stack(arc, axis=1)]
                top += [np.full(turn.size, min(corner, self.speed))]
        p = np.vstack(places)
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
        v = np.concatenate(top)
        v[0] = v[-1] = 0.0
        for index in (range(1, s.size), range(s.size - 2, -1, -1)):
            for k in index:
                before = k - 1 if index.step > 0 else k + 1
                v[k] = min(v[k], np.sqrt(v[before] ** 2 + 2.0 * ALONG * abs(s[k] - s[before])))
        return s, p, v

    @cached_property
    def _times(self) -> np.ndarray:
        """When one pass is at each of its places [s]."""
        s, _, v = self._curve
        return np.concatenate([[0.0], np.cumsum(2.0 * np.diff(s) / np.maximum(v[1:] + v[:-1], 1e-6))])

    @property
    def pass_length(self) -> float:
        """Length [m] of one pass."""
        return float(self._curve[0][-1])

    @property
    def pass_time(self) -> float:
        """Duration [s] of one pass."""
        return float(self._times[-1])

    @property
    def end(self) -> float:
        """When all passes are done [s]."""
        return self.start + self.passes * self.pass_time

    def arc(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pass (n,) and arc length (n,) [m] from the lower end at times t (n,) [s]."""
        gone = np.clip(t - self.start, 0.0, self.passes * self.pass_time)
        number = np.minimum((gone / self.pass_time).astype(int), self.passes - 1)
        within = gone - number * self.pass_time
        return number, np.interp(np.where(number % 2, self.pass_time - within, within), self._times, self._curve[0])

    def point(self, t: np.ndarray) -> np.ndarray:
        """Places (n, 2) [m] along the wall and up."""
        _, s = self.arc(t)
        return np.stack([np.interp(s, self._curve[0], self._curve[1][:, k]) for k in range(2)], axis=1)


class _References:
    """Hand and base over time; the hand comes from home first."""

    def __init__(self, settings: SwervePlasterSettings, robot: RobotModel) -> None:
        first = np.array([AHEAD, WALL - STANDOFF, LOWEST])
        self.approach = Approach(robot.pose(robot.home), (first, HAND_ORIENTATION))
        self.lines = Lines(settings.passes, settings.speed, self.approach.duration + 1.0)
        self.duration = float(np.ceil((self.lines.end + 0.5) * 10.0) / 10.0)

    def hand(self, t: np.ndarray) -> np.ndarray:
        """Positions (n, 3) [m]."""
        along, up = self.lines.point(t).T
        place = np.stack([AHEAD + along, np.full(t.size, WALL - STANDOFF), LOWEST + up], axis=1)
        return place + self.approach.offset(t)[0]

    def base(self, t: np.ndarray) -> np.ndarray:
        """Poses (n, 3): along the wall."""
        x = BASE_SHARE * self.lines.point(t)[:, 0]
        return np.stack([x, 0.0 * x, 0.0 * x], axis=1)

    def set(self, mpc: MPC, robot: RobotModel) -> None:
        t = np.arange(0.0, self.duration + 0.02, 0.02)
        mpc.reference["hand"] = Reference.poses(t, self.hand(t), self.approach.offset(t)[1])
        states = np.tile(robot.home, (t.size, 1))
        states[:, robot.state["base"]] = self.base(t)
        mpc.reference["state"] = Reference(t, states)
        inputs = np.zeros((t.size, robot.input.size))
        inputs[:, robot.input["base"]] = np.gradient(self.base(t), t, axis=0)
        mpc.reference["input"] = Reference(t, inputs)


def terrain(spec: mujoco.MjSpec) -> None:
    """Cables across the way, smooth bumps."""
    common = {"friction": [0.75, 0.005, 1e-4], "solref": [0.01, 1.0], **GROUND}
    for x in CABLES:
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[x, -2, 0, x, 2, 0], size=[CABLE_RADIUS, 0, 0], **common
        )
    for x, y in BUMPS:
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_ELLIPSOID,
            size=[BUMP_RADIUS, BUMP_RADIUS, BUMP_HEIGHT],
            pos=[x, y, 0.0],
            **common,
        )


class _WallSensor:
    """Distance from the hand to the wall along the tool's axis, turned into what it says of the base's place across."""

    def __init__(self, robot: RobotModel, period: float, seed: int) -> None:
        self.robot, self._rng = robot, np.random.default_rng([seed, 2])
        self._every, self._count = max(round(1.0 / (DISTANCE_RATE * period)), 1), 0

    def __call__(self, plant: SwervePlant, agent: SwerveController) -> None:
        """Correct the odometry at the sensor's rate: the hand by the planner's kinematics, the base as estimated."""
        self._count += 1
        if self._count % self._every:
            return
        truth = plant.truth()
        axis = truth.tool_rotation[:, 2]
        distance = (WALL - truth.tool[1]) / axis[1] + DISTANCE_NOISE * self._rng.normal()
        x = agent.state()
        hand, quaternion = self.robot.pose(x)
        beam = lie.quaternion_to_rotation(quaternion)[1, 2]
        pose = x[self.robot.state["base"]].copy()
        pose[1] += WALL - distance * beam - hand[1]
        assert agent.measured is not None
        agent.odometry.correct(
            agent.measured.time, pose, np.diag([UNKNOWN[0] ** 2, DISTANCE_NOISE**2, UNKNOWN[1] ** 2])
        )


def run(settings: SwervePlasterSettings, seed: int, progress: Progress | None = None) -> RunResult:
    """All passes; docs/reference/metrics.md says what each metric means."""
    robot = swerve_robot(settings.robot)
    references = _References(settings, robot)
    mpc = swerve_mpc(robot, settings.mpc, settings.cost)
    references.set(mpc, robot)
    source = settings.localisation.source(seed) if settings.sensors else None
    plant = SwervePlant(
        robot.description, robot.state.split(robot.home), settings.plant, seed,
        edit=terrain if settings.terrain else None, localisation=source,
    )  # fmt: skip
    timing = Timing.of(plant.timestep, settings.control.rate, settings.mpc.rate, settings.mpc.delay)
    calibration = calibrated(robot, settings.calibration, settings.plant, settings.localisation, seed)
    agent = SwerveController(
        robot, plant.truth().pose, timing.period, lag=settings.drive_lag, calibration=calibration,
        faulty=closed_brakes(robot, mpc),
    )  # fmt: skip
    stand_still(plant, agent, timing, settings.rest)
    mpc.reset(robot.home)
    log = Log()
    sensor = _WallSensor(robot, timing.period, seed) if settings.sensors else None

    def record(t: float, command: Any, plans: Any) -> None:
        if sensor is not None and t >= references.lines.start - 0.5:
            sensor(plant, agent)
        if round(t / timing.period) % 4:
            return
        truth, pose = plant.truth(), agent.odometry.pose
        log.add("base", t, truth.pose)
        log.add("base_odometry", t, pose)
        log.add("hand", t, truth.tool)
        log.add("hand_odometry", t, in_frame(pose, truth.tool_in_base, truth.tool[2]))
        log.add("hand_reference", t, references.hand(np.array([t]))[0])
        log.add("wheel_slip", t, truth.slip)
        if WALL - truth.tool[1] < NEAREST:
            raise RunAborted(f"the hand's switch stopped it {1e3 * (WALL - truth.tool[1]):.0f} mm before the wall")

    ending = run_lockstep(plant, agent, mpc, timing, references.duration, record, progress)
    return finished(
        NAME, seed, settings, ending, mpc, log,
        metrics=lambda: _metrics(log, references, settings.sensors), plots=lambda: _plots(log, references),
        idealisations=IDEALISATIONS, faults=agent.faults,
    )  # fmt: skip


def pass_spread(lines: Lines, t: np.ndarray, across: np.ndarray) -> float:
    """Root mean square [m] of how far passes differ from their mean across the wall (k,), place by place along the path."""
    number, s = lines.arc(t)
    use = (t >= lines.start) & (t <= lines.end)
    cell, offset = (s / 0.05).astype(int), []
    for k in np.unique(cell[use]):
        here = [across[use & (cell == k) & (number == n)].mean() for n in np.unique(number[use & (cell == k)])]
        offset += [v - np.mean(here) for v in here]
    return float(np.sqrt(np.mean(np.square(offset)))) if offset else float("nan")


def coat(hand: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Thickness (nz, nx) [volume per area for a rate of 1/s] on the wall's grid: along (nx,), up (nz,) [m].

    ``hand`` (k, 3) every ``step`` [s]. The cone's cross-section at the wall is a paraboloid whose radius grows with the
    distance, at a constant rate.
    """
    along, up = np.arange(AHEAD - 0.2, AHEAD + LENGTH + 0.2, GRID), np.arange(LOWEST - 0.2, LOWEST + 0.9, GRID)
    thick = np.zeros((up.size, along.size))
    for x, y, z in hand:
        radius = CONE * max(WALL - y, 1e-3)
        i, j = (slice(*np.searchsorted(g, (v - radius, v + radius))) for g, v in ((along, x), (up, z)))
        square = ((along[i] - x) ** 2)[None, :] + ((up[j] - z) ** 2)[:, None]
        thick[j, i] += step * 2.0 / (np.pi * radius**2) * np.clip(1.0 - square / radius**2, 0.0, None)
    return along, up, thick


def judged(along: np.ndarray, up: np.ndarray, thick: np.ndarray) -> np.ndarray:
    """The part of the coat that is judged: between the outer lines, without the ends where the hand turns."""
    i = (along >= AHEAD + ENDS) & (along <= AHEAD + LENGTH - ENDS)
    j = (up >= LOWEST + 0.5 * APART) & (up <= LOWEST + (LINES - 1.5) * APART)
    return thick[np.ix_(j, i)]


def stops(t: np.ndarray, hand: np.ndarray, wanted: np.ndarray) -> int:
    """How often the hand stood though it was asked to move."""
    step = t[1] - t[0]
    speed = lambda p: np.linalg.norm(np.gradient(p, step, axis=0), axis=1)
    still = (speed(hand) < STOP_SPEED) & (speed(wanted) > 2.0 * STOP_SPEED)
    count = round(STOP_TIME / step)
    long = np.convolve(still, np.ones(count))[: still.size] >= count
    return int(np.sum(long[1:] & ~long[:-1]))


def _metrics(log: Log, references: _References, sensors: bool) -> dict[str, Metric]:
    t, lines = log.times("hand"), references.lines
    use = t >= lines.start
    if use.sum() < 2:
        return {}
    hand, wanted, odometry = (log.array(n)[use] for n in ("hand", "hand_reference", "hand_odometry"))
    rms = lambda d: float(np.sqrt(np.mean(np.sum(np.atleast_2d(d.T).T ** 2, axis=1))))
    part = judged(*coat(hand, float(t[1] - t[0])))
    spread = pass_spread(lines, t[use], odometry[:, 1])
    goal = lambda value: value if sensors else None
    number, _ = lines.arc(t[use])
    spreads = {
        "pass_spread_rms": Metric(spread, "m", goal=0.003),
        "pass_spread_rms_world": Metric(pass_spread(lines, t[use], hand[:, 1]), "m"),
    }
    return {
        **(spreads if number.max() > 0 else {}),  # one pass differs from nothing
        "hand_error_rms": Metric(rms(odometry - wanted), "m"),
        "hand_error_rms_world": Metric(rms(hand - wanted), "m", goal=goal(0.004)),
        "hand_error_rms_world_normal": Metric(rms(hand[:, 1] - wanted[:, 1]), "m"),
        "wall_distance_min": Metric(float((WALL - hand[:, 1]).min()), "m", least=NEAREST),
        "path_length": Metric(float(np.sum(np.linalg.norm(np.diff(wanted, axis=0), axis=1))), "m"),
        "stops": Metric(float(stops(t[use], hand, wanted)), "1", goal=0.0),
        "coat_variation": Metric(float(part.std() / part.mean()), "1", goal=goal(0.10)),
        "coat_gaps": Metric(float(np.mean(part < GAP * part.mean())), "1", goal=goal(0.0)),
        "base_error_rms_world": Metric(rms((log.array("base_odometry") - log.array("base"))[use][:, :2]), "m"),
        "wheel_slip_max": Metric(float(log.array("wheel_slip")[use].max()), "m/s"),
    }


def _plots(log: Log, references: _References) -> list[Plot]:
    t, hand, wanted, odometry = (
        log.times("hand"), log.array("hand"), log.array("hand_reference"), log.array("hand_odometry"),
    )  # fmt: skip
    use = t >= references.lines.start
    along, up, thick = coat(hand[use], float(t[1] - t[0])) if use.sum() > 1 else (np.zeros(1),) * 2 + (np.ones((1, 1)),)
    mean = max(float(thick.mean()), 1e-12)
    return [
        Plot("Lines on the wall", "along [m]", "up [m]", [
            Series("reference", wanted[use, 0], wanted[use, 2], dashed=True), Series("hand", hand[use, 0], hand[use, 2]),
        ], equal_axes=True),
        Plot("Distance from the wall", "time [s]", "distance [mm]", [
            Series("world", t, 1e3 * (WALL - hand[:, 1])), Series("estimated frame", t, 1e3 * (WALL - odometry[:, 1])),
        ]),
        Plot("Coat at five heights", "along [m]", "thickness over mean", [
            Series(f"{up[k]:.2f} m", along, thick[k] / mean) for k in np.linspace(0, up.size - 1, 7).astype(int)[1:-1]
        ]),
        Plot("Hand error", "time [s]", "error [mm]", [
            Series("estimated frame", t, 1e3 * np.linalg.norm(odometry - wanted, axis=1)),
            Series("world", t, 1e3 * np.linalg.norm(hand - wanted, axis=1)),
        ]),
    ]  # fmt: skip
