"""Another localisation of a swerve robot. Truth: poses that were sent, a Kalman step by hand, limits of the settings."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from needs import MISSING, needs_dds

pytestmark = needs_dds
if not MISSING:
    from standin import PERIOD, check_stopped


def test_a_pose_in_a_wrong_frame_is_told_once_until_it_is_right(
    pair: Callable[..., Any], caplog: pytest.LogCaptureFixture
) -> None:
    p = pair(topics={"pose": "/amcl_pose"})
    publisher = p.standin.node.publisher("/amcl_pose", "geometry_msgs/msg/PoseWithCovarianceStamped")
    assert p.until(lambda: publisher._writer.get_matched_subscriptions())
    says = "/amcl_pose: the pose is in frame 'map', 'odom' is needed"

    def tell(frame: str, times: int) -> None:
        for _ in range(times):
            publisher.publish({"header": {"frame_id": frame}, "pose": {"pose": {"position": {"x": 1.0}}}})
            time.sleep(0.02)

    said = lambda: [v.value for m in p.said for s in m.status for v in s.values if v.key == "refused pose"]
    for k in (1, 2):
        tell("map", 5)
        assert p.until(lambda: p.control.state == f"waiting: {says}"), p.control.state
        assert sum(r.getMessage() == says for r in caplog.records) == k
        assert p.until(lambda: says in said())
        tell("odom", 1)
        assert p.until(lambda: p.control.source.fault == "")
        time.sleep(0.6)


def test_lost_localisation_stops(pair: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    p = pair(topics={"pose": "/amcl_pose"})
    assert p.until(lambda: p.control.state == "waiting: no pose on /amcl_pose"), p.control.state
    publisher = p.standin.node.publisher("/amcl_pose", "geometry_msgs/msg/PoseWithCovarianceStamped")
    sending = [True]

    def change(message: dict[str, Any]) -> dict[str, Any]:
        if sending and round(p.standin.time / PERIOD) % 10 == 0:
            publisher.publish({"header": {"frame_id": "odom"}, "pose": {"pose": {"position": {"x": 3.0, "y": -1.0}}}})
        return message

    p.standin.change = change
    p.ready()
    np.testing.assert_allclose(p.control.pilot.snapshot()[1][:3], [3.0, -1.0, 0.0])
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
    assert p.control.pilot.snapshot()[1][0] == pytest.approx(3.005, abs=1e-4)
    e = p.control.pilot.estimate()
    assert e.covariance[0, 0] == pytest.approx(0.5e-4, rel=0.05) and e.covariance[2, 2] == 1e6
