"""A controller's node and a simulated robot's in one process, in lockstep: nothing depends on the machine's speed."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Any

import numpy as np

from wbmpc.model.robot import RobotModel
from wbmpc.ros2.control import ControlNode
from wbmpc.ros2.network import Network
from wbmpc.ros2.opening import open_node
from wbmpc.ros2.settings import settings_of
from wbmpc.ros2.sim import SimNode
from wbmpc.types import Truth

#: Rate of the controller of a robot that does not balance [1/s] where a test does not ask for another one, a quarter of the default: less to do.
RATE = 100.0


class Simulated:
    """``change``: what becomes of a JointState before it is sent (None: lost); ``said``: diagnostics that came."""

    def __init__(self, robot: RobotModel, network: Network, seed: int = 3, **settings: Any) -> None:
        safety = {"clock": 60.0, **settings.pop("safety", {})}  # a busy machine gives the time no time
        rates = {} if robot.base.balances else {"control": RATE}
        rates |= settings.pop("rates", {})
        given = {"use_sim_time": True, "lockstep": True, **settings, "rates": rates, "safety": safety}
        self.settings = settings_of(robot).model_validate(given)
        self.node = open_node("wbmpc", "dds", network)
        try:
            self.control = ControlNode(self.node, robot, self.settings)
        except BaseException:
            self.node.close()
            raise
        self.other: Any = open_node("robot", "dds", network)
        self.said: list[Any] = []
        self.other.subscribe("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", self.said.append)
        self.sim = SimNode(self.other, robot, self.settings, seed, factor=20.0)
        self.sim.patience = 15.0  # a busy machine
        self.sim.lockstep = True  # also for a controller that takes the time that it takes
        self.change: Callable[[dict[str, Any]], Mapping[str, Any] | None] = lambda message: message
        send = self.sim._joints.publish
        self.sim._joints = self  # type: ignore[assignment]
        self._send, self.why = send, ""
        self._physics = threading.Lock()
        for name in ("_advance", "publish"):
            setattr(self.sim, name, self._locked(getattr(self.sim, name)))
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def publish(self, message: dict[str, Any]) -> None:
        """In place of the publisher of joint states."""
        changed = self.change(message)
        if changed is not None:
            self._send(changed)

    def _locked(self, call: Callable[[], None]) -> Callable[[], None]:
        def locked() -> None:
            with self._physics:
                call()

        return locked

    def truth(self) -> Truth:
        """What really is, between two steps of the physics."""
        with self._physics:
            return self.sim.plant.truth()

    def _spin(self) -> None:
        self.why = self.sim.spin(self._end.is_set)

    def until(self, condition: Callable[[], object], seconds: float = 180.0) -> bool:
        """Step the controller's node until a condition comes true; whether it did within ``seconds`` of the wall's time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.control.step()
            if condition():
                return True
            time.sleep(0.005)
        return False

    def run(self, seconds: float) -> None:
        """Let simulated time pass; fails if it does not."""
        end = self.sim.time + seconds
        assert self.until(lambda: self.sim.time >= end or self.why, 180.0 + 30.0 * seconds), self.control.state

    def ready(self) -> None:
        """Until a goal can be given."""
        here = lambda: self.control.state == "waiting for a goal" and self.control.adapter.snapshot() is not None
        assert self.until(here), self.control.state

    def send(self, topic: str, kind: str, values: Mapping[str, Any]) -> None:
        """A message from somebody on the bus."""
        publisher = self.other.publisher(topic, kind)
        assert self.until(lambda: publisher._writer.get_matched_subscriptions())
        publisher.publish(values)
        time.sleep(0.05)

    def end_effector(self, dx: float = 0.0, dz: float = 0.0) -> None:
        """A goal for the end effector, from where it is."""
        position, turned = self.control.robot.pose(self.control.adapter.snapshot()[1])  # type: ignore[index]
        position = position + [dx, 0.0, dz + self.control.adapter.planner.lift]
        pose = {"position": dict(zip("xyz", position)), "orientation": dict(zip("wxyz", turned))}
        self.send("/end_effector_goal", "geometry_msgs/msg/PoseStamped", {"header": {"frame_id": "odom"}, "pose": pose})

    def messages(self, level: int) -> list[str]:
        """What diagnostics of a level said."""
        return [s.message for m in self.said for s in m.status if s.level == level]

    def close(self) -> None:
        """End both; once."""
        if self._end.is_set():
            return
        self._end.set()
        self.sim.patience = 0.0
        with ExitStack() as closing:  # all, whatever fails: nothing is left on the bus for the next test
            closing.callback(self.other.close)
            closing.callback(self.node.close)
            closing.callback(self._thread.join, 60.0)
            closing.callback(self.control.close)


class Localization:
    """Another localization of a simulated robot, ``/localization``: its true pose, moved by ``offset`` (2) [m], as long as it is
    ``sending``; with a ``covariance`` (36), or exact."""

    def __init__(self, s: Simulated, covariance: Any = ()) -> None:
        self.offset, self.sending = np.zeros(2), True
        self._covariance = {"covariance": covariance} if len(covariance) else {}
        self._poses = s.other.publisher("/localization", "nav_msgs/msg/Odometry")
        self._truth, s.sim._odom = s.sim._odom, self

    def publish(self, message: dict[str, Any]) -> None:
        """In place of the publisher of the true odometry."""
        self._truth.publish(message)
        if self.sending:
            pose = message["pose"]["pose"]
            moved = {k: pose["position"][k] + o for k, o in zip("xy", self.offset)}
            self._poses.publish({**message, "pose": {"pose": {**pose, "position": moved}, **self._covariance}})
