"""Residuals of ball robots, and of hands that push doors and walls (:mod:`wbmpc.ocp.residuals` has them all)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from wbmpc.bases.ball.balance import load_offset
from wbmpc.checks import finite
from wbmpc.errors import InputError, unknown_name
from wbmpc.model.robot import RobotModel
from wbmpc.ocp.symbols import Symbols


@dataclass(frozen=True)
class BallSpin:
    """Torque (1) [N m] of the wheels on a ball about the base's z axis: more than the floor's spin friction spins the ball."""

    robot: RobotModel

    size, reference = 1, 0
    groups = {"torque": slice(0, 1)}  # noqa: RUF012

    def __call__(self, s: Symbols) -> ca.SX:
        return ca.DM(self.robot.base.wheel_torque_map()[2:]) @ s.u[self.robot.input["wheel"]]


@dataclass(frozen=True)
class CapturePoint:
    """Divergent component [m] of a ball robot's lean along ``directions`` that divide half a turn evenly, the first along x:
    horizontal offset of the load's centre of mass from the ball plus its rate over ``pole`` [1/s]
    (:class:`wbmpc.model.Balance`). What it has beyond the wheels' reach cannot be stopped.

    In a box this is a polygon around a circle. Four directions: by at most 8 % too wide; two (a square) would be by 41 %, and
    pushes along its diagonals then fell the robot at less than half the impulse.

    ``answer`` [m/N] (:class:`wbmpc.model.Balance`), if not zero: the reference is the horizontal force (2) [N] of the world on
    the hand that is expected, and the component is counted from the lean that answers it. ``pushed``: the parameters ``push``
    are added, so that a limit leaves room for what a push will do that the plan does not know.
    """

    robot: RobotModel
    pole: float
    directions: int = 4
    answer: float = 0.0
    pushed: bool = False

    def __post_init__(self) -> None:
        finite("capture point", pole=self.pole, answer=self.answer)
        if self.pole <= 0.0:
            raise InputError(f"capture point: pole must be positive, got {self.pole}")
        if not isinstance(self.directions, int | np.integer) or self.directions < 1:
            raise InputError(f"capture point: directions must be a whole number, at least 1, got {self.directions}")

    @property
    def reference(self) -> int:
        return 2 if self.answer else 0

    @property
    def size(self) -> int:
        return self.directions

    @property
    def groups(self) -> dict[str, slice]:
        return {"offset": slice(0, self.directions)}

    def __call__(self, s: Symbols) -> ca.SX:
        n = self.robot.base.nq
        offset = load_offset(self.robot.base, s.x[:n], s.parameters)
        slope = ca.jacobian(offset, s.x[:n])
        angles = np.pi * np.arange(self.directions) / self.directions
        along = np.round([np.cos(angles), np.sin(angles)], 15).T  # exact zeros
        component = offset + slope @ s.x[n : 2 * n] / self.pole
        if self.answer:
            component += self.answer * s.reference[:2]
        if self.pushed:
            component += s.parameters[self.robot.parameters["push"]]
        return ca.DM(along) @ component


@dataclass(frozen=True)
class JointEffort:
    """What drives a ball robot's arm joints (n) [N m]: torques beyond those that hold the arm at rest in its present pose,
    contacts, payload and estimated disturbance included. Zero in every equilibrium, so that its cost moves none."""

    robot: RobotModel
    groups: Mapping[str, slice] = field(init=False, repr=False)

    reference = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "groups", {"arm": slice(0, self.size)})

    @property
    def size(self) -> int:
        return len(self.robot.state.groups["arm"])

    def __call__(self, s: Symbols) -> ca.SX:
        base, n = self.robot.base, self.robot.base.nq
        rest, w = ca.SX(n, 1), s.parameters
        net = base.generalised_force(s.x[:n], s.u, w) - base.inverse_dynamics(s.x[:n], rest, rest, w)
        return net[n - self.size :]


@dataclass(frozen=True)
class PanelContact:
    """Hand and door move together: the hand stays at its place on the panel, by rows of acceleration (Baumgarte 1972).

    ``normal``: g̈ + 2 ``rate`` ġ + ``rate``² g for the distance g [m] from the panel, with g̈ = tᵀ(J q̈ + J̇ q̇) − ℓ φ̈ + … and φ̈ from
    the door's own equation: the row that Minniti et al. 2019, section V-A, leave out. ``stick``: s̈ + 2 ``rate`` ṡ for the
    place along the panel and the height: a hand inside its friction cone does not slide. ``dynamics``: a
    :class:`wbmpc.studies.minniti2019.door_model.WithDoor`; ``rate`` [1/s].
    """

    dynamics: Any
    rate: float = 10.0

    size, reference = 3, 0
    groups = {"normal": slice(0, 1), "stick": slice(1, 3)}  # noqa: RUF012

    def __post_init__(self) -> None:
        finite("panel contact", rate=self.rate)
        if self.rate < 0.0:
            raise InputError(f"panel contact: rate must not be negative, got {self.rate}")

    def __call__(self, s: Symbols) -> ca.SX:
        place, speed, acceleration = self.dynamics.contact_motion(s.all_x, s.all_u, s.parameters, s.mode)
        pull = ca.vertcat(self.rate**2 * place[0], 0.0, 0.0)
        return acceleration + 2.0 * self.rate * speed + pull


@dataclass(frozen=True)
class PushForce:
    """The robot's push on a surface in its axes, minus what is wanted: along the normal, across (level), up [N].

    Reference: the unit normal (3) of an upright surface, into it, and the wanted force [N] along it. ``group``: the input that
    is the force of the world on the robot, world axes.
    """

    robot: RobotModel
    group: str = "force"

    size, reference = 3, 4
    groups = {"push": slice(0, 1), "across": slice(1, 2), "up": slice(2, 3)}  # noqa: RUF012

    def __post_init__(self) -> None:
        if self.group not in self.robot.input:
            raise unknown_name("input group", self.group, self.robot.input.groups, where=self.robot.description.name)

    def __call__(self, s: Symbols) -> ca.SX:
        push = push_on_surface(-s.u[self.robot.input[self.group]], s.reference[0:3])
        return push - ca.vertcat(s.reference[3], 0.0, 0.0)


def push_on_surface(force: ca.SX, normal: ca.SX) -> ca.SX:
    """A force (3) [N] in the axes of an upright surface: along its unit normal (3), across, up."""
    return ca.vertcat(ca.dot(normal, force), normal[0] * force[1] - normal[1] * force[0], force[2])


@dataclass(frozen=True)
class FrictionCone:
    """A hand that can only push, and not slide: rows [N] that are to be at least zero.

    Reference: the unit normal n (3) of an upright surface, into it. With the robot's push F = −(force of the world on it):
    ``push``: nᵀF − ``least``; ``cone``: a pyramid inside the cone, μ nᵀF/√2 ± F along two tangents (μ = ``friction``).
    """

    robot: RobotModel
    friction: float
    least: float = 0.0
    group: str = "force"

    size, reference = 5, 3
    groups = {"push": slice(0, 1), "cone": slice(1, 5)}  # noqa: RUF012

    def __post_init__(self) -> None:
        if self.group not in self.robot.input:
            raise unknown_name("input group", self.group, self.robot.input.groups, where=self.robot.description.name)
        finite("friction cone", friction=self.friction, least=self.least)
        if not self.friction > 0.0:
            raise InputError(f"friction cone: friction must be positive, got {self.friction}")

    def __call__(self, s: Symbols) -> ca.SX:
        push, side, rise = ca.vertsplit(push_on_surface(-s.u[self.robot.input[self.group]], s.reference))
        most = self.friction / np.sqrt(2.0) * push
        return ca.vertcat(push - self.least, most - side, most + side, most - rise, most + rise)
