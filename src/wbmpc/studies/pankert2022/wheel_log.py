"""The channels of a log from which the wheels of a swerve base are calibrated, and the robot that it is of."""

from __future__ import annotations

import numpy as np

from wbmpc.bases.swerve.messages import SwerveMeasurement
from wbmpc.bases.swerve.wheel_record import WheelRecord
from wbmpc.errors import InputError
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel, load_robot


def swerve_robot(name: str) -> RobotModel:
    """The robot of that name or file, which must have a swerve base."""
    robot = load_robot(name)
    if robot.description.base.type != "swerve":
        raise InputError(f"robot: '{name}' has a base of type '{robot.description.base.type}'; valid: swerve")
    return robot


def record_of(log: Log) -> WheelRecord:
    """What a calibration reads of a log."""
    return WheelRecord.of({c: log.array(c) for c in log.channels} | {f"{c}.time": log.times(c) for c in log.channels})


class WheelLog:
    """Writes the channels that a calibration reads: one row for ``every`` messages of ``robot``."""

    def __init__(self, log: Log, robot: RobotModel, every: int = 4) -> None:
        self.log, self.every = log, every
        self._count, self._gyro = 0, list[float]()
        wheels, legs = robot.description.base.joint_groups()["wheel"], set(robot.state.unit_groups.get("leg", ()))
        moved = legs.pop() if len(legs) == 1 else ""
        for channel, unit in (("steer", "rad"), ("wheel", "rad"), ("leg", moved), ("brake", "1")):
            log.label(channel, wheels, unit)

    def add(self, t: float, m: SwerveMeasurement, brake: np.ndarray | None = None) -> None:
        """Take in the message of time ``t`` [s] on the log's clock, and what brakes (n, 1 = open) were commanded before it."""
        self._gyro.append(float(m.gyro[2]))
        if m.place is not None:
            row = np.concatenate([m.place.pose, np.sqrt(np.diag(m.place.covariance))])
            self.log.add("place", m.place.time - m.time + t, row)
        if self._count % self.every == 0:
            self.log.add("steer", t, m.steer)
            self.log.add("wheel", t, m.wheel)
            if m.leg.size:
                self.log.add("leg", t, m.leg)
                self.log.add("brake", t, np.zeros(m.leg.size) if brake is None else brake)
            self.log.add("gyro", t, sum(self._gyro) / len(self._gyro))
            self._gyro = []
        self._count += 1
