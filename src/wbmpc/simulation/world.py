"""What both MuJoCo plants share: the floor, the free base, time, pushes, reading frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.errors import InputError, unknown_name
from wbmpc.kernel.step import bind
from wbmpc.robots import RobotDescription
from wbmpc.robots.checks import compiled
from wbmpc.robots.model_file import log_warnings
from wbmpc.simulation.contacts import GROUND, Contacts, enable
from wbmpc.simulation.scene import from_base
from wbmpc.simulation.speed_torque import SpeedTorque

#: Called before every physics step with (model, data): doors, terrain that moves, pushes of any kind.
Hook = Callable[[mujoco.MjModel, mujoco.MjData], None]

#: Physics step [s]: 400, 80 and 50 Hz and a drive loop of 2 kHz are whole numbers of steps.
TIMESTEP = 5e-4
#: Tilt [rad] at which a robot counts as fallen, and one whose hull touches the floor: it may be propped up by its arm.
FALL_TILT, PROPPED_TILT = 0.9, 0.35
#: Speed [m/s, rad/s] below which a robot rests.
STANDS = 0.05
NO_TORQUE = (0.0, 0.0, 0.0)


def set_options(spec: mujoco.MjSpec, timestep: float, integrator: mujoco.mjtIntegrator) -> None:
    """Physics options: elliptic friction cones, stiff friction (impratio 10), no silent reset on divergence."""
    o = spec.option
    o.timestep, o.integrator = timestep, integrator
    o.cone, o.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 10.0
    # one robot is one island: looking for several finds the same motion and takes longer
    o.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET) | int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
    spec.visual.headlight.ambient = [0.35, 0.35, 0.35]
    spec.visual.headlight.diffuse = [0.35, 0.35, 0.35]
    spec.visual.headlight.specular = [0.1, 0.1, 0.1]


#: Direction of the sun's rays.
SUN = (-0.35, 0.45, -0.82)


def add_floor(spec: mujoco.MjSpec, condim: int, friction: list[float], solref: list[float]) -> None:
    """A flat floor with a grid of 1 m squares, and a sky."""
    texture = mujoco.mjtTexture
    spec.add_texture(
        name="sky", type=texture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.93, 0.95, 0.98], rgb2=[0.62, 0.72, 0.84], width=256, height=256,
    )  # fmt: skip
    spec.add_texture(
        name="grid", type=texture.mjTEXTURE_2D, builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER, width=512, height=512,
        rgb1=[0.80, 0.82, 0.85], rgb2=[0.72, 0.745, 0.78], mark=mujoco.mjtMark.mjMARK_EDGE, markrgb=[0.62, 0.65, 0.69],
    )  # fmt: skip
    # one texture holds 2 x 2 squares of the checker
    material = spec.add_material(name="grid", texrepeat=[0.5, 0.5], texuniform=True, reflectance=0.04)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "grid"
    world = spec.worldbody
    world.add_geom(
        name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.1], condim=condim, friction=friction,
        solref=solref, material="grid", **GROUND,
    )  # fmt: skip


def free_body(spec: mujoco.MjSpec, base: str, source: object) -> mujoco.MjsBody:
    """The body that gets the free joint of a moving base: the outermost that the body ``base`` is fixed to (as ``base_footprint`` of
    many robots). Raises :class:`InputError` where a joint is between them."""
    body = spec.body(base)
    while body.parent.name != "world":
        if list(body.joints):
            raise InputError(
                f"{source}: key 'base.body': body '{base}' hangs on '{body.parent.name}' by joint '{body.joints[0].name}'; a base that "
                "moves is simulated if nothing but fixed bodies carries it: name the outermost body, or hold the joint (fixed_joints)"
            )
        body = body.parent
    return body


def add_light(body: mujoco.MjsBody) -> None:
    """The sun, which goes with a body so that its shadow map covers the robot wherever it is."""
    body.add_light(
        pos=-4.0 * np.array(SUN), dir=SUN, mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACK,
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, diffuse=[0.7, 0.7, 0.7], specular=[0.2, 0.2, 0.2],
        castshadow=True,
    )  # fmt: skip


def add_drive(
    spec: mujoco.MjSpec, name: str, joint: str, kind: mujoco.mjtTrn, limit: float, lag: float, gain: float = 0.0
) -> mujoco.MjsActuator:
    """A motor on a joint (a velocity servo with ``gain`` [N m s/rad] if not 0) with a force limit and a first-order lag
    [s] of its command (exact filter)."""
    actuator = spec.add_actuator(name=name, target=joint, trntype=kind)
    if gain > 0.0:
        actuator.set_to_velocity(kv=gain)
    else:
        actuator.set_to_motor()
    if np.isfinite(limit):
        actuator.forcerange, actuator.forcelimited = [-limit, limit], mujoco.mjtLimited.mjLIMITED_TRUE
    if lag > 0.0:
        actuator.dyntype, actuator.dynprm[0], actuator.actdim = mujoco.mjtDyn.mjDYN_FILTEREXACT, lag, 1
    return actuator


def unwrap(angle: float, near: float) -> float:
    """``angle`` plus the whole turns that bring it nearest to ``near``."""
    return angle + 2.0 * np.pi * round((near - angle) / (2.0 * np.pi))


class World:
    """A compiled model with its data: time, pushes, and sensor readings that belong to the present state.

    One physics step is ``mj_step1`` (positions, velocities, sensors of the present state), the controls, ``mj_step2``.
    ``refresh`` does the first half when it has not been done, so that what is read never belongs to the step before.
    """

    def __init__(
        self, spec: mujoco.MjSpec, description: RobotDescription, joints: list[str], rated: Mapping[str, float]
    ) -> None:
        """The robot of a ``description`` with the scene of a ``spec``; ``joints``: those that are read; ``rated`` [rad/s]: speeds up to
        which drives give their whole torque, by actuator. Raises :class:`InputError` naming the robot's file where it cannot be
        simulated: a base without mass."""
        log_warnings()
        enable(spec, description.home, description.model, description.collision.self.ignore)
        self.model: mujoco.MjModel = compiled(spec, description.model)
        self.data = mujoco.MjData(self.model)
        self.timestep = float(self.model.opt.timestep)
        self.external: Hook | None = None
        m = self.model
        self.contacts, self._drives = Contacts(m, self.data), SpeedTorque(m, self.data, rated)
        self.body, self.site = m.body(description.base.body).id, self._tool(description.arm.tool)
        self._bind_frames()
        self._root, self._mount = self._free_root()
        self._joints = {name: (int(m.joint(name).qposadr[0]), int(m.joint(name).dofadr[0])) for name in joints}
        self._pushes: dict[int, tuple[Array, Array, Array | None]] = {}
        self._steps, self._fresh, self._lost = 0, False, False
        self.counted_yaw = 0.0  # the base's yaw [rad] of the last command's end, with its whole turns

    def _bind_frames(self) -> None:
        """What :meth:`frames` reads, and its step."""
        d, (is_site, index) = self.data, self.site
        places, rotations = (d.site_xpos, d.site_xmat) if is_site else (d.xpos, d.xmat)
        #: where base and tool are: views of the simulator's memory
        self.frame_memory = {"base": d.xpos[self.body], "rotation": d.xmat[self.body]}
        self.frame_memory |= {"tool": places[index], "tool_rotation": rotations[index]}
        self._frames = self.frame_memory | {"seen": np.zeros(3), "turned": np.zeros(9)}
        self._from_base: Callable[[], None] = bind(from_base, self._frames).call

    def _tool(self, name: str) -> tuple[bool, int]:
        """The tool's frame: (it is a site, id)."""
        try:
            return True, self.model.site(name).id
        except KeyError:
            return False, self.model.body(name).id

    def _free_root(self) -> tuple[int | None, Array | None]:
        """Where the position of the free joint that carries the base is in qpos (None: nothing does, the base stands), and the pose (7)
        of the base's frame in that joint's body (None: it is that frame)."""
        m, body = self.model, self.body
        mount = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        while body and not m.body_jntnum[body]:
            mount = lie.pose_compose(np.concatenate([m.body_pos[body], m.body_quat[body]]), mount)
            body = int(m.body_parentid[body])
        if not body or m.jnt_type[m.body_jntadr[body]] != mujoco.mjtJoint.mjJNT_FREE:
            mujoco.mj_kinematics(m, self.data)
            return None, None
        return int(m.jnt_qposadr[m.body_jntadr[body]]), None if body == self.body else mount

    def base_pose(self) -> Array:
        """Pose (7) of the base's frame at the present positions."""
        if self._root is None:
            return np.concatenate([self.data.xpos[self.body], self.data.xquat[self.body]])
        pose: Array = self.data.qpos[self._root : self._root + 7]
        return pose if self._mount is None else lie.pose_compose(pose, self._mount)

    def place(self, pose: Array) -> None:
        """Put the frame of a base that is free at a pose (7) above the floor: position [m] and quaternion; the rest of the positions stays."""
        assert self._root is not None
        at = pose if self._mount is None else lie.pose_compose(pose, lie.pose_inverse(self._mount))
        self.data.qpos[self._root : self._root + 7] = at

    # ------------------------------------------------------------------ time
    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self._steps * self.timestep

    def restart(self) -> None:
        """The present state becomes that of time 0."""
        self._steps, self.data.time = 0, 0.0
        self.counted_yaw = self._wrapped_yaw()
        self._fresh = False

    def refresh(self) -> None:
        """Positions, velocities and sensors of the present state."""
        if not self._fresh and not self._lost:
            mujoco.mj_step1(self.model, self.data)
            self._fresh = True

    def advance(
        self, control: Callable[[], None] | None = None, steps: int = 1, after: Callable[[], None] | None = None
    ) -> None:
        """So many physics steps; ``control`` may write what depends on the present state, ``after`` reads the new one."""
        model, data, limit_drives = self.model, self.data, self._drives.apply
        for _ in range(steps):
            self._steps += 1
            if not self._lost:
                if not self._fresh:
                    mujoco.mj_step1(model, data)
                if control is not None:
                    control()
                limit_drives()
                if self._pushes:
                    self._apply_pushes()
                if self.external is not None:
                    self.external(model, data)
                mujoco.mj_step2(model, data)
                self._fresh = False
            if after is not None:
                after()

    def check(self) -> None:
        """After a command's steps: note whether numbers are still finite, count the turns of the base."""
        self._lost = self.diverged
        if not self._lost:
            self.contacts.update(self.time)
            self.counted_yaw = unwrap(self._wrapped_yaw(), self.counted_yaw)

    # ------------------------------------------------------------------ pushes
    def push(
        self, force: ArrayLike, torque: ArrayLike = NO_TORQUE, body: str | None = None, point: ArrayLike | None = None
    ) -> None:
        """Push a body (the base when left out) with a force (3) [N] and torque (3) [N m] in world axes, until changed.

        The force acts at ``point`` (3) [m] of the body's frame, or at its center of mass. Zeros end the push.
        """
        names = [self.model.body(i).name for i in range(1, self.model.nbody)]
        if body is not None and body not in names:
            raise unknown_name("body", body, names)
        index = self.body if body is None else self.model.body(body).id
        f, t = np.asarray(force, float), np.asarray(torque, float)
        p = None if point is None else np.asarray(point, float)
        if f.shape != (3,) or t.shape != (3,) or not np.isfinite([f, t]).all():
            raise InputError(f"push: force and torque need 3 finite numbers each, got {f} and {t}")
        self.data.xfrc_applied[index] = 0.0
        self._pushes.pop(index, None)
        if f.any() or t.any():
            self._pushes[index] = (f, t, p)

    def end_pushes(self) -> None:
        """Push nothing any more."""
        for body in self._pushes:
            self.data.xfrc_applied[body] = 0.0
        self._pushes.clear()

    def _apply_pushes(self) -> None:
        d = self.data
        for body, (force, torque, point) in self._pushes.items():
            if point is not None:
                at = d.xpos[body] + d.xmat[body].reshape(3, 3) @ point
                torque = torque + np.cross(at - d.xipos[body], force)
            d.xfrc_applied[body, :3], d.xfrc_applied[body, 3:] = force, torque

    # ------------------------------------------------------------------ what is true
    def _wrapped_yaw(self) -> float:
        w, x, y, z = self.base_pose()[3:].tolist()
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))

    @property
    def yaw(self) -> float:
        """Yaw of the base [rad], not wrapped."""
        return unwrap(self._wrapped_yaw(), self.counted_yaw)

    @property
    def tilt(self) -> float:
        """Angle [rad] between the base's z axis and the vertical."""
        w, x, y, z = self.base_pose()[3:].tolist()
        half = math.sqrt((x * x + y * y) / (w * w + x * x + y * y + z * z))  # its sine
        return 2.0 * math.asin(min(half, 1.0))

    @property
    def rests(self) -> bool:
        """Whether nothing of robot and scene moves faster than :data:`STANDS`."""
        return bool(np.abs(self.data.qvel).max(initial=0.0) < STANDS)

    @property
    def diverged(self) -> bool:
        """Whether positions are not finite: the physics cannot go on."""
        # what is infinite or no number stays so in a sum
        return self._lost or not math.isfinite(sum(self.data.qpos.tolist()))

    @property
    def fell(self) -> bool:
        """Whether the base leans by more than 0.9 rad, or by 0.35 rad with its hull on the floor, or numbers are not finite."""
        return self.diverged or self.tilt > self.fall_tilt

    @property
    def fall_tilt(self) -> float:
        """The tilt [rad] beyond which the robot has fallen."""
        return PROPPED_TILT if self.contacts.grounded else FALL_TILT

    @property
    def twist(self) -> Array:
        """Of the base (6) in its own axes: linear [m/s], angular [rad/s]."""
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_XBODY, self.body, velocity, 1)
        return np.concatenate([velocity[3:], velocity[:3]])

    def frames(self, height: float) -> dict[str, Array]:
        """Base and tool as :class:`Truth` has them; ``height`` [m] of the planner's z = 0 above the floor."""
        self.refresh()
        a = self._frames
        self._from_base()
        tool = a["tool"].copy()
        tool[2] -= height
        x, y = self.base_pose()[:2].tolist()
        return {
            "pose": np.array([x, y, self.yaw]), "tool": tool, "tool_rotation": a["tool_rotation"].reshape(3, 3).copy(),
            "tool_in_base": a["seen"].copy(), "tool_rotation_in_base": a["turned"].reshape(3, 3).copy(),
        }  # fmt: skip

    def joints(self) -> dict[str, float]:
        """True joint angles [rad] by name."""
        positions = self.data.qpos.tolist()
        return {name: positions[q] for name, (q, _) in self._joints.items()}

    def joint_speeds(self) -> dict[str, float]:
        """True joint speeds [rad/s] by name."""
        speeds = self.data.qvel.tolist()
        return {name: speeds[v] for name, (_, v) in self._joints.items()}


