"""A door that a ball robot pushes with its end effector, and the force sensor in that end effector.

The panel is a box on a hinge with inertia, damping, dry friction and a closer; it may stick until it has moved once, or be
locked. The end effector touches it with a soft ball of rubber on a light body of its own (``hand_tip``), so that the sensor between
end effector and tip reads hardly any inertia. The panel collides with the whole robot; only the tip
is meant to touch it.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from wbmpc.bases.ball.messages import BallCommand, BallMeasurement
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.checks import not_negative, positive
from wbmpc.errors import InputError
from wbmpc.robots import RobotDescription
from wbmpc.simulation.contacts import HANDLE
from wbmpc.simulation.perturbation import Perturbation
from wbmpc.simulation.world import Array
from wbmpc.studies.force_tip import SOFT, TIP, ForceSensor, add_tip, contact_force

#: Half the thickness [m] of the panel, its height [m], and how far [m] its lower edge is above the floor.
HALF_THICKNESS, HEIGHT, CLEARANCE = 0.02, 1.8, 0.01
#: A door that sticks is free once it has opened so far [rad].
LOOSE = np.deg2rad(0.5)
#: How far [rad] a door opens before it meets its stop.
WIDE_OPEN = 2.2


@dataclass(frozen=True)
class Door:
    """Where a door is, and how hard it is to open.

    ``hinge`` (2) [m] in the world; ``closed`` [rad]: heading of the closed panel as seen from its hinge; ``opening``: +1 when the panel turns
    counter-clockwise as it opens, −1 when clockwise. ``width`` [m], ``mass`` [kg] of the homogeneous panel, ``friction`` [N m] (Coulomb),
    ``closer`` [N m], ``damping`` [N m s/rad] of the hinge, ``grip``: friction coefficient of the tip on it, ``contact``: time constant [s]
    and damping ratio of that contact; ``friction_time`` [s]: time constant with which its friction stops what slides, where that is not the
    contact's (None): with a soft contact's, surfaces that turn creep along each other. ``breakaway`` [N m]: dry friction until it has once
    opened by half a degree. ``locked``: no hinge at all.
    """

    hinge: tuple[float, float]
    closed: float = -np.pi / 2
    opening: float = 1.0
    width: float = 0.8
    mass: float = 12.0
    friction: float = 1.5
    closer: float = 2.0
    damping: float = 12.0
    grip: float = 0.5
    breakaway: float = 0.0
    contact: tuple[float, float] = SOFT
    friction_time: float | None = None
    locked: bool = False

    def __post_init__(self) -> None:
        if self.opening not in (1.0, -1.0):
            raise InputError(f"door: opening must be 1 (counter-clockwise) or -1, got {self.opening}")
        positive("door", width=self.width, mass=self.mass)
        names = ("friction", "closer", "damping", "grip", "breakaway")
        not_negative("door", **{name: getattr(self, name) for name in names})

    @property
    def inertia(self) -> float:
        """About the hinge [kg m²]."""
        return self.mass * (self.width**2 + HALF_THICKNESS**2) / 3.0

    def add(self, spec: mujoco.MjSpec) -> None:
        """The panel on its hinge; the joint's angle is positive when the door is open."""
        half, rotation = self.closed / 2.0, [0.0, 0.0, self.opening]
        body = spec.worldbody.add_body(
            name="door", pos=[*self.hinge, CLEARANCE + HEIGHT / 2.0], quat=[np.cos(half), 0, 0, np.sin(half)]
        )
        body.explicitinertial, body.mass, body.ipos = True, self.mass, [self.width / 2.0, 0.0, 0.0]
        w, d, h = self.width**2, (2.0 * HALF_THICKNESS) ** 2, HEIGHT**2
        body.inertia = self.mass / 12.0 * np.array([d + h, w + h, w + d])
        if not self.locked:
            joint = body.add_joint(name="door", type=mujoco.mjtJoint.mjJNT_HINGE, axis=rotation)
            stops = np.array([0.0, WIDE_OPEN])  # in the unit of the robot's file
            joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
            joint.range = np.rad2deg(stops) if spec.compiler.degree else stops
            joint.damping, joint.frictionloss = [self.damping, 0, 0], max(self.friction, self.breakaway)
            joint.solref_limit = [0.01, 1.0]
        body.add_geom(
            name="door", type=mujoco.mjtGeom.mjGEOM_BOX, size=[self.width / 2.0, HALF_THICKNESS, HEIGHT / 2.0],
            pos=[self.width / 2.0, 0, 0], mass=0, condim=3, friction=[self.grip, 0.005, 1e-4], solref=self.contact,
            rgba=[0.72, 0.53, 0.34, 0.9], **HANDLE,
        )  # fmt: skip


