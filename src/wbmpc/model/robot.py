"""The robot model: layouts, home, limits, kinematics and dynamics of one described robot."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import casadi as ca
import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.bases.ball.model import BallBase
from wbmpc.bases.fixed.model import FixedBase
from wbmpc.bases.swerve.model import SwerveBase
from wbmpc.errors import InputError, unknown_name
from wbmpc.model.kinematics import FramePose
from wbmpc.model.layout import Layout
from wbmpc.model.numeric import Numeric
from wbmpc.model.tree import read_tree
from wbmpc.robots import BallBaseDescription, RobotDescription, SwerveBaseDescription, load_description, load_spec

Array = NDArray[np.float64]
_LOG = logging.getLogger("wbmpc")
#: By how much [rad] a steering range may be short of half a turn (files say 1.57): a wheel points 0.01 rad off at worst.
NEARLY = 0.02


@dataclass(frozen=True)
class Limits:
    """Bounds of state (nx) and input (nu); infinite where there is none.

    ``input_rate`` (nu): how fast an input that is a joint's speed may change [rad/s²]; ``actuator_upper`` (nu): largest command to
    a drive, above ``input_upper`` where it has a reserve to follow the plan.
    """

    state_lower: Array
    state_upper: Array
    input_lower: Array
    input_upper: Array
    input_rate: Array
    actuator_upper: Array


class Dynamics:
    """ẋ = f(x, u; w, m): state, input, parameters that hold over the horizon, and mode values per node."""

    def __init__(self, base: Any) -> None:
        self._base = base
        self.state, self.input = Layout(base.state), Layout(base.input)
        self.parameters, self.mode = Layout(base.parameters), Layout(base.mode)
        self.unit_quaternions: tuple[int, ...] = base.unit_quaternions
        #: Lowest and highest value of a group of mode values; any number where there is none.
        self.mode_bounds: dict[str, tuple[float, float]] = getattr(base, "mode_bounds", {})

    def view(self, x: ca.SX, u: ca.SX) -> tuple[ca.SX, ca.SX]:
        """The robot's own state and input; wrappers that add states override this."""
        return x, u

    def __call__(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        """ẋ (nx)."""
        return self._base.derivative(x, u, w, m)

    def jacobian(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> tuple[ca.SX, ca.SX]:
        """ẋ and its Jacobian (nx, nx + nu) by [x; u]."""
        if hasattr(self._base, "jacobian"):
            return self._base.jacobian(x, u, w, m)  # type: ignore[no-any-return]
        f = self(x, u, w, m)
        return f, ca.jacobian(f, ca.vertcat(x, u))


class RobotModel:
    """A described robot as symbolic functions on CasADi SX, with named layouts."""

    def __init__(self, description: RobotDescription) -> None:
        self.description = description
        spec = load_spec(description)
        self.base = self._make_base(spec)
        self.tree = self.base.tree
        self.state, self.input = Layout(self.base.state), Layout(self.base.input)
        self.parameters, self.mode = Layout(self.base.parameters), Layout(self.base.mode)
        self._check_home()
        self._check_steering()

    def _check_home(self) -> None:
        for group, names in self.state.groups.items():
            for i, name in enumerate(names, start=self.state[group].start):
                value = self.description.home.get(name, 0.0)
                low, high = self.limits.state_lower[i], self.limits.state_upper[i]
                if name in self.description.joints() and not low <= value <= high:
                    raise InputError(
                        f"{self.description.source}: key 'home.{name}': {value:g} is outside its limits {low:g} to {high:g}"
                    )

    def _check_steering(self) -> None:
        """A wheel with less than half a turn of steering cannot roll in every direction: possible, but not what is expected."""
        names = self.state.groups.get("steer", ())
        part = self.state["steer"] if names else slice(0, 0)
        low, high = self.limits.state_lower[part], self.limits.state_upper[part]
        short = np.flatnonzero(high - low < np.pi - NEARLY)
        if short.size:
            i = int(short[0])
            more = f" (and {short.size - 1} more)" if short.size > 1 else ""
            _LOG.warning(
                "%s: steering joint '%s'%s turns from %g to %g rad, less than half a turn: no wheel rolls along what is left out, "
                "%g to %g rad, and motions that ask for it drag the wheel",
                self.description.source, names[i], more, low[i], high[i], high[i], low[i] + np.pi,
            )  # fmt: skip

    def _make_base(self, spec: mujoco.MjSpec) -> Any:
        d = self.description
        if isinstance(d.base, BallBaseDescription):
            ball = d.base.ball
            inside = read_tree(spec, ball).links[0]
            return BallBase(d, read_tree(spec, d.base.body, without=(ball,)), inside)
        tree = read_tree(spec, d.base.body)
        if isinstance(d.base, SwerveBaseDescription):
            return SwerveBase(d, tree)
        compiled = spec.compile().body(d.base.body)
        return FixedBase(d, tree, compiled.pos.copy(), compiled.quat.copy())

    # ------------------------------------------------------------------ data
    @property
    def frames(self) -> tuple[str, ...]:
        """Names of all frames: bodies and sites."""
        return tuple(self.tree.frames)

    @property
    def tool(self) -> str:
        """Name of the hand's frame."""
        return self.description.arm.tool

    @cached_property
    def home(self) -> Array:
        """State (nx) with the joints of the description's home; a ball robot leans at its equilibrium."""
        if isinstance(self.base, BallBase):
            names = self.state.groups["arm"]
            return self.equilibrium([self.description.home.get(n, 0.0) for n in names])[0]
        values = {
            group: [self.description.home.get(n, 0.0) for n in names]
            for group, names in self.state.groups.items()
            if group != "base"
        }
        x = self.state.vector(values)
        if isinstance(self.base, SwerveBase) and self.base.quaternion:
            x[self.state["base"]] = [0, 0, self.base.height, 1, 0, 0, 0]
        return x

    @cached_property
    def limits(self) -> Limits:
        """Ranges of the joints (state); speeds or torques (input)."""
        d, limits = self.description, self.description.limits
        lower, upper = np.full(self.state.size, -np.inf), np.full(self.state.size, np.inf)
        size, change = np.full(self.input.size, np.inf), np.full(self.input.size, np.inf)
        ranges = {link.joint: link.range for link in self.tree.links if link.joint}
        rate = limits.effort if isinstance(d.base, BallBaseDescription) else limits.velocity
        for group in ("leg", "steer", "wheel", "arm"):
            for name in self.state.groups.get(group, ()):
                i = self.state.index(f"{group}.{name}")
                lower[i], upper[i] = limits.position.get(name, ranges[name])
            for name in self.input.groups.get(group, ()):
                size[self.input.index(f"{group}.{name}")] = rate.get(name, np.inf)
                if not isinstance(d.base, BallBaseDescription):  # its inputs are torques
                    change[self.input.index(f"{group}.{name}")] = limits.acceleration.get(name, np.inf)
        if isinstance(d.base, BallBaseDescription):
            size[self.input["wheel"]] = limits.wheel_effort
            for name in self.state.groups["arm_velocity"]:
                i = self.state.index(f"arm_velocity.{name}")
                upper[i] = limits.velocity.get(name, np.inf)
                lower[i] = -upper[i]
        elif "base" in self.input:
            size[self.input["base"]] = [limits.base_linear, limits.base_linear, limits.base_angular]
        drive = size.copy()
        for name in self.input.groups.get("steer", ()):
            drive[self.input.index(f"steer.{name}")] = limits.drive_velocity.get(name, rate.get(name, np.inf))
        return Limits(lower, upper, -size, size, change, drive)

    def dynamics(self) -> Dynamics:
        """The equations of motion as a value for an optimal control problem."""
        return Dynamics(self.base)

    # ------------------------------------------------------------------ symbolic
    def _frame(self, name: str) -> Any:
        if name not in self.tree.frames:
            raise unknown_name("frame", name, self.tree.frames, where=self.description.name)
        return self.tree.frames[name]

    def frame_pose(self, x: ca.SX, frame: str) -> FramePose:
        """Pose of a frame in the world. The world's origin is on the ground; for ball robots at the ball's centre height."""
        return self.base.chain(x).frame_pose(self._frame(frame))  # type: ignore[no-any-return]

    def frame_velocity(self, x: ca.SX, u: ca.SX, frame: str) -> tuple[ca.SX, ca.SX]:
        """Linear [m/s] and angular [rad/s] velocity (3 each) of a frame, world axes."""
        rates, linear, angular = self.base.motion(x, u)
        return self.base.chain(x).frame_velocity(self._frame(frame), rates, linear, angular)  # type: ignore[no-any-return]

    # ------------------------------------------------------------------ numeric
    @cached_property
    def _functions(self) -> dict[str, ca.Function]:
        return {}

    @cached_property
    def _numeric(self) -> dict[str, Numeric]:
        return {}

    def pose(self, x: ArrayLike, frame: str | None = None) -> tuple[Array, Array]:
        """Position (3) and quaternion (4) of a frame (the tool when left out) at a numeric state (nx)."""
        frame = frame or self.tool
        if frame not in self._functions:
            s = ca.SX.sym("x", self.state.size)
            pose = self.frame_pose(s, frame)
            self._functions[frame] = ca.Function("pose", [s], [pose.position, pose.quaternion])
        p, q = self._functions[frame](np.asarray(x, float))
        return np.array(p).ravel(), np.array(q).ravel()

    def poses(self, states: ArrayLike, frame: str | None = None) -> Array:
        """Poses (n, 7) of a frame (the tool when left out) at states (n, nx): position and quaternion."""
        states = np.atleast_2d(np.asarray(states, float))
        self.pose(states[0], frame)  # makes the function
        p, q = self._functions[frame or self.tool](states.T)
        return np.vstack([np.array(p), np.array(q)]).T

    def _ball(self) -> BallBase:
        if not isinstance(self.base, BallBase):
            raise InputError(f"{self.description.name}: this needs a ball base")
        return self.base

    def mass_matrix(self, q: ArrayLike) -> Array:
        """M (nq, nq) of a ball robot."""
        base = self._ball()
        if "M" not in self._numeric:
            s = ca.SX.sym("q", base.nq)
            self._numeric["M"] = Numeric(ca.Function("M", [s], [ca.densify(base.mass_matrix(s))]))
        return self._numeric["M"](q)[0]

    def tool_moment(self, q: ArrayLike, moment: ArrayLike) -> Array:
        """Generalised forces (nq) of a moment (3) [N m] of the world on a ball robot's hand, world axes."""
        base = self._ball()
        if "moment" not in self._numeric:
            s, m = ca.SX.sym("q", base.nq), ca.SX.sym("m", 3)
            function = ca.Function("moment", [s, m], [ca.densify(base.tool_moment(s, m))])
            self._numeric["moment"] = Numeric(function)
        return self._numeric["moment"](q, moment)[0].ravel()

    def tool_weight(self, q: ArrayLike) -> Array:
        """Generalised forces (nq) [N, N m] of the weight of 1 kg at a ball robot's tool."""
        base = self._ball()
        if "weight" not in self._numeric:
            s = ca.SX.sym("q", base.nq)
            function = ca.Function("weight", [s], [ca.densify(base.tool_force(s, ca.SX([0, 0, -9.81])))])
            self._numeric["weight"] = Numeric(function)
        return self._numeric["weight"](q)[0].ravel()

    def inverse_dynamics(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """M a + h (nq): the generalised forces of a ball robot's motion."""
        base = self._ball()
        if "tau" not in self._functions:
            s = [ca.SX.sym(n, base.nq) for n in "qva"]
            self._functions["tau"] = ca.Function("tau", s, [ca.densify(base.inverse_dynamics(*s))])
        return np.array(self._functions["tau"](*(np.asarray(value, float) for value in (q, v, a)))).ravel()

    def equilibrium(self, arm: ArrayLike, yaw: float = 0.0, force: ArrayLike = (0.0, 0.0, 0.0)) -> tuple[Array, Array]:
        """State (nx) and torques (wheels + arm) at which a ball robot rests with a force (3) [N] of the world on its hand."""
        from scipy.optimize import root

        base = self._ball()
        n = base.nq
        if "rest" not in self._functions:
            q, u, f = ca.SX.sym("q", n), ca.SX.sym("u", len(base.input["wheel"]) + n - 5), ca.SX.sym("f", 3)
            given = ca.vertcat(u, ca.SX.zeros(self.input.size - u.shape[0]))
            rest = base.inverse_dynamics(q, ca.SX(n, 1), ca.SX(n, 1)) - base.tool_force(q, f)
            rest -= base.generalised_force(q, given, ca.SX.zeros(self.parameters.size))
            self._functions["rest"] = ca.Function("rest", [q, u, f], [rest])
        rest_of, angles, push = self._functions["rest"], np.asarray(arm, float), np.asarray(force, float)
        if angles.shape != (n - 5,) or push.shape != (3,):
            raise InputError(f"{self.description.name}: an equilibrium needs {n - 5} arm angles and 3 forces")

        def joints(z: Array) -> Array:
            return np.concatenate([[0, 0, yaw], z[:2], angles])

        # With more than three wheels the torques are not unique: the least-norm ones to a torque (3) on the ball.
        wheels = np.linalg.pinv(base.wheel_torque_map())

        def torques(z: Array) -> Array:
            return np.concatenate([wheels @ z[2:5], z[5:]])

        def unbalanced(z: Array) -> Array:
            return np.array(rest_of(joints(z), torques(z), push)).ravel()

        found = root(unbalanced, np.zeros(n), method="hybr", options={"xtol": 1e-14})
        if np.abs(found.fun).max() > 1e-8:
            raise InputError(f"{self.description.name}: no equilibrium for the arm at {angles} with force {push}")
        x = self.state.vector({})
        x[:n] = joints(found.x)
        return x, torques(found.x)


def load_robot(name_or_path: str | Path, **base: Any) -> RobotModel:
    """A built-in robot by name, or one's own YAML. ``base`` replaces keys of the base section.

    ``load_robot("rezero", contact="wrench", contact_frame="tool")``: the wrench of the world at that frame is an input.
    Raises :class:`InputError` naming file and key.
    """
    return RobotModel(load_description(name_or_path, **base))
