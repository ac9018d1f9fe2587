"""The ball robot of the benchmarks. Truth: shares of the reach that docstrings promise."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

import limit_scenarios
import realtime

from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.defaults import RezeroCost
from wbmpc.bases.ball.settings import STEPS_AND_PUSHES, PushedDisturbance
from wbmpc.model.robot import load_robot

ROBOT = load_robot("rezero")
NO_MPC: Any = SimpleNamespace(reference={}, reset=lambda *_: None)  # compiling one takes a second
STRONG = np.array([400.0, -100.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def in_real_time() -> BallController:
    return realtime.make_rezero_controller(NO_MPC, None, 400.0)  # type: ignore[arg-type]


def at_its_limits(cost: RezeroCost) -> BallController:
    variant: Any = SimpleNamespace(mpc=lambda *_: NO_MPC)
    controller: BallController = limit_scenarios._rezero(ROBOT, variant, 0, 5.0, cost).controller
    return controller


@pytest.mark.parametrize(
    ("make", "share"),
    [
        (in_real_time, 0.0),
        (lambda: at_its_limits(limit_scenarios.BALL_COST), STEPS_AND_PUSHES.lean),
        (lambda: at_its_limits(RezeroCost()), 0.0),
    ],
)
def test_it_leans_against_forces_as_in_the_experiments(make: Any, share: float) -> None:
    """Against one that is too strong with what is left of 90 % of the reach beside ``share``, to which the problem limits it."""
    lean_control = make().learned.lean_control
    assert lean_control is not None and lean_control.speed == PushedDisturbance().max_pushed_speed
    leans = lean_control.leans(STRONG, 0.3)
    lean = np.array(leans[:2]) - lean_control.center(leans, 0.3)
    assert np.hypot(*lean) == pytest.approx((0.9 - share) * lean_control.reach)
