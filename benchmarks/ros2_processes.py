"""The processes of a bus for benchmarks and tests: `wbmpc ros2 sim` and `wbmpc ros2 control` on a private domain, and who records
what is reported there."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from wbmpc import lie
from wbmpc.ros2.bus import Qos
from wbmpc.ros2.convert import planar, read_pose, seconds
from wbmpc.ros2.network import Network
from wbmpc.ros2.opening import open_node
from wbmpc.ros2.sim import TRUTH_END_EFFECTOR, TRUTH_ODOM

#: The state of a controller that has all it needs.
READY = "waiting for a goal"


@cache
def private(domain: int) -> dict[str, str]:
    """Environment of a bus of its own; a process configures a domain once."""
    tag = f"<CycloneDDS><Domain><Discovery><Tag>{uuid.uuid4()}</Tag></Discovery></Domain></CycloneDDS>"
    own = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "CYCLONEDDS_URI": tag}
    return {**os.environ, **own}


class Bus:
    """The two processes and a node that watches them. ``said``: the last state of the controller."""

    def __init__(
        self,
        environment: dict[str, str],
        seed: int,
        lockstep: bool,
        factor: float,
        config: str,
        robot: str,
        fifo: bool = False,
        ready: str = READY,
    ) -> None:
        self.environment, self.ready = environment, ready
        self.log = tempfile.TemporaryFile("w+")  # noqa: SIM115
        run = [sys.executable, "-m", "wbmpc", "ros2"]
        given = [robot, "--backend", "dds", "--config", config, *(["--lockstep"] if lockstep else [])]
        given += ["--fifo"] if fifo else []
        sim = [*run, "sim", *given, "--seed", str(seed), "--factor", str(factor)]
        start = lambda command: subprocess.Popen(command, env=environment, stdout=self.log, stderr=self.log)
        self.start_control = lambda: start([*run, "control", *given])
        self.start_sim = lambda: start(sim)
        self.said, self.level = "", 0
        self.node: Any = None
        self.control: Any = None
        self.sim: Any = None
        try:
            self._start()
        except BaseException:  # what has been started is known only here
            self.close()
            raise

    def _start(self) -> None:
        self.control = self.start_control()
        self.node = open_node("watcher", "dds", Network.of(self.environment))
        self.node.subscribe("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", self._diagnostics)
        self.wait_for(lambda: "waiting" in self.said, 120.0)  # the controller has built its solver
        self.sim = self.start_sim()
        self.wait_for(lambda: self.said == self.ready, 60.0)

    def _diagnostics(self, message: Any) -> None:
        self.said, self.level = message.status[0].message, message.status[0].level
        self.figures = {v.key: v.value for v in message.status[0].values}

    def wait_for(self, condition: Callable[[], object], limit: float) -> None:
        """Wait for a condition [s]; show the processes' output if it does not come."""
        end = time.monotonic() + limit
        while not condition():
            if time.monotonic() > end:
                raise TimeoutError(f"the controller says: '{self.said}'\n{self.output()}")
            time.sleep(0.01)

    def output(self) -> str:
        """What both processes have written."""
        self.log.flush()
        self.log.seek(0)
        return self.log.read()

    def close(self) -> None:
        """End both processes, as far as they have begun, by force where they do not end."""
        running = [process for process in (self.control, self.sim) if process is not None]
        for process in running:
            if process.poll() is None:
                process.terminate()
        for process in running:
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        if self.node is not None:
            self.node.close()
        self.log.close()


@contextmanager
def open_bus(
    domain: int,
    seed: int,
    lockstep: bool = True,
    factor: float = 1.0,
    settings: dict[str, Any] | None = None,
    robot: str = "swerve-ur10",
    fifo: bool = False,
    ready: str = READY,
) -> Iterator[Bus]:
    """Both processes on a private bus, ready for a goal, or in another state that the controller reports then."""
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "bus.yaml"
        config.write_text(json.dumps(settings or {}))
        bus = Bus(private(domain), seed, lockstep, factor, str(config), robot, fifo, ready)
        try:
            yield bus
        finally:
            bus.close()


class Recorder:
    """Poses from the bus over their stamps: true base and end effector, estimated base. ``rows``: time [s], x, y, yaw (``base``,
    ``odom``); ``poses``: time [s], position (3) [m], quaternion (4)."""

    def __init__(self, node: Any) -> None:
        self.rows: dict[str, list[list[float]]] = {"base": [], "odom": []}
        self.poses: dict[str, list[list[float]]] = {"base": [], "odom": [], "hand": []}
        take = lambda name: lambda m: self._take(name, m.header, m.pose.pose)
        node.subscribe(TRUTH_ODOM, "nav_msgs/msg/Odometry", take("base"), Qos(depth=100))
        node.subscribe("/odom", "nav_msgs/msg/Odometry", take("odom"), Qos(depth=100))
        end_effector = lambda m: self._take("hand", m.header, m.pose)
        node.subscribe(TRUTH_END_EFFECTOR, "geometry_msgs/msg/PoseStamped", end_effector, Qos(depth=100))

    def _take(self, name: str, head: Any, given: Any) -> None:
        position, turned = read_pose(given, name)
        self.poses[name].append([seconds(head.stamp), *position, *turned])
        if name in self.rows:
            self.rows[name].append([seconds(head.stamp), *planar(position, turned)])

    @property
    def time(self) -> float:
        """The newest stamp [s]."""
        return self.rows["base"][-1][0] if self.rows["base"] else 0.0

    def end_effector_in_estimate(self) -> tuple[np.ndarray, np.ndarray]:
        """Times (n) [s] and positions (n, 3) of the end effector in the estimated frame: estimated base, true end effector in the base."""
        base, end_effector, odom = (np.array(sorted(self.poses[n])) for n in ("base", "hand", "odom"))
        t = end_effector[(end_effector[:, 0] > odom[0, 0]) & (end_effector[:, 0] < odom[-1, 0]), 0]
        true, tool, seen = (_at(rows, t) for rows in (base, end_effector, odom))
        turned = [
            lie.quaternion_to_rotation(s[3:]) @ lie.quaternion_to_rotation(b[3:]).T @ (h[:3] - b[:3]) + s[:3]
            for b, h, s in zip(true, tool, seen, strict=True)
        ]
        return t, np.array(turned)

    def tilt(self) -> float:
        """The largest true lean [rad]."""
        up = [lie.quaternion_to_rotation(np.array(row[4:]))[2, 2] for row in self.poses["base"]]
        return float(np.arccos(np.clip(min(up), -1.0, 1.0)))


def _at(rows: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Poses (n, 7) at times t (n), between the recorded ones."""
    turned = rows[:, 4:].copy()
    for k in range(1, len(turned)):
        turned[k] *= np.sign(turned[k] @ turned[k - 1]) or 1.0
    columns = np.concatenate([rows[:, 1:4], turned], axis=1).T
    found = np.stack([np.interp(t, rows[:, 0], c) for c in columns], axis=1)
    found[:, 3:] /= np.linalg.norm(found[:, 3:], axis=1)[:, None]
    return found


def matched(publisher: Any) -> bool:
    """Whether a publisher has subscribers."""
    return bool(publisher._writer.get_matched_subscriptions())
