"""Settings of `swerve-drive`, its ways, and the knock of a leg."""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco
import numpy as np
from pydantic import Field

from wbmpc.bases.swerve.defaults import EndEffectorCost, InputCost, StateCost, SwerveCost
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.model.robot import RobotModel
from wbmpc.settings import Robot
from wbmpc.stability import configuration_positions
from wbmpc.studies.pankert2022.driving import DrivingSettings
from wbmpc.studies.pankert2022.mission import Leg, Mission, Reconfiguration

#: Along the way [m]: where the turn by 180° begins, where it has been made, the end. Speed [rad/s] at which the arm folds.
WAY, FOLDING = (9.0, 11.0, 15.0), 0.3
#: Duration [s] of the tour.
TOUR = 65.0
#: When [s] the brakes open (1) and close (0).
BRAKES = ((15.0, 1.0), (19.5, 0.0), (32.0, 1.0), (46.8, 0.0), (54.0, 1.0), (58.5, 0.0))
#: A knock [rad] of the left front leg by a torque [N m] up to a speed [rad/s].
KNOCK, KNOCK_TORQUE, KNOCK_SPEED = np.radians(5.0), 150.0, 0.3


class MissionSettings(DrivingSettings):
    """``leg_guard``: whether the brakes of open legs that move off their plan close."""

    # by runs on seed 0, checked on seed 5
    cost: SwerveCost = SwerveCost(
        end_effector=EndEffectorCost(weight=0.0, orientation=0.0),
        state=StateCost(position=30_000.0, yaw=9000.0, leg=300.0, arm=1.0),
        input=InputCost(base=5.0, steer=0.002),
    )
    robot: Robot = "swerve-ur10"
    leg_guard: bool = True


class SwerveDriveSettings(MissionSettings):
    """``baseline_only``: nothing but the tour with the baseline, for the search of its gains. ``leg_guard``: of the MPC.
    ``baseline_base_gain`` [1/s]: the baseline's gain of the base's pose; ``baseline_leg_gain`` [1/s]: its gain of the legs;
    ``baseline_steer_gain`` [1/s]: its gain of the steering angles; ``baseline_lead`` [s]: by which it reads its goals ahead;
    ``baseline_look_ahead`` [s]: its wheels turn, at rest, to a motion that begins so soon. The other settings are those of all
    experiments that drive."""

    baseline_only: bool = False
    baseline_base_gain: float = Field(8.0, ge=0, le=50)
    baseline_leg_gain: float = Field(8.0, ge=0, le=50)
    baseline_steer_gain: float = Field(40.0, gt=0, le=100)
    baseline_lead: float = Field(0.0, ge=0, le=0.5)
    baseline_look_ahead: float = Field(0.0, ge=0, le=5)


def tour_way() -> tuple[Leg, ...]:
    """15 m ahead within :data:`TOUR` [s], sideways in the middle part, with a turn by 180°.

    The base never stops while legs turn: at rest the wheels would have to turn before anything can move."""
    quarter, (begin, after, end) = 0.5 * np.pi, WAY
    return (
        Leg(1.0, 30.5, (begin, 0.0, 0.0)),
        Leg(20.0, 10.0, (begin, 0.0, -quarter)),
        Leg(30.0, 19.5, (after, 0.0, -quarter)),
        Leg(30.0, 18.0, (after, 0.0, quarter)),
        Leg(48.0, 14.5, (end, 0.0, quarter)),
        Leg(48.0, 10.0, (end, 0.0, 0.0)),
    )


def tour(robot: RobotModel, delay: float) -> tuple[Mission, float]:
    """The whole way and its duration [s]: the door in H, X, then A and X again while turning by 180°, and H."""
    h, x, a = (configuration_positions(robot, name) for name in "HXA")
    # Brakes are open while legs turn, and closed where wheels have to turn round (the base turns faster than it drives): they would
    # swing the legs.
    turns = (
        Reconfiguration(15.0 + delay, x),
        Reconfiguration(32.0 + delay, a),
        Reconfiguration(40.0, x),
        Reconfiguration(54.0 + delay, h),
    )
    home = robot.home[robot.state["arm"]]
    return Mission(tour_way(), h, turns, BRAKES, folding(robot, home)), TOUR


def folding(robot: RobotModel, home: np.ndarray) -> tuple[Reconfiguration, ...]:
    """The arm's first joint turns the end effector to before the base, and back behind the door."""
    place = robot.pose(robot.home)[0]
    folded = home.copy()
    folded[0] -= float(np.arctan2(place[1], place[0]))
    return Reconfiguration(1.0, folded, FOLDING), Reconfiguration(16.0, home, FOLDING)


def straight(robot: RobotModel, name: str, is_open: bool) -> tuple[Mission, float]:
    """1.5 m ahead with a quarter turn of 0.3 rad in one configuration, brakes open or closed."""
    brakes = ((0.5, 1.0),) if is_open else ()
    return Mission((Leg(1.0, 8.0, (1.5, 0.2, 0.3)),), configuration_positions(robot, name), (), brakes), 10.0


@dataclass
class Knock:
    """Pushes the left front leg inwards from ``start`` [s] until it has gone by 5°."""

    start: float
    plant: SwervePlant
    offset: float
    module: int
    dof: int = field(init=False)
    at: float = field(init=False, default=np.nan)
    done: float = field(init=False, default=np.nan)

    def __post_init__(self) -> None:
        joint = self.plant.model.joint(self.plant.base.modules[self.module].hinge or "")
        self.dof, self._place = int(joint.dofadr[0]), int(joint.qposadr[0])

    def __call__(self, m: mujoco.MjModel, d: mujoco.MjData) -> None:
        t = self.plant.time - self.offset
        angle = float(d.qpos[self._place])
        if t < self.start or not np.isnan(self.done):
            d.qfrc_applied[self.dof] = 0.0
            return
        if np.isnan(self.at):
            self.at = angle
        d.qfrc_applied[self.dof] = -KNOCK_TORQUE if abs(d.qvel[self.dof]) < KNOCK_SPEED else 0.0
        if abs(angle - self.at) >= KNOCK or t > self.start + 1.0:
            self.done = t