class DoorPlant(BallPlant):
    """A ball robot before a door. Its measurements also hold the ``force`` (3) [N] that the sensor in the end effector reads.

    The other arguments are those of :class:`BallPlant`.
    """

    def __init__(
        self, description: RobotDescription, door: Door, state: ArrayLike | None = None, torque: ArrayLike | None = None,
        perturbation: Perturbation | None = None, seed: int = 0, *, sensor: ForceSensor | None = None, payload: float = 0.0,
    ) -> None:  # fmt: skip
        self.door, self._sensor = door, sensor or ForceSensor()
        self._rng = np.random.default_rng([seed, 17])
        self._bias = self._rng.uniform(-self._sensor.bias, self._sensor.bias, 3)
        self._forces: deque[Array] = deque(maxlen=64)
        self._pressed = np.zeros(3)

        def edit(spec: mujoco.MjSpec) -> None:
            door.add(spec)
            add_tip(spec, description.arm.tool, door.grip, door.contact)
            if door.friction_time is not None:
                spec.add_pair(
                    name="hand_tip_door", geomname1=TIP, geomname2="door", condim=3, solref=door.contact,
                    friction=[door.grip, door.grip, 0.005, 1e-4, 1e-4], solreffriction=[door.friction_time, 1.0],
                )  # fmt: skip

        super().__init__(description, state, torque, perturbation, seed, payload=payload, edit=edit)
        self._tip, self._panel = self.model.geom(TIP).id, self.model.geom("door").id
        self._hinge = None if door.locked else self.model.joint("door")
        if self._hinge is not None:
            self._dof, self._q = int(self._hinge.dofadr[0]), int(self._hinge.qposadr[0])
            self.external = self._act

    def _act(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """The closer, and the dry friction of a door that sticks."""
        data.qfrc_applied[self._dof] = -self.door.closer
        if data.qpos[self._q] > LOOSE:
            model.dof_frictionloss[self._dof] = self.door.friction

    def _record(self) -> None:
        super()._record()
        # MuJoCo's sensor reads what the end effector does to the tip
        self._forces.append(-self.data.sensordata[:3])

    def step(self, command: BallCommand, steps: int = 1) -> None:
        super().step(command, steps)
        self._pressed = self._panel_force()

    def measure(self) -> BallMeasurement:
        """As of the robot, with the force of the same moment in the end effector's axes: what the world and the tip's weight do to
        the end effector, averaged over the last controller period of 2.5 ms."""
        if self._last is not None and self._last.time == self.time:
            return self._last
        message = super().measure()
        late = round(message.age / self.timestep)
        recent = list(self._forces)[: len(self._forces) - late][-5:]
        force = np.mean(recent, axis=0) + self._bias + self._sensor.noise * self._rng.normal(size=3)
        self._last = replace(message, force=force)
        return self._last

    # ------------------------------------------------------------------ what is true
    @property
    def angle(self) -> float:
        """How far the door is open [rad]."""
        return 0.0 if self._hinge is None else float(self.data.qpos[self._q])

    @property
    def rate(self) -> float:
        """How fast it opens [rad/s]."""
        return 0.0 if self._hinge is None else float(self.data.qvel[self._dof])

    @property
    def normal(self) -> Array:
        """Unit vector (3) normal to the panel, in the direction in which it opens."""
        heading = self.door.closed + self.door.opening * self.angle
        return self.door.opening * np.array([-np.sin(heading), np.cos(heading), 0.0])

    @property
    def penetration(self) -> float:
        """How far [m] the robot, its tip included, is in the panel at its deepest contact; contacts are soft."""
        contacts = self.data.contact
        touching = (contacts.geom == self._panel).any(axis=1) if self.data.ncon else np.zeros(0, bool)
        return float(max(-contacts.dist[touching].min(initial=0.0), 0.0)) if touching.any() else 0.0

    def contact_force(self) -> Array:
        """The force (3) [N] of the end effector on the panel in the last physics step, world axes; zero without contact."""
        return self._pressed.copy()

    def _panel_force(self) -> Array:
        """Of the step that MuJoCo has just done."""
        return contact_force(self.model, self.data, self._tip, self._panel)
