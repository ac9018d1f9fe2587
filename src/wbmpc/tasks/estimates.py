"""What plans do not know and a closed loop finds: a payload, by the torques of the arm's drives; the friction of a floor, from slips."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, ClassVar

import numpy as np

from wbmpc.bases.base import System
from wbmpc.default_problem import carry, grip
from wbmpc.errors import InputError
from wbmpc.estimation.floor_friction import FloorFriction, turning
from wbmpc.estimation.payload import ArmScale
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.result import Metric, Plot, Series
from wbmpc.settings import StabilitySettings, WheelLoadSettings
from wbmpc.tasks.settings import KinematicPlant, SimulationSettings, TaskSettings


class EstimateWatch:
    """Has the MPC of a ``system`` plan with a number that is estimated, ``planned`` until then; ``true``: what it really is. ``channel``
    of the log; ``change``: by how much it has to change for other plans; ``plan``: what makes them; ``title`` and ``axis`` of the plot
    and ``shown``: the name of its line."""

    channel: ClassVar[str]
    change: ClassVar[float]
    title: ClassVar[str]
    axis: ClassVar[str]
    shown: ClassVar[str]
    plan: Callable[[MPC, float], None]

    def __init__(self, system: System, log: Log, planned: float, true: float) -> None:
        self.controller: Any = system.controller
        self.log, self._mpc, self._true, self._planned = log, system.mpc, true, planned

    def note(self, t: float, found: float) -> None:
        """The estimate at time t [s]."""
        self.log.add(self.channel, t, np.array([found]))
        if abs(found - self._planned) > self.change:
            self._planned = found
            type(self).plan(self._mpc, found)

    def plots(self) -> list[Plot]:
        """The estimate over time."""
        if self.channel not in self.log.channels:
            return []
        t, found = self.log.times(self.channel), self.log.array(self.channel)[:, 0]
        lines = [Series(self.shown, t, found), Series("true", t[[0, -1]], np.full(2, self._true))]
        return [Plot(self.title, "time [s]", self.axis, lines)]


class PayloadWatch(EstimateWatch):
    """Weighs what the robot carries."""

    channel, change, plan = "payload", 0.02, staticmethod(carry)
    title, axis, shown = "Payload", "mass [kg]", "estimated"

    def __init__(self, settings: StabilitySettings, robot: RobotModel, system: System, log: Log, true: float) -> None:
        super().__init__(system, log, settings.payload, true)
        self._scale = ArmScale(robot, settings.payload_center, settings.payload)

    def tick(self, t: float, plans: Any) -> None:
        """At a controller period."""
        seen = self.controller.measured
        if seen is not None and self._scale.update(seen.time, seen.arm, seen.effort, seen.accel, seen.gyro):
            self.note(t, self._scale.mass)

    def metrics(self) -> dict[str, Metric]:
        """What was found."""
        mass = self._scale.mass
        return {
            "payload_estimated": Metric(mass, "kg"),
            "payload_error_end": Metric(abs(mass - self._true), "kg"),
        }


class FloorFrictionWatch(EstimateWatch):
    """Estimates the friction of the floor under the robot."""

    channel, change, plan = "floor_friction", 0.005, staticmethod(grip)
    title, axis, shown = "Friction of the floor", "coefficient [1]", "planned with"

    def __init__(self, settings: WheelLoadSettings, robot: RobotModel, system: System, log: Log, true: float) -> None:
        super().__init__(system, log, settings.friction, true)
        self._floor, self._time = FloorFriction(settings.friction, turning(robot, settings.payload)), -np.inf

    def tick(self, t: float, plans: Any) -> None:
        """At a controller period."""
        seen, slip = self.controller.measured, self.controller.slip
        if seen is None or slip is None or seen.time <= self._time:
            return
        h, self._time = seen.time - self._time, seen.time
        if np.isfinite(h):
            self._floor.update(h, seen.accel, seen.gyro[2], slip)
            self.note(t, self._floor.bound)

    def metrics(self) -> dict[str, Metric]:
        """What was found."""
        bounds = self.log.array(self.channel) if self.channel in self.log.channels else np.array([[self._planned]])
        return {
            "floor_friction_least": Metric(float(bounds.min()), "1"),
            "floor_slips": Metric(float(self._floor.slips), "1"),
        }


def estimate_watches(
    settings: SimulationSettings, robot: RobotModel, system: System, log: Log
) -> Iterator[EstimateWatch]:
    """Those that the settings ask for. Raises :class:`InputError` for robots that do not report torques, or do not feel slips."""
    kept, plant = settings.upright if isinstance(settings, TaskSettings) else None, settings.plant
    if kept is not None and kept.estimate_payload:
        if isinstance(plant, KinematicPlant):
            raise InputError(
                "stability.estimate_payload: with plant=kinematic no drive has a torque; valid: plant=mujoco"
            )
        yield PayloadWatch(kept, robot, system, log, plant.payload)
    if isinstance(kept, WheelLoadSettings) and kept.estimate_friction:
        if kept.friction <= 0.0:
            raise InputError(
                "stability.estimate_friction: plans with stability.friction=0 know no friction; valid: more than 0"
            )
        if not hasattr(system.controller, "slip"):
            raise InputError(
                f"stability.estimate_friction: the base of '{robot.description.name}' with plant={plant.kind} compares no wheels with an "
                "accelerometer; valid: a base of steered wheels with plant=mujoco"
            )
        simulated: Any = system.plant
        yield FloorFrictionWatch(kept, robot, system, log, simulated.draw.friction)
