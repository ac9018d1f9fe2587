"""Drift of a base against its wheels. Truth: the twist that was put in; the offset that is left without it."""

from __future__ import annotations

import numpy as np
import pytest

from toys import robot
from wbmpc import lie
from wbmpc.bases.swerve.defaults import SwerveCost, swerve_mpc
from wbmpc.errors import InputError
from wbmpc.estimation.base_slip import BaseSlipObserver
from wbmpc.estimation.offset import OffsetObserver
from wbmpc.ocp import Reference
from wbmpc.settings import MpcSettings
from wbmpc.types import Observation

SLOPE = np.array([0.03, -0.05, 0.02])


def test_a_constant_drift_is_found() -> None:
    observer, pose, rng = BaseSlipObserver(0.3), np.zeros(3), np.random.default_rng(0)
    observer.update(pose, np.zeros(3), 0.01)
    for k in range(400):
        twist = np.array([0.3, 0.1 * np.sin(0.05 * k), 0.4])
        pose = lie.se2_step(pose, 0.01 * (twist + SLOPE))
        observer.update(pose + 1e-5 * rng.normal(size=3), twist, 0.01)
    np.testing.assert_allclose(observer.drift, SLOPE, atol=2e-3)


def test_bad_time_constant() -> None:
    with pytest.raises(InputError, match="time_constant"):
        BaseSlipObserver(0.0)


def driven(observed: str, noise: float = 0.0) -> np.ndarray:
    """Mean hand error (3) [m] over the last second of a drive forwards at 0.2 m/s on a slope.

    Poses are measured from outside with ``noise`` [m, rad]; "drift": the first-order filter, "offset": the Kalman filter, "":
    nothing corrects the plan.
    """
    model, rng = robot("swerve-ur10"), np.random.default_rng(4)
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
    first_order, x, h, errors = BaseSlipObserver(0.3), model.home.copy(), 0.02, []
    seen = ("base.x", "base.y", "base.yaw")
    kalman = OffsetObserver(
        model.dynamics(),
        "drift",
        x,
        np.zeros(model.input.size),
        measured=seen,
        noise=max(noise, 1e-5),
        process=1e-3,
        walk=0.03,
    )
    u = np.zeros(model.input.size)
    for k in range(300):
        pose = x[:3] + noise * rng.normal(size=3)
        believed = np.concatenate([pose, x[3:]])
        if observed == "drift":
            mpc.solver.set_parameters({"drift": first_order.update(pose, u[:3], h)})
        elif observed == "offset":
            mpc.solver.set_parameters({"drift": kalman.update(pose, u, h)})
            believed[:3] = kalman.state[:3]
        policy = mpc.update(Observation(k * h, believed))
        u = policy.feedforward(k * h)
        drift = SLOPE * min(1.0, k * h)  # the slope begins: it does not hit like a step
        moved = lie.se2_step(x[:3], h * (u[:3] + drift))
        x = np.concatenate([moved, x[3:] + h * u[3:] * np.where(np.arange(3, 21) < 7, 0.0, 1.0)])
        errors.append(model.pose(x)[0] - np.array([np.interp((k + 1) * h, t, c) for c in hand.T]))
    return np.mean(errors[-50:], axis=0)  # type: ignore[no-any-return]


def test_the_estimate_in_the_plan_takes_the_offset_away() -> None:
    without, with_it = (np.linalg.norm(driven(kind)) for kind in ("", "drift"))
    assert without > 5e-4
    assert with_it < 0.3 * without


def test_and_with_noise_the_kalman_filter_does() -> None:
    """Poses with 1 mm and 1 mrad of noise, 50 per second: what is left in the mean is the noise."""
    without, with_it = (np.linalg.norm(driven(kind, 1e-3)) for kind in ("", "offset"))
    assert without > 5e-4
    assert with_it < 0.5 * without
