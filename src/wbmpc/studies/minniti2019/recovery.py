"""Whether a pushed ball robot is back in its place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wbmpc.log import Log
from wbmpc.studies.minniti2019.metrics import estimated_ball, estimated_end_effector

#: Recovered: in the last half second before the next push ball or end effector are nearer than this [m] to their place as the robot knows
#: it, and do not move farther than this in the world. (Wheels that slipped moved the robot's world; one that runs away, or swings
#: its arm about, has not recovered, wherever it believes to be.)
NEAR, LAST = 0.05, 0.5


@dataclass(frozen=True)
class Rest:
    """How ball or end effector are for the last :data:`LAST` [s] before some time: farthest from their place as the robot knows it
    (``felt``) and in the ``world``, and how far they move in the world (``moves``) [m]; infinite if the run had ended by then."""

    felt: float = np.inf
    world: float = np.inf
    moves: float = np.inf

    @property
    def recovered(self) -> bool:
        """Back in its place and at rest, see :data:`NEAR`."""
        return max(self.felt, self.moves) < NEAR


def rest(log: Log, held: str, place: np.ndarray, end: float) -> Rest:
    """Before ``end`` [s]: of the ball, with ``place`` (2) [m], or of the end effector, with ``place`` (3)."""
    t = log.times("state")
    window = (t >= end - LAST) & (t < end)
    if not window.any() or t[-1] < end - 0.1:
        return Rest()
    felt = (estimated_end_effector(log) if held == "hand" else estimated_ball(log))[window]
    world = (log.array("hand") if held == "hand" else log.array("state")[:, :2])[window]
    maximum = lambda away: float(np.linalg.norm(away, axis=1).max())
    return Rest(maximum(felt - place), maximum(world - place), maximum(world - world[-1]))
