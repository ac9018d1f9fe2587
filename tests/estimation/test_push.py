"""The drift of a lean that a model does not explain. Truth: MuJoCo's center of mass under speeds the model knows nothing of."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from toys import made, robot
from wbmpc.bases.ball.balance import Balance
from wbmpc.bases.ball.push import DEAD, SMOOTH, PushEstimator
from wbmpc.robots import load_spec

ROBOT, H, BALL = robot("rezero"), 0.0025, 2.65
HOME = ROBOT.home[ROBOT.state["arm"]]


def offset(q: np.ndarray) -> np.ndarray:
    """Horizontal offset (2) [m] of the center of mass of all but the ball from the ball's center, for angles q (8), by MuJoCo."""
    spec = load_spec(ROBOT.description)
    spec.body("base").add_freejoint()
    model = spec.compile()
    data, turn = mujoco.MjData(model), np.zeros(4)
    mujoco.mju_euler2Quat(turn, q[2:5], "zyx")
    data.qpos[:7], data.qpos[7 + 4 :] = [*q[:2], 0.0, *turn], q[5:8]
    mujoco.mj_forward(model, data)
    mass = model.body("base").subtreemass
    ball = data.body("ball").xipos
    return ((mass * (data.body("base").subtree_com - ball)) / (mass - BALL))[:2]


def felt(kick: np.ndarray, ticks: int) -> tuple[PushEstimator, np.ndarray]:
    """What is felt of speeds (8) [m/s², rad/s²] that come up in every tick, in a model in which nothing moves; angles (8)."""
    push, x = PushEstimator(ROBOT, HOME, expected_push_time=0.2), ROBOT.home.copy()
    x[2:8] += [0.4, 0.1, -0.05, 0.2, 0.1, -0.3]
    for k in range(ticks):
        push.update(np.concatenate([x[:8], k * H * kick]), np.zeros(6), H, lambda x, u, h: x)
    return push, x[:8]


def test_what_the_model_does_not_explain_moves_the_lean() -> None:
    kick = np.array([30.0, -10.0, 1.0, 2.0, -3.0, 5.0, -20.0, 40.0])
    push, q = felt(kick, 60)
    e = 1e-6
    pole = Balance.of(ROBOT, HOME).pole
    want = (offset(q + e * kick) - offset(q - e * kick)) / (2.0 * e) / pole
    assert np.hypot(*want) > 1.5 * DEAD
    np.testing.assert_allclose(push.drift, want, rtol=1e-4)
    np.testing.assert_allclose(push.lean_margin, 0.2 * want * (1.0 - DEAD / np.hypot(*want)), rtol=1e-3)
    push.reset()
    np.testing.assert_array_equal(push.lean_margin, 0.0)


def test_a_push_is_felt_within_a_few_messages_and_as_soon_forgotten() -> None:
    """After the time constant 1/e is missing, a little more for steps of a quarter of it."""
    kick = np.array([0.0, 0.0, 0.0, 8.0, 0.0, 0.0, 0.0, 0.0])
    push, q = felt(kick, 80)
    late = np.linalg.norm(felt(kick, 1 + round(SMOOTH / H))[0].drift)
    assert late / np.linalg.norm(push.drift) == pytest.approx(1.0 - np.exp(-1.0), abs=0.05)
    x = np.concatenate([q, 79 * H * kick])
    for _ in range(20):
        push.update(x, np.zeros(6), H, lambda x, u, h: x)
    np.testing.assert_array_equal(push.lean_margin, 0.0)


def test_what_is_no_push_leaves_the_limit_as_it_is() -> None:
    push, _ = felt(np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]), 80)
    assert 0.02 < np.linalg.norm(push.drift) < DEAD
    np.testing.assert_array_equal(push.lean_margin, 0.0)


def test_machine_code_finds_what_the_same_source_does_as_python() -> None:
    rng = np.random.default_rng(2)
    one, other = (made(backend, PushEstimator, ROBOT, HOME, 0.2) for backend in ("compiled", "interpreted"))
    for _ in range(20):
        x, u = ROBOT.home + 0.1 * rng.normal(size=ROBOT.home.size), rng.normal(size=6)
        for push in (one, other):
            push.update(x, u, H, lambda x, u, h: x)
        np.testing.assert_allclose(one.drift, other.drift, rtol=1e-12)
    assert np.linalg.norm(one.drift) > DEAD
