"""Drift of a base against its wheels. Truth: the twist that was put in; the offset that is left without it."""

from __future__ import annotations

import numpy as np
import pytest

from toys import robot
from wbmpc import lie
from wbmpc.errors import InputError
from wbmpc.estimation import DriftObserver
from wbmpc.experiments.settings import MpcSettings
from wbmpc.experiments.swerve_problem import SwerveCost, swerve_mpc
from wbmpc.mpc import Observation
from wbmpc.ocp import Reference

SLOPE = np.array([0.03, -0.05, 0.02])


def test_a_constant_drift_is_found() -> None:
    observer, pose, rng = DriftObserver(0.3), np.zeros(3), np.random.default_rng(0)
    observer.update(pose, np.zeros(3), 0.01)
    for k in range(400):
        twist = np.array([0.3, 0.1 * np.sin(0.05 * k), 0.4])
        pose = lie.se2_step(pose, 0.01 * (twist + SLOPE))
        observer.update(pose + 1e-5 * rng.normal(size=3), twist, 0.01)
    np.testing.assert_allclose(observer.drift, SLOPE, atol=2e-3)


def test_bad_time_constant() -> None:
    with pytest.raises(InputError, match="time constant"):
        DriftObserver(0.0)


def driven(observed: bool) -> float:
    """Mean hand error [m] over the last second of a drive forwards at 0.2 m/s on a slope, poses measured from outside."""
    model = robot("swerve-ur10")
    mpc = swerve_mpc(model, MpcSettings(horizon=4.0, intervals=20, first_interval=0.02), SwerveCost())
    t = np.linspace(0.0, 12.0, 300)
    along = 0.2 * np.where(t < 2.0, t * t / 4.0, t - 1.0)
    position, quaternion = model.pose(model.home)
    hand = position + np.stack([along, 0 * t, 0 * t], axis=1)
    states, inputs = np.tile(model.home, (t.size, 1)), np.zeros((t.size, model.input.size))
    states[:, 0], inputs[:, 0] = along, 0.2 * np.clip(t / 2.0, 0.0, 1.0)
    mpc.reference["hand"] = Reference.poses(t, hand, quaternion)
    mpc.reference["state"], mpc.reference["input"] = Reference(t, states), Reference(t, inputs)
    mpc.reset(model.home)
    observer, x, h, errors = DriftObserver(0.3), model.home.copy(), 0.02, []
    twist = np.zeros(3)
    for k in range(300):
        estimate = observer.update(x[:3], twist, h)
        if observed:
            mpc.solver.set_parameters({"drift": estimate})
        policy = mpc.update(Observation(k * h, x))
        u = policy.feedforward(k * h)
        twist = u[:3]
        drift = SLOPE * min(1.0, k * h)  # the slope begins: it does not hit like a step
        moved = lie.se2_step(x[:3], h * (twist + drift))
        x = np.concatenate([moved, x[3:] + h * u[3:] * np.where(np.arange(3, 21) < 7, 0.0, 1.0)])
        errors.append(np.linalg.norm(model.pose(x)[0] - np.array([np.interp((k + 1) * h, t, c) for c in hand.T])))
    return float(np.mean(errors[-50:]))


def test_the_estimate_in_the_plan_takes_the_offset_away() -> None:
    without, with_it = driven(False), driven(True)
    assert without > 5e-4
    assert with_it < 0.3 * without
