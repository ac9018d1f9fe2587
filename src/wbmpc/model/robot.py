"""The robot model: layouts, home, limits, kinematics and dynamics of one described robot."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.bases import base_type
from wbmpc.bases.base import Base
from wbmpc.bases.optional import HasJacobian, HasUnits
from wbmpc.checks import real_numbers
from wbmpc.errors import InputError, unknown_name
from wbmpc.interrupts import Interruptible
from wbmpc.model.joints import Limits
from wbmpc.model.kinematics import FramePose
from wbmpc.model.layout import Layout
from wbmpc.model.numeric import Numeric
from wbmpc.robots import RobotDescription, load_description, load_spec

#: Numbers of a pose in the plane.
POSE_SIZE = 3


def layouts(base: Base) -> tuple[Layout, Layout]:
    """Names of state and input of a base, and their units where it says them."""
    if isinstance(base, HasUnits):
        return Layout(base.state, base.state_units), Layout(base.input, base.input_units)
    return Layout(base.state), Layout(base.input)


class Dynamics:
    """ẋ = f(x, u; w, m): state, input, parameters that hold over the horizon, and mode values per node. ``base``: the model behind it."""

    def __init__(self, base: Base) -> None:
        self.base = base
        self.state, self.input = layouts(base)
        self.parameters, self.mode = Layout(base.parameters), Layout(base.mode)
        self.unit_quaternions: tuple[int, ...] = base.unit_quaternions
        #: Lowest and highest value of a group of mode values; any number where there is none.
        self.mode_bounds: dict[str, tuple[float, float]] = base.mode_bounds

    def view(self, x: ca.SX, u: ca.SX) -> tuple[ca.SX, ca.SX]:
        """The robot's own state and input; wrappers that add states override this."""
        return x, u

    def __call__(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        """ẋ (nx)."""
        return self.base.derivative(x, u, w, m)

    def jacobian(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> tuple[ca.SX, ca.SX]:
        """ẋ and its Jacobian (nx, nx + nu) by [x; u]."""
        if isinstance(self.base, HasJacobian):
            return self.base.jacobian(x, u, w, m)
        f = self(x, u, w, m)
        return f, ca.jacobian(f, ca.vertcat(x, u))


class RobotModel:
    """Symbolic functions (CasADi SX) of a robot that a file describes, with named layouts.

    ``description``: the robot's file; ``base``: the symbolic side of its base type; ``tree``: its links; layouts of ``state`` (nx), ``input``
    (nu), ``parameters`` (np) that hold over a horizon, and ``mode`` values (nm): slices by group. Joints in rad or m, speeds in rad/s or m/s.
    """

    def __init__(self, description: RobotDescription) -> None:
        self.description = description
        self.base: Base = base_type(description.base.type).model(description, load_spec(description))
        self.tree = self.base.tree
        self.state, self.input = layouts(self.base)
        self.parameters, self.mode = Layout(self.base.parameters), Layout(self.base.mode)
        self._check_base()
        self._check_home()

    def __repr__(self) -> str:
        d = self.description
        return f"RobotModel({d.name}: {d.base.type} base, {self.state.size} states, {self.input.size} inputs, tool {self.tool})"

    def _repr_html_(self) -> str:
        from wbmpc.plots.notebook import html_table

        limits, rows = self.limits, []
        for kind, layout, low, high in (
            ("state", self.state, limits.state_lower, limits.state_upper), ("input", self.input, limits.input_lower, limits.input_upper),
        ):  # fmt: skip
            for name, unit, a, b in zip(layout.names, layout.units, low, high, strict=True):
                rows.append([kind, name, unit, f"{a:g} to {b:g}" if np.isfinite([a, b]).any() else ""])
        return html_table(repr(self), ["", "name", "unit", "limits"], rows)

    def _check_base(self) -> None:
        """Runs, views and recordings read a pose from the state group "base"."""
        size = len(self.state.groups.get("base", ()))
        if 0 < size < POSE_SIZE:
            raise InputError(
                f"base type '{self.description.base.type}': its state group 'base' has {size} numbers; valid: a pose (x, y, yaw, or "
                "position and quaternion), or another name for coordinates that are none"
            )

    def _sized(self, what: str, values: Array, layout: Layout, names: str) -> Array:
        """``values`` of the base, which have a number for each name of a ``layout``."""
        if np.shape(values) != (layout.size,):
            raise InputError(
                f"base type '{self.description.base.type}': '{what}' has the shape {np.shape(values)}; "
                f"valid: ({layout.size},), a number for each name of '{names}'"
            )
        return values

    def _check_home(self) -> None:
        for group, names in self.state.groups.items():
            for i, name in enumerate(names, start=self.state[group].start):
                value = self.description.home.get(name, 0.0)
                low, high = self.limits.state_lower[i], self.limits.state_upper[i]
                if name in self.description.joints() and not low <= value <= high:
                    raise InputError(
                        f"{self.description.source}: key 'home.{name}': {value:g} is outside its limits {low:g} to {high:g}"
                    )

    # ------------------------------------------------------------------ data
    @property
    def frames(self) -> tuple[str, ...]:
        """Names of all frames: bodies and sites."""
        return tuple(self.tree.frames)

    @property
    def tool(self) -> str:
        """Name of the end effector's frame."""
        return self.description.arm.tool

    @property
    def tools(self) -> dict[str, str]:
        """Frames of all end effectors by arm; :attr:`tool` is the first."""
        return self.description.tools()

    @cached_property
    def home(self) -> Array:
        """State (nx) with the joints of the description's home."""
        return self._sized("home", self.base.home(self), self.state, "state")

    @cached_property
    def limits(self) -> Limits:
        """Bounds of state and input."""
        limits = self.base.limits(self.description)
        for name in ("state_lower", "state_upper"):
            self._sized(f"limits.{name}", getattr(limits, name), self.state, "state")
        for name in ("input_lower", "input_upper", "input_rate", "actuator_upper"):
            self._sized(f"limits.{name}", getattr(limits, name), self.input, "input")
        return limits

    @cached_property
    def inertial_unit(self) -> Array:
        """Position (3) [m] of the inertial unit, the frame "imu", in axes of the base; its origin where no such frame is fixed to it."""
        place = self.tree.place_on(self.description.base.body, "imu")
        return np.zeros(3) if place is None else place[0]

    def dynamics(self) -> Dynamics:
        """The equations of motion, for an optimal control problem."""
        return Dynamics(self.base)

    # ------------------------------------------------------------------ symbolic
    def _frame(self, name: str) -> Any:
        if name not in self.tree.frames:
            raise unknown_name("frame", name, self.tree.frames, where=self.description.name)
        return self.tree.frames[name]

    def frame_pose(self, x: ca.SX, frame: str) -> FramePose:
        """Pose of a frame in the world. The world's origin is ``-base.ground`` [m] above the floor."""
        return self.base.chain(x).frame_pose(self._frame(frame))  # type: ignore[no-any-return]

    def frame_velocity(self, x: ca.SX, u: ca.SX, frame: str) -> tuple[ca.SX, ca.SX]:
        """Linear [m/s] and angular [rad/s] velocity (3 each) of a frame, world axes."""
        rates, linear, angular = self.base.velocities(x, u)
        return self.base.chain(x).frame_velocity(self._frame(frame), rates, linear, angular)  # type: ignore[no-any-return]

    # ------------------------------------------------------------------ numeric
    @cached_property
    def _functions(self) -> dict[str, ca.Function]:
        return {}

    @cached_property
    def _numeric(self) -> dict[str, Numeric]:
        return {}

    def pose(self, x: ArrayLike, frame: str | None = None) -> tuple[Array, Array]:
        """Position (3) [m] and quaternion (4) of a frame (the tool when left out) at a numeric state x (nx)."""
        frame = frame or self.tool
        if frame not in self._numeric:
            with Interruptible():
                self._numeric[frame] = Numeric(self._pose_of(frame))
        p, q = self._numeric[frame](real_numbers("state", x))
        return p.ravel(), q.ravel()

    def _pose_of(self, frame: str | None) -> ca.Function:
        """Position and quaternion of a frame (the tool: None) by the state."""
        frame = frame or self.tool
        if frame not in self._functions:
            s = ca.SX.sym("x", self.state.size)
            pose = self.frame_pose(s, frame)
            self._functions[frame] = ca.Function("pose", [s], [pose.position, pose.quaternion])
        return self._functions[frame]

    def poses(self, states: ArrayLike, frame: str | None = None) -> Array:
        """Poses (n, 7) of a frame (the tool when left out) at states (n, nx): position and quaternion."""
        states = np.atleast_2d(real_numbers("states", states))
        with Interruptible():
            p, q = self._pose_of(frame)(states.T)
        return np.vstack([np.array(p), np.array(q)]).T


def load_robot(name_or_path: str | Path, **base: Any) -> RobotModel:
    """A built-in robot by name, or one's own YAML (``name_or_path``). ``base`` replaces keys of the base section.

    ``load_robot("my_robot.yaml", contact="wrench", contact_frame="tool")``: the wrench of the world at that frame is an input.
    Raises :class:`InputError` naming file and key.
    """
    return RobotModel(load_description(name_or_path, **base))
