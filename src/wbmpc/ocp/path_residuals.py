"""Residuals of a path whose progress is a state: what is off the path, how fast it is followed, where it ends.

They see the path near the predicted progress alone, as an expansion that an MPC renews before every solve: another path is other
parameters, and nothing is compiled again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Protocol

import casadi as ca

from wbmpc import lie
from wbmpc.errors import InputError, unknown_name
from wbmpc.ocp.path import WIDTH
from wbmpc.ocp.symbols import Symbols


class Posed(Protocol):
    """What a contour asks of a :class:`wbmpc.RobotModel`."""

    @property
    def frames(self) -> Any: ...
    def frame_pose(self, x: ca.SX, frame: str) -> Any: ...


def _path_state(dynamics: Any) -> slice:
    """Position and speed of the path in the state of a problem."""
    if "path" not in dynamics.state or "path" not in dynamics.input:
        raise InputError("path: the problem's model has no progress; valid: one of wbmpc.WithPath(dynamics)")
    found: slice = dynamics.state["path"]
    return found


@dataclass(frozen=True)
class Contour:
    """Error of a frame from the point of the path at the progress s of ``dynamics`` (:class:`wbmpc.WithPath`).

    ``contour`` (3) [m]: across the path, world axes; ``lag`` (1) [m]: along it, negative behind; ``orientation`` (3) [rad]: world
    ``axes``, or those of the path's. ``frame``: of the end effector, of the base's body, any. Reference: an expansion of the path
    (:meth:`wbmpc.Path.expansion`), set by :meth:`wbmpc.mpc.path.PathProgress.follow`. Errors and first derivatives are exact where it is
    made. Raises :class:`InputError` for another frame, and dynamics without a path.
    """

    dynamics: Any
    robot: Posed
    frame: str
    axes: Literal["world", "reference"] = "world"

    size = 7
    reference = WIDTH
    follows: ClassVar[Literal["pose"]] = "pose"
    #: a path has to be set: numbers of zero are none
    reference_required = True
    groups = {"contour": slice(0, 3), "lag": slice(3, 4), "orientation": slice(4, 7)}  # noqa: RUF012

    def __post_init__(self) -> None:
        _path_state(self.dynamics)
        if self.frame not in self.robot.frames:
            raise unknown_name("frame", self.frame, self.robot.frames, where="contour")
        if self.axes not in ("world", "reference"):
            raise unknown_name("axes", self.axes, ("world", "reference"), where=f"contour of '{self.frame}'")

    def __call__(self, s: Symbols) -> ca.SX:
        r, pose = s.reference, self.robot.frame_pose(s.x, self.frame)
        # beyond the ends of the path there are its ends
        ahead = ca.fmin(ca.fmax(s.all_x[_path_state(self.dynamics).start], r[17]), r[18]) - r[0]
        tangent = r[4:7] + ahead * r[7:10]
        error = pose.position - r[1:4] - ahead * (r[4:7] + 0.5 * ahead * r[7:10])
        lag = ca.dot(tangent, error)
        back = lie.quaternion_conjugate(r[10:14])
        turned = ahead * r[14:17]
        if self.axes == "world":
            rotation = lie.quaternion_log(lie.quaternion_multiply(pose.quaternion, back)) - turned
        else:
            rotation = lie.quaternion_log(lie.quaternion_multiply(back, pose.quaternion))
            rotation -= lie.quaternion_to_rotation(r[10:14]).T @ turned
        return ca.vertcat(error - tangent * lag, lag, rotation)


@dataclass(frozen=True)
class Progress:
    """Speed along the path minus the desired one [m/s], (1). Reference: progress s [m], the desired speed [m/s] there and how it changes
    with s [1/s]; set by :meth:`wbmpc.mpc.path.PathProgress.follow`, which ends with the path."""

    dynamics: Any

    size = 1
    reference = 3
    follows: ClassVar[Literal["speed"]] = "speed"
    groups = {"speed": slice(0, 1)}  # noqa: RUF012

    def __post_init__(self) -> None:
        _path_state(self.dynamics)

    def __call__(self, s: Symbols) -> ca.SX:
        path = s.all_x[_path_state(self.dynamics)]
        return ca.vertcat(path[1] - s.reference[1] - s.reference[2] * (path[0] - s.reference[0]))


@dataclass(frozen=True)
class PathAcceleration:
    """How far the acceleration along the path [m/s²] is from its bounds, (2), to be at least zero. Reference: the largest one."""

    dynamics: Any

    size = 2
    reference = 1
    follows: ClassVar[Literal["acceleration"]] = "acceleration"

    def __post_init__(self) -> None:
        _path_state(self.dynamics)

    @property
    def groups(self) -> Mapping[str, slice]:
        """Below the upper and above the lower bound."""
        return {"upper": slice(0, 1), "lower": slice(1, 2)}

    def __call__(self, s: Symbols) -> ca.SX:
        acceleration = s.all_u[self.dynamics.input["path"]]
        return ca.vertcat(s.reference[0] - acceleration, s.reference[0] + acceleration)
