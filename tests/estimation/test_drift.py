"""Drift of a base against its wheels. Truth: the offset that is left without the estimate."""

from __future__ import annotations

import numpy as np

from toys import robot
from wbmpc import lie
from wbmpc.bases.swerve.defaults import SwerveCost, swerve_mpc
from wbmpc.estimation.offset import OffsetObserver
from wbmpc.mpc.mpc import Observation
from wbmpc.ocp import Reference
from wbmpc.settings import MpcSettings

SLOPE = np.array([0.03, -0.05, 0.02])


def driven(observed: str, noise: float = 0.0) -> np.ndarray:
    """Mean hand error (3) [m] over the last second of a drive forwards at 0.2 m/s on a slope.

    Poses are measured from outside with ``noise`` [m, rad]; "offset": the Kalman filter corrects the plan, "": nothing does.
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
    x, h, errors = model.home.copy(), 0.02, list[np.ndarray]()
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
        if observed == "offset":
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
    """Poses with 1 mm and 1 mrad of noise, 50 per second: what is left in the mean is the noise."""
    without, with_it = (np.linalg.norm(driven(kind, 1e-3)) for kind in ("", "offset"))
    assert without > 5e-4
    assert with_it < 0.5 * without
