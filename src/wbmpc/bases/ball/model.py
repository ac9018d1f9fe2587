"""Ball-balancing bases on the minimal coordinates: ball position, ZYX Euler angles of the base, arm.

Sources: Minniti et al., RA-L 2019 (arXiv 1902.10415), equation 1; Fankhauser and Gwerder, "Modeling and Control of a
Ballbot" (2010). Rolling adds the ball's spin energy: I_b / r² on x and y. With wheel axes a_i in the base and the base's
rotation R the wheels turn at ψ̇ = −(r / r_w) aᵀ Rᵀ (Ω − ω), Ω = (−ẏ / r, ẋ / r, 0): forces are the transpose of that map.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.bases.ball.description import BallBaseDescription
from wbmpc.constants import GRAVITY
from wbmpc.errors import InputError, unknown_name
from wbmpc.model.joints import Limits, joint_limits
from wbmpc.model.kinematics import Chain, FramePose, solve_spd
from wbmpc.model.layout import Layout
from wbmpc.model.numeric import Numeric
from wbmpc.model.tree import Frame, Link, Tree
from wbmpc.robots import RobotDescription
from wbmpc.units import force_unit, rate_unit

if TYPE_CHECKING:
    from wbmpc.bases.footprint import Footprint
    from wbmpc.model.robot import RobotModel
    from wbmpc.ocp import Constraint

#: Newton's method for an equilibrium: largest force and torque [N, N m] that are left, largest change of the lean [rad] in a step, shortest
#: step, and the condition of a matrix that counts as singular.
EXACT, FAR, SHORTEST, SINGULAR = 1e-11, 0.2, 1e-3, 1e12
_EULER = (("yaw", (0, 0, 1)), ("pitch", (0, 1, 0)), ("roll", (1, 0, 0)))


class BallBase:
    """Full dynamics: state (q, q̇), inputs wheel torques, arm torques and (optionally) forces or wrenches of the world.

    ``contacts``: by frame the input groups of the force (3) [N] and of the moment (3) [N m] that act there, world axes:
    ``force`` and ``moment``, or with several frames ``force_FRAME`` and ``moment_FRAME``; ``mount`` (3) [m] of the inertial
    unit in the base's frame. Parameters w: ``disturbance`` (nq),
    generalized forces; ``force`` (3) [N] on the tool where no contact is an input; ``push`` (2) [m], by which a push that is felt
    will move the lean (no part of the dynamics: limits of the lean leave room for it); ``payload`` [kg], a point mass at the tool,
    where the description has it: left out, functions of w count none.
    """

    def __init__(self, description: RobotDescription, tree: Tree, ball: Link) -> None:
        assert isinstance(description.base, BallBaseDescription)
        self.base, self.ball, self.name = description.base, ball, description.name
        self.radius = self.base.ball_radius
        self.spin_mass = float(ball.inertia[0, 0]) / self.radius**2
        links, shift = self._virtual(tree.links[0], ball)
        for link in tree.links[1:]:
            links.append(Link(**{**link.__dict__, "parent": link.parent + shift}))
        frames = {n: Frame(f.link + shift, f.position, f.rotation) for n, f in tree.frames.items()}
        self.tree = Tree(tuple(links), frames)
        self.tool = frames[description.arm.tool]
        self.mount = self._mount(description)
        arm = list(description.arm.joints)
        self._moving = [*range(5), *(self.tree.joint(n) for n in arm)]
        pose = ["x", "y", "yaw", "pitch", "roll"]
        self.nq = 5 + len(arm)
        self.state = {"base": pose, "arm": arm, "base_velocity": pose, "arm_velocity": arm}
        wheels = [f"wheel_{i}" for i in range(len(self.base.wheels.azimuths))]
        axes = ["x", "y", "z"]
        self.contacts = self._contacts(description.arm.tool)
        contact_forces = {group: axes for groups in self.contacts.values() for group in groups.values()}
        self.input = {"wheel": wheels, "arm": arm, **contact_forces}
        units = {"base": ("m", "m", "rad", "rad", "rad"), "arm": self.tree.units(arm)}
        self.state_units = {**units, **{f"{g}_velocity": [rate_unit(u) for u in own] for g, own in units.items()}}
        self.input_units: dict[str, str | Sequence[str]] = {
            "wheel": "N m",
            "arm": [force_unit(u) for u in units["arm"]],
        }
        for groups in self.contacts.values():
            self.input_units |= {group: {"force": "N", "moment": "N m"}[kind] for kind, group in groups.items()}
        self.mode: dict[str, list[str]] = {}
        self.parameters = {"disturbance": [*pose, *arm], **({} if self.contacts else {"force": axes})}
        self.parameters["push"] = ["x", "y"]
        if self.base.payload:
            self.parameters["payload"] = ["mass"]
        self.unit_quaternions: tuple[int, ...] = ()
        self.mode_bounds: dict[str, tuple[float, float]] = {}
        self.brakes: dict[str, str] = {}
        self.rolling_groups: tuple[str, ...] = ()
        self.steering_groups: tuple[str, ...] = ()
        self.footprint: Footprint | None = None
        self.twist = np.eye(3)
        self.wheels, self.balances = 0, True
        self.ground, self.body_height = self.base.ground, self.radius

    @cached_property
    def numeric(self) -> BallNumeric:
        """The same equations for numbers."""
        return BallNumeric(self)

    def _mount(self, description: RobotDescription) -> Array:
        """Position (3) [m] of the inertial unit, the frame ``imu``, in the base's frame; the origin without one."""
        if "imu" not in self.tree.frames:
            return np.zeros(3)
        place = self.tree.place_on(self.base.body, "imu")
        if place is None or not np.allclose(place[1], np.eye(3), atol=1e-6):
            raise InputError(
                f"{description.model}: frame 'imu': the inertial unit of a base of type ball needs to be fixed to "
                f"'{self.base.body}' with the same axes"
            )
        return place[0]

    def _contacts(self, tool: str) -> dict[str, dict[str, str]]:
        """By frame the input groups of what acts there."""
        kinds = {"none": (), "force": ("force",), "wrench": ("force", "moment")}[self.base.contact]
        frames = (self.base.contact_frame or (tool,)) if kinds else ()
        for frame in frames:
            if frame not in self.tree.frames:
                raise unknown_name("frame of the base or arm (key 'base.contact_frame')", frame, self.tree.frames)
        name = lambda kind, frame: kind if len(frames) == 1 else f"{kind}_{frame}"
        return {frame: {kind: name(kind, frame) for kind in kinds} for frame in frames}

    def _virtual(self, root: Link, ball: Link) -> tuple[list[Link], int]:
        """x, y (carrying the ball), yaw, pitch, roll (carrying the base body)."""
        zero, none, eye = np.zeros(3), np.zeros((3, 3)), np.eye(3)
        links = [
            Link("virtual.x", -1, "x", "prismatic", np.array([1.0, 0, 0]), zero, eye, 0.0, zero, none),
            Link("virtual.y", 0, "y", "prismatic", np.array([0, 1.0, 0]), zero, eye, ball.mass, zero, none),
        ]
        for k, (name, axis) in enumerate(_EULER):
            last = k == 2
            body = (root.mass, root.com, root.inertia) if last else (0.0, zero, none)
            links.append(Link(f"virtual.{name}", 1 + k, name, "revolute", np.array(axis, float), zero, eye, *body))
        return links, 4

    # ------------------------------------------------------------------ kinematics
    def chain(self, x: ca.SX, w: ca.SX | None = None) -> Chain:
        """The tree at a state (or at q alone), with the payload of the parameters w."""
        load = None if w is None else self.payload(w)
        values = {link: x[k] for k, link in enumerate(self._moving)}
        return Chain(self.tree.links, values, load=None if load is None else (self.tool, load))

    def payload(self, w: ca.SX) -> ca.SX | None:
        """The mass [kg] at the tool among the parameters w, if the model has it: the last of the base's own."""
        last = sum(map(len, self.parameters.values()))
        return w[last - 1] if "payload" in self.parameters else None

    def root_pose(self, x: ca.SX) -> FramePose:
        """Pose of the base's frame, whose origin is the ball's center."""
        return self.chain(x).link_pose(4)

    def velocities(self, x: ca.SX, u: ca.SX) -> tuple[dict[int, ca.SX], ca.SX, ca.SX]:
        """Joint rates by link; the root does not move by itself."""
        return {link: x[self.nq + k] for k, link in enumerate(self._moving)}, ca.SX(3, 1), ca.SX(3, 1)

    def wheel_axes(self) -> Array:
        """Axes a_i (3, wheels) in the base frame."""
        z = self.base.wheels.zenith
        return np.array(
            [[np.cos(z) * np.cos(b), np.cos(z) * np.sin(b), -np.sin(z)] for b in self.base.wheels.azimuths]
        ).T

    def wheel_torque_map(self) -> Array:
        """Torque (3, wheels) on the ball in base axes per unit wheel torque; the opposite acts on the base."""
        return -self.radius / self.base.wheels.radius * self.wheel_axes()

    def wheel_speeds(self, q: ca.SX, v: ca.SX) -> ca.SX:
        """Speeds (wheels) [rad/s] of the omni wheels relative to the base for rates v."""
        chain = self.chain(q)
        rates = {link: v[k] for k, link in enumerate(self._moving)}
        base = Frame(4, np.zeros(3), np.eye(3))
        _, omega = chain.frame_velocity(base, rates, ca.SX(3, 1), ca.SX(3, 1))
        spin = ca.vertcat(-v[1] / self.radius, v[0] / self.radius, ca.SX(1, 1))
        _, rotation = chain.link_place(4)
        return ca.DM(self.wheel_torque_map().T) @ (rotation.T @ (spin - omega))

    # ------------------------------------------------------------------ dynamics
    def mass_matrix(self, q: ca.SX, w: ca.SX | None = None) -> ca.SX:
        """M(q), (nq, nq), with the ball's spin and the payload of the parameters w."""
        return self.chain(q, w).mass_matrix() + ca.diag(
            ca.vertcat(self.spin_mass, self.spin_mass, ca.SX(self.nq - 2, 1))
        )

    def inverse_dynamics(self, q: ca.SX, v: ca.SX, a: ca.SX, w: ca.SX | None = None) -> ca.SX:
        """M a + h: generalized forces (nq) for accelerations a, with the payload of the parameters w."""
        rates = {link: v[k] for k, link in enumerate(self._moving)}
        accelerations = {link: a[k] for k, link in enumerate(self._moving)}
        spin = self.spin_mass * ca.vertcat(a[0], a[1], ca.SX(self.nq - 2, 1))
        return self.chain(q, w).inverse_dynamics(rates, accelerations) + spin

    def generalized_force(self, q: ca.SX, u: ca.SX, w: ca.SX) -> ca.SX:
        """S(q)ᵀ τ + Jᵀ (F, M) + disturbance, by virtual power."""
        v = ca.SX.sym("v", self.nq)
        n, arm = len(self.base.wheels.azimuths), self.nq - 5
        power = ca.dot(u[0:n], self.wheel_speeds(q, v)) + ca.dot(u[n : n + arm], v[5:])
        if not self.contacts:
            power += ca.dot(w[self.nq : self.nq + 3], self._velocities(q, v, self.tool)["force"])
        start = n + arm
        for frame, groups in self.contacts.items():
            speeds = self._velocities(q, v, self.tree.frames[frame])
            for kind in groups:
                power += ca.dot(u[start : start + 3], speeds[kind])
                start += 3
        return ca.jacobian(power, v).T + w[0 : self.nq]

    def _velocities(self, q: ca.SX, v: ca.SX, frame: Frame) -> dict[str, ca.SX]:
        """What a force and a moment at a frame do work on: its linear and angular velocity, world axes."""
        rates = {link: v[k] for k, link in enumerate(self._moving)}
        linear, angular = self.chain(q).frame_velocity(frame, rates, ca.SX(3, 1), ca.SX(3, 1))
        return {"force": linear, "moment": angular}

    def tool_force(self, q: ca.SX, force: ca.SX) -> ca.SX:
        """Generalized forces (nq) of a force (3) [N] on the tool, world axes."""
        v = ca.SX.sym("v", self.nq)
        return ca.jacobian(ca.dot(force, self._velocities(q, v, self.tool)["force"]), v).T

    def tool_moment(self, q: ca.SX, moment: ca.SX) -> ca.SX:
        """Generalized forces (nq) of a moment (3) [N m] on the tool, world axes."""
        v = ca.SX.sym("v", self.nq)
        return ca.jacobian(ca.dot(moment, self._velocities(q, v, self.tool)["moment"]), v).T

    def derivative(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        """ẋ = (v, M⁻¹ (forces − h))."""
        q, v = x[: self.nq], x[self.nq :]
        right = self.generalized_force(q, u, w) - self.inverse_dynamics(q, v, ca.SX(self.nq, 1), w)
        return ca.vertcat(v, solve_spd(self.mass_matrix(q, w), right))

    def jacobian(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> tuple[ca.SX, ca.SX]:
        """f and its Jacobian: the derivative of the Newton-Euler residual, solved with one factor of M."""
        q, v = x[: self.nq], x[self.nq :]
        f = self.derivative(x, u, w, m)
        a = ca.SX.sym("a", self.nq)
        residual = self.inverse_dynamics(q, v, a, w) - self.generalized_force(q, u, w)
        slope = ca.substitute(ca.jacobian(residual, ca.vertcat(x, u)), a, f[self.nq :])
        kinematic = ca.horzcat(ca.SX(self.nq, self.nq), ca.SX.eye(self.nq), ca.SX(self.nq, u.shape[0]))
        return f, ca.vertcat(kinematic, -solve_spd(self.mass_matrix(q, w), slope))

    # ------------------------------------------------------------------ description
    def rolling(self, x: ca.SX, u: ca.SX, m: ca.SX) -> ca.SX:
        """No rows: the coordinates contain the rolling of the ball."""
        return ca.SX(0, 1)

    def constraints(self, robot: RobotModel, *, hard: bool = True) -> list[Constraint]:
        """None: every torque is possible."""
        return []

    def limits(self, description: RobotDescription) -> Limits:
        """Ranges and speeds of the arm (state), torques of wheels and arm (input)."""
        limits = description.limits
        found = joint_limits(self, description, ("arm",), limits.effort, {}, {"wheel": limits.wheel_effort})
        part = Layout(self.state)["arm_velocity"]
        found.state_upper[part] = [limits.velocity.get(name, np.inf) for name in self.state["arm_velocity"]]
        found.state_lower[part] = -found.state_upper[part]
        return found

    def home(self, robot: RobotModel) -> Array:
        """The equilibrium with the arm at the description's home: the base leans."""
        return self.numeric.equilibrium([robot.description.home.get(n, 0.0) for n in self.state["arm"]])[0]


class BallNumeric:
    """Dynamics and equilibria of one ball robot with nq coordinates; reached as ``robot.base.numeric``."""

    def __init__(self, base: BallBase) -> None:
        self._base, self._state = base, Layout(base.state)
        self._input, self._parameters = Layout(base.input).size, Layout(base.parameters).size
        self._numeric: dict[str, Numeric] = {}
        #: What :class:`wbmpc.bases.ball.balance.Balance` has found, by all that it depends on.
        self.balances: dict[tuple[object, ...], Any] = {}

    def mass_matrix(self, q: ArrayLike) -> Array:
        """M (nq, nq) with the spin of the ball."""
        base = self._base
        if "M" not in self._numeric:
            s = ca.SX.sym("q", base.nq)
            self._numeric["M"] = Numeric(ca.Function("M", [s], [ca.densify(base.mass_matrix(s))]))
        return self._numeric["M"](q)[0]

    def tool_moment(self, q: ArrayLike, moment: ArrayLike) -> Array:
        """Generalized forces (nq) of a moment (3) [N m] of the world on the tool, world axes."""
        base = self._base
        if "moment" not in self._numeric:
            s, m = ca.SX.sym("q", base.nq), ca.SX.sym("m", 3)
            function = ca.Function("moment", [s, m], [ca.densify(base.tool_moment(s, m))])
            self._numeric["moment"] = Numeric(function)
        return self._numeric["moment"](q, moment)[0].ravel()

    def tool_weight(self, q: ArrayLike) -> Array:
        """Generalized forces (nq) [N, N m] of the weight of 1 kg at the tool."""
        base = self._base
        if "weight" not in self._numeric:
            s = ca.SX.sym("q", base.nq)
            function = ca.Function("weight", [s], [ca.densify(base.tool_force(s, ca.SX([0, 0, -GRAVITY])))])
            self._numeric["weight"] = Numeric(function)
        return self._numeric["weight"](q)[0].ravel()

    def inverse_dynamics(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """M a + h (nq): the generalized forces of a motion."""
        base = self._base
        if "tau" not in self._numeric:
            s = [ca.SX.sym(n, base.nq) for n in "qva"]
            self._numeric["tau"] = Numeric(ca.Function("tau", s, [ca.densify(base.inverse_dynamics(*s))]))
        return self._numeric["tau"](q, v, a)[0].ravel()

    def equilibrium(self, arm: ArrayLike, yaw: float = 0.0, force: ArrayLike = (0.0, 0.0, 0.0)) -> tuple[Array, Array]:
        """State (nx) and torques (wheels + arm) at which the robot rests with a force (3) [N] of the world on the tool.

        Raises :class:`InputError` for other sizes, and where Newton's method finds none.
        """
        base, angles, push = self._base, np.asarray(arm, float), np.asarray(force, float)
        n = base.nq
        if angles.shape != (n - 5,) or push.shape != (3,):
            raise InputError(f"{base.name}: an equilibrium needs {n - 5} arm angles and 3 forces")
        given, z = np.array([yaw, *angles, *push]), np.zeros(n)
        residual, slope = self._rest(z, given)
        missed, share = float(np.abs(residual).max()), 1.0
        while missed > EXACT and share > SHORTEST and np.linalg.cond(slope) < SINGULAR:
            step = np.linalg.solve(slope, residual.ravel())
            # the lean in small steps: there are others, far from the upright
            trial = z - step * min(share, FAR / max(float(np.abs(step[:2]).max()), FAR))
            after, its = self._rest(trial, given)
            size = float(np.abs(after).max())
            if size < missed:
                z, residual, slope, missed, share = trial, after, its, size, 1.0
            else:
                share *= 0.5
        if not missed <= 1e-8:
            raise InputError(f"{base.name}: no equilibrium for the arm at {angles} with force {push}")
        x = self._state.vector({})
        x[:n] = [0.0, 0.0, yaw, *z[:2], *angles]
        return x, np.concatenate([self._least_torques @ z[2:5], z[5:]])

    @cached_property
    def _least_torques(self) -> Array:
        """Torques (wheels) of the least norm for a torque (3) on the ball: with more than three wheels they are not unique."""
        return np.asarray(np.linalg.pinv(self._base.wheel_torque_map()), float)

    @cached_property
    def _rest(self) -> Numeric:
        """The generalized forces (nq) that are not balanced at rest, and their slope, by pitch, roll, torque on the ball (3) and torques of
        the arm; given the yaw, the arm's angles and a force (3) on the tool."""
        base = self._base
        n = base.nq
        z, given = ca.SX.sym("z", n), ca.SX.sym("given", 1 + n - 5 + 3)
        q = ca.vertcat(0, 0, given[0], z[:2], given[1 : n - 4])
        torques = ca.vertcat(ca.DM(self._least_torques) @ z[2:5], z[5:])
        inputs = ca.vertcat(torques, ca.SX.zeros(self._input - torques.shape[0]))
        rest = base.inverse_dynamics(q, ca.SX(n, 1), ca.SX(n, 1)) - base.tool_force(q, given[n - 4 :])
        rest -= base.generalized_force(q, inputs, ca.SX.zeros(self._parameters))
        parts = [ca.densify(rest), ca.densify(ca.jacobian(rest, z))]
        return Numeric(ca.Function("rest", [z, given], parts))


def ball_base(robot: RobotModel) -> BallBase:
    """The base of a robot that balances on a ball. Raises :class:`InputError` for one of another type."""
    if not isinstance(robot.base, BallBase):
        kind = robot.description.base.type
        raise InputError(f"{robot.description.name}: a base of type ball is needed, it has one of type '{kind}'")
    return robot.base
