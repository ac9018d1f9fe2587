"""A robot on a bus that is driven by a test: kinematic, in lockstep, as good or as broken as the test wants it."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Any

import numpy as np
import pytest
from needs import private

from wbmpc.bases.swerve.ros_settings import SwerveRosSettings
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.model.wheels import rolling_inverse_kinematics
from wbmpc.ros2.bus import Qos
from wbmpc.ros2.control import ControlNode
from wbmpc.ros2.convert import header, stamp
from wbmpc.ros2.network import Network
from wbmpc.ros2.opening import open_node

ROBOT = load_robot("swerve-ur10")
ENVIRONMENT = {**private(), "ROS_DOMAIN_ID": "45"}
NETWORK = Network.of(ENVIRONMENT)
#: Rate of the controller and of the states [1/s] where a test does not ask for another one, a quarter of the default: less to do.
RATE = 100
PERIOD = 1.0 / RATE
#: How often the node looks at requests [s].
STEP = 0.02
GROUPS = ("leg", "steer", "wheel", "arm")
#: Which way each wheel turns [1 or -1] where the base goes ahead, with the joints as at home.
AHEAD = np.sign(
    rolling_inverse_kinematics(ROBOT.base.geometry, *(ROBOT.home[ROBOT.state[g]] for g in ("leg", "steer")), [1, 0, 0])[
        1
    ]
)
Change = Callable[[dict[str, Any]], Mapping[str, Any] | None]


class Standin:
    """Publishes joint states and time, moves its joints as commanded. ``change``: what becomes of a JointState (None: lost)."""

    def __init__(self, robot: RobotModel, network: Network, rate: float = RATE) -> None:
        self.robot, self.time, self.period = robot, 1.0, 1.0 / rate
        self.node = open_node("standin", "dds", network)
        self.names = {g: list(robot.state.groups[g]) for g in GROUPS}
        self.joints = {g: robot.home[robot.state[g]].copy() for g in GROUPS}
        self.commands = {g: np.zeros(len(self.names[g])) for g in ("steer", "wheel", "arm")}
        self.counts = dict.fromkeys(self.commands, 0)
        self._joints = self.node.publisher("/joint_states", "sensor_msgs/msg/JointState", Qos(depth=5))
        self._clock = self.node.publisher("/clock", "rosgraph_msgs/msg/Clock", Qos(depth=1))
        self.change: Change = lambda message: message
        self.answers = 5.0  # how long a command is waited for [s]
        self.heard: Callable[[], bool] = lambda: (
            True
        )  # whether a state that was sent has come in; is waited for as long
        for group in self.commands:
            take = lambda message, g=group: self._take(g, message)
            self.node.subscribe(f"/{group}_controller/commands", "std_msgs/msg/Float64MultiArray", take)

    def _take(self, group: str, message: Any) -> None:
        self.commands[group] = np.array(message.data)
        self.counts[group] += 1

    def tick(self, wait: bool) -> None:
        """A period: state, time, and with ``wait`` the commands to them."""
        previous = dict(self.counts)
        message = {
            "header": header(self.time, ""),
            "name": [n for g in GROUPS for n in self.names[g]],
            "position": np.concatenate([self.joints[g] for g in GROUPS]),
        }
        changed = self.change(message)
        if changed is not None:
            self._joints.publish(changed)
        self._clock.publish({"clock": stamp(self.time)})
        end = time.monotonic() + self.answers
        due = lambda: wait and any(self.counts[g] == previous[g] for g in previous)
        while (due() or not self.heard()) and time.monotonic() < end:
            time.sleep(1e-4)
        for group, rates in self.commands.items():
            self.joints[group] = self.joints[group] + self.period * rates
        self.time += self.period

    @property
    def speed(self) -> float:
        """The largest commanded speed [rad/s]."""
        return max(float(np.abs(v).max()) for v in self.commands.values())


class Pair:
    """A controller's node and a stand-in on one bus; both are driven from here."""

    def __init__(self, **settings: Any) -> None:
        time = {"use_sim_time": True, "lockstep": settings.get("use_sim_time", True)}
        safety = {"clock": 60.0, **settings.pop("safety", {})}  # a busy machine gives the time no time
        rates = {"control": RATE, **settings.pop("rates", {})}
        self.settings = SwerveRosSettings.model_validate({**time, "rates": rates, **settings, "safety": safety})
        with ExitStack() as made:  # whatever fails, nothing is left on the bus for the next test
            self.node = open_node("wbmpc", "dds", NETWORK)
            made.callback(self.node.close)
            self.control = ControlNode(self.node, ROBOT, self.settings)
            made.callback(self.control.close)
            self.standin = Standin(ROBOT, NETWORK, self.settings.rates.control)
            made.callback(self.standin.node.close)
            self.close = made.pop_all().close
        self.said: list[Any] = []
        self.standin.node.subscribe("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", self.said.append)

    def run(self, seconds: float) -> None:
        """Let time pass."""
        often = round(STEP / self.standin.period)
        for k in range(round(seconds / self.standin.period)):
            if k % often == 0:
                self.control.step()
            self.standin.tick(wait=self.control.running)

    def until(self, condition: Callable[[], object], seconds: float = 180.0) -> bool:
        """Let time pass until a condition comes true; whether it did within ``seconds`` of the wall's time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.run(STEP)
            if condition():
                return True
        return False

    def ready(self) -> None:
        """Let time pass until a goal can be given."""
        assert self.until(lambda: self.control.state == "waiting for a goal"), self.control.state
        self.run(0.05)

    def send(self, topic: str, kind: str, values: Mapping[str, Any], times: int = 1) -> None:
        """A message from somebody on the bus."""
        publisher = self.standin.node.publisher(topic, kind)
        end = time.monotonic() + 60.0
        while not publisher._writer.get_matched_subscriptions() and time.monotonic() < end:  # type: ignore[attr-defined]
            time.sleep(0.005)
        for _ in range(times):
            publisher.publish(values)
        time.sleep(0.05)

    def go(self, x: float = 1.0, y: float = 0.0, frame: str = "odom") -> None:
        """A goal for the base."""
        pose = {"header": {"frame_id": frame}, "pose": {"position": {"x": x, "y": y}}}
        self.send("/goal_pose", "geometry_msgs/msg/PoseStamped", pose)


def drive(p: Pair) -> None:
    """Bring a pair to a base that drives."""
    p.ready()
    p.go(2.0)
    assert p.until(lambda: p.standin.speed > 0.5), p.control.state


def check_stopped(p: Pair, because: str, caplog: pytest.LogCaptureFixture) -> None:
    """The robot is at rest for good; one log line and a diagnostics entry say why."""
    runner = p.control.runner
    assert runner is not None and p.until(lambda: runner.stopped), p.control.state
    assert because in p.control.state
    p.standin.change = lambda message: message
    assert p.until(lambda: p.standin.speed == 0.0)
    p.said.clear()
    p.run(0.1)
    assert p.standin.speed == 0.0
    assert sum(because in r.getMessage() and r.levelno == logging.ERROR for r in caplog.records) == 1
    assert sum(r.getMessage() == p.control.state for r in caplog.records) == 1
    assert p.until(lambda: any(s.level == 2 and because in s.message for m in p.said for s in m.status))
