"""Settings of `swerve-plaster`, the lines on the wall, and where end effector and base shall be over time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pydantic import Field

from wbmpc.bases.swerve.defaults import StateCost, SwerveCost
from wbmpc.configuration import OneOf
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Reference
from wbmpc.settings import Nothing, Robot
from wbmpc.studies.pankert2022.driving import DrivingSettings, LidarPoses
from wbmpc.studies.pankert2022.track_references import END_EFFECTOR_ORIENTATION
from wbmpc.studies.paths import Approach

#: Lines [m]: length, distance, lowest; the wall's place and the end effector's distance from it [m]; the end effector ahead of the base at the
#: start of a line [m].
LENGTH, APART, LOWEST, WALL, STANDOFF, AHEAD = 3.5, 0.15, 0.60, 0.75, 0.10, -0.10
LINES = 5
#: Largest accelerations [m/s²] along the path and in its corners (half circles): 2 m/s² is the bound.
ALONG, ACROSS = 1.5, 1.6
#: Share of the end effector's way along the wall that the base makes.
BASE_SHARE = 0.85
#: The end effector stops at this distance [m] from the wall, by a switch of its own.
NEAREST = 0.03
#: Spray: radius of the cone on the wall over its distance, step of the grid [m], thinnest coat that is no gap [share of mean].
CONE, GRID, GAP = 2.0, 0.025, 0.7
#: Ends of lines that are not judged, where the end effector slows down to turn [m].
ENDS = 0.45
#: An end effector asked to move at twice the second [m/s] that moves slower than it for the first [s] has stopped.
STOP_TIME, STOP_SPEED = 0.3, 0.1


class SwervePlasterSettings(DrivingSettings):
    """``passes``: number of passes over the five lines; ``speed`` [m/s]: along them; ``localization``: lidar, with a sensor of
    the wall's distance (b), or none, odometry only (a); ``terrain``: cables and bumps. The other settings are those of all experiments
    that drive."""

    cost: SwerveCost = SwerveCost(state=StateCost(position=20.0, yaw=100.0))
    robot: Robot = "swerve-ur10"
    passes: int = Field(10, ge=1, le=50)
    speed: float = Field(0.7, gt=0.05, le=0.9)
    localization: OneOf[Nothing | LidarPoses] = LidarPoses()
    terrain: bool = True


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
                previous = k - 1 if index.step > 0 else k + 1
                v[k] = min(v[k], np.sqrt(v[previous] ** 2 + 2.0 * ALONG * abs(s[k] - s[previous])))
        return s, p, v

    @cached_property
    def _times(self) -> np.ndarray:
        """When one pass is at each of its places [s]."""
        s, _, v = self._curve
        return np.concatenate([[0.0], np.cumsum(2.0 * np.diff(s) / np.maximum(v[1:] + v[:-1], 1e-6))])

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


class WallReferences:
    """End effector and base over time; the end effector comes from home first."""

    def __init__(self, settings: SwervePlasterSettings, robot: RobotModel) -> None:
        first = np.array([AHEAD, WALL - STANDOFF, LOWEST])
        self.approach = Approach(robot.pose(robot.home), (first, END_EFFECTOR_ORIENTATION))
        self.lines = Lines(settings.passes, settings.speed, self.approach.duration + 1.0)
        self.duration = float(np.ceil((self.lines.end + 0.5) * 10.0) / 10.0)

    def end_effector(self, t: np.ndarray) -> np.ndarray:
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
        mpc.reference["end_effector"] = Reference.poses(t, self.end_effector(t), self.approach.offset(t)[1])
        states = np.tile(robot.home, (t.size, 1))
        states[:, robot.state["base"]] = self.base(t)
        mpc.reference["state"] = Reference(t, states)
        inputs = np.zeros((t.size, robot.input.size))
        inputs[:, robot.input["base"]] = np.gradient(self.base(t), t, axis=0)
        mpc.reference["input"] = Reference(t, inputs)
