"""A flat wall that a swerve robot wipes with a tip on a spring: physics, and the force sensor behind the tip."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.swerve.messages import SwerveMeasurement
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.robots import RobotDescription
from wbmpc.simulation.contacts import HANDLE
from wbmpc.simulation.wheeled import CREEP_DECAY, SLIDING_IMPEDANCE
from wbmpc.studies.force_tip import FORCE, TIP, ForceSensor, add_tip, contact_force
from wbmpc.studies.pankert2022.wipe_messages import WipeMeasurement
from wbmpc.types import Edit

#: Half the thickness and half the height of the wall [m], and how far it goes on beyond the points that say where it is [m].
HALF_THICKNESS, HALF_HEIGHT, BEYOND = 0.05, 1.0, 1.0
#: Stiffness [1/s²] and damping [1/s] of the contact over its apparent mass: the spring behind the tip is what is soft.
STIFFNESS, DAMPING = 1e6, 2000.0


@dataclass(frozen=True)
class Wall:
    """Its surface goes through (``along[0]``, ``across[0]``) and (``along[1]``, ``across[1]``) [m]; the robot is on its right.
    ``grip``: friction coefficient of the tip on it."""

    along: tuple[float, float]
    across: tuple[float, float]
    grip: float

    @property
    def angle(self) -> float:
        """From the world's x axis to the wall [rad]."""
        return float(np.arctan2(self.across[1] - self.across[0], self.along[1] - self.along[0]))

    @property
    def normal(self) -> Array:
        """Unit vector (3) into the wall."""
        return np.array([-np.sin(self.angle), np.cos(self.angle), 0.0])

    def add(self, spec: mujoco.MjSpec) -> None:
        """The wall as something that a tool may touch, and nothing else; the tip must be there. As with tires, surfaces that slide must not
        push each other apart (:func:`wbmpc.simulation.wheeled.let_tires_slide`)."""
        middle = np.array([np.mean(self.along), np.mean(self.across), HALF_HEIGHT]) + HALF_THICKNESS * self.normal
        half = 0.5 * np.hypot(np.diff(self.along)[0], np.diff(self.across)[0]) + BEYOND
        spec.worldbody.add_geom(
            name="wall", type=mujoco.mjtGeom.mjGEOM_BOX, size=[half, HALF_THICKNESS, HALF_HEIGHT], pos=middle,
            quat=[np.cos(0.5 * self.angle), 0, 0, np.sin(0.5 * self.angle)], rgba=[0.85, 0.83, 0.78, 0.6], **HANDLE,
        )  # fmt: skip
        low = SLIDING_IMPEDANCE
        spec.add_pair(
            geomname1="wall", geomname2=TIP, condim=3, friction=[self.grip, self.grip, 0.005, 1e-4, 1e-4],
            solref=[-STIFFNESS, -DAMPING], solreffriction=[-1.0, -CREEP_DECAY * low], solimp=[low, low, 0.001, 0.5, 2.0],
        )  # fmt: skip


class WipePlant(SwervePlant):
    """A swerve robot at a ``wall`` with a tip on a ``spring`` [N/m]; ``floor`` changes the specification too. ``steps``: a row for each
    physics step of time [s] and force of the tip on the wall along its normal and across it [N]. The other arguments are those of
    :class:`SwervePlant`."""

    def __init__(
        self, description: RobotDescription, wall: Wall, spring: float, *args: Any, sensor: ForceSensor | None = None,
        floor: Edit | None = None, **more: Any,
    ) -> None:  # fmt: skip
        self.wall, self._sensor = wall, sensor or ForceSensor()
        self.steps: list[tuple[float, float, float]] = []
        self._sensed: deque[Array] = deque(maxlen=5)

        def edit(spec: mujoco.MjSpec) -> None:
            add_tip(spec, description.arm.tool, wall.grip, spring=spring)
            wall.add(spec)
            if floor is not None:
                floor(spec)

        super().__init__(description, *args, edit=edit, **more)
        self._zero = self._noise.uniform(-self._sensor.bias, self._sensor.bias, 3)
        self.steps.clear()

    def index(self) -> None:
        """Also tip, wall and force sensor."""
        super().index()
        self._tip, self._surface = self.model.geom(TIP).id, self.model.geom("wall").id
        self._force_at = int(self.model.sensor(FORCE).adr[0])

    def _bind_steps(self) -> None:
        super()._bind_steps()
        keep = self._keep

        def both() -> None:
            keep()
            self._see()

        self._keep = both

    def _see(self) -> None:
        """After a physics step, before anything looks for the contacts of the next one."""
        force = contact_force(self.model, self.data, self._tip, self._surface)
        push = float(force @ self.wall.normal)
        self.steps.append((self.time, push, float(np.linalg.norm(force - push * self.wall.normal))))
        self._sensed.append(self.data.sensordata[self._force_at : self._force_at + 3].copy())

    def measure(self) -> SwerveMeasurement:
        """As of the robot, with the force sensor."""
        if self._last is not None and self._last.time == self.time:
            last: SwerveMeasurement = self._last
            return last
        message = super().measure()
        force = np.mean(self._sensed, axis=0) + self._zero + self._sensor.noise * self._noise.normal(size=3)
        self._last = WipeMeasurement(**{**vars(message), "force": force})
        return self._last
