"""What a solver starts from and leaves: states and inputs over the horizon."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass
class Trajectory:
    """``start`` [s]: time of the first node; ``grid`` (N + 1,) [s]: from there on; ``x`` (N + 1, nx); ``u`` (N, nu), held over each
    interval."""

    start: float
    grid: np.ndarray
    x: np.ndarray
    u: np.ndarray

    @property
    def times(self) -> np.ndarray:
        """Of the nodes, (N + 1,) [s]."""
        return self.start + self.grid
