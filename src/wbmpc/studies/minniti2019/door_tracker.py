"""What a ball robot knows of a door: the force on its end effector, the contact, the phase, the door's angle, place and impedance.

A contact is one when the debounced force says so; plans made without it have no wrench (one made before, which goes on while newer ones
are rejected, still has). A sensor that says nothing cannot be distinguished from an end effector that is free, nor a frozen one from an
end effector that pushes; so its numbers must change, and they are compared with the force that the momentum observer finds without it.
Before the end effector starts it touches nothing, whatever the sensor says: that is its zero. An end effector whose sensor is not
believed lets go, as one does that has found no door in time; the force is zero from then on.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.messages import BallMeasurement
from wbmpc.control.monitor import SimpleFault
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Mode
from wbmpc.studies.minniti2019.contact import ContactDetector
from wbmpc.studies.minniti2019.door_filter import DoorFilter, DoorNoise, LeverFit
from wbmpc.studies.minniti2019.door_model import FADE_TIME, DoorGeometry, arm_jacobian, end_effector_motion, place_of
from wbmpc.studies.minniti2019.door_plant import HALF_THICKNESS
from wbmpc.studies.minniti2019.force import ForceMonitor, ForceReadings
from wbmpc.studies.minniti2019.grip import SPEED_TIME, GripEstimator
from wbmpc.studies.minniti2019.momentum import SensorlessForce

_LOG = logging.getLogger("wbmpc")
#: Least and largest impedance that the optimizer is given (inertia, damping, resistance).
BOUNDS = np.array([0.5, 0.1, 0.1]), np.array([50.0, 200.0, 50.0])
#: How long [s] the force fades when the door is open.
RELAX = 0.8
#: A door that was let go is believed to open no farther [rad]: nothing measures it.
OPENS = 0.5 * np.pi
#: A door moves when it is faster than this [rad/s] on average over :data:`SPEED_TIME`, and rests below a third of it.
MOVING = 0.03
#: Above this rate [rad/s] the motion shows its impedance.
SLIDING = 0.06
#: Of way [m], speed [m/s] and force [N/√Hz] at the tip.
TIP_NOISE = DoorNoise(angle=1.4e-3, rate=0.035, torque=0.07)
#: How much of the resistance that was estimated is taken for a closer's, which brings the door back, and not for dry friction.
#: A door is taken to come back no faster than at the last [rad/s], however it was estimated.
CLOSER_SHARE, MAX_CLOSING = 0.5, 0.5
#: Forces [N] at which a contact begins, at once, and ends that the end effector comes to slowly, and after how long [s] without a force: what
#: inertia the sensor carries hardly counts, and a hard tip bounces until the plan presses it on. A soft one may lean on the panel with less
#: than the first for a tenth of a second.
LIGHT = {"on": 0.8, "off": 0.4, "debounce": 0.0, "release": 0.06, "mean_time": 0.01}
#: The push is corrected by what is measured within this time [s]; of so many torques it is known which push went with them.
EXCESS_TIME, ASKED = 0.05, 16


def modes(door: bool) -> dict[str, Mode]:
    """The modes by name; ``door``: whether the door is part of the dynamics."""
    value = lambda moves: {"door": [moves]} if door else {}
    return {
        "free": Mode("free", value(1.0)),
        "held": Mode("held", value(0.0)),
        "moving": Mode("moving", value(1.0)),
    }


@dataclass(frozen=True)
class Push:
    """What is to be done: ``force`` (t since touch [s]) [N] along the normal; the end effector starts from ``start`` (3) [m] at time
    ``begin`` [s] with ``speed`` [m/s] towards the panel; it lets go at ``open`` [rad] or, touch or not, at time ``give_up`` [s]
    and backs off by ``back`` [m]; it goes no farther than ``reach`` [m]. ``tip_weight`` [N]: of what the force sensor carries;
    ``fastest`` (gap [m], times (n) [s]) [m/s]: limits of the speed so long after the end effector was so far before the panel (None: no
    limit); ``lead`` [m]: how far ahead of an end effector that has not touched the panel is believed to be at least, 0 with a limit: the plan
    knows of no touch before it is felt; ``friction``: coefficient
    that is planned with, at first if the robot ``learns`` it."""

    force: Callable[[float], float]
    start: Array
    quaternion: Array
    begin: float
    speed: float
    open: float
    give_up: float
    back: float
    reach: float
    tip_weight: float
    fastest: Callable[[float, Array], Array] | None
    lead: float
    friction: float
    learns: bool


class DoorTracker(BallController):
    """A controller that follows phase and state of a door. ``geometry``: where it believes the door to be; it learns the closed panel's
    place when it touches it, and how far its hinge is from the end effector's way. ``door`` (2): angle [rad] and rate [rad/s] of the door;
    ``phase``: approach, push, relax or release."""

    def __init__(
        self, robot: RobotModel, mpc: MPC, push: Push, geometry: DoorGeometry, impedance: Array, identify: bool,
        *args: Any, **more: Any,
    ) -> None:  # fmt: skip
        super().__init__(robot, mpc, *args, **more)
        self.push, self.geometry = push, geometry
        self.lever = geometry.lever(push.start, 0.0)
        self.filter = DoorFilter(impedance / self._at_tip, TIP_NOISE)
        self.impedance, self.identify = np.array(impedance, float), identify
        self.with_door = "door" in mpc.ocp.dynamics.state
        self.modes = modes(self.with_door)
        self.contact, self.sensor = (ContactDetector(**LIGHT) if push.fastest else ContactDetector()), ForceMonitor()
        self.phase = "approach"
        self.force = np.zeros(3)  # of the world on the end effector, world axes [N]
        self.door = np.zeros(2)
        self.touched = self.relaxed = self.released = np.inf
        self.fades_from = np.inf  # the push [N] when it began to fade: a door that ran away took less than was wanted
        self._loaded = np.inf  # when the push passed what the door resists [s]
        self.fit, self._on_panel = LeverFit(geometry.lever(push.start, 0.0)), 0.0  # time [s] of the last touch
        self.moving, self._mean_rate = False, 0.0
        self._end_effector = end_effector_motion(robot)
        self.sensorless = SensorlessForce(robot)
        self.grip, self.sliding = GripEstimator(push.friction), np.zeros(2)
        self._let_go = push.start
        self._arm_jacobian = arm_jacobian(robot)
        self._seen = 0.0  # the measured push [N], as late as the estimated one
        self._asked: deque[float] = deque(maxlen=ASKED)  # pushes [N] that went with the last torques
        self.excess = 0.0  # by how much [N] the push is more than that

    # ------------------------------------------------------------------ state
    def _step(self, x: Array, u: Array, h: float) -> Array:
        """Robot (and door, where x has it) after h seconds under torques u and the measured force."""
        n = self.robot.state.size
        whole = np.concatenate([x, self.door]) if self.with_door and x.size == n else x
        after = self.mpc.solver.simulate(whole, np.concatenate([u, self.force]), h)
        return after[: x.size]

    def measure(self, measurement: BallMeasurement) -> None:
        """State, force, contact and door of this tick."""
        if measurement.force.size:
            self._read_force(measurement)
        super().measure(measurement)
        assert self.measured is not None
        motion = self._end_effector(self.measured.state)
        acted = self.sent.acted(self._late())
        self.sensorless.update(self.measured.state, acted, self.period, self.learned.carried)
        if measurement.time < self.push.begin:
            self.sensorless.observer.zero()
        self._compare(measurement.time)
        self._follow(measurement.time, *motion[:2])
        self._judge_grip(measurement.time, motion)
        self._learn_excess()

    def _pushed(self) -> Array:
        return self.force[:2]

    def _monitor_encoders(self, t: float, arm: Array, h: float) -> None:
        """While the end effector touches, a slow panel may hold a joint still, by forces that are measured late and with noise: the model
        cannot say then that an arm's encoder stands."""
        super()._monitor_encoders(t, arm, h)
        if self.contact.touching:
            self._accelerates = None

    def _read_force(self, m: BallMeasurement) -> None:
        """The contact force in world axes, with the last known attitude of the end effector; zero if the sensor is not believed. Before
        it starts the end effector touches nothing: what the sensor reads then is its zero."""
        known, free = self.sensor.fault, m.time < self.push.begin
        if not free:
            self.sensor.tare()
        reading = self.sensor.judge(self.period, m.force)
        if self.sensor.fault:
            if not known:
                self._distrust(m.time)
            return
        state = self.measured.state if self.measured is not None else self.robot.home
        rotation = lie.quaternion_to_rotation(self.robot.pose(state)[1])
        force = rotation @ reading + np.array([0.0, 0.0, self.push.tip_weight])
        if free:
            self.sensor.rest(self.period, rotation.T @ force)
            return
        normal = self.geometry.directions(float(self.door[0]))[1]
        touching = self.contact.update(m.time, float(-normal @ force))
        self.force = force if touching else np.zeros(3)

    def _compare(self, t: float) -> None:
        """The sensor's force against the one that the motion says, along the panel's normal: both as late as the latter, for the force of a
        touch grows within that time."""
        touching, normal = self.contact.touching, self.geometry.directions(float(self.door[0]))[1]
        estimated = float(-normal @ self.sensorless.force)
        self._seen += self.sensorless.observer.share(self.period) * (float(-normal @ self.force) - self._seen)
        measured = self._seen
        watched = t >= self.push.begin and (touching or self.phase != "release")
        for fault in self.sensor.update(
            ForceReadings(t, self.period, touching, measured, estimated if watched else measured)
        ):
            self._distrust(fault.time)

    def _distrust(self, t: float) -> None:
        """The sensor has a fault: there is neither force nor contact any more."""
        self._report(self.sensor.fault, t)
        self.force, self.contact.touching = np.zeros(3), False

    def _report(self, fault: str, t: float) -> None:
        """A force sensor that is not believed, a door that was not there."""
        self._found.append(SimpleFault(t, fault))
        _LOG.warning("%s", self._found[-1])

    def _follow(self, t: float, end_effector: Array, velocity: Array) -> None:
        """Phase and door."""
        touching = self.contact.touching
        if touching and self.phase == "approach":
            self.phase, self.touched = "push", t
            self.fit.first, self._on_panel = end_effector.copy(), t
        if touching and self.phase == "push" and np.linalg.norm(self.force) > LIGHT["on"]:  # not in a bounce
            self._place_door(t, end_effector)
        elif self.phase == "approach" and not touching:
            self._not_there(end_effector)
        if touching and self.geometry.touches(end_effector):
            angle = self.geometry.angle(end_effector)
            self.door = np.array([angle, self.geometry.rate(end_effector, velocity, angle)])
        elif self.phase == "push" or self.door[1] > 0.0:  # one that was let go does not stop at once
            self.door = self._coasting(end_effector, velocity)
        else:
            self.door = np.array([max(self.door[0] - self._closing() * self.period, 0.0), 0.0])
        limit = MOVING / 3.0 if self.moving else MOVING
        share = 1.0 - np.exp(-self.period / SPEED_TIME)
        self._mean_rate = self._mean_rate + share * (self.door[1] - self._mean_rate) if touching else 0.0
        self.moving = bool(touching and abs(self._mean_rate) > limit)
        self._identify(end_effector)
        if self.phase == "push" and (self.door[0] >= self.push.open or t >= self.push.give_up - RELAX):
            self.phase, self.relaxed, self.fades_from = "relax", t, max(self._seen, 0.0)
        if self.phase != "release" and self._ends(t):
            self.phase, self.released, self._let_go = "release", t, end_effector.copy()

    @property
    def friction(self) -> float:
        """The friction coefficient that is planned with; infinite without a cone."""
        return self.grip.bound if self.push.learns else self.push.friction

    def _judge_grip(self, t: float, motion: tuple[Array, Array, Array]) -> None:
        """Whether the end effector slides, the grip of the panel, and whether the push is enough to move it."""
        angle, rate = self.door
        normal = self.geometry.directions(angle)[1]
        push = float(-normal @ self.force) if self.phase in ("push", "relax") else 0.0
        self.sliding = self.geometry.sliding(motion, angle, rate, HALF_THICKNESS)
        across = float(np.linalg.norm(self.force + push * normal))
        self.grip.update(self.period, push, across, self.sliding)
        if push * self.lever > self.impedance[2]:
            self._loaded = min(self._loaded, t)

    def _coasting(self, end_effector: Array, velocity: Array) -> Array:
        """Angle and rate of a door that has run away from the end effector: it slows down as its impedance says, and is at least
        as far open as the end effector is, which does not touch it."""
        inertia, damping, resistance = self.impedance
        rate = max(self.door[1] - (damping * self.door[1] + resistance) / inertia * self.period, 0.0)
        angle = min(self.door[0] + rate * self.period, max(self.door[0], OPENS))
        if self.geometry.touches(end_effector) and (reached := self.geometry.angle(end_effector)) > angle:
            angle, rate = reached, max(rate, self.geometry.rate(end_effector, velocity, reached))
        return np.array([angle, rate])

    def _closing(self) -> float:
        """How fast [rad/s] a door that was let go is taken to come back: nothing measures it any more."""
        if self.phase != "release":
            return 0.0
        _, damping, resistance = self.impedance
        return float(min(CLOSER_SHARE * resistance / damping, MAX_CLOSING))

    def _place_door(self, t: float, end_effector: Array) -> None:
        """The door's place after another place of an end effector (3) [m] that touches it at time t [s]; the closed panel is where it was
        touched."""
        along, normal = self.geometry.directions(0.0)
        interval, self._on_panel = t - self._on_panel, t
        apart = max(interval - 1.5 * self.period, 0.0)
        self.fit.update(interval, apart, end_effector, along, normal, HALF_THICKNESS)
        before = self.lever
        self.lever = self.fit.now
        hinge = self.fit.first - self.fit.lever * along + self.geometry.offset * normal
        known, self.geometry = self.geometry, replace(self.geometry, hinge=(float(hinge[0]), float(hinge[1])))
        if known.touches(end_effector) and self.geometry.touches(end_effector):
            self.filter.shift(self.lever * self.geometry.angle(end_effector) - before * known.angle(end_effector))

    def _not_there(self, end_effector: Array) -> None:
        """An end effector (3) [m] that touches nothing is before the panel: one that comes slowly would else stop where the panel is believed to
        be."""
        past = self.geometry.gap(end_effector, 0.0) + self.push.lead
        if self.push.fastest and past > 0.0:
            self.geometry = self.geometry.moved(past)

    def _ends(self, t: float) -> bool:
        """Whether the end effector lets go, or turns back: it has stopped pushing, it took too long, or its force sensor is not believed."""
        if self.sensor.fault:
            return True
        if self.phase == "approach" and t >= self.push.give_up:
            self._report("the end effector has found no door", t)
        relaxed = self.phase == "relax" and (t >= self.relaxed + RELAX or not self.contact.touching)
        return bool(t >= self.push.give_up or relaxed)

    @property
    def _at_tip(self) -> Array:
        """A door's inertia, damping and resistance over what the tip feels of them: mass [kg], damping [N s/m], force [N]."""
        return np.array([self.lever**2, self.lever**2, self.lever])

    def _identify(self, end_effector: Array) -> None:
        """The door's impedance, while it moves and is pushed: as the tip feels it, for its way and force do not change with what is
        learned of the lever."""
        angle, rate = float(self.door[0]), float(self.door[1])
        way, speed = self.lever * angle, self.lever * rate
        if self.phase != "push" or not self.moving or rate < SLIDING:
            self.filter.rest(way, max(speed, 0.0))
            return
        push = float(-self.geometry.directions(angle)[1] @ self.force)
        self.filter.update(self.period, self.geometry.lever(end_effector, angle) / self.lever * push, way, speed)
        if self.identify:
            inertia, damping, resistance = np.clip(self.filter.impedance * self._at_tip, *BOUNDS)
            self.impedance = np.array([inertia, min(damping, inertia / FADE_TIME), resistance])

    def parameters(self) -> dict[str, Array]:
        """The model's parameters: with the door's place and impedance where it is part of the model."""
        own = super().parameters()
        return {**own, "place": place_of(self.geometry), "impedance": self.impedance} if self.with_door else own

    def state(self) -> Array:
        """The measured state brought up to now, with the door's."""
        x = super().state()
        return np.concatenate([x, self.door]) if self.with_door else x

    def _learn_excess(self) -> None:
        """The push that is measured against the one that the plan has with the same torques: an end effector that is believed to move
        while it stands presses harder or less."""
        late = self._late()
        if self.phase != "push" or not self.contact.touching or late >= len(self._asked):
            self.excess = 0.0
            return
        push = float(-self.geometry.directions(float(self.door[0]))[1] @ self.force)
        self.excess += self.period / EXCESS_TIME * (push - self._asked[-1 - late] - self.excess)
