"""The compiled tracking law against the same source as ordinary Python, and against NumPy's algebra."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from toys import made, robot
from wbmpc import lie
from wbmpc.bases.swerve.messages import SwerveMeasurement
from wbmpc.mpc.policy import Policy
from wbmpc.studies.pankert2022.track_control import FrictionTracking, TrackTracking

ROBOT = robot("swerve-ur10")
NU, NX, PERIOD = ROBOT.input.size, ROBOT.state.size, 0.0025


def policy(rng: np.random.Generator, scale: float) -> Policy:
    x, u = 0.2 * rng.normal(size=(9, NX)), scale * rng.normal(size=(8, NU))
    return Policy(np.linspace(0.0, 1.0, 9), x, u, np.zeros((8, NU, NX)))


def laws(planned: bool) -> list[FrictionTracking]:
    settings, scale = (
        TrackTracking(lag=0.02, friction=True, planned_steering=planned),
        np.array([1.0, 1.01, 0.99, 1.0]),
    )
    return [made(b, FrictionTracking, ROBOT, PERIOD, settings, scale) for b in ("compiled", "interpreted")]


@pytest.mark.parametrize("planned", [True, False])
def test_both_back_ends_say_the_same(planned: bool) -> None:
    """Plans that are followed, that are too fast, and whose steering angles are far away; brakes that open and close; predictions."""
    rng, both, seen = np.random.default_rng(0), laws(planned), set()
    fast = policy(rng, 8.0)
    previous = SwerveMeasurement(0.0, *(np.zeros(k) for k in (4, 4, 4, 6)))
    for k in range(80):
        plan, brake = policy(rng, 0.1) if k < 20 else fast, (rng.uniform(size=4) > 0.5).astype(float)
        steer = plan.state(PERIOD * k + 0.02)[ROBOT.state["steer"]] + (0.5 if 5 < k < 10 else 0.01) * rng.normal(size=4)
        estimate = SimpleNamespace(steer=steer, hinge_angles=np.zeros(4))
        now = SwerveMeasurement(PERIOD * (k + 1), *(0.01 * rng.normal(size=n) for n in (4, 4, 4, 6)))
        found, x = [], rng.normal(size=NX)
        for law in both:
            if k == 50:  # as if wheels had been too fast
                law._arrays["sent"][ROBOT.input["wheel"]] = 2.0 * ROBOT.limits.input_upper[ROBOT.input["wheel"]]
            law.arm.learn(now.arm - previous.arm, PERIOD)
            law.learn_friction(previous, now)
            command, legs = law.command(PERIOD * k, plan, estimate, brake)  # type: ignore[arg-type]
            law.ahead(x, brake)
            law.predict(plan.u[0], brake)
            parts = (
                command.wheel,
                command.steer,
                command.arm,
                legs,
                law.target,
                law.sent,
                law.drives.rates,
                law.predicted,
            )
            found.append([np.array(p) for p in parts])
        for one, other in zip(*found, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-12)
        assert (both[0].aligning, both[0].clamped) == (both[1].aligning, both[1].clamped)
        seen.add((both[0].aligning, both[0].clamped))
        previous = now
    assert {a for a, _ in seen} == ({True, False} if planned else {False}) and {c for _, c in seen} == {True, False}


def test_accelerations_go_one_share_of_the_way() -> None:
    """Truth: the definition by NumPy. Closed brakes stop their legs as hard as they like; the steering and each joint of the arm are on
    their own: an arm that has to stop does not wait for wheels."""
    rng, law = np.random.default_rng(1), laws(True)[0]
    plan, brake = policy(rng, 3.0), np.array([1.0, 0.0, 1.0, 0.0])
    steer, leg = ROBOT.input["steer"], ROBOT.input["leg"]
    at = SimpleNamespace(steer=plan.state(0.02)[ROBOT.state["steer"]], hinge_angles=np.zeros(4))
    law.command(0.0, plan, at, brake)  # type: ignore[arg-type]
    limit = ROBOT.limits.input_rate * PERIOD
    limit[leg] = np.where(brake > 0.5, limit[leg], np.inf)
    excess = np.maximum(np.abs(law.target) / limit, 1.0)
    together = np.setdiff1d(np.arange(NU), np.r_[steer, ROBOT.input["arm"]])
    excess[together] = excess[together].max()
    np.testing.assert_allclose(law.sent, law.target / excess, rtol=1e-12)


def test_a_prediction_is_exact_for_constant_rates() -> None:
    """Truth: the motion of a constant twist on SE(2); joints by their rates, legs only with open brakes."""
    law, given, state = laws(True)[0], ROBOT.input, ROBOT.state
    x, brake = np.random.default_rng(2).normal(size=NX), np.array([1.0, 0.0, 1.0, 1.0])
    law.drives.rates[:] = np.random.default_rng(3).normal(size=NU)
    law.ahead(x, brake)
    rates, h = law.drives.rates, law.settings.lag
    expected = x.copy()
    expected[state["base"]] = lie.se2_step(x[state["base"]], rates[given["base"]] * h)
    for group in ("leg", "steer", "wheel", "arm"):
        expected[state[group]] += rates[given[group]] * h * (brake if group == "leg" else 1.0)
    np.testing.assert_allclose(law.predicted, expected, atol=1e-13)
