"""What others say to a ball robot on a bus: where it is, and what pushes it. Truth: MuJoCo's pose, moved by known offsets."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from needs import MISSING, needs_dds

from effort import thorough

pytestmark = [needs_dds, thorough]
if not MISSING:
    from balancing import ROBOT, balancing, errors, standing
    from simulated import Localization


def test_another_localization_leads_it_and_when_that_is_lost_it_holds_its_place(
    made: Callable[..., Any], caplog: pytest.LogCaptureFixture
) -> None:
    """The simulator's true pose, moved by an offset, as an exact source: the robot is where that says."""
    s = made(topics={"pose": "/localization"})
    source = Localization(s)
    source.offset[:] = offset = np.array([3.0, -1.0])
    balancing(s)
    s.end_effector(dx=0.2)
    s.run(3.0)
    truth = s.truth()
    seen = s.control.adapter.snapshot()[1]
    np.testing.assert_allclose(seen[:2], truth.pose[:2] + offset, atol=3e-3)
    np.testing.assert_allclose(truth.tool, ROBOT.pose(ROBOT.home)[0] + [0.2, 0.0, 0.0], atol=0.02)
    assert np.sqrt(s.control.adapter.estimate().covariance[0, 0]) < 3e-3
    source.sending = False
    assert s.until(lambda: "holds its position: the pose on /localization is" in s.control.state), s.control.state
    s.end_effector(dx=0.2)
    standing(s)
    assert "a goal is rejected: the pose on /localization" in s.control.request_queue.rejected
    assert errors(caplog, "the pose on /localization") == 1 and any("/localization" in m for m in s.messages(2))
    source.sending = True
    assert s.until(lambda: s.control.state == "running: stay"), s.control.state


def test_a_localization_that_jumps_does_not_count_and_it_holds_its_place(
    made: Callable[..., Any], caplog: pytest.LogCaptureFixture
) -> None:
    """One pose that is off by 1 m is left out; when they stay there it holds its position and takes no goals until they are back."""
    s = made(topics={"pose": "/localization"})
    source = Localization(s)
    balancing(s)
    source.offset[0] = 1.05
    assert s.until(lambda: "jumped by 1.0" in s.control.source.fault)
    source.offset[0] = 0.0
    assert s.until(lambda: not s.control.source.fault) and s.control.state == "running: end effector to a goal"
    assert errors(caplog, "jumped by 1.0") == 1
    source.offset[0] = 1.05
    assert s.until(lambda: "holds its position: the pose on /localization is" in s.control.state), s.control.state
    s.end_effector(dx=0.2)
    standing(s)
    assert "jumped by 1.0" in s.control.state and "a goal is rejected: the pose on" in s.control.request_queue.rejected
    assert any("jumped by 1.0" in m for m in s.messages(2)) and np.abs(s.truth().pose[:2]).max() < 0.1
    source.offset[0] = 0.0
    assert s.until(lambda: s.control.state == "running: stay"), s.control.state


def test_a_moment_that_is_announced_turns_the_hand_less(made: Callable[..., Any]) -> None:
    """1.5 N m at the forearm, without the disturbance observer: with the reference the plan counts with the world's answer."""
    moved = []
    for announced in (False, True):
        s = made(disturbance="none", topics={"wrench": f"/moment_{announced}"})
        balancing(s)
        start = s.truth().tool.copy()
        publisher = s.other.publisher(f"/moment_{announced}", "geometry_msgs/msg/WrenchStamped")
        assert s.until(lambda p=publisher: p._writer.get_matched_subscriptions())
        with s._physics:
            s.sim.plant.push(np.zeros(3), [0.0, 1.5, 0.0], body="arm_forearm_link")
        wrong = 0.0
        for _ in range(10):
            if announced:
                publisher.publish({"header": {"frame_id": "odom"}, "wrench": {"torque": {"y": -1.5}}})
            s.run(0.1)
            wrong = max(wrong, float(np.linalg.norm(s.truth().tool - start)))
        moved.append(wrong)
        assert not s.why
        s.close()
    assert moved[1] < 0.6 * moved[0], moved
