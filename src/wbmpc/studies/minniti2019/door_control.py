"""A ball robot that opens a door: contact phases as modes, forces in the prediction, references over the horizon.

Phases: the end effector approaches (mode ``free`` up to the predicted touch, then contact with a door that gives way: the plan leans
before it touches), pushes (``moving``, or ``held`` while the door does not move); when the door is open it stops pushing (``relax``:
the force fades while the robot straightens up, so that it does not fall after the door), lets go, and goes back to where it started,
out of the door's way.
"""

from __future__ import annotations

import numpy as np

from wbmpc.arrays import Array
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.policy import Policy
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.ocp import Mode, ModeSchedule, Reference
from wbmpc.solver.results import Trajectory
from wbmpc.studies.minniti2019.door_tracker import RELAX, DoorTracker
from wbmpc.types import Observation

#: While it has not touched, the end effector is planned to touch no earlier than this [s].
SOON = 0.05
#: Before it has touched, the plan leans for no more than the first of these [N]. To lean forward the ball first rolls back, and a
#: plan that does so again and again, as if the touch were always imminent, never touches (seen at 24 N): while a touch is overdue,
#: that goes down to the second within :data:`OVERDUE` [s].
ANTICIPATED, OVERDUE = (16.0, 8.0), 2.0
#: A time [s] that no run reaches.
NEVER = 1e6
#: How fast [m/s] the end effector goes back when it has let go.
RETURN_SPEED = 0.3
#: Before this time [s] after the push has passed what the door resists a door that has not moved yet is planned to.
UNMOVED = 0.1
#: While it pushes, the body is before the panel anyway: a distance [m] that leaves its limit without effect.
FAR = 5.0
#: The push [N] of a touch that no plan knows yet: no plan pushes less than :data:`UNPLANNED` [N] that does.
FIRST, UNPLANNED = 4.0, 0.1
#: A planned force [N] that is none.
NO_FORCE = 1e-3
#: Solves start with a push so far [N] from its least, and with so much of what friction holds.
ROOM, WITHIN = 0.1, 0.95
#: Points of the references over the horizon.
POINTS = 27


class PossibleForce:
    """Where solves start from (:class:`wbmpc.mpc.guess.Guess`): with no force where the end effector is free now, and elsewhere with the last
    plan's, brought into the friction cone of the panel as it is believed to stand now. What an equality or a hard limit fixes would
    else keep a share of what it was until a full step is taken, and plans are rejected meanwhile: a light door, whose plan turns
    away from one solve to the next, left the robot without a plan until it fell. ``least`` [N]: push within the cone (None: there is
    no cone)."""

    def __init__(self, least: float | None = None) -> None:
        self._least = least

    def bind(self, mpc: MPC) -> None:
        self._mpc = mpc

    def __call__(self, t: float, x0: Array, trajectory: Trajectory) -> Trajectory | None:
        schedule = self._mpc.solver.schedule
        ends = np.maximum(trajectory.times[1:], t)
        free = np.array([schedule.modes[i].name == "free" for i in np.searchsorted(schedule.events, ends, "right")])
        forces = trajectory.u[:, -3:]
        possible = np.where(free[:, None], 0.0, forces)
        if self._least is not None and not free.all():
            possible[~free] = self._within_cone(np.maximum(trajectory.times[:-1], t)[~free], forces[~free])
        if not np.any(np.abs(possible - forces) > NO_FORCE):
            return None
        forces[:] = possible
        return trajectory

    def _within_cone(self, times: Array, forces: Array) -> Array:
        """The forces (n, 3) [N] of the world at ``times`` (n) [s], with as much push as they have, at least the least, and no more across it
        than friction holds."""
        assert self._least is not None
        cone = np.array([self._mpc.reference["cone"].at(t) for t in times])
        normals, friction = cone[:, :3], cone[:, 3]
        push = np.maximum(-np.sum(forces * normals, axis=1), self._least + ROOM)
        level = np.column_stack([-normals[:, 1], normals[:, 0]])
        most = WITHIN * friction / np.sqrt(2.0) * push
        side = np.clip(-np.sum(forces[:, :2] * level, axis=1), -most, most)
        rise = np.clip(-forces[:, 2], -most, most)
        return -np.column_stack([push[:, None] * normals[:, :2] + side[:, None] * level, rise])


