"""Settings of `swerve-track`, and where end effector and base shall be over time."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from wbmpc import lie
from wbmpc.bases.swerve.defaults import EndEffectorCost, SwerveCost
from wbmpc.configuration import OneOf
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Reference
from wbmpc.settings import Robot, Settings
from wbmpc.studies.pankert2022.driving import DrivingSettings
from wbmpc.studies.paths import Approach, SinePath

#: Length of one period [m] (15.96 m for six) and heights, offsets of the end effector's path [m].
PERIOD_LENGTH, HEIGHT, SIDE, AHEAD = 15.96 / 6, 0.80, 0.65, 0.30
#: How far [m] to the left of its base the UR10's tool comes at that height and so far ahead, pointing to the left; how far
#: beyond that the peaks of the variant of that name are.
REACH, BEYOND = 1.248, 0.030
#: The tool's axis points to the left of the base.
END_EFFECTOR_ROTATION = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
END_EFFECTOR_ORIENTATION = lie.rotation_to_quaternion(END_EFFECTOR_ROTATION)


class PlainSine(Settings):
    """The sine lies, or stands upright (vertical). ``amplitude`` [m]: amplitude of the sine."""

    kind: Literal["horizontal", "vertical"] = "horizontal"
    amplitude: float = Field(0.498, gt=0, le=0.6)


class Peaks(Settings):
    """The sine lies, with peaks 30 mm out of reach of an arm whose base stays on its line."""

    kind: Literal["peaks"] = "peaks"
    amplitude: ClassVar[float] = REACH + BEYOND - SIDE


class SwerveTrackSettings(DrivingSettings):
    """``periods``: number of periods of the sine (6 are the paper's 15.96 m); ``variant``: horizontal or vertical (:class:`PlainSine`),
    or :class:`Peaks`; ``speed`` [m/s]: along it (an end effector that is elsewhere at home comes to its start first); ``friction``:
    whether the dry friction of wheels and steering is estimated and compensated; ``smoothing`` [s]: of base position and arm against the
    jitter of the encoders' age (0: none). The other settings are those of all experiments that drive."""

    cost: SwerveCost = SwerveCost(end_effector=EndEffectorCost(weight=4000.0))
    robot: Robot = "swerve-ur10"
    variant: OneOf[PlainSine | Peaks] = PlainSine()
    periods: int = Field(6, ge=1, le=20)
    speed: float = Field(0.255, ge=0.01, le=0.8)
    friction: bool = True
    smoothing: float = Field(0.025, ge=0, le=1)


class TrackReferences:
    """End effector and base paths over time. The end effector first comes from where it is at the robot's home to the path's start."""

    def __init__(self, settings: SwerveTrackSettings, robot: RobotModel) -> None:
        s = settings
        self.vertical = s.variant.kind == "vertical"
        self.approach = Approach(robot.pose(robot.home), (np.array([AHEAD, SIDE, HEIGHT]), END_EFFECTOR_ORIENTATION))
        begin = self.approach.duration + 0.5
        self.path = SinePath(s.variant.amplitude, PERIOD_LENGTH * s.periods, s.periods, s.speed, start=begin, ramp=2.0)
        self.duration = float(np.ceil((self.path.end + 0.5) * 10.0) / 10.0)

    @property
    def counted(self) -> float:
        """From when on errors count [s]: 2 s after the approach."""
        return self.approach.duration + 2.0

    def pose(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions (n, 3) [m] and quaternions (n, 4) of the end effector's reference at times t (n,) [s]."""
        offset, turns = self.approach.offset(t)
        return self._place(*self.path.point(t)) + offset, turns

    def end_effector(self, t: np.ndarray) -> np.ndarray:
        """Positions (n, 3) [m] of the end effector's reference at times t (n,) [s]."""
        return self.pose(t)[0]

    def orientation(self, t: np.ndarray) -> np.ndarray:
        """Quaternions (n, 4) of the end effector's reference at times t (n,) [s]."""
        return self.pose(t)[1]

    def _place(self, along: np.ndarray, across: np.ndarray) -> np.ndarray:
        side, up = (0.0 * across, across) if self.vertical else (across, 0.0 * across)
        return np.stack([along + AHEAD, SIDE + side, HEIGHT + up], axis=1)

    def curve(self) -> np.ndarray:
        return self._place(*self.path.curve())

    def base(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position along x [m] and speed [m/s]: the sine's mean line, as fast as the arc goes."""
        s, rate = self.path.arc(t)
        share = self.path.length / self.path.arc_length
        return s * share, rate * share

    def set(self, mpc: MPC, home: np.ndarray, lift: float = 0.0) -> None:
        """``lift`` [m]: by what the end effector goes higher over the model's base than over the floor."""
        robot_state, robot_input = mpc.ocp.dynamics.state, mpc.ocp.dynamics.input
        t = np.arange(0.0, self.duration + 0.02, 0.02)
        mpc.reference["end_effector"] = Reference.poses(t, self.end_effector(t) + [0.0, 0.0, lift], self.orientation(t))
        x, speed = self.base(t)
        states = np.tile(home, (t.size, 1))
        states[:, robot_state["base"]] = np.stack([x, 0.0 * x, 0.0 * x], axis=1)
        mpc.reference["state"] = Reference(t, states)
        inputs = np.zeros((t.size, robot_input.size))
        inputs[:, robot_input["base"].start] = speed
        mpc.reference["input"] = Reference(t, inputs)
