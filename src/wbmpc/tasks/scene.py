"""What a closed loop among obstacles does at every tick, and what is measured of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wbmpc import lie
from wbmpc.bases.base import System
from wbmpc.log import Log
from wbmpc.recording.observer import end_effector_goal
from wbmpc.result import Metric, Plot, Series
from wbmpc.simulation.obstacles import SimulatedObstacles
from wbmpc.tasks.perception import Perception

Array = NDArray[np.float64]
#: How often [s] true distances are measured.
MEASURED = 0.02
#: What may be missing [m] of the margin in the world: odometry and drives are not exact.
TOLERATED = 0.01
#: A robot is stuck while its end effector is farther [m] than this from its reference and slower [m/s], for so long [s].
BEHIND, SLOW, LONG = 0.05, 0.02, 1.0


class SceneWatch:
    """Moves the obstacles of a simulated world, shows them to the MPC (with ``perceive``: its sensors do), and measures how near the robot
    comes; ``margin`` [m]: what is asked for."""

    def __init__(
        self, around: SimulatedObstacles, system: System, log: Log, since: float, margin: float,
        perceive: Callable[[], Perception] | None = None,
    ) -> None:  # fmt: skip
        self._around, self._system, self._log, self._since = around, system, log, since
        self._margin = margin
        self._every = max(1, round(MEASURED / system.timing.period))
        around.bind(system.plant.model)
        around.place(system.plant.data, 0.0)
        self._perception = perceive() if perceive else None
        if self._perception is None and system.mpc.obstacles is not None:  # the first plan knows them
            pose = system.plant.truth().pose
            around.show(system.mpc.obstacles, 0.0, pose, pose)
        self._waits, self._stuck, self._last = 0.0, 0.0, np.zeros(3)

    def tick(self, t: float, plans: Any) -> None:
        """At a controller period."""
        system, around = self._system, self._around
        k = round(t / system.timing.period)
        data = system.plant.data
        around.place(data, t)
        if self._perception is not None:
            self._perception.tick(t)
        elif k % system.timing.mpc_every == 0 and system.mpc.obstacles is not None:
            true = system.plant.truth().pose
            around.show(system.mpc.obstacles, t, true, self._estimated(true))
        around.count_contacts(data, t)
        if k % self._every == 0:
            planned = plans.current.clearance
            self._log.add("obstacle_clearance", t, around.distance(data))
            self._log.add("planned_clearance", t, planned.distance if planned is not None and planned.frame else np.nan)
            self._progress(t)

    def _estimated(self, true: Array) -> Array:
        """Where the controller believes the base (x, y, yaw) to be."""
        if not hasattr(self._system.controller, "base_pose"):
            return true
        pose = self._system.controller.base_pose()
        return np.array([*pose[:2], lie.rotation_to_euler_zyx(lie.quaternion_to_rotation(pose[3:]))[0]])

    def _progress(self, t: float) -> None:
        """Count the time in which the robot stands away from its goal."""
        mpc, tool = self._system.mpc, self._system.plant.truth().tool
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

    def metrics(self) -> dict[str, Metric]:
        """Least true distance, contacts, and how long the robot stood away from its goal."""
        around = self._around
        return {
            "obstacle_clearance_min": Metric(around.least, "m", least=self._margin - TOLERATED),
            "obstacle_contacts": Metric(float(around.contacts), "1", goal=0.0),
            "contact_speed_max": Metric(around.contact_speed, "m/s"),
            "stuck_time": Metric(self._stuck, "s"),
            "braking_plans": Metric(float(self._system.mpc.statistics.braking_plans), "1"),
            **(self._perception.metrics() if self._perception else {}),
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
