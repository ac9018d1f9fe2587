"""A robot on a ROS 2 bus meets a box that a third process publishes: `python benchmarks/ros2_obstacle.py [ROBOT]`.

`wbmpc ros2 sim` and `wbmpc ros2 control` run in lockstep; this process says at 10 Hz of simulated time where a box is, in the robot's way.
The base is to go 2.5 m ahead. Reported: the least distance from the base's middle to the box, how far the base came, and what the controller
said when the detections ended.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from typing import Any

import numpy as np
from ros2_processes import Bus, Recorder, open_bus

from wbmpc.ros2.convert import header, seconds
from wbmpc.ros2.settings import OBSTACLE_TYPES

#: What the controller waits for before detections are published.
MISSING = "waiting: no obstacles on /detections yet"
#: The box: middle and size over the floor [m], and the goal of the base [m].
BOX, SIZE, GOAL = (1.5, 0.15), (0.3, 0.3, 0.8), 2.5


class Detector:
    """Publishes the box at 10 Hz of the bus's time, until :meth:`stop`."""

    def __init__(self, bus: Bus) -> None:
        self._publisher: Any = bus.node.publisher("/detections", OBSTACLE_TYPES["detections"])
        self._last, self._on = -np.inf, threading.Event()
        self._on.set()
        bus.node.subscribe("/clock", "rosgraph_msgs/msg/Clock", lambda m: self._tick(seconds(m.clock)))

    def _tick(self, t: float) -> None:
        if t - self._last < 0.1 or not self._on.is_set():
            return
        self._last = t
        center = {"position": {"x": BOX[0], "y": BOX[1], "z": 0.5 * SIZE[2]}}
        box = {"id": "crate", "bbox": {"center": center, "size": dict(zip("xyz", SIZE, strict=True))}}
        self._publisher.publish({"header": header(t, "odom"), "detections": [box]})

    def stop(self) -> None:
        """Say nothing any more."""
        self._on.clear()


def distance(rows: np.ndarray) -> float:
    """The least [m] between places (n, 2) and the box."""
    off = np.abs(rows - BOX) - 0.5 * np.array(SIZE[:2])
    return float(np.linalg.norm(np.maximum(off, 0.0), axis=1).min())


def run(robot: str, duration: float) -> dict[str, Any]:
    """Drive for so long [s of the bus], then let the detections end."""
    settings = {"topics": {"detections": "/detections"}, "safety": {"clock": 60.0}}
    with open_bus(47, 3, factor=10.0, settings=settings, robot=robot, ready=MISSING) as bus:
        recorder = Recorder(bus.node)
        goal: Any = bus.node.publisher("/goal_pose", "geometry_msgs/msg/PoseStamped")
        detector = Detector(bus)
        bus.wait_for(lambda: bus.said == "waiting for a goal" and goal._writer.get_matched_subscriptions(), 60.0)
        goal.publish({"header": {"frame_id": "odom"}, "pose": {"position": {"x": GOAL}}})
        bus.wait_for(lambda: bus.said.startswith("running"), 60.0)
        end = recorder.rows["base"][-1][0] + duration
        bus.wait_for(lambda: recorder.rows["base"][-1][0] > end or "stopped" in bus.said, 240.0)
        driving, rows = bus.said, np.array(recorder.rows["base"])
        detector.stop()
        bus.wait_for(lambda: "stopped" in bus.said, 60.0)
        time.sleep(0.5)
        return {
            "while it drove": driving, "base came to [m]": rows[-1, 1:3].round(3).tolist(),
            "base's middle to the box [m]": round(distance(rows[:, 1:3]), 3), "without detections": bus.said,
        }  # fmt: skip


if __name__ == "__main__":
    print(json.dumps(run(sys.argv[1] if len(sys.argv) > 1 else "swerve-ur10", 9.0), indent=2))
