"""The mass in the end effector. Truth: weights of known masses at the tool, and torques of a robot that has them in MuJoCo's place."""

from __future__ import annotations

import numpy as np
import pytest

from toys import robot
from wbmpc.bases.ball.payload_step import SPREADS, Load, learn
from wbmpc.kernel.step import bind

ROBOT = robot("rezero")
N, H = ROBOT.base.nq, 0.0025
HOME = ROBOT.home[:N]


def weighed(force: np.ndarray, seconds: float = 4.0, weight: np.ndarray | None = None) -> tuple[float, np.ndarray]:
    """The mass after ``seconds`` at home, or with other weights, and what is left of the disturbance."""
    load = np.zeros(len(Load))
    arrays = {
        "weight": ROBOT.base.numeric.tool_weight(HOME) if weight is None else weight,
        "force": force.copy(),
        "load": load,
        "spreads": np.array(SPREADS),
    }
    step = bind(learn, arrays, n=N)
    for _ in range(round(seconds / H)):
        step(H)
    return float(load[Load.MASS]), arrays["force"]


def test_the_weight_of_a_mass_is_found_and_taken_over() -> None:
    weight = ROBOT.base.numeric.tool_weight(HOME)
    mass, rest = weighed(1.3 * weight, seconds=8.0)
    assert mass == pytest.approx(1.3, abs=1e-3)
    np.testing.assert_allclose(rest, 0.0, atol=1e-3 * np.abs(weight).max())
    slower, rest = weighed(1.3 * weight, seconds=0.5)
    assert slower == pytest.approx(1.3 * (1.0 - np.exp(-1.0)), rel=0.01)  # rate 2 /s
    np.testing.assert_allclose(rest + slower * weight, 1.3 * weight, atol=1e-9)  # no force appears or goes


def test_a_displaced_center_of_mass_is_no_payload() -> None:
    """10 mm of 25 kg in the base turn the lean alone: of 2.5 N m, which 0.35 kg would give, little is taken for a mass."""
    pitched = np.zeros(N)
    pitched[3] = np.sign(ROBOT.base.numeric.tool_weight(HOME)[3]) * 2.5
    assert abs(ROBOT.base.numeric.tool_weight(HOME)[3]) * 0.3 < 2.5
    assert 0.0 < weighed(pitched)[0] < 0.1


def test_no_mass_is_negative_and_none_is_beyond_what_can_be() -> None:
    weight = ROBOT.base.numeric.tool_weight(HOME)
    lifted, rest = weighed(-0.5 * weight)
    assert lifted == 0.0
    np.testing.assert_array_equal(rest, -0.5 * weight)
    heavy, rest = weighed(9.0 * weight)
    assert heavy == 3.0
    np.testing.assert_allclose(rest, 6.0 * weight, atol=1e-9)


def test_an_arm_that_cannot_tell_weighs_nothing() -> None:
    """Of 1.3 kg an arm of vertical axes feels nothing: what is left is the lean, as of 13 mm beside the middle. Straight up nobody
    feels anything: 0.3 N m of the base would be kilograms."""
    weight = ROBOT.base.numeric.tool_weight
    for own, force in (
        (np.where(np.arange(N) < 5, weight(HOME), 0.0), 1.3 * weight(HOME)),
        (weight(ROBOT.base.numeric.equilibrium([0.0, 0.0, 0.0])[0][:N]), np.eye(N)[3] * -0.3),
        (np.zeros(N), np.ones(N)),  # what weighs nothing here teaches nothing
    ):
        mass, rest = weighed(force, 0.1, own)
        np.testing.assert_array_equal(rest, force)
        assert mass == 0.0
