"""Smooth ramps of references, and the distance from a path."""

from __future__ import annotations

import numpy as np


def rise(t: np.ndarray, length: float) -> np.ndarray:
    """From 0 to 1 over ``length`` > 0, half a cosine, at times or ways t (k) of the same unit."""
    q = np.clip(t / length, 0.0, 1.0)
    return 0.5 * (1.0 - np.cos(np.pi * q))


def risen(t: np.ndarray, length: float) -> np.ndarray:
    """Integral of :func:`rise`."""
    q = np.clip(t / length, 0.0, 1.0)
    return length * (0.5 * q - np.sin(np.pi * q) / (2.0 * np.pi)) + np.maximum(t - length, 0.0)


def nearest_distance(points: np.ndarray, curve: np.ndarray) -> np.ndarray:
    """Distance (n,) [m] of points (n, 3) to a curve of straight pieces between (m, 3), finely sampled: to those beside its
    nearest corner."""
    from scipy.spatial import cKDTree

    corner = cKDTree(curve).query(points)[1]
    return np.minimum(*(_to_segments(points, curve[corner], curve[beside]) for beside in _beside(corner, len(curve))))


def _beside(corner: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    return np.maximum(corner - 1, 0), np.minimum(corner + 1, count - 1)


def _to_segments(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distance (n,) of points to the segments from a to b (n, 3), which may have no length."""
    along = b - a
    length = np.maximum(np.sum(along**2, axis=1), 1e-300)
    share = np.clip(np.sum((points - a) * along, axis=1) / length, 0.0, 1.0)
    return np.asarray(np.linalg.norm(points - a - share[:, None] * along, axis=1))
