"""Wheels that have to turn round on the way, and wheels that were turned by hand, in physics.

Truth: the reference's poses against the true pose of the base in MuJoCo, and the encoders' range.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from driving import Motion, drive
from wbmpc.simulation.any_perturbation import AnyPerturbation


@dataclass(frozen=True)
class Round(Motion):
    """The base goes round a circle without turning, at ``rate`` [rad/s]: its wheels turn on and on."""

    rate: float = 0.4

    def preview(self, times: np.ndarray, pose: np.ndarray) -> np.ndarray:
        angle = self.rate * np.maximum(times - self.start, 0.0)
        turned = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
        return np.hypot(*self.twist[:2]) * self.share(times)[:, None] * turned

    def poses(self, t: np.ndarray) -> np.ndarray:
        v = self.preview(t, np.zeros(3))
        steps = np.diff(t)[:, None] * 0.5 * (v[1:] + v[:-1])
        return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def apart(result, motion: Motion) -> np.ndarray:  # type: ignore[no-untyped-def]
    """Distance (n,) [m] of the true base from the reference over time."""
    grid = np.arange(0.0, result.times[-1] + 0.02, 0.02)
    poses = motion.poses(grid)
    at = np.stack([np.interp(result.times, grid, poses[:, k]) for k in range(2)], axis=1)
    return np.asarray(np.hypot(*(result.poses[:, :2] - at).T))


def test_wheels_turn_round_while_the_base_waits() -> None:
    """1.6 rounds of the wheels in a range of one: the base stops for a moment, catches up, and never leaves for good."""
    motion = Round((0.15, 0.0, 0.0), 12.0)
    result = drive(motion, perturbation=AnyPerturbation(), seed=1)
    assert result.reason == ""
    assert np.abs(result.steer).max() < 3.15
    assert (
        np.abs(np.diff(result.steer, axis=0)).max() < 0.05
    )  # 5 rad/s and the encoders' noise: it turns, it does not jump
    error = apart(result, motion)
    late = result.times > result.times[-1] - 1.0
    assert error[late].max() < 0.03
    assert error.max() < 0.35
    assert np.mean(error < 0.05) > 0.6


def test_wheels_turned_by_hand_are_aligned_first() -> None:
    motion = Motion((0.2, 0.0, 0.0), 3.0, start=2.0)
    steer = np.array([0.4, -1.2, 1.5, 0.1])
    result = drive(motion, steer=steer, perturbation=AnyPerturbation(), seed=2)
    assert result.reason == ""
    way = np.linalg.norm(result.reference[:2])
    assert np.linalg.norm((result.truth - result.reference) * [1, 1, 0.8]) < 0.05 * way
    assert np.abs(result.poses[result.times < 1.0][:, :2]).max() < 0.01  # nothing moves while they are aligned


@pytest.mark.parametrize("seed", [3])
def test_a_wheel_turned_by_hand_before_a_start_with_the_wrong_plan(seed: int) -> None:
    """Three wheels agree, one is across: the nearest common center is found and the drive starts from it."""
    motion = Motion((0.0, 0.2, 0.0), 3.0, start=2.0)
    steer = -np.array([1.0, -1.0, -1.0, 1.0]) * np.pi / 4 + np.array([0.0, 0.0, 1.4, 0.0])
    result = drive(motion, steer=steer, perturbation=AnyPerturbation(), seed=seed)
    assert result.reason == ""
    way = np.linalg.norm(result.reference[:2])
    assert np.linalg.norm((result.truth - result.reference) * [1, 1, 0.8]) < 0.05 * way
