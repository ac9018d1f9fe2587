"""A floor's friction that plans do not know, estimated during a closed loop from slips."""

from __future__ import annotations

from typing import Any

import numpy as np

from wbmpc.bases.base import System
from wbmpc.default_problem import grip
from wbmpc.errors import InputError
from wbmpc.estimation.floor_friction import FloorFriction, turning
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.result import Metric, Plot, Series
from wbmpc.settings import WheelLoadSettings
from wbmpc.tasks.settings import SimulationSettings, TaskSettings

#: Plans change when the coefficient has changed by so much.
CHANGE = 0.005


class FloorFrictionWatch:
    """Estimates the friction of the floor under the robot of a ``system``, and has its MPC plan with it; ``true``: what it really is."""

    def __init__(self, settings: WheelLoadSettings, robot: RobotModel, system: System, log: Log, true: float) -> None:
        self._controller: Any = system.controller
        self._mpc, self._log, self._true, self._planned = system.mpc, log, true, settings.friction
        self._floor, self._time = FloorFriction(settings.friction, turning(robot, settings.payload)), -np.inf

    @classmethod
    def of(cls, settings: SimulationSettings, robot: RobotModel, system: System, log: Log) -> FloorFrictionWatch | None:
        """Where the settings ask for it. Raises :class:`InputError` for robots that do not feel slips."""
        kept = settings.upright if isinstance(settings, TaskSettings) else None
        if not isinstance(kept, WheelLoadSettings) or not kept.estimate_friction:
            return None
        if kept.friction <= 0.0:
            raise InputError(
                "stability.estimate_friction: plans with stability.friction=0 know no friction; valid: more than 0"
            )
        if not hasattr(system.controller, "slip"):
            raise InputError(
                f"stability.estimate_friction: the base of '{robot.description.name}' with plant={settings.plant.kind} compares no wheels with an "
                "accelerometer; valid: a base of steered wheels with plant=mujoco"
            )
        plant: Any = system.plant
        return cls(kept, robot, system, log, plant.draw.friction)

    def tick(self, t: float, plans: Any) -> None:
        """At a controller period."""
        seen, slip = self._controller.measured, self._controller.slip
        if seen is None or slip is None or seen.time <= self._time:
            return
        h, self._time = seen.time - self._time, seen.time
        if not np.isfinite(h):
            return
        self._floor.update(h, seen.accel, seen.gyro[2], slip)
        self._log.add("floor_friction", t, np.array([self._floor.bound]))
        if abs(self._floor.bound - self._planned) > CHANGE:
            self._planned = self._floor.bound
            grip(self._mpc, self._planned)

    def metrics(self) -> dict[str, Metric]:
        """What was found."""
        bounds = (
            self._log.array("floor_friction") if "floor_friction" in self._log.channels else np.array([[self._planned]])
        )
        return {
            "floor_friction_least": Metric(float(bounds.min()), "1"),
            "floor_slips": Metric(float(self._floor.slips), "1"),
        }

    def plots(self) -> list[Plot]:
        """The coefficient over time."""
        if "floor_friction" not in self._log.channels:
            return []
        t, bound = self._log.times("floor_friction"), self._log.array("floor_friction")[:, 0]
        shown = [Series("planned with", t, bound), Series("true", t[[0, -1]], np.full(2, self._true))]
        return [Plot("Friction of the floor", "time [s]", "coefficient [1]", shown)]