class DoorController(DoorTracker):
    """The controller of the ball robot before a door: what its plans know of touch, door and push."""

    def _law(self, t: float, x: Array, policy: Policy | None, acts: bool = False) -> tuple[Array, Array]:
        """As of every ball robot; the push that goes with torques that are sent is kept. A touch that the plan does not know yet is
        pressed on at once: a hard tip would have left the panel before the next plan."""
        feedforward, target = super()._law(t, x, policy, acts)
        if acts and policy is not None:
            normal = self.geometry.directions(float(self.door[0]))[1]
            push = float(-normal @ policy.law(t, x)[-3:])
            if self.push.fastest and self.phase == "push" and push < UNPLANNED:
                jacobian = self._arm_jacobian(x[: self.robot.state.size])
                push, target = FIRST, target.copy()
                target[-jacobian.shape[1] :] += FIRST * (normal @ jacobian)
            self._asked.append(push)
        return feedforward, target

    def predict(self, t: float, until: float, plans: PolicyQueue) -> Observation:
        """As of every ball robot; phases and references over the horizon from then on are set."""
        start = super().predict(t, until, plans)
        self._look_ahead(start.t, plans)
        return start

    def schedule(self, now: float) -> ModeSchedule:
        """The modes from ``now`` [s] on. Terms name their modes: all must be in a schedule, if only in a far future."""
        order: tuple[Mode, ...]
        events: tuple[float, ...]
        free, push = self.modes["free"], self.modes["moving" if self.moving or now < self._loaded + UNMOVED else "held"]
        unforeseen = self.phase == "approach" and not self.contact.touching and self.push.fastest and not self.push.lead
        if self.phase == "release" or unforeseen:
            order, events = (free,), ()
        elif self.contact.touching:
            order, events = ((push, free), (self.push.give_up,)) if self.push.give_up > now else ((free,), ())
        else:
            order, events = (free, push), (self.predicted_touch(now),)
        others = [m for m in self.modes.values() if m not in order]
        return ModeSchedule((*order, *others), (*events, *(NEVER + k for k in range(len(others)))))

    def predicted_touch(self, now: float) -> float:
        """When the end effector will touch the panel [s], not before one period of the plan after ``now``."""
        assert self.measured is not None
        end_effector, velocity, _ = self._end_effector(self.measured.state)
        normal = self.geometry.directions(float(self.door[0]))[1]
        speed = max(float(normal @ velocity), 0.5 * self.push.speed)
        gap = -self.geometry.gap(end_effector, float(self.door[0]))
        return max(now + SOON, self.push.begin, self.measured.time + gap / speed)

    def _look_ahead(self, until: float, plans: PolicyQueue) -> None:
        mpc, schedule = self.mpc, self.schedule(until)
        times = until + np.linspace(0.0, mpc.ocp.horizon, POINTS)
        angles = self._angles(times, plans)
        normals = np.array([self.geometry.directions(a)[1] for a in angles])
        touch = self.touched if np.isfinite(self.touched) else (schedule.events or (np.inf,))[0]
        target = np.array([self.push.force(s - touch) if s >= touch else 0.0 for s in times])
        open_at = self._opens(times, angles)
        target = np.minimum(target, self.fades_from) * np.clip(1.0 - (times - open_at) / RELAX, 0.0, 1.0)
        if self.phase == "approach":
            target = np.minimum(target, self._anticipated(until))
        target = np.maximum(target - self.excess, 0.0)
        mpc.set_schedule(schedule)
        mpc.reference["end_effector"] = Reference.poses(times, self._path(times, angles), self.push.quaternion)
        mpc.reference["force"] = Reference(times, np.column_stack([normals, target]))
        if "cone" in mpc.ocp.terms:
            mpc.reference["cone"] = Reference(times, np.column_stack([normals, np.full(times.size, self.friction)]))
        if "approach" in mpc.ocp.terms:
            mpc.reference["approach"] = Reference(times, self._fastest(times)[:, None])
        if "panel" in mpc.ocp.terms:
            mpc.reference["panel"] = Reference(times, np.where(times < open_at, FAR, 0.0)[:, None])
        if "lean" in mpc.ocp.terms:
            mpc.reference["lean"] = Reference(times, -target[:, None] * normals[:, :2])

    def _fastest(self, times: Array) -> Array:
        """The limit (n) [m/s] of the speed of an end effector that comes to the panel, at ``times`` (n) [s]."""
        if self.phase not in ("approach", "push") or not self.push.fastest:
            return np.full(times.size, FAR)
        assert self.measured is not None
        gap = -self.geometry.gap(self._end_effector(self.measured.state)[0], float(self.door[0]))
        return self.push.fastest(max(gap, 0.0), np.maximum(times - self.measured.time, 0.0))

    def _opens(self, times: Array, angles: Array) -> float:
        """When [s] the door is open, by its angles [rad] at times [s] of the last plan: infinite if not within them."""
        if self.phase == "release":
            return self.released
        if self.phase == "push" and angles[-1] >= self.push.open:
            return float(times[np.argmax(angles >= self.push.open)])
        return float(self.relaxed)

    def _anticipated(self, now: float) -> float:
        """For which force [N] the plan leans before the touch, the less the longer that is overdue."""
        expected = self.push.begin - self.geometry.gap(self.push.start, 0.0) / self.push.speed
        return float(np.interp(now - expected, [0.0, OVERDUE], ANTICIPATED))

    def _angles(self, times: Array, plans: PolicyQueue) -> Array:
        """The door's angle [rad] at times [s]: as the last plan has it, or as it is now."""
        if not self.with_door or plans.current is None:
            return np.full(times.size, self.door[0])
        place = plans.current.x.shape[1] - 2
        return np.interp(times, plans.current.times, plans.current.x[:, place])

    def _path(self, times: Array, angles: Array) -> Array:
        """Where the end effector is to be while it is free (n, 3) [m]: on its way to the panel, or away from it."""
        push = self.push
        if self.phase == "release":
            behind = self._let_go - push.back * self.geometry.directions(float(self.door[0]))[1]
            corners = np.array([self._let_go, behind, push.start])
            gone = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
            at = RETURN_SPEED * (times - self.released)
            return np.column_stack([np.interp(at, gone, corners[:, i]) for i in range(3)])
        if self.phase in ("push", "relax"):  # contact was lost: after the panel
            return np.array([self.geometry.place(a, self.lever, push.start[2]) for a in angles])
        way = push.speed * np.clip(times - push.begin, 0.0, None)
        return push.start + np.minimum(way, push.reach)[:, None] * self.geometry.directions(0.0)[1]