class WorldAccess:
    """What a plant hands on to its world: time, the fall, pushes."""

    world: World
    has_physics = True

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.world.time

    @property
    def fell(self) -> bool:
        """Whether the robot has fallen: see :attr:`World.fell`."""
        return self.world.fell

    @property
    def diverged(self) -> bool:
        """Whether positions are not finite: the physics cannot go on."""
        return self.world.diverged

    @property
    def rests(self) -> bool:
        """Whether nothing moves any more."""
        return self.world.rests

    @property
    def fall_reason(self) -> str:
        """What counts as the fall, in words; empty while there is none."""
        if not self.fell:
            return ""
        if self.diverged:
            return "numbers of the simulation are not finite"
        tilt, limit = np.degrees([self.world.tilt, self.world.fall_tilt])
        return f"its base leaned by {tilt:.0f} deg, the limit is {limit:.0f} deg"

    @property
    def external(self) -> Hook | None:
        """Called before every physics step with (model, data)."""
        return self.world.external

    @external.setter
    def external(self, hook: Hook | None) -> None:
        self.world.external = hook

    def push(
        self, force: ArrayLike, torque: ArrayLike = NO_TORQUE, body: str | None = None, point: ArrayLike | None = None
    ) -> None:
        """Push a body until changed: see :meth:`World.push`."""
        self.world.push(force, torque, body, point)

    def end_pushes(self) -> None:
        """Push nothing any more."""
        self.world.end_pushes()
