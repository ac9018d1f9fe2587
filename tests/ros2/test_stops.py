"""The odometry through stops while the base turns. Truth: the stand-in's wheels, which roll without slip, summed up in every
period; whoever stops our robot goes on turning it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from needs import MISSING, needs_dds, wait_until

from effort import THOROUGH, some
from wbmpc.bases.swerve.wheel_odometry import WheelOdometry
from wbmpc.model.wheels import rolling_inverse_kinematics

pytestmark = needs_dds
if not MISSING:
    from standin import ROBOT, STEP

#: What the odometry lacks is what a tick that is left out does: the fewer ticks, the more.
RATE = 400.0
PERIOD = 1.0 / RATE


class Turned:
    """A stand-in with an inertial unit that turns as the bus asks it to, or as ``other`` does. ``imu_heard``, ``joints_heard``:
    which of its sensors are; ``broken``: the next joint states are; ``repeats``: its joint states are those of before, or the first
    ones in them are, of the base, while the arm's encoders go on."""

    def __init__(self, p: Any) -> None:
        self.p, self.imu_heard, self.joints_heard, self.other = p, True, True, False
        self.truth, self.spike = WheelOdometry(ROBOT.base.geometry), 0.0  # what the next reading is off by [rad/s]
        self._imu = p.standin.node.publisher("/imu", "sensor_msgs/msg/Imu")
        self._speeds = p.standin.node.publisher("/cmd_vel", "geometry_msgs/msg/Twist")
        self.broken, self.repeats, self._slice = False, 0, STEP
        p.standin.change = self.change
        take = p.standin._take
        p.standin._take = lambda group, message: None if self.other else take(group, message)

    def change(self, message: dict[str, Any]) -> dict[str, Any] | None:
        """The inertial unit speaks before the joint states."""
        joints = self.p.standin.joints
        self.truth.update(joints["leg"], joints["steer"], joints["wheel"])
        if self.imu_heard:
            rate, self.spike = self.truth.increment[2] / PERIOD + self.spike, 0.0
            self._imu.publish({"header": message["header"], "angular_velocity": {"z": rate}})
        if self.broken:
            self.broken = False
            return {**message, "position": message["position"] * np.nan}
        if self.repeats:
            arm = message["position"][self.repeats :] + 1e-5 * np.sin(1e3 * self.p.standin.time)
            return {**message, "position": np.concatenate([self._position[: self.repeats], arm])}
        self._position = message["position"].copy()
        return message if self.joints_heard else None

    def turn(self) -> None:
        """Until the base turns at 0.6 rad/s."""
        p, self.other = self.p, False
        assert p.until(lambda: self._speeds._writer.get_matched_subscriptions() and not p.control._other_publisher)
        self._speeds.publish({})
        p.run(0.3)

        def turns() -> bool:
            self._speeds.publish({"angular": {"z": 0.6}})
            return bool(self.truth.increment[2] > 0.55 * PERIOD)

        assert p.until(turns), (p.control.state, p.control.request_queue.rejected)

    def stopped(self, seconds: float, paced: bool = False) -> None:
        """The controller stops, and another one turns the base for some time; ``paced``: no faster than the odometry hears.

        A controller that is stopped on its way leaves wheels that contradict each other: first they are steered so that all roll."""
        p = self.p
        assert p.until(lambda: p.control.runner.stopped), p.control.state
        self.other = True
        if paced:
            p.run(0.05)
            self._pace()
        leg, steer = p.standin.joints["leg"], p.standin.joints["steer"]
        target, self._turning = rolling_inverse_kinematics(ROBOT.base.geometry, leg, steer, (0.0, 0.0, 1.0))
        p.standin.commands["steer"] = (target - steer) / STEP
        self.drive(0.6, STEP)
        p.standin.commands["steer"] = np.zeros(4)
        self.drive(0.6, seconds)
        self.drive(0.0, 0.3)

    def drive(self, turn: float, seconds: float) -> None:
        """Wheels as they point, at the speed of a turn [rad/s]."""
        self.p.standin.commands["wheel"] = self._turning * turn
        for _ in range(round(seconds / self._slice)):
            self.p.run(self._slice)

    def _pace(self) -> None:
        """From now on the stand-in waits for the odometry, of which a controller that is stopped thinks at its steps alone: nothing
        else paces it then, and a busy machine loses what the queue has no room for."""
        self._slice = PERIOD
        behind = lambda: self.p.standin.time - self.p.control.adapter.snapshot()[0]
        usual = behind()
        self.p.standin.heard = lambda: behind() < usual + 1.5 * PERIOD

    def error(self) -> np.ndarray:
        """Of the odometry: x, y, yaw."""
        p = self.p
        state = lambda: p.control.adapter.snapshot()[1][ROBOT.state["wheel"]]
        now = lambda: np.abs(state() - p.standin.joints["wheel"]).max() < 1e-6
        assert wait_until(lambda: p.run(PERIOD) or now(), 20.0), p.control.state
        return np.abs(p.control.adapter.controller.estimator.odometry.pose - self.truth.pose)


