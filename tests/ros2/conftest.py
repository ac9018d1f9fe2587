"""Tests of this directory may import what stands beside them, and the benchmark of the bus."""

import logging
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parents[1] / "benchmarks")]


@pytest.fixture
def pair(caplog: pytest.LogCaptureFixture) -> Iterator[Callable[..., Any]]:
    """Makes a controller's node of given settings and a robot that the test drives."""
    from standin import Pair

    caplog.set_level(logging.INFO, "wbmpc")
    made: list[Any] = []

    def make(**settings: Any) -> Any:
        made.append(Pair(**settings))
        return made[-1]

    yield make
    for p in made:
        p.close()
