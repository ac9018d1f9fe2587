"""What simulated robots on wheels share beside the arm: a free body, a floor and an inertial unit in MuJoCo. Wheels and what carries
them are a base type's own.

Wheels are driven by velocity servos under the `discrete` integrator, and touch the floor in three-dimensional contacts whose
softness is that of tires.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, ClassVar

import mujoco
import numpy as np

from wbmpc.bases.base import WHEELS
from wbmpc.model.tree import read_tree
from wbmpc.simulation.arm import ArmPlant, span
from wbmpc.simulation.contacts import FLOOR
from wbmpc.simulation.payloads import add_body_payload, incline
from wbmpc.simulation.perturbation import WheeledPerturbation
from wbmpc.simulation.world import Array, add_drive, add_floor, add_light, free_body, set_options
from wbmpc.types import Edit

#: Contact softness of the tires (time constant [s], damping ratio): the odometry's scale, radius less half the sink.
TIRE = [0.01, 1.0]
#: The same for tires that slide (:func:`let_tires_slide`): stiffness [1/s²] and damping [1/s] over the apparent mass, decay [1/s] of what
#: creeps, impedance, and ratio of friction's impedance to it. Stiffness and creep under a load are those of :data:`TIRE`.
SLIDING_STIFFNESS, SLIDING_DAMPING, CREEP_DECAY, SLIDING_IMPEDANCE, SLIDING_RATIO = 9e4, 200.0, 222.0, 0.01, 1e4
#: Gain [N m s/rad] of the wheels' servos.
WHEEL_GAIN = 100.0
#: Interval [s] that sets the noise of the inertial unit's first sample.
_IMU_INTERVAL = 0.0025


def let_tires_slide(spec: mujoco.MjSpec, tires: list[str]) -> None:
    """Contacts of the geoms ``tires`` with all that they roll on, in place, whose load does not depend on how fast they slide.

    MuJoCo's friction cone pushes surfaces apart that slide on each other, by impedance × friction × decay × speed: with usual settings a
    wheel that turns about at 0.1 m/s would lift its corner of a base on four wheels. A small impedance makes that force small; a stiffer
    spring and friction of a higher ratio keep everything else.
    """
    impedance = SLIDING_IMPEDANCE
    spec.option.impratio = SLIDING_RATIO
    ground = [g for g in spec.geoms if g.contype == FLOOR]
    for k, geom in enumerate(ground):
        geom.name = geom.name or f"wbmpc_ground_{k}"
    for tire in (spec.geom(name) for name in tires):
        for geom in ground:
            slide, spin, roll = np.maximum(geom.friction, tire.friction)
            spec.add_pair(
                geomname1=geom.name, geomname2=tire.name, condim=3, friction=[slide, slide, spin, roll, roll],
                solref=[-SLIDING_STIFFNESS, -SLIDING_DAMPING], solreffriction=[-1.0, -CREEP_DECAY * impedance],
                solimp=[impedance, impedance, 0.001, 0.5, 2.0],
            )  # fmt: skip


class WheeledPlant(ArmPlant):
    """Subclasses also set ``base`` (its ``body``); their wheels are a group of joints."""

    #: what :meth:`measure` gives: a time [s], positions by group, and keys
    Measurement: ClassVar[Callable[..., Any]]
    base: Any
    perturbation: WheeledPerturbation

    # ------------------------------------------------------------------ building
    def stand_on_floor(self, spec: mujoco.MjSpec) -> list[float]:
        """Perturbed masses, a floor, a free body; gives the friction (slide, spin, roll) of what rolls."""
        self.draw.apply_to_bodies(spec, balanced={spec.joint(n).parent.name for n in self._names[WHEELS]})
        set_options(spec, self.timestep, mujoco.mjtIntegrator.mjINT_DISCRETE)
        friction = [self.draw.friction, 0.005, 1e-4]
        add_floor(spec, 3, friction, TIRE)
        free_body(spec, self.base.body, self.description.source).add_freejoint(name="root")
        add_light(spec.body(self.base.body))
        return friction

    def drive_joint(self, spec: mujoco.MjSpec, name: str, effort: float, lag: float) -> None:
        """The servo of a wheel's or a steering joint with a ``lag`` [s], up to ``effort`` [N m] where the robot's file has no limit."""
        joint = spec.joint(name)
        joint.armature, joint.frictionloss = 0.03, self.perturbation.dry_friction
        effort = self.description.limits.effort.get(name, effort)
        add_drive(spec, name, name, mujoco.mjtTrn.mjTRN_JOINT, effort, lag, WHEEL_GAIN)

    @staticmethod
    def add_load_sensor(spec: mujoco.MjSpec, wheel: str, kind: mujoco.mjtObj, name: str) -> None:
        """What a ``wheel`` carries: net force of all that touches a body, or a geom, in world axes (data: force; reduction 3: net force)."""
        spec.add_sensor(
            name=f"contact_{wheel}", type=mujoco.mjtSensor.mjSENS_CONTACT, objtype=kind, objname=name,
            intprm=[1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), 3, 1],
        )  # fmt: skip

    def finish(self, spec: mujoco.MjSpec, edit: Edit | None) -> None:
        """Also the inertial unit, and what the perturbation adds to the body and the floor."""
        self._add_imu(spec)
        p = self.perturbation
        if p.body_payload > 0.0:
            add_body_payload(spec, self.base.body, p.body_payload)
        if p.slope > 0.0:
            incline(spec, p.slope, self.draw.downhill)
        super().finish(spec, edit)

    def _add_imu(self, spec: mujoco.MjSpec) -> None:
        site = "imu" if any(s.name == "imu" for s in spec.sites) else "wbmpc_imu"
        if site == "wbmpc_imu":
            linked = any(b.name == "imu" for b in spec.bodies)
            place = read_tree(spec, self.base.body).place_on(self.base.body, "imu") if linked else None
            spec.body(self.base.body).add_site(name=site, pos=np.zeros(3) if place is None else place[0])
        for name, kind in (("gyro", mujoco.mjtSensor.mjSENS_GYRO), ("accel", mujoco.mjtSensor.mjSENS_ACCELEROMETER)):
            spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=site)

    def index(self) -> None:
        super().index()
        m = self.model
        self._imu = span(np.concatenate([m.sensor(n).adr[0] + np.arange(3) for n in ("gyro", "accel")]))
        self._forces = np.array([m.sensor(f"contact_{n}").adr[0] + 2 for n in self._names[WHEELS]], dtype=int)

    def start_sensors(self, offsets: dict[str, Array]) -> None:
        """Also the inertial unit, and torques of the arm's drives."""
        super().start_sensors(offsets)
        limits = self.description.limits.effort
        self._effort_noise = self.perturbation.effort_noise * np.array([limits.get(n, 0.0) for n in self._names["arm"]])
        self._effort_rng = self._noise.spawn(1)[0]  # of its own: noise of other sensors is what it is without
        p, draw = self.perturbation, self.draw
        self._bias = np.concatenate([draw.gyro_bias, draw.accel_bias])
        self._density = np.repeat([p.gyro_noise, p.accel_noise], 3), np.repeat([p.gyro_walk, p.accel_walk], 3)

    def _averaged(self) -> list[int]:
        """The accelerometer, whose filter lets no vibrations through."""
        return [int(i) for i in np.arange(self.model.nsensordata)[self._imu][3:]]

    def counts(self, group: str) -> int:
        """Those of the arm, or of the base."""
        return self.perturbation.arm_counts if group == "arm" else self.perturbation.encoder_counts

    # ------------------------------------------------------------------ running
    def measure(self) -> Any:
        """Encoder positions (quantized, with their zero errors, up to the jitter old; all joints of a message share one age), the inertial
        unit, and torques of the arm's drives. Asking twice at the same time gives the same message."""
        if self._last is None or self._last.time != self.time:
            self.world.refresh()
            read, imu = self.quantized(self.encoders()), self.inertial()
            positions = {group: read[part] for group, part in self._parts.items()}
            more = self.observed()
            self._last = self.Measurement(self.time, **positions, **imu, **more, effort=self.efforts())
        return self._last

    def observed(self) -> dict[str, Any]:
        """What else a message has, by name."""
        return {}

    def efforts(self) -> Array:
        """Torques (m) [N m or N] of the arm's drives in the last physics step as they report them, with what is fed forward to each joint
        and to those that follow it."""
        d, n = self.data, len(self._names["arm"])
        applied = d.qfrc_applied[self._arm_dofs]
        carried = applied[:n] if applied.size == n else applied[:n] + self._shares @ applied[n:]
        noise = self._effort_noise * self._effort_rng.standard_normal(n)
        read: Array = self.draw.effort_gain * (d.actuator_force[self._arm_drives] + carried) + noise
        return read

    def inertial(self) -> dict[str, Array]:
        """ "gyro" [rad/s] now and "accel" [m/s²], the mean since the last message (3 each), with walking biases and the noise of a sample that
        stands for that time."""
        interval = _IMU_INTERVAL if self._last is None else self.time - self._last.time
        (noise, walk), root = self._density, math.sqrt(interval)
        draws = self._noise.normal(size=(2, 2, 3))
        self._bias = self._bias + walk * root * draws[:, 0].ravel()
        shown = self.data.sensordata[self._imu].copy()
        if self._sums[3] > 0.0:
            shown[3:] = self._sums[:3] / self._sums[3]
        self._sums[:] = 0.0
        reading: Array = shown + self._bias + noise / root * draws[:, 1].ravel()
        return {"gyro": reading[:3], "accel": reading[3:]}
