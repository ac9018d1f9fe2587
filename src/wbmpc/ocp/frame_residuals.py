"""Residuals of frames: pose, twist, wrench."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import casadi as ca

from wbmpc import lie
from wbmpc.bases.optional import HasContacts
from wbmpc.errors import InputError, unknown_name
from wbmpc.model.robot import RobotModel
from wbmpc.ocp.symbols import Symbols

_CHOICES = {"orientation": ("log", "vector"), "axes": ("world", "reference")}


@dataclass(frozen=True)
class FramePose:
    """Pose error of a frame: position (3) [m] in world axes; orientation (3) [rad] in world or the reference's ``axes``.

    Reference: position (3) and quaternion (4). ``orientation``: "log" (default), twice the vector part of the error
    quaternion for "vector" (Minniti et al. 2019, section IV-B), which is flat at 180 degrees.
    """

    robot: RobotModel
    frame: str
    orientation: Literal["log", "vector"] = "log"
    axes: Literal["world", "reference"] = "world"

    size = 6
    reference = 7
    #: a pose has to be set: numbers of zero are none
    reference_required = True
    groups = {"position": slice(0, 3), "orientation": slice(3, 6)}  # noqa: RUF012

    def __post_init__(self) -> None:
        if self.frame not in self.robot.frames:
            raise unknown_name("frame", self.frame, self.robot.frames, where=self.robot.description.name)
        for key, choices in _CHOICES.items():
            if getattr(self, key) not in choices:
                raise unknown_name(key, getattr(self, key), choices, where=f"pose of '{self.frame}'")

    def __call__(self, s: Symbols) -> ca.SX:
        pose = self.robot.frame_pose(s.x, self.frame)
        target = lie.quaternion_conjugate(s.reference[3:7])
        pair = (pose.quaternion, target) if self.axes == "world" else (target, pose.quaternion)
        error = lie.quaternion_multiply(*pair)
        rotation = lie.quaternion_log(error) if self.orientation == "log" else 2.0 * lie.quaternion_error_vector(error)
        return ca.vertcat(pose.position - s.reference[0:3], rotation)


@dataclass(frozen=True)
class FrameTwist:
    """Linear (3) [m/s] and angular (3) [rad/s] velocity of a frame, world axes, minus their reference."""

    robot: RobotModel
    frame: str

    size = 6
    reference = 6
    groups = {"linear": slice(0, 3), "angular": slice(3, 6)}  # noqa: RUF012

    def __post_init__(self) -> None:
        if self.frame not in self.robot.frames:
            raise unknown_name("frame", self.frame, self.robot.frames, where=self.robot.description.name)

    def __call__(self, s: Symbols) -> ca.SX:
        linear, angular = self.robot.frame_velocity(s.x, s.u, self.frame)
        return ca.vertcat(linear, angular) - s.reference


@dataclass(frozen=True)
class RelativePose:
    """Pose of the frame ``other`` in the axes of ``frame``, against its reference: position (3) [m], orientation (3) [rad].

    Reference: position (3) and quaternion (4). As a cost: two end effectors hold one object. Raises :class:`InputError` for unknown or
    equal frames.
    """

    robot: RobotModel
    frame: str
    other: str

    size = 6
    reference = 7
    #: a pose has to be set: numbers of zero are none
    reference_required = True
    groups = {"position": slice(0, 3), "orientation": slice(3, 6)}  # noqa: RUF012

    def __post_init__(self) -> None:
        for name in (self.frame, self.other):
            if name not in self.robot.frames:
                raise unknown_name("frame", name, self.robot.frames, where=self.robot.description.name)
        if self.frame == self.other:
            raise InputError(f"relative pose: two frames are needed, got '{self.frame}' twice")

    def __call__(self, s: Symbols) -> ca.SX:
        one, other = (self.robot.frame_pose(s.x, name) for name in (self.frame, self.other))
        position = one.rotation.T @ (other.position - one.position)
        turned = lie.quaternion_multiply(lie.quaternion_conjugate(one.quaternion), other.quaternion)
        error = lie.quaternion_multiply(turned, lie.quaternion_conjugate(s.reference[3:7]))
        return ca.vertcat(position - s.reference[:3], lie.quaternion_log(error))


@dataclass(frozen=True)
class RelativeMotion(RelativePose):
    """Rate of change of the relative pose (:class:`RelativePose`), plus ``rate`` [1/s] times its error: linear (3) [m/s], angular (3)
    [rad/s].

    As an equality constraint the two frames stay as the reference has them, and an error decays by ``rate``. Its rows are of inputs,
    unlike those of :class:`RelativePose`, which no input changes at once.
    """

    rate: float = 5.0

    def __call__(self, s: Symbols) -> ca.SX:
        one, other = (self.robot.frame_pose(s.x, name) for name in (self.frame, self.other))
        (v, w), (v_other, w_other) = (self.robot.frame_velocity(s.x, s.u, name) for name in (self.frame, self.other))
        linear = v_other - v - ca.cross(w, other.position - one.position)
        change = ca.vertcat(one.rotation.T @ linear, one.rotation.T @ (w_other - w))
        return change + self.rate * super().__call__(s)


@dataclass(frozen=True)
class FrameWrench:
    """External wrench on the robot at a frame, world axes, minus its reference: force (3) [N] and, for a robot loaded
    with ``contact="wrench"``, moment (3) [N m] about the frame's origin.

    The frame is one of the robot's contact frames. ``groups``: "force" and "moment" as far as there are.

    Raises :class:`InputError` for another one, and for robots without.
    """

    robot: RobotModel
    frame: str
    groups: Mapping[str, slice] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        contacts, name = _contacts(self.robot), self.robot.description.name
        if not contacts:
            raise InputError(
                f"{name}: there is no contact at '{self.frame}'; a robot with torques as inputs has one when it is loaded "
                "with contact='force' or contact='wrench' (and contact_frame=...); on one whose inputs are speeds it has "
                "no effect"
            )
        if self.frame not in contacts:
            raise unknown_name("contact frame", self.frame, contacts, where=name)
        kinds = contacts[self.frame]
        object.__setattr__(self, "groups", {kind: slice(3 * k, 3 * k + 3) for k, kind in enumerate(kinds)})

    @property
    def size(self) -> int:
        """How many rows."""
        return 3 * len(self.groups)

    @property
    def reference(self) -> int:
        """How many numbers it is compared with."""
        return self.size

    def __call__(self, s: Symbols) -> ca.SX:
        groups = _contacts(self.robot)[self.frame].values()
        return ca.vertcat(*[s.u[self.robot.input[g]] for g in groups]) - s.reference


def _contacts(robot: RobotModel) -> Mapping[str, Mapping[str, str]]:
    """Groups of the input by kind, by contact frame; empty without contacts."""
    return robot.base.contacts if isinstance(robot.base, HasContacts) else {}
