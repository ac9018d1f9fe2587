"""What a closed loop among obstacles does at every tick, and what is measured of it.

How long a robot stands away from its reference, and how long it goes back before somebody who comes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.bases.base import Reshaping, System
from wbmpc.errors import RobotStuck, WayDeclined
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.alternatives import WAITS, Alternatives
from wbmpc.mpc.reference_pacing import PacedReferences
from wbmpc.recording.observer import end_effector_goal
from wbmpc.result import Metric, Plot, Series
from wbmpc.simulation.obstacles import SimulatedObstacles
from wbmpc.tasks.perception import Perception

#: Who moves within this [m] stands.
STANDS = 0.05
#: Who goes back from an obstacle within this [m], with this share of its speed at least, is driven back by it; pauses [s] that do not count.
NEAR, SHARE, PAUSE = 0.3, 0.5, 0.3


class Standing:
    """``longest`` [s]: the longest time in which somebody who ``waits`` stayed near the place where it then was."""

    def __init__(self) -> None:
        self.longest = 0.0
        self._places: deque[tuple[float, Array]] = deque()

    def update(self, t: float, place: Array, waits: bool) -> None:
        """At ``t`` [s] it is at ``place`` (3) [m]."""
        if not waits:
            self._places.clear()
            return
        self._places.append((t, place.copy()))
        while np.linalg.norm(self._places[0][1] - place) > STANDS:
            self._places.popleft()
        self.longest = max(self.longest, t - self._places[0][0])


class DrivenBack:
    """``longest`` [s]: the longest time in which a robot went away from its goal before an obstacle that comes after it."""

    def __init__(self) -> None:
        self.longest = 0.0
        self._since, self._until = 0.0, -np.inf

    def update(self, t: float, velocity: Array, to_goal: Array, obstacle: Array, distance: float) -> None:
        """At ``t`` [s] a robot with ``velocity`` (2) [m/s], whose goal lies in the direction ``to_goal`` (2), is ``distance`` [m] from the nearest
        obstacle, whose velocity is ``obstacle`` (2)."""
        speed = float(np.linalg.norm(obstacle))
        along = float(velocity @ obstacle) / max(speed, 1e-9)
        if speed == 0.0 or distance > NEAR or along < SHARE * speed or velocity @ to_goal >= 0.0:
            return
        if t - self._until > PAUSE:
            self._since = t
        self._until = t
        self.longest = max(self.longest, t - self._since)


#: How near [m] to the end of its path the end effector shall be at the end.
GOAL = 0.05
#: How often [s] true distances are measured.
MEASURED = 0.02
#: What may be missing [m] of the margin in the world: odometry and drives are not exact.
TOLERATED = 0.01
#: A robot is stuck while its end effector is farther [m] than this from its reference and slower [m/s], for so long [s].
BEHIND, SLOW, LONG = 0.05, 0.02, 1.0
#: It ends the run if its references wait for so long [s] in which the end effector moves by less than this [m], or for so long however it
#: moves.
WINDOW, STAYS, HOPELESS = 1.5, 0.1, 4.0
#: Or if so many searches for other ways in a row found none.
FAILED = 2


def believed(system: System) -> tuple[Array, Array, Array]:
    """Where the controller believes to be the base (x, y, yaw), the end effector (3) [m] and its axes (3, 3)."""
    truth, controller = system.plant.truth(), system.controller
    if not hasattr(controller, "base_pose"):
        return truth.pose, truth.tool, truth.tool_rotation
    base = controller.base_pose()
    turned = lie.quaternion_to_rotation(base[3:])
    pose = np.array([*base[:2], lie.rotation_to_euler_zyx(turned)[0]])
    return pose, base[:3] + turned @ truth.tool_in_base, turned @ truth.tool_rotation_in_base


def stays(places: Sequence[tuple[float, Array]]) -> bool:
    """Whether who has been at ``places``, times [s] with positions (3) [m], has stayed near the last one for :data:`WINDOW`: who comes back
    there from where it evaded somebody has not."""
    end, last = places[-1]
    recent = np.array([place for since, place in places if since > end - WINDOW - 1e-9])
    return end - places[0][0] > WINDOW and bool(np.linalg.norm(recent - last, axis=1).max() < STAYS)


class SceneWatch:
    """Moves the obstacles of a simulated world, shows them to the MPC (with ``perceive``: its sensors do), and measures how near the
    ``robot`` comes. ``pace``: what lets the references wait; with it a robot that is stuck ends its run; ``alternatives``: what is tried before
    that; ``reshaping``: what adapts the base's shape."""

    def __init__(
        self, around: SimulatedObstacles, system: System, log: Log, since: float, robot: RobotModel,
        pace: PacedReferences | None = None, perceive: Callable[[], Perception] | None = None,
        alternatives: Alternatives | None = None, reshaping: Reshaping | None = None,
    ) -> None:  # fmt: skip
        self._around, self._system, self._log, self._since = around, system, log, since
        self._margin, self._pace = robot.description.collision.margin, pace
        self._alternatives, self._reshaping = alternatives, reshaping
        self._every = max(1, round(MEASURED / system.timing.period))
        around.bind(system.plant.model)
        around.place(system.plant.data, 0.0)
        self._perception = perceive() if perceive else None
        if self._perception is None and system.mpc.obstacles is not None:  # the first plan knows them
            pose = system.plant.truth().pose
            around.show(system.mpc.obstacles, 0.0, pose, pose)
        self._waits, self._stuck, self._last, self._base = 0.0, 0.0, np.zeros(3), np.zeros(2)
        self._standing, self._driven = Standing(), DrivenBack()
        self._places: deque[tuple[float, Array]] = deque()

    def tick(self, t: float, plans: Any) -> None:
        """At a controller period."""
        system, around = self._system, self._around
        k = round(t / system.timing.period)
        data = system.plant.data
        around.place(data, t)
        if self._perception is not None:
            self._perception.tick(t)
        if k % system.timing.mpc_every == 0:
            pose, tool, _ = believed(system)
            if self._perception is None and system.mpc.obstacles is not None:
                around.show(system.mpc.obstacles, t, system.plant.truth().pose, pose)
            if self._pace is not None:
                self._pace.advance(t, tool)
            if self._alternatives is not None:
                self._alternatives.advance(t)
            if self._reshaping is not None:
                self._reshaping.update(t, self._pace.running(t).get("state") if self._pace is not None else None)
        around.count_contacts(data, t)
        if k % self._every == 0:
            planned = plans.current.clearance
            distance = around.distance(data)
            self._log.add("obstacle_clearance", t, distance)
            self._log.add("planned_clearance", t, planned.distance if planned is not None and planned.frame else np.nan)
            self._progress(t, distance)

    def _progress(self, t: float, distance: float) -> None:
        """Count the time in which the robot stands away from its goal, ``distance`` [m] from the nearest obstacle."""
        mpc, tool, around = self._system.mpc, self._system.plant.truth().tool, self._around
        moved, self._last = float(np.linalg.norm(tool - self._last)), tool
        path = mpc.path.following.path if mpc.path.following else None
        # who goes as far as obstacles allow is where it is to be, and stuck nevertheless
        goal = end_effector_goal(mpc, t, np.zeros(3)) if path is None else path.at([path.length])[0]
        if t < self._since or goal is None:
            return
        behind = float(np.linalg.norm(goal[:3] - tool))
        h = self._every * self._system.timing.period
        self._waits = self._waits + h if behind > BEHIND and moved < SLOW * h else 0.0
        if self._waits >= LONG:
            self._stuck += h if self._waits > LONG + 0.5 * h else LONG
        held_up = self._pace is not None and self._pace.rate < WAITS and self._pace.time < self._pace.end
        self._standing.update(t, tool, behind > BEHIND or held_up)
        base, near = self._system.plant.truth().pose[:2].copy(), around.nearest
        went, self._base = (base - self._base) / h, base
        self._driven.update(t, went, goal[:2] - tool[:2], around.velocity(near)[:2], distance)
        self._check_progress(t, tool)

    def _check_progress(self, t: float, tool: Array) -> None:
        """End the run of a robot whose references wait while it stays where it is."""
        if self._pace is None:
            return
        others = self._alternatives
        tries = others is not None and others.searching
        if others is not None and others.failed >= FAILED:
            left = f"{self._pace.missed(tool):.2f} m from its goal, no other way was found"
            if others.can_leave:
                raise WayDeclined(f"the robot does not enter what it does not get through, {left}")
            raise RobotStuck(f"the robot is stuck {left}")
        if not self._pace.waits or self._pace.waits_for(t) or tries:
            self._places.clear()
        self._places.append((t, tool.copy()))
        if stays(self._places) or t - self._places[0][0] > HOPELESS:
            raise RobotStuck(f"the robot is stuck {self._pace.missed(tool):.2f} m from its goal")

    def metrics(self) -> dict[str, Metric]:
        """Least true distance, contacts, and how long the robot stood away from its goal."""
        around, pace = self._around, self._pace
        caused = {
            "obstacle_contacts_caused": Metric(float(around.caused), "1", goal=0.0),
            "pushed_time_max": Metric(around.pushed, "s", goal=2.0),
        }
        missed = np.nan if pace is None else pace.missed(self._last)
        waited = {} if pace is None else {
            "reference_delay": Metric(pace.delay, "s"), "goal_missed": Metric(missed, "m", goal=GOAL),
            "passed": Metric(float(missed <= GOAL), "1", least=1.0),
        }  # fmt: skip
        return {
            "obstacle_clearance_min": Metric(around.least, "m", least=self._margin - TOLERATED),
            "obstacle_contacts": Metric(float(around.contacts), "1", goal=0.0),
            "contact_speed_max": Metric(around.contact_speed, "m/s"),
            **(caused if self._system.plant.has_physics else {}),
            "time_stuck": Metric(self._stuck, "s"),
            "standing_time_max": Metric(self._standing.longest, "s"),
            "driven_back_time_max": Metric(self._driven.longest, "s", goal=2.0),
            "braking_plans": Metric(float(self._system.mpc.statistics.braking_plans), "1"),
            **(self._perception.metrics() if self._perception else {}),
            **waited,
            **(self._tried(self._alternatives) if self._alternatives else {}),
        }

    @staticmethod
    def _tried(alternatives: Alternatives) -> dict[str, Metric]:
        return {
            "alternative_searches": Metric(float(alternatives.searches), "1"),
            "alternatives_taken": Metric(float(len(alternatives.taken)), "1"),
            "alternatives_computation": Metric(alternatives.computation, "s"),
        }

    def plots(self) -> list[Plot]:
        """Distances over time."""
        log = self._log
        t = log.times("obstacle_clearance")
        found = [
            Series(name, t, 1e3 * log.array(channel).ravel())
            for name, channel in (("true, now", "obstacle_clearance"), ("least of the plan", "planned_clearance"))
        ]
        more = self._perception.plots() if self._perception else []
        return [Plot("Distance to obstacles", "time [s]", "distance [mm]", found), *more]
