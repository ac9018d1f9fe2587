"""The swerve base with its arm in MuJoCo.

Choices (measured with MuJoCo 4.0): ellipsoid wheels; brakes as switched dry friction of 200 N m on the hinges with stiff constraint
settings. The rest is of :mod:`wbmpc.simulation.wheeled`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from wbmpc import lie
from wbmpc.bases.swerve.brakes import BRAKE_FORCE, BRAKE_TORQUE, Brakes
from wbmpc.bases.swerve.description import SwerveBaseDescription
from wbmpc.bases.swerve.messages import SwerveCommand, SwerveMeasurement
from wbmpc.bases.swerve.perturbation import StuckBrake, SwervePerturbation
from wbmpc.bases.swerve.slip_step import contact_slips
from wbmpc.checks import numbers
from wbmpc.errors import InputError, unknown_name
from wbmpc.kernel.step import bind
from wbmpc.robots import RobotDescription
from wbmpc.robots.couplings import put_followers
from wbmpc.simulation.arm import span
from wbmpc.simulation.contacts import ROLLING
from wbmpc.simulation.localization import Localization
from wbmpc.simulation.perturbation import Perturbation, clipped
from wbmpc.simulation.wheeled import TIRE, WheeledPlant, let_tires_slide
from wbmpc.simulation.world import TIMESTEP, Array
from wbmpc.types import Edit, Truth

#: Torque limits [N m] of wheel and steer drives whose effort the robot's file leaves out (Pankert et al., RA-L 2022, and its release).
WHEEL_TORQUE, STEER_TORQUE = 40.0, 20.0
#: Speed limits of wheel and steer drives over those that plans have from the robot's file (of the same robot: 11.52 over 10 rad/s and 5.76
#: over 5), and the limits [rad/s] of those that the file leaves out.
DRIVE_MARGIN, WHEEL_SPEED, STEER_SPEED = 1.152, 11.52, 5.76
#: Half width [m] of a wheel.
WHEEL_HALF_WIDTH = 0.02
#: Damping [N s/m] of a leg that slides: it is pushed in by 30 N at 0.3 m/s (assumed).
SLIDE_DAMPING = 100.0
#: Constraint settings of the brakes: soft ones would let a closed brake creep.
_BRAKE_SOLREF, _BRAKE_SOLIMP = [0.002, 1.0], [0.9999, 0.9999, 0.001, 0.5, 2.0]


def reject_two_wheels(description: RobotDescription) -> None:
    """Raise :class:`InputError` for a swerve base that cannot stand by itself."""
    assert isinstance(description.base, SwerveBaseDescription)
    if len(description.base.modules) < 3:
        raise InputError(
            f"{description.name}: it stands on 2 wheels, and would tip over: casters are not simulated; valid: 3 modules or "
            "more (odometry and 'wbmpc calibrate' take 2)"
        )


def drive_speeds(description: RobotDescription) -> dict[str, float]:
    """Speeds [rad/s] of the simulated wheel and steer drives of a swerve robot by joint, up to which they give their whole torque."""
    assert isinstance(description.base, SwerveBaseDescription)
    speed, modules = description.limits.velocity, description.base.modules
    unknown = {m.wheel: WHEEL_SPEED for m in modules} | {m.steer: STEER_SPEED for m in modules}
    return {n: DRIVE_MARGIN * speed[n] if n in speed else default for n, default in unknown.items()}


class SwervePlant(WheeledPlant):
    """Physics, drives, brakes and sensors of a swerve robot.

    ``state``: where it starts, by group (``base`` (x, y, yaw), ``leg``, ``steer``, ``wheel``, ``arm``) or as a vector
    of the planner's layout, as its encoders see it; left out: the description's home. ``edit`` changes the
    specification before it is compiled; ``lift`` [m] raises the start; ``settle`` [s]: time to sink into the tires
    before time 0. ``external`` is called before every physics step with (model, data). ``brakes``: those of the hinges.
    ``localization``: a source of global poses, which come with the messages.
    """

    Measurement = SwerveMeasurement
    perturbation: SwervePerturbation

    def __init__(
        self, description: RobotDescription, state: Mapping[str, ArrayLike] | ArrayLike | None = None,
        perturbation: Perturbation | None = None, seed: int = 0, timestep: float = TIMESTEP, *,
        edit: Edit | None = None, lift: float = 0.0, settle: float = 0.5, localization: Localization | None = None,
    ) -> None:  # fmt: skip
        if not isinstance(description.base, SwerveBaseDescription):
            raise InputError(f"{description.name}: this plant needs a swerve base")
        reject_two_wheels(description)
        self.description, self.base, self.timestep = description, description.base, timestep
        self.perturbation, self.localization = SwervePerturbation.of(perturbation, description), localization
        self._reject_brake_fault()
        modules, arm = self.base.modules, list(description.arm.joints)
        self._names = {
            "leg": [m.leg for m in modules if m.leg], "steer": [m.steer for m in modules],
            "wheel": [m.wheel for m in modules], "arm": arm,
        }  # fmt: skip
        self.make_world(seed, len(modules), edit, self._rated())
        holds = [BRAKE_FORCE if m.slide else BRAKE_TORQUE for m in modules if m.leg]
        self.brakes = Brakes(len(holds), self.perturbation.brake_delay, np.array(holds))
        self._held: Array | None = None  # what brakes hold, as the model has it
        self.start_sensors(self._zero_errors())
        self._place(self._groups(state), lift, settle)

    def _reject_brake_fault(self) -> None:
        fault, legs = self.perturbation.brake_fault, [m.leg for m in self.base.modules if m.leg]
        if isinstance(fault, StuckBrake) and fault.leg >= len(legs):
            valid = ", ".join(f"{i} ({n})" for i, n in enumerate(legs)) or "a robot with legs that move"
            raise InputError(
                f"plant.brake_fault.leg: {self.description.name} has no leg {fault.leg} with a brake; valid: {valid}"
            )

    # ------------------------------------------------------------------ building
    def build(self, spec: mujoco.MjSpec, edit: Edit | None) -> None:
        draw, friction = self.draw, self.stand_on_floor(spec)
        for i, module in enumerate(self.base.modules):
            radius = self.base.wheel_radius * float(draw.radius[i])
            spec.joint(module.wheel).parent.add_geom(
                name=f"contact_{module.wheel}", type=mujoco.mjtGeom.mjGEOM_ELLIPSOID,
                size=[radius, WHEEL_HALF_WIDTH, radius], condim=3, friction=friction, solref=TIRE, mass=0,
                rgba=[0, 0, 0, 0], group=3, **ROLLING,
            )  # fmt: skip
            self.add_load_sensor(spec, module.wheel, mujoco.mjtObj.mjOBJ_GEOM, f"contact_{module.wheel}")
            if module.leg:
                spec.joint(module.leg).damping = [SLIDE_DAMPING if module.slide else 1.0, 0, 0]
            self.drive_joint(spec, module.wheel, WHEEL_TORQUE, draw.wheel_lag[i])
            self.drive_joint(spec, module.steer, STEER_TORQUE, draw.mount_lag[i])
        self.finish(spec, edit)
        let_tires_slide(spec, [f"contact_{m.wheel}" for m in self.base.modules])

    def index(self) -> None:
        super().index()
        m, names = self.model, self._names
        self._v = {g: np.array([m.joint(n).dofadr[0] for n in part], dtype=int) for g, part in names.items()}
        driven = ("wheel", "steer", "arm")
        self._control = {g: span(np.array([m.actuator(n).id for n in names[g]], dtype=int)) for g in driven}
        rated = self._rated()
        self._drive_speed = {g: np.array([rated[n] for n in names[g]]) for g in driven}
        self._bind_slip(16)
        for dof in self._v["leg"]:
            m.dof_solref[dof], m.dof_solimp[dof] = _BRAKE_SOLREF, _BRAKE_SOLIMP

    def _bind_slip(self, room: int) -> None:
        """The step that reads contacts, of which there is ``room`` for so many."""
        m, d = self.model, self.data
        geoms = np.array([m.geom(f"contact_{n}").id for n in self._names["wheel"]], dtype=np.int64)
        bodies = m.geom_bodyid[geoms].astype(np.int64)
        wheels = {"geoms": geoms, "bodies": bodies, "roots": m.body_rootid[bodies].astype(np.int64)}
        own = {
            "touching": np.zeros((room, 2), dtype=np.int64), "distance": np.zeros(room), "at": np.zeros((room, 3)),
            "frame": np.zeros((room, 9)), "slip": np.zeros((len(geoms), 2)),
        }  # fmt: skip
        self._touching, read = own, {"cvel": d.cvel, "subtree_com": d.subtree_com, "xmat": d.xmat}
        self._contact_slips = bind(contact_slips, wheels | read | own, n=len(geoms))

    def _rated(self) -> dict[str, float]:
        """Speeds [rad/s] up to which the drives give their whole torque."""
        speed = self.description.limits.velocity
        return drive_speeds(self.description) | {n: speed.get(n, np.inf) for n in self._names["arm"]}

    def _zero_errors(self) -> dict[str, Array]:
        (leg, steer), n = self.draw.mount_offset, len(self._names["leg"])
        wheel = np.zeros(len(self._names["wheel"]))
        return {"leg": leg[:n], "steer": steer, "wheel": wheel, "arm": self.draw.arm_offset}

    def _groups(self, state: Mapping[str, ArrayLike] | ArrayLike | None) -> dict[str, Array]:
        """Start by group, (x, y, yaw) for the base."""
        home = {g: np.array([self.description.home.get(n, 0.0) for n in names]) for g, names in self._names.items()}
        groups: dict[str, Array] = {"base": np.zeros(3), **home}
        if isinstance(state, Mapping):
            start = {g: np.asarray(v, float) for g, v in state.items()}
        elif state is None:
            start = {}
        else:
            sizes = {"base": 7 if self.base.orientation == "quaternion" else 3, **{g: len(v) for g, v in home.items()}}
            vector, stops = numbers("start", "state", state, sum(sizes.values())), np.cumsum(list(sizes.values()))
            start = dict(zip(sizes, np.split(vector, stops[:-1]), strict=True))
        for group, values in start.items():
            if group not in groups:
                raise unknown_name("group of the state", group, groups)
            if group == "base" and values.size == 7:
                yaw = lie.rotation_to_euler_zyx(lie.quaternion_to_rotation(values[3:7]))[0]
                values = np.array([values[0], values[1], yaw])
            groups[group] = numbers("start", f"state.{group}", values, groups[group].size)
        return groups

    def _place(self, state: dict[str, Array], lift: float, settle: float) -> None:
        d, (x, y, yaw) = self.data, state["base"]
        pose = np.array([x, y, 0.0, *lie.quaternion_about([0.0, 0.0, 1.0], yaw)])
        self.world.place(pose)
        for group, index in self._q.items():
            d.qpos[index] = state[group] - self.offsets[group]
        pose[2] = self._standing_height() + lift
        self.world.place(pose)
        self._advance_brakes()
        self.settle(settle)

    def arrange(self, state: Array) -> None:
        """Put the bodies where a planner's state (nx) has them, for pictures: no physics, no offsets."""
        d, groups = self.data, self._groups(state)
        x, y, yaw = groups["base"]
        pose = np.array([x, y, self.world.base_pose()[2], *lie.quaternion_about([0.0, 0.0, 1.0], yaw)])
        self.world.place(pose)
        for group, index in self._q.items():
            d.qpos[index] = groups[group]
        put_followers(self.model, d)
        pose[2] = self._standing_height()
        self.world.place(pose)
        mujoco.mj_kinematics(self.model, d)

    def _standing_height(self) -> float:
        """Height [m] of the base at which its wheels touch the floor on average, for the joints as they are."""
        mujoco.mj_kinematics(self.model, self.data)
        wheels = [self.model.geom(f"contact_{m.wheel}").id for m in self.base.modules]
        below = self.data.geom_xpos[wheels, 2] - self.model.geom_size[wheels, 0]
        return float(self.world.base_pose()[2] - below.mean())

    # ------------------------------------------------------------------ running
    def _advance_brakes(self) -> None:
        held = self.brakes.advance(self.timestep)
        if held is not self._held:
            self.model.dof_frictionloss[self._v["leg"]] = self._held = held

    def step(self, command: SwerveCommand, steps: int = 1) -> None:
        """Hold a command for ``steps`` physics steps. Drives clip at their speed limits, one by one."""
        d, names = self.data, self._names
        n = len(names["wheel"])
        wheel, steer = numbers("command", "wheel", command.wheel, n), numbers("command", "steer", command.steer, n)
        arm = numbers("command", "arm", command.arm, len(names["arm"]))
        legs = len(names["leg"])
        # fixed legs have no brakes: what is commanded to them is ignored
        brake = numbers("command", "brake", command.brake, legs if legs else np.size(command.brake))[:legs]
        self.world.refresh()
        control = d.ctrl
        for group, speeds in (("wheel", wheel), ("steer", steer), ("arm", arm)):
            control[self._control[group]] = clipped(speeds, self._drive_speed[group])
        self.brakes.command(brake)
        fault = self.perturbation.brake_fault
        if isinstance(fault, StuckBrake) and self.time >= fault.time:
            self.brakes.fail(fault.leg, fault.kind)
        rest = self.brakes.rests and self.brakes.held is self._held
        for part in (steps,) if rest else (1,) * steps:
            self._advance_brakes()
            self.world.advance(self._carry, part, self._keep)
        self.world.check()

    def encoders(self) -> Array:
        """Also with noise of the steering."""
        raw, noise = super().encoders(), self.perturbation.steer_noise
        if noise > 0.0:
            steer = self._parts["steer"]
            raw[steer] += noise * self._noise.normal(size=steer.stop - steer.start)
        return raw

    def observed(self) -> dict[str, Any]:
        """A global pose, where there is a localization."""
        source = self.localization
        return {"place": None if source is None else source.observe(self.time, self._planar_pose)}

    # ------------------------------------------------------------------ truth
    def _planar_pose(self) -> Array:
        """True (x, y, yaw) of the base."""
        return np.array([*self.world.base_pose()[:2], self.world.yaw])

    def truth(self) -> Truth:
        frames = self.world.frames(height=0.0)
        d = self.data
        pose = frames["pose"] if self.base.orientation == "yaw" else self.world.base_pose().copy()
        along = self._slip()
        return Truth(
            time=self.time, **frames, tilt=self.world.tilt, state=np.concatenate([pose, d.qpos[self._all]]),
            joints=self.world.joints(), joint_speeds=self.world.joint_speeds(), slip=np.hypot(along[:, 0], along[:, 1]),
            wheel_force=np.abs(d.sensordata[self._forces]),
        )  # fmt: skip

    def _slip(self) -> Array:
        """Velocity (n, 2) [m/s] of each wheel's contact point over the floor, along the wheel and along its axle.

        Of several contacts of one wheel the deepest counts; a wheel in the air has none.
        """
        contacts, count = self.data.contact, self.data.ncon
        if count > len(self._touching["distance"]):
            self._bind_slip(2 * count)
        a = self._touching
        a["touching"][:count], a["distance"][:count] = contacts.geom, contacts.dist
        a["at"][:count], a["frame"][:count] = contacts.pos, contacts.frame
        self._contact_slips(count)
        return np.array(a["slip"], float)
