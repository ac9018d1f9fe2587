"""A ball robot on a bus. Truth: MuJoCo's robot stands or has fallen; limits of the settings; the simulator's pose."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from needs import MISSING, needs_dds, private

from wbmpc.errors import InputError
from wbmpc.model import load_robot
from wbmpc.ros2 import Network

pytestmark = needs_dds
if not MISSING:
    from simulated import Simulated

    from wbmpc.ros2.settings import BallSettings

ROBOT = load_robot("rezero")
NETWORK = Network.of({**private(), "ROS_DOMAIN_ID": "48"})


@pytest.fixture
def made(caplog: pytest.LogCaptureFixture) -> Iterator[Callable[..., Any]]:
    caplog.set_level(logging.INFO, "wbmpc")
    opened: list[Any] = []

    def make(**settings: Any) -> Any:
        opened.append(Simulated(ROBOT, NETWORK, **settings))
        return opened[-1]

    yield make
    for s in opened:
        s.close()


def balancing(s: Any) -> None:
    """Bring a robot to balance."""
    s.ready()
    s.hand()
    assert s.until(lambda: s.control.state.startswith("running:")), s.control.state
    s.run(0.5)


def standing(s: Any) -> None:
    """It stands, 2 s later too: without torques it falls within 1 s."""
    s.run(2.0)
    assert not s.why and s.truth().tilt < 0.25 and s.control.running


def errors(caplog: pytest.LogCaptureFixture, text: str) -> int:
    return sum(text in r.getMessage() and r.levelno == logging.ERROR for r in caplog.records)


def test_it_is_held_until_a_goal_comes_and_then_balances(made: Callable[..., Any]) -> None:
    s = made()
    s.ready()
    s.run(0.3)
    assert not any(s.sim._count.values()) and s.sim.plant.time == 0.0
    s.hand(dx=0.1)
    s.run(3.0)
    assert not s.why and s.control.running
    truth = s.truth()
    home = ROBOT.pose(ROBOT.home)[0]
    np.testing.assert_allclose(truth.tool, home + [0.1, 0.0, 0.0], atol=0.02)
    e = s.control.pilot.estimate()
    np.testing.assert_allclose(e.position, [*truth.pose[:2], 0.125], atol=0.01)
    spread = np.sqrt(np.diag(e.covariance))
    assert np.all(spread > 0.0) and spread[0] < 0.05 and spread[3] < 0.05
    # the position is known less and less, the lean is not
    s.run(1.0)
    later = s.control.pilot.estimate().covariance
    assert later[0, 0] > e.covariance[0, 0] and later[3, 3] < 1.5 * e.covariance[3, 3]


def test_an_mpc_that_dies_leaves_its_last_policy(made: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    s = made()
    balancing(s)

    def dies(observation: Any) -> bool:
        raise RuntimeError("no memory")

    s.control.pilot.mpc.advance = dies
    standing(s)
    assert "running on the last policy" in s.control.state and "no memory" in s.control.state
    assert errors(caplog, "no memory") == 1
    assert any("no memory" in m for m in s.messages(2))


def test_an_mpc_that_gives_no_plan_for_a_while(made: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    """A policy that is too old is kept, and given up as soon as there is a new one."""
    s = made()
    balancing(s)
    solve = s.control.pilot.mpc.advance
    s.control.pilot.mpc.advance = lambda observation: False
    s.run(2.0)
    assert "the policy is 0.5" in s.control.state and errors(caplog, "running on the last policy") == 1
    assert not s.why and s.truth().tilt < 0.25
    s.control.pilot.mpc.advance = solve
    assert s.until(lambda: s.control.state == "running: hand to a goal"), s.control.state
    standing(s)


def test_a_message_that_is_wrong_does_not_count(made: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    s = made()
    balancing(s)
    broken = iter([
        lambda m: {**m, "position": m["position"] * np.nan}, lambda m: m, lambda m: {**m, "position": m["position"] + 1.0},
    ])  # fmt: skip
    s.change = lambda m: next(broken, lambda same: same)(m)
    standing(s)
    assert errors(caplog, "is not finite; it does not count") == 1 and errors(caplog, "jumped by 1 rad") == 1


def test_somebody_else_on_the_drives_topic_is_told_and_it_holds_its_place(
    made: Callable[..., Any], caplog: pytest.LogCaptureFixture
) -> None:
    s = made()
    balancing(s)
    somebody = s.other.publisher("/arm_controller/commands", "std_msgs/msg/Float64MultiArray")
    assert s.until(lambda: "holds its place: somebody else publishes on /arm" in s.control.state)
    s.hand(dx=0.2)
    standing(s)
    assert "a goal is refused: somebody else" in s.control.inbox.refused
    assert errors(caplog, "somebody else publishes") == 1 and any("somebody" in m for m in s.messages(2))
    s.other._writers.remove(somebody._writer)
    somebody._writer.__del__()
    assert s.until(lambda: s.control.state == "running: stay"), s.control.state


def test_without_states_there_is_no_balance(made: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    s = made()
    balancing(s)
    s.change = lambda m: None
    assert s.until(lambda: s.control.runner.stopped), s.control.state
    assert "s old, the limit is 0.1 s" in s.control.state
    assert s.until(lambda: np.all(s.sim._groups["wheel"] == 0.0) or s.why)
    assert errors(caplog, "s old, the limit") == 1
    assert s.until(lambda: any("s old" in m for m in s.messages(2)))


def test_what_it_needs_and_what_it_cannot_do(made: Callable[..., Any]) -> None:
    for topics, says in (({"imu": ""}, "needs an inertial unit"), ({"pose": "/amcl"}, "takes no poses")):
        with pytest.raises(InputError, match=says):
            made(topics=topics)
    assert BallSettings().command_topics(ROBOT)["wheel_controller"].joints == ("wheel_0", "wheel_1", "wheel_2")
