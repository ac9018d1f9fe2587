"""A payload that plans do not know, weighed during a closed loop by the torques of the arm's drives."""

from __future__ import annotations

from typing import Any

import numpy as np

from wbmpc.bases.base import System
from wbmpc.default_problem import carry
from wbmpc.errors import InputError
from wbmpc.estimation.payload import ArmScale
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.result import Metric, Plot, Series
from wbmpc.settings import StabilitySettings
from wbmpc.tasks.settings import KinematicPlant, SimulationSettings, TaskSettings

#: Plans change when the mass has changed by so much [kg].
CHANGE = 0.02


class PayloadWatch:
    """Weighs what the robot of a ``system`` carries, and has its MPC plan with it; ``true`` [kg]: what it really is."""

    def __init__(self, settings: StabilitySettings, robot: RobotModel, system: System, log: Log, true: float) -> None:
        self._controller: Any = system.controller
        self._mpc, self._log, self._true, self._planned = system.mpc, log, true, settings.payload
        self._scale = ArmScale(robot, settings.payload_center, settings.payload)

    @classmethod
    def of(cls, settings: SimulationSettings, robot: RobotModel, system: System, log: Log) -> PayloadWatch | None:
        """Where the settings ask for it. Raises :class:`InputError` for robots that do not report torques."""
        kept = settings.upright if isinstance(settings, TaskSettings) else None
        if kept is None or not kept.estimate_payload:
            return None
        if isinstance(settings.plant, KinematicPlant):
            raise InputError(
                "stability.estimate_payload: with plant=kinematic no drive has a torque; valid: plant=mujoco"
            )
        return cls(kept, robot, system, log, settings.plant.payload)

    def tick(self, t: float, plans: Any) -> None:
        """At a controller period."""
        seen = self._controller.measured
        if seen is None or not self._scale.update(seen.time, seen.arm, seen.effort, seen.accel, seen.gyro):
            return
        self._log.add("payload", t, np.array([self._scale.mass]))
        if abs(self._scale.mass - self._planned) > CHANGE:
            self._planned = self._scale.mass
            carry(self._mpc, self._planned)

    def metrics(self) -> dict[str, Metric]:
        """What was found."""
        mass = self._scale.mass
        return {
            "payload_estimated": Metric(mass, "kg"),
            "payload_error_end": Metric(abs(mass - self._true), "kg"),
        }

    def plots(self) -> list[Plot]:
        """The mass over time."""
        if "payload" not in self._log.channels:
            return []
        t, mass = self._log.times("payload"), self._log.array("payload")[:, 0]
        shown = [Series("estimated", t, mass), Series("true", t[[0, -1]], np.full(2, self._true))]
        return [Plot("Payload", "time [s]", "mass [kg]", shown)]
