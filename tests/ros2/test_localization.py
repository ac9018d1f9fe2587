"""Another localization of a swerve robot. Truth: poses that were sent, a Kalman step by hand, limits of the settings."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from needs import MISSING, needs_dds

from effort import some

pytestmark = needs_dds
if not MISSING:
    from simulated import Localization, Simulated
    from standin import NETWORK, PERIOD, ROBOT, check_stopped

    from wbmpc.bases.swerve.ros import SwerveRosAdapter
    from wbmpc.bases.swerve.ros_settings import SwerveRosSettings
    from wbmpc.ros2.localization import PoseGate


def test_a_pose_in_a_wrong_frame_is_reported_once_until_it_is_right(
    pair: Callable[..., Any], caplog: pytest.LogCaptureFixture
) -> None:
    p = pair(topics={"pose": "/amcl_pose"})
    publisher = p.standin.node.publisher("/amcl_pose", "geometry_msgs/msg/PoseWithCovarianceStamped")
    assert p.until(lambda: publisher._writer.get_matched_subscriptions())
    says = "/amcl_pose: the pose is in frame 'map', 'odom' is needed"

    def publish(frame: str, times: int) -> None:
        for _ in range(times):
            publisher.publish({"header": {"frame_id": frame}, "pose": {"pose": {"position": {"x": 1.0}}}})
            time.sleep(0.02)

    said = lambda: [v.value for m in p.said for s in m.status for v in s.values if v.key == "rejected pose"]
    for k in (1, 2):
        publish("map", 5)
        assert p.until(lambda: p.control.state == f"waiting: {says}"), p.control.state
        assert p.until(lambda: says in said())
        assert sum(r.getMessage() == says for r in caplog.records) == k
        publish("odom", 1)
        assert p.until(lambda: p.control.source.fault == "")
        time.sleep(0.6)


def test_lost_localization_stops(pair: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    p = pair(topics={"pose": "/amcl_pose"})
    assert p.until(lambda: p.control.state == "waiting: no pose on /amcl_pose"), p.control.state
    publisher = p.standin.node.publisher("/amcl_pose", "geometry_msgs/msg/PoseWithCovarianceStamped")
    sending = [True]

    def change(message: dict[str, Any]) -> dict[str, Any]:
        if sending and round(p.standin.time / PERIOD) % 3 == 0:
            publisher.publish({"header": {"frame_id": "odom"}, "pose": {"pose": {"position": {"x": 3.0, "y": -1.0}}}})
        return message

    p.standin.change = change
    p.ready()
    np.testing.assert_allclose(p.control.adapter.snapshot()[1][:3], [3.0, -1.0, 0.0])
    p.go(3.5, -1.0)
    assert p.until(lambda: p.control.runner is not None and "running" in p.control.state)
    sending.clear()
    p.run(0.45)
    check_stopped(p, "the pose on /amcl_pose is 0.", caplog)


def test_a_pose_with_a_covariance_is_weighed(pair: Callable[..., Any]) -> None:
    """Two poses of the same spread for a robot that stands: their mean, with half of the variance (Kalman by hand)."""
    p = pair(topics={"pose": "/amcl_pose"})
    publisher = p.standin.node.publisher("/amcl_pose", "geometry_msgs/msg/PoseWithCovarianceStamped")
    assert p.until(lambda: publisher._writer.get_matched_subscriptions())
    covariance = np.diag([1e-4, 1e-4, 0.0, 0.0, 0.0, 1e-4]).ravel()
    for x in (3.0, 3.01):
        message = {"pose": {"position": {"x": x}}, "covariance": covariance}
        publisher.publish({"header": {"frame_id": "odom"}, "pose": message})
        time.sleep(0.05)
        p.run(0.05)
    assert p.control.adapter.snapshot()[1][0] == pytest.approx(3.005, abs=1e-4)
    e = p.control.adapter.estimate()
    assert e.covariance[0, 0] == pytest.approx(0.5e-4, rel=0.05) and e.covariance[2, 2] == 1e6


@pytest.mark.parametrize(
    "variances", [(1.0, 0.0, 0.0), (1e-4, 1e-4, 0.0), (1e-4, 1e-4, 5e-324), (0.0, 0.0, 1e12), (1.0, 1.0, 1.0)]
)
def test_a_covariance_that_is_zero_in_a_direction_does_not_count(
    pair: Callable[..., Any], variances: tuple[float, ...]
) -> None:
    """A filter that has taken one in has nothing to weigh the next one with. The last one is of two that are the same variable."""
    control = pair(topics={"pose": "/pose"}, use_sim_time=False).control
    covariance = np.zeros((6, 6))
    covariance[[0, 1, 5], [0, 1, 5]] = variances
    covariance[0, 1] = covariance[1, 0] = float(variances[0] == variances[1] == 1.0)
    upright = SimpleNamespace(
        position=SimpleNamespace(x=1.0, y=0, z=0), orientation=SimpleNamespace(x=0, y=0, z=0, w=1)
    )
    head = SimpleNamespace(frame_id="odom", stamp=SimpleNamespace(sec=0, nanosec=0))
    message = lambda c: SimpleNamespace(header=head, pose=SimpleNamespace(pose=upright, covariance=c.ravel()))
    control.source._take(message(covariance))
    assert control.source.newest() is None
    assert control.source.fault.startswith("/pose: the covariance is 0 in a direction, but not in all")
    for good in (np.zeros((6, 6)), 1e-6 * np.eye(6)):
        control.source._take(message(good))
        assert control.source.newest() is not None and not control.source.fault


@pytest.fixture
def simulated(caplog: pytest.LogCaptureFixture) -> Iterator[Any]:
    caplog.set_level(logging.INFO, "wbmpc")
    # an exact pose that a busy machine brings late is off by the way that the robot has gone meanwhile
    s = Simulated(ROBOT, NETWORK, topics={"pose": "/localization"}, safety={"jump": 0.3})
    yield s
    s.close()


@pytest.mark.parametrize("variance", some([0.0, 1e-4], [1]))
def test_a_pose_that_jumps_stops_and_a_goal_goes_on_from_the_new_place(
    simulated: Any, caplog: pytest.LogCaptureFixture, variance: float
) -> None:
    """MuJoCo's true pose, moved: by 0.03 m it is taken in, by 1 m it is not. A robot that stands believes its localization again:
    the next goal starts from there."""
    s = simulated
    source = Localization(s, np.diag([variance] * 6).ravel())

    def go(x: float) -> None:
        s.send("/goal_pose", "geometry_msgs/msg/PoseStamped", {
            "header": {"frame_id": "odom"}, "pose": {"position": {"x": x}},
        })  # fmt: skip
        begin = s.truth().pose[0]
        assert s.until(lambda: s.truth().pose[0] > begin + 0.1), s.control.state

    s.ready()
    go(3.0)
    source.offset[0] = 0.03
    s.run(0.3)
    assert s.control.state == "running: base to a goal" and not s.control.source.fault
    source.offset[0] = 1.05
    says = "the pose on /localization jumped by "
    assert s.until(lambda: s.control.runner.stopped) and says in s.control.state, s.control.state
    assert s.until(lambda: any(says in m for m in s.messages(2)))
    assert s.until(lambda: np.abs(s.sim._groups["wheel"]).max() == 0.0)
    assert sum(says in r.getMessage() for r in caplog.records) == 1
    at = lambda: s.control.adapter.snapshot()[1][0]
    assert s.until(lambda: abs(at() - s.truth().pose[0] - 1.05) < 0.03 and not s.control.source.fault), at()
    go(at() + 1.0)
    assert s.control.state == "running: base to a goal"


def test_the_gate_allows_what_motion_and_spread_explain() -> None:
    """By hand: a robot at 1 m/s and a pose that is 0.1 s old; 0.1 m, and three standard deviations of both, are allowed."""
    gate, exact = PoseGate("/p", 0.1), np.zeros((3, 3))
    for t in np.arange(0.0, 1.0, 0.01):
        gate.note(float(t), np.array([t, 0.0, np.pi - 1e-3]))
    pose = lambda x, y=0.0, yaw=np.pi: np.array([x, y, yaw])
    assert gate.jumped(0.9, pose(0.9), exact, exact) == "" != gate.jumped(0.7, pose(0.9), exact, exact)
    assert gate.jumped(0.9, pose(0.9, 0.09), exact, exact) == ""
    assert "jumped by 0.11 m" in gate.jumped(0.9, pose(0.9, 0.11), exact, exact)
    spread = np.diag([0.03**2, 0.0, 0.0])
    assert gate.jumped(0.9, pose(0.9, 0.22), spread, np.diag([0.04, 0.04, 0.0]) ** 2) == ""  # 0.1 + 3 * 0.05
    assert "0.25 m are allowed" in gate.jumped(0.9, pose(0.9, 0.26), spread, np.diag([0.04, 0.04, 0.0]) ** 2)
    assert gate.jumped(0.9, pose(0.9, yaw=-np.pi), exact, exact) == ""  # the same direction
    assert "jumped by 0.20 rad" in gate.jumped(0.9, pose(0.9, yaw=np.pi - 0.201), exact, exact)
    gate.reset()
    assert gate.jumped(0.9, pose(99.0), exact, exact) == ""


def test_the_gate_follows_a_clock_that_is_restarted() -> None:
    """A run begins at 0 s; the estimate from before it is of the old clock, at 2 s. By hand: the robot turns at 1 rad/s, so that an
    exact pose of 0.5 s says 0.5 rad."""
    gate, exact = PoseGate("/p", 0.1), np.zeros((3, 3))
    gate.note(2.0, np.zeros(3))
    for t in np.arange(0.0, 0.6, 0.01):
        gate.note(float(t), np.array([0.0, 0.0, t]))
    assert gate.jumped(0.5, np.array([0.0, 0.0, 0.5]), exact, exact) == ""
    assert "jumped by 0.50 rad" in gate.jumped(0.5, np.zeros(3), exact, exact)


def test_after_a_jump_the_next_pose_counts_whatever_was_known() -> None:
    """The filter rejects a pose that is 100 standard deviations off, and takes the same one as the robot's place then."""
    adapter, covariance = SwerveRosAdapter(ROBOT, SwerveRosSettings(), PERIOD), 1e-4 * np.eye(3)
    controller, first, far = adapter.controller.estimator, np.array([1.0, 0.0, 0.0]), np.array([2.0, 0.5, 0.1])
    controller.correct(0.0, first, covariance)
    np.testing.assert_array_equal(controller.odometry.pose, first)
    controller.correct(0.0, far, covariance)
    np.testing.assert_array_equal(controller.odometry.pose, first)
    adapter.relocate()
    controller.correct(0.0, far, covariance)
    np.testing.assert_allclose(controller.odometry.pose, far, atol=1e-12)
