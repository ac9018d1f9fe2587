"""Tests of this directory may import what stands beside them, and the benchmark of the bus."""

import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from wbmpc.model.robot import RobotModel

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parents[1] / "benchmarks")]


@pytest.fixture
def pair(caplog: pytest.LogCaptureFixture) -> Iterator[Callable[..., Any]]:
    """Makes a controller's node of given settings and a robot that the test drives."""
    from standin import Pair

    caplog.set_level(logging.INFO, "wbmpc")
    with ExitStack() as closing:  # all of them, whatever fails

        def make(**settings: Any) -> Any:
            made = Pair(**settings)
            closing.callback(made.close)
            return made

        yield make


@pytest.fixture
def made(caplog: pytest.LogCaptureFixture) -> Iterator[Callable[..., Any]]:
    """Makes a ball robot on a bus: the node of given settings and MuJoCo's robot, in lockstep."""
    from balancing import NETWORK, ROBOT
    from simulated import Simulated

    caplog.set_level(logging.INFO, "wbmpc")
    with ExitStack() as closing:

        def make(**settings: Any) -> Any:
            s = Simulated(ROBOT, NETWORK, **settings)
            closing.callback(s.close)
            return s

        yield make


@pytest.fixture
def simulated(robot: RobotModel) -> Iterator[Any]:
    """The node and MuJoCo's robot of the test's ``robot``, in lockstep on a network of their own."""
    from needs import private
    from simulated import Simulated

    from wbmpc.ros2.network import Network

    made = Simulated(robot, Network.of(private()))
    yield made
    made.close()