def second_publisher(t: Turned) -> Callable[[], None]:
    node = t.p.node
    publishers = node.publishers
    node.publishers = lambda topic, *within: [SimpleNamespace(own=False)] if "commands" in topic else publishers(topic)
    return lambda: setattr(node, "publishers", publishers)


def stale_joints(t: Turned) -> Callable[[], None]:
    t.joints_heard = False
    return lambda: setattr(t, "joints_heard", True)


def repeated_joints(t: Turned, count: int = 18) -> Callable[[], None]:
    t.repeats = count
    return lambda: setattr(t, "repeats", 0)


def repeated_wheels(t: Turned) -> Callable[[], None]:
    """One broadcaster speaks for the drives of base and arm; those of the base hang."""
    return repeated_joints(t, 12)


def gyro_spike(t: Turned) -> Callable[[], None]:
    t.spike = 30.0
    return lambda: None


def silent_imu(t: Turned) -> Callable[[], None]:
    t.imu_heard = False
    return lambda: setattr(t, "imu_heard", True)


def broken_message(t: Turned) -> Callable[[], None]:
    t.broken = True
    return lambda: None


def plan_too_old(t: Turned) -> Callable[[], None]:
    t.p.control.runner.halt("the policy is 0.6 s old, the limit is 0.5 s")
    return lambda: None


def clock_ahead(t: Turned) -> Callable[[], None]:
    t.p.standin.time += 3.0
    return lambda: None


def clock_back(t: Turned) -> Callable[[], None]:
    t.p.standin.time -= 0.5
    t.p.standin.answers = 0.01
    return lambda: setattr(t.p.standin, "answers", 5.0)


CAUSES = [
    second_publisher,
    stale_joints,
    repeated_joints,
    silent_imu,
    broken_message,
    plan_too_old,
    clock_ahead,
    clock_back,
    repeated_wheels,
    gyro_spike,
]


@pytest.mark.parametrize("cause", some(CAUSES, [1, 2, 5, 7, 8, 9]))
def test_odometry_goes_on_through_stops(pair: Callable[..., Any], cause: Any) -> None:
    """Wrong by less than 5 mrad and 5 mm after a stop, and after a second one. What nobody heard of joints or inertial unit
    begins while steering still turns: twice that."""
    maximum = 1e-2 if cause in (stale_joints, repeated_joints, repeated_wheels, silent_imu) else 5e-3
    t = Turned(pair(rates={"control": RATE}))
    t.p.ready()
    for seconds in (0.2, 1.0) if THOROUGH or cause is clock_back else (0.5,):
        t.turn()
        end = cause(t)
        t.stopped(seconds)
        end()
        assert t.error().max() < maximum, (t.error(), seconds)


def test_odometry_goes_on_through_a_long_stop(pair: Callable[..., Any]) -> None:
    t = Turned(pair(rates={"control": RATE}))
    t.p.ready()
    t.turn()
    end = second_publisher(t)
    t.stopped(6.0, paced=True)
    end()
    assert t.truth.pose[2] > 3.6 and t.error().max() < 5e-3, t.error()


def test_a_tick_that_a_stop_overtakes_has_the_estimator_to_itself(pair: Callable[..., Any]) -> None:
    t = Turned(pair(rates={"control": RATE}))
    p = t.p
    p.ready()
    t.turn()
    controller, inside, ends, users = p.control.adapter.controller, threading.Event(), threading.Event(), []
    measure = controller.measure

    def slow(measurement: Any) -> None:
        users.append(threading.current_thread())
        if len(users) == 1:
            inside.set()
            assert ends.wait(60.0)
        measure(measurement)

    controller.measure, p.standin.answers = slow, 0.01
    assert wait_until(lambda: p.standin.tick(wait=True) or inside.is_set())
    second_publisher(t)
    assert wait_until(lambda: p.run(STEP) or p.control.runner.stopped)  # whose thread may wait for its turn
    assert len(users) == 1
    ends.set()
    assert wait_until(lambda: p.run(STEP) or users[-1] is threading.current_thread())
