"""Falls that are foreseen. Truth: leans of MuJoCo's robot against what the wheels can stop (tests/model/test_balance.py)."""

from __future__ import annotations

import numpy as np
import pytest

from toys import robot
from wbmpc.bases.ball.balance import Balance
from wbmpc.bases.ball.fall_detection import FallPredictor, stop_for
from wbmpc.errors import FallPredicted
from wbmpc.model.robot import load_robot
from wbmpc.mpc.policy import Policy

ROBOT = robot("rezero")
ARM = ROBOT.home[ROBOT.state["arm"]]


def tilted(pitch: float) -> np.ndarray:
    x = ROBOT.home.copy()
    x[3] += pitch
    return x


def plan(pitch: float, at: float = 0.1) -> Policy:
    """Two intervals; it leans in the middle, ``at`` seconds from the start."""
    times = 2.0 + at * np.arange(3)
    x = np.tile(tilted(0.0), (3, 1))
    x[1] = tilted(pitch)
    return Policy(times, x, np.zeros((2, 6)), np.zeros((2, 6, 16)))


def test_plans_in_a_row_that_lean_too_far() -> None:
    """The load's center of mass is 0.28 to 0.45 m above the ball: 0.2 rad are within 115 mm, 0.6 rad are not."""
    fall_predictor = FallPredictor(ROBOT, ARM, ahead=0.1001)
    for pitch in (*[0.6] * 7, 0.2, *[0.6] * 7):
        policy = plan(pitch)
        stop_for(fall_predictor.update_plan(policy))
        stop_for(fall_predictor.update_plan(policy))  # the same one again
    with pytest.raises(FallPredicted, match="8 plans in a row"):
        stop_for(fall_predictor.update_plan(plan(0.6)))


def test_what_a_plan_says_later_is_not_looked_at() -> None:
    fall_predictor = FallPredictor(ROBOT, ARM, ahead=0.1)
    for _ in range(20):
        assert fall_predictor.update_plan(plan(0.6, at=0.2)) == []


def test_a_state_beyond_reach_is_a_fall_whatever_is_planned() -> None:
    fall_predictor, t = FallPredictor(ROBOT, ARM), 0.0
    for pitch, seconds in ((0.2, 1.0), (0.6, 0.045), (0.2, 0.1), (-0.6, 0.045)):
        for _ in range(round(seconds / 0.0025)):
            t += 0.0025
            stop_for(fall_predictor.update(t, tilted(pitch)))
    with pytest.raises(FallPredicted, match=r"for 50 ms it has leant by \d+ mm .* can stop \d+ mm; motors off"):
        for _ in range(4):
            t += 0.0025
            stop_for(fall_predictor.update(t, tilted(-0.6)))


def test_a_rate_that_leads_there_counts_like_the_lean() -> None:
    """The pole is 4.7 /s: turning by 2 rad/s counts as a lean of 0.42 rad more."""
    still, turning = FallPredictor(ROBOT, ARM), FallPredictor(ROBOT, ARM)
    x = tilted(0.15)
    for k in range(30):
        stop_for(still.update(0.0025 * k, x))
    x[ROBOT.base.nq + 3] = 2.0
    with pytest.raises(FallPredicted):
        for k in range(30):
            stop_for(turning.update(0.0025 * k, x))


def test_a_learned_force_moves_the_lean_from_which_falls_count() -> None:
    """What is 40 mm beyond the reach counts as none if a learned force answers 60 mm of it."""
    fall_predictor, answered = FallPredictor(ROBOT, ARM), FallPredictor(ROBOT, ARM)
    lean = next(
        p
        for p in np.arange(0.2, 0.8, 0.005)
        if fall_predictor._maximum(tilted(p)[None], 0.0, np.zeros((1, 2)), (0.0, 0.0)) > 1.3 * 0.1256
    )
    fall_predictor._evaluate.arguments[0] = [*tilted(lean), 0.0, 0.0, 0.0]
    away = fall_predictor._evaluate(1)[0].copy()
    for k in range(40):
        stop_for(answered.update(0.0025 * k, tilted(lean), shift=-0.06 * away / np.linalg.norm(away)))
    with pytest.raises(FallPredicted):
        for k in range(40):
            stop_for(fall_predictor.update(0.0025 * k, tilted(lean)))


def test_a_force_on_the_hand_moves_the_lean_from_which_falls_count() -> None:
    """Balance.answer (tests/model/test_balance.py): a lean that a push of the world answers is none, without it one is lost."""
    pushed, fall_predictor = load_robot("rezero", contact="force"), FallPredictor(ROBOT, ARM)
    against = -1.2 * fall_predictor.reach / Balance.of(ROBOT, ARM).answer  # N along x
    lean = next(
        p
        for p in np.arange(0.2, 0.6, 0.005)
        if fall_predictor._maximum(tilted(p)[None], 0.0, np.zeros((1, 2)), (0.0, 0.0)) > 1.1 * fall_predictor.reach
    )
    for k in range(40):
        stop_for(fall_predictor.update(0.0025 * k, tilted(lean), force=(against, 0.0)))
    with pytest.raises(FallPredicted):
        for k in range(40, 80):
            stop_for(fall_predictor.update(0.0025 * k, tilted(lean)))
    planned, still = FallPredictor(pushed, ARM), plan(lean, at=0.05)
    u = np.zeros((2, 9))
    u[0, pushed.input["force"]] = [against, 0.0, 0.0]  # the last state of the plan leans no more
    for _ in range(8):
        stop_for(planned.update_plan(Policy(still.times, still.x, u, np.zeros((2, 9, 16)))))
    with pytest.raises(FallPredicted):
        for _ in range(8):
            stop_for(planned.update_plan(Policy(still.times, still.x, 0.0 * u, np.zeros((2, 9, 16)))))
