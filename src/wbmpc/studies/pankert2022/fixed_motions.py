"""Settings of `swerve-fixed`, and the motions that the base is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from wbmpc.bases.swerve.defaults import EndEffectorCost, InputCost, StateCost, SwerveCost
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.configuration import OneOf
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Reference
from wbmpc.settings import Nothing, Robot, Settings
from wbmpc.studies.base_path import BasePath, Segment, in_turn, random_twists
from wbmpc.studies.pankert2022.directions import reject_directions
from wbmpc.studies.pankert2022.driving import DrivingSettings

Name = Literal["forward", "sideways", "diagonal", "turning", "combined"]
Controller = Literal["mpc", "ik", "four_wheel"]
SEGMENTS: dict[Name, Segment] = {
    "forward": Segment((0.4, 0.0, 0.0), 6.0),
    "sideways": Segment((0.0, 0.4, 0.0), 6.0),
    "diagonal": Segment((0.3, -0.3, 0.0), 6.0),
    "turning": Segment((0.0, 0.0, 0.5), 6.0),
    "combined": Segment((0.3, 0.15, 0.3), 8.0),
}
#: Rest before the first segment and between segments, ramp of each [s].
START, PAUSE, RAMP = 1.0, 2.0, 1.0


class BaselineGains(Settings):
    """Gains of :class:`wbmpc.studies.pankert2022.rolling.RollingGains`. ``base_gain`` [1/s]: gain of the base's pose; ``steer_gain`` [1/s]: gain
    of the steering angles; ``lead`` [s]: by which goals are read ahead, for the drives' lag; ``look_ahead`` [s]: wheels of a base at rest turn to
    a motion that begins so soon."""

    kind: Literal["gains"] = "gains"
    base_gain: float = Field(12.0, ge=0, le=50)
    steer_gain: float = Field(30.0, gt=0, le=100)
    lead: float = Field(0.0, ge=0, le=0.5)
    look_ahead: float = Field(2.0, ge=0, le=5)


class SwerveFixedSettings(DrivingSettings):
    """``planned``: whether the MPC follows the motions; ``ik``: gains of rolling inverse kinematics, found on tuning seeds, or none;
    ``four_wheel``: those of four-wheel steering (by forward and turning, what it can do). ``motions``: which, in this order, each once at most;
    ``random_time`` [s]: duration of random twists after the motions (600 is the ten minutes of the protocol); ``speed`` [m/s]: the largest of them;
    ``yaw_rate`` [rad/s]: their fastest turn. The other settings are those of all experiments that drive."""

    cost: SwerveCost = SwerveCost(
        end_effector=EndEffectorCost(weight=0.0, orientation=0.0),
        state=StateCost(position=10_000.0, yaw=3000.0, arm=1.0),
        input=InputCost(base=5.0),
    )
    robot: Robot = "swerve-fixed-ur10"
    planned: bool = True
    ik: OneOf[Nothing | BaselineGains] = BaselineGains()
    four_wheel: OneOf[Nothing | BaselineGains] = BaselineGains(base_gain=19.1, steer_gain=19.4, look_ahead=1.7)
    motions: tuple[Name, ...] = tuple(SEGMENTS)
    random_time: float = Field(60.0, ge=0, le=3600)
    speed: float = Field(0.5, gt=0, le=1.0)
    yaw_rate: float = Field(0.4, ge=0, le=1.0)

    @model_validator(mode="after")
    def _something_to_compare(self) -> Self:
        """A base that is asked nothing compares no controllers; of a motion twice the figures would be of the second alone."""
        if not self.controllers:
            raise ValueError(
                "planned: one controller at least is needed; valid: planned=true, ik=gains or four_wheel=gains"
            )
        if not self.motions and self.random_time == 0.0:
            raise ValueError("motions: none is left, and random_time is 0: there is nothing to follow")
        twice = [name for k, name in enumerate(self.motions) if name in self.motions[:k]]
        if twice:
            raise ValueError(f"motions: '{twice[0]}' appears twice; valid: each once at most")
        return self

    @property
    def controllers(self) -> list[Controller]:
        """Those that follow the motions."""
        run: dict[Controller, bool] = {
            "mpc": self.planned, "ik": self.ik.kind == "gains", "four_wheel": self.four_wheel.kind == "gains",
        }  # fmt: skip
        return [name for name, is_run in run.items() if is_run]


@dataclass(frozen=True)
class Motion:
    """The motions one after another, then random ones from where they end; ``spans`` [s] by name."""

    path: BasePath
    spans: dict[str, tuple[float, float]]

    @classmethod
    def of(cls, settings: SwerveFixedSettings, seed: int) -> Motion:
        first, times = in_turn([SEGMENTS[n] for n in settings.motions], START, PAUSE, RAMP)
        spans: dict[str, tuple[float, float]] = dict(zip(settings.motions, times, strict=True))
        twists = first.twists
        if settings.random_time > 0.0:
            more = random_twists(settings.random_time, settings.speed, settings.yaw_rate, seed)
            spans["random"] = (float(first.times[-1]), float(first.times[-1] + settings.random_time))
            twists = np.vstack([twists[:-1], more.twists])
        return cls(BasePath.of(np.vstack([twists, np.zeros((100, 3))])), spans)

    def set(self, mpc: MPC, robot: RobotModel) -> None:
        t = self.path.times[::2]
        legs = np.tile(legs_at_home(robot), (t.size, 1))
        reject_directions(robot, t, self.path.twists[::2], legs, 0.0 * legs)
        states = np.tile(robot.home, (t.size, 1))
        states[:, robot.state["base"]] = self.path.poses[::2]
        inputs = np.zeros((t.size, robot.input.size))
        inputs[:, robot.input["base"]] = self.path.twists[::2]
        mpc.reference["state"] = Reference(t, states)
        mpc.reference["input"] = Reference(t, inputs)
        position, orientation = robot.pose(robot.home)
        mpc.reference["end_effector"] = Reference.poses(np.zeros(1), position[None], orientation[None])


def legs_at_home(robot: RobotModel) -> np.ndarray:
    """Leg angles (n) [rad] at which hinged legs are held; 0 for fixed ones."""
    return robot.home[robot.state["leg"]] if "leg" in robot.state else np.zeros(swerve_base(robot).geometry.modules)
