"""A door as part of the system that is planned: its states, its impedance, and where the end effector touches it.

Minniti et al. 2019 plan the wrench at the end effector as a free input and leave the door's motion out (their section V-A): the
optimizer may give the environment any impedance. Here the door's angle φ and rate are states, I φ̈ + d φ̇ + c = −ℓ nᵀF for the force
F of the world on the end effector, and the end effector's distance from the panel is a function of robot and door whose second derivative a
state-input equality keeps at zero (:class:`wbmpc.studies.minniti2019.door_residuals.PanelContact`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.errors import InputError
from wbmpc.model.layout import Layout
from wbmpc.model.numeric import Numeric
from wbmpc.model.robot import RobotModel

#: Dry friction and closer act fully above this rate [rad/s]; below, they fade, so that a door at rest stays there. Light doors
#: fade over a wider range: no faster than with :data:`FADE_TIME` [s], which the plan's time steps can follow.
SMOOTH_RATE, FADE_TIME = 0.05, 0.03
#: A door that is held comes to rest with this time constant [s].
STOP_TIME = 0.05
IMPEDANCE = ("inertia", "damping", "resistance")


@dataclass(frozen=True)
class DoorGeometry:
    """Where a door is believed to be: ``hinge`` (2) [m]; ``closed`` [rad]: heading of the closed panel from the hinge;
    ``opening``: +1 counter-clockwise, −1 clockwise; ``offset`` [m] of the end effector's center from the panel's middle plane when it
    touches."""

    hinge: tuple[float, float]
    closed: float
    opening: float
    offset: float

    def directions(self, angle: float) -> tuple[Array, Array]:
        """Unit vectors (3) along the panel, away from the hinge, and normal to it, the way it opens."""
        heading = self.closed + self.opening * angle
        along = np.array([np.cos(heading), np.sin(heading), 0.0])
        return along, self.opening * np.array([-along[1], along[0], 0.0])

    def moved(self, distance: float) -> DoorGeometry:
        """The same door, ``distance`` [m] farther in the direction in which it opens when closed."""
        x, y = np.array(self.hinge) + distance * self.directions(0.0)[1][:2]
        return replace(self, hinge=(float(x), float(y)))

    def lever(self, end_effector: ArrayLike, angle: float) -> float:
        """Distance [m] of the end effector (3) [m] from the hinge along the panel."""
        return float(self.directions(angle)[0][:2] @ (np.asarray(end_effector)[:2] - self.hinge))

    def gap(self, end_effector: ArrayLike, angle: float) -> float:
        """How far [m] the end effector (3) is beyond the surface of the panel; negative before it touches."""
        return float(self.directions(angle)[1][:2] @ (np.asarray(end_effector)[:2] - self.hinge)) + self.offset

    def touches(self, end_effector: ArrayLike) -> bool:
        """Whether an end effector (3) [m] that touches something can touch the panel: it is not at the hinge."""
        return bool(np.hypot(*(np.asarray(end_effector)[:2] - self.hinge)) > self.offset)

    def angle(self, end_effector: ArrayLike) -> float:
        """The angle [rad] of a panel that the end effector (3) [m] touches."""
        out = np.asarray(end_effector)[:2] - self.hinge
        radius = float(np.hypot(*out))
        if radius <= self.offset:
            raise InputError(f"door: an end effector {radius:g} m from the hinge cannot touch the panel")
        turn = self.opening * (np.arctan2(out[1], out[0]) - self.closed)
        return float(np.remainder(turn + np.pi, 2.0 * np.pi) - np.pi + np.arcsin(self.offset / radius))

    def rate(self, end_effector: ArrayLike, velocity: ArrayLike, angle: float) -> float:
        """The rate [rad/s] of a panel that the end effector (3) [m], moving at ``velocity`` (3) [m/s], keeps touching."""
        return float(self.directions(angle)[1] @ np.asarray(velocity, float)) / self.lever(end_effector, angle)

    def sliding(self, motion: tuple[Array, Array, Array], angle: float, rate: float, half: float) -> Array:
        """How fast (2) [m/s] the tip slides along the panel, away from the hinge and up, where they touch: end effector with its ``motion``
        (:func:`end_effector_motion`), panel at an ``angle`` [rad] with ``rate`` [rad/s], of ``half`` its thickness [m]. A tip that rolls does
        not slide."""
        (along, normal), (place, velocity, turn) = self.directions(angle), motion
        point = self.lever(place, angle) * along - half * normal
        panel = np.cross([0.0, 0.0, self.opening * rate], point)
        slides = velocity + np.cross(turn, (self.offset - half) * normal) - panel
        return np.array([along @ slides, slides[2]])

    def place(self, angle: float, lever: float, height: float) -> Array:
        """Where the end effector (3) [m] is that touches the panel at ``lever`` [m] from the hinge."""
        along, normal = self.directions(angle)
        return np.array([*self.hinge, height]) + lever * along - self.offset * normal


class WithDoor:
    """A robot whose end effector may push a door: states ``door.angle``, ``door.rate``; the end effector's force must be an input.

    Parameters ``place`` (hinge x, y, closed heading, offset) and ``impedance`` (inertia about the hinge [kg m²], damping
    [N m s/rad], resistance [N m]: closer and dry friction of a door that opens). Mode value ``door.moves``: 1, or 0 for a door
    that is held (locked, sticking). ``opening`` ±1: which way it turns.
    """

    def __init__(self, robot: RobotModel, opening: float = 1.0) -> None:
        if "force" not in robot.input:
            raise InputError(
                f"{robot.description.name}: a door needs the end effector's force as an input (contact='force')"
            )
        inner = robot.dynamics()
        self.robot, self.inner, self.opening = robot, inner, opening
        door, units = ("angle", "rate"), ("rad", "rad/s")
        self.state = Layout({**inner.state.groups, "door": door}, {**inner.state.unit_groups, "door": units})
        self.input = inner.input
        place = ("hinge_x", "hinge_y", "closed", "offset")
        self.parameters = Layout({**inner.parameters.groups, "place": place, "impedance": IMPEDANCE})
        self.mode = Layout({**inner.mode.groups, "door": ("moves",)})
        self.mode_bounds = {**inner.mode_bounds, "door": (0.0, 1.0)}
        self.unit_quaternions = inner.unit_quaternions

    def view(self, x: ca.SX, u: ca.SX) -> tuple[ca.SX, ca.SX]:
        """The robot's own state and input."""
        return x[: self.inner.state.size], u

    # ------------------------------------------------------------------ geometry
    def _directions(self, x: ca.SX, w: ca.SX) -> tuple[ca.SX, ca.SX]:
        heading = w[self.parameters["place"]][2] + self.opening * x[self.state["door"]][0]
        along = ca.vertcat(ca.cos(heading), ca.sin(heading))
        return along, self.opening * ca.vertcat(-along[1], along[0])

    def _from_hinge(self, x: ca.SX, w: ca.SX) -> ca.SX:
        own = x[: self.inner.state.size]
        return self.robot.frame_pose(own, self.robot.tool).position[0:2] - w[self.parameters["place"]][0:2]

    def part(self, x: ca.SX, frame: str, height: float) -> ca.SX:
        """Where (3) [m] a point of a frame of the robot is, ``height`` [m] above the frame's origin along its z axis."""
        pose = self.robot.frame_pose(x[: self.inner.state.size], frame)
        return pose.position + height * pose.rotation[:, 2]

    def beyond(self, x: ca.SX, w: ca.SX, point: ca.SX) -> ca.SX:
        """How far [m] a ``point`` (3) [m] is beyond the panel's middle plane, in the direction in which it opens."""
        return ca.dot(self._directions(x, w)[1], point[0:2] - w[self.parameters["place"]][0:2])

    def gap(self, x: ca.SX, w: ca.SX) -> ca.SX:
        """How far [m] the end effector is beyond the panel's surface."""
        return ca.dot(self._directions(x, w)[1], self._from_hinge(x, w)) + w[self.parameters["place"]][3]

    def lever(self, x: ca.SX, w: ca.SX) -> ca.SX:
        """Distance [m] of the end effector from the hinge along the panel."""
        return ca.dot(self._directions(x, w)[0], self._from_hinge(x, w))

    # ------------------------------------------------------------------ dynamics
    def _door(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        """(φ̇, φ̈)."""
        rate, moves = x[self.state["door"]][1], m[self.mode["door"]]
        inertia, damping, resistance = ca.vertsplit(w[self.parameters["impedance"]])
        push = -ca.dot(self._directions(x, w)[1], u[self.input["force"]][0:2])
        slow = ca.fmax(SMOOTH_RATE, FADE_TIME * resistance / inertia)
        torque = self.lever(x, w) * push - damping * rate - resistance * ca.tanh(rate / slow)
        return ca.vertcat(rate, moves * torque / inertia - (1.0 - moves) * rate / STOP_TIME)

    def _inner(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        return x[: self.inner.state.size], u, w[: self.inner.parameters.size], m[: self.inner.mode.size]

    def __call__(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        """ẋ of robot and door."""
        return ca.vertcat(self.inner(*self._inner(x, u, w, m)), self._door(x, u, w, m))

    def jacobian(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> tuple[ca.SX, ca.SX]:
        """ẋ and its Jacobian by [x; u]."""
        f, own = self.inner.jacobian(*self._inner(x, u, w, m))
        n, door = self.inner.state.size, self._door(x, u, w, m)
        wide = ca.horzcat(own[:, :n], ca.SX(n, 2), own[:, n:])
        return ca.vertcat(f, door), ca.vertcat(wide, ca.jacobian(door, ca.vertcat(x, u)))

    def contact(self, x: ca.SX, w: ca.SX) -> ca.SX:
        """Where the end effector is on the panel (3) [m]: beyond its surface, along it from the hinge, height."""
        own = x[: self.inner.state.size]
        height = self.robot.frame_pose(own, self.robot.tool).position[2]
        return ca.vertcat(self.gap(x, w), self.lever(x, w), height)

    def contact_motion(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """That place (3) and its first two derivatives by time along a motion of robot and door."""
        f, place = self(x, u, w, m), self.contact(x, w)
        speed = ca.jtimes(place, x, f)
        return place, speed, ca.jtimes(speed, x, f)


def place_of(door: DoorGeometry) -> Array:
    """The parameters ``place`` of a believed door."""
    return np.array([*door.hinge, door.closed, door.offset])


def end_effector_motion(robot: RobotModel) -> Callable[[Array], tuple[Array, Array, Array]]:
    """Position (3) [m], velocity (3) [m/s] and angular velocity (3) [rad/s] of the end effector at a state (nx) of the robot."""
    x, u = ca.SX.sym("x", robot.state.size), ca.SX(robot.input.size, 1)
    place, (velocity, turn) = robot.frame_pose(x, robot.tool).position, robot.frame_velocity(x, u, robot.tool)
    function = Numeric(ca.Function("hand", [x], [place, velocity, turn]))

    def motion(state: Array) -> tuple[Array, Array, Array]:
        p, v, w = function(state)
        return p.ravel(), v.ravel(), w.ravel()

    return motion


def arm_jacobian(robot: RobotModel) -> Callable[[Array], Array]:
    """How the end effector's position (3) [m] changes with the arm's joints (3, m) [m/rad] at a state (nx) of the robot."""
    x = ca.SX.sym("x", robot.state.size)
    place = robot.frame_pose(x, robot.tool).position
    function = Numeric(ca.Function("arm_jacobian", [x], [ca.jacobian(place, x)[:, robot.state["arm"]]]))
    return lambda state: function(state)[0]
