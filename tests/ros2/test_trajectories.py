"""Trajectories for a joint_trajectory_controller. Truth: its rules as documented (an end at rest, rising times, all joints, not in
the past), limits of the robot's file, and braking by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from wbmpc.errors import InputError
from wbmpc.model import load_robot
from wbmpc.mpc import Policy
from wbmpc.ros2.convert import seconds
from wbmpc.ros2.plants import SwerveSide
from wbmpc.ros2.sending import AHEAD, TrajectorySender
from wbmpc.ros2.settings import Controller, RosSettings

ROBOT = load_robot("swerve-ur10")
ARM = list(ROBOT.input.groups["arm"])
LIMITS = ROBOT.description.limits


def plain(values: dict[str, Any]) -> Any:
    """A message as it comes out of the bus."""
    points = [
        SimpleNamespace(**{**p, "time_from_start": SimpleNamespace(**p["time_from_start"])}) for p in values["points"]
    ]
    head = SimpleNamespace(stamp=SimpleNamespace(**values["header"]["stamp"]))
    return SimpleNamespace(header=head, joint_names=values["joint_names"], points=points)


def sent(rate: np.ndarray, start: np.ndarray | None = None) -> Any:
    """What is sent for an arm that moves at a constant rate [rad/s] as long as anybody plans; now is 7 s."""
    said: list[dict[str, Any]] = []
    node: Any = SimpleNamespace(publisher=lambda *given: SimpleNamespace(publish=said.append))
    controller = Controller(topic="/arm", joints=tuple(ARM), takes="trajectory")
    times = np.linspace(0.0, 2.0, 41)
    x = np.tile(ROBOT.home, (41, 1))
    x[:, ROBOT.state["arm"]] = (ROBOT.home[ROBOT.state["arm"]] if start is None else start) + times[:, None] * rate
    u = np.zeros((40, ROBOT.input.size))
    u[:, ROBOT.input["arm"]] = rate
    policy = Policy(times, x, u, np.zeros((40, ROBOT.input.size, ROBOT.state.size)))
    TrajectorySender(node, ROBOT, RosSettings(), controller).send(policy, 0.01, 7.0)
    return plain(said[0])


def test_a_moving_arms_trajectory_ends_at_rest() -> None:
    """Two joints at 1 and -0.5 rad/s: constant deceleration below the limits, over half the way of the speed."""
    rate = np.array([1.0, 0.0, -0.5, 0.0, 0.0, 0.0])
    message = sent(rate)
    last, end = message.points[-2:]
    assert seconds(last.time_from_start) < AHEAD and np.array_equal(last.velocities, rate)
    np.testing.assert_array_equal(end.velocities, np.zeros(6))
    takes = seconds(end.time_from_start) - seconds(last.time_from_start)
    acceleration = np.array([LIMITS.acceleration[n] for n in ARM])
    assert np.all(np.abs(rate) / takes <= acceleration) and takes < 2.0 * np.max(np.abs(rate) / acceleration)
    np.testing.assert_allclose(np.array(end.positions) - last.positions, 0.5 * takes * rate, atol=1e-9)
    led = SwerveSide(ROBOT, None, 0).lead(ARM, [("arm", i) for i in range(6)], message, 7.0)
    np.testing.assert_array_equal(led.at(led.times[-1])[1], np.zeros(6))


def test_no_joint_is_sent_beyond_its_range() -> None:
    upper = ROBOT.limits.state_upper[ROBOT.state["arm"]]
    start = ROBOT.home[ROBOT.state["arm"]].copy()
    start[2] = upper[2] - 0.52
    message = sent(np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), start)
    assert message.points[-2].positions[2] < upper[2] == message.points[-1].positions[2]


RULES = [
    (lambda m: m.points.clear(), "no points"),
    (lambda m: m.joint_names.pop(), "joints .* are needed"),
    (lambda m: m.joint_names.__setitem__(0, "elbow"), "joints .* are needed"),
    (lambda m: setattr(m.points[-1], "velocities", np.full(6, 0.01)), "must be at rest"),
    (lambda m: setattr(m.points[2], "time_from_start", m.points[1].time_from_start), "must rise"),
    (lambda m: setattr(m.header.stamp, "sec", 5), "it ended"),
    (lambda m: setattr(m.points[1], "positions", np.zeros(5)), "needs 6 positions"),
    (lambda m: setattr(m.points[1], "velocities", np.zeros(7)), "needs 6 velocities"),
    (lambda m: setattr(m.points[1], "positions", np.full(6, np.nan)), "must be finite"),
]


@pytest.mark.parametrize(("change", "says"), RULES)
def test_the_follower_rejects_what_the_real_controller_does(change: Any, says: str) -> None:
    side, places = SwerveSide(ROBOT, None, 0), [("arm", i) for i in range(6)]
    message = sent(np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    side.lead(ARM, places, message, 7.0)
    change(message)
    with pytest.raises(InputError, match=says):
        side.lead(ARM, places, message, 7.0)
