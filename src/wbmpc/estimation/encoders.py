"""A ball robot's encoders that stand still, and wheels that slip: what the filter found out, and joints that should have moved.

A tracker of angles cannot tell a joint at rest from an encoder that stands: both read the same. What tells them apart is the
model: under the torques that are sent the joint would have turned.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: With fewer wheel encoders than this the ball's place is not known any more: the inertial unit alone drifts.
LEAST_WHEELS = 2
#: As near as this [rad] to its stop a joint may stand whatever its drive does.
NEAR = 0.01
#: What the floor lets happen in ordinary runs: the ball spins when the robot yaws hard.
ORDINARY = "ball spins"


@dataclass(frozen=True)
class EncoderFault:
    """At ``time`` [s] a ``part`` (wheel, arm joint, the ball) turned out to be ``stalled``, or to slip: ``str()`` tells it."""

    time: float
    part: str
    kind: str

    def __str__(self) -> str:
        what = f"the encoder of {self.part} stands still" if self.kind == "stalled" else f"{self.part} {self.kind}"
        return f"{what} ({self.time:.2f} s)"


class EncoderMonitor:
    """Watches the encoders of ``wheels`` and of named arm ``joints`` (n).

    A joint's encoder is stalled when it has stayed within ``still`` [rad] (a few counts) for ``least`` [s] while the joint should
    have turned by ``expected`` [rad]: by its speed at the last reading that moved, less ``crawl`` [rad/s], and by how much more
    the model says that it accelerates than it said then, less ``doubt`` [rad/s²]. (A load that nobody knows of makes the model
    accelerate a joint that stands, but no more from one moment to the next; friction holds a joint against less than the doubt.)
    At its ``stops``, lower and upper (n) [rad], a joint is not judged. Wheels are judged by the filter; what it says counts once
    it has said so for ``patience`` [s]. ``faults``: all that were told, each part once.
    """

    def __init__(
        self, wheels: int, joints: Sequence[str], stops: tuple[Array, Array] | None = None, still: float = 1.5e-4,
        expected: float = 0.02, crawl: float = 0.05, doubt: float = 2.0, least: float = 0.02, patience: float = 0.05,
    ) -> None:  # fmt: skip
        self.joints, self.wheels, self.still, self.expected = list(joints), wheels, still, expected
        self.crawl, self.doubt, self.least, self.patience = crawl, doubt, least, patience
        self.faults: list[EncoderFault] = []
        low, high = stops or (np.full(len(self.joints), -np.inf), np.full(len(self.joints), np.inf))
        self._low, self._high = low + NEAR, high - NEAR
        self._anchor = np.full(len(self.joints), np.nan)
        self._speed, self._gone, self._then, self._stood = np.zeros((4, len(self.joints)))
        self._said: dict[str, float] = {}

    def update(
        self, t: float, interval: float, arm: Array, speed: Array, acceleration: Array | None, said: Sequence[str]
    ) -> list[EncoderFault]:
        """What is new after readings ``arm`` (n) [rad] at t [s]: ``speed`` (n) [rad/s] as estimated, ``acceleration`` (n) [rad/s²]
        as the model has it for the ``interval`` [s] before (None: not known yet), and what the wheels' filter ``said``."""
        standing: Iterable[int] = () if acceleration is None else self._standing(interval, arm, speed, acceleration)
        new = [EncoderFault(t, self.joints[i], "stalled") for i in standing]
        new += [EncoderFault(t, *name.split()) for name in self._lasting(interval, said)]
        told = {(f.part, f.kind) for f in self.faults}
        new = [f for f in new if (f.part, f.kind) not in told]
        self.faults += new
        return new

    def _standing(self, h: float, arm: Array, speed: Array, acceleration: Array) -> NDArray[np.int_]:
        """Joints whose encoders have not moved though they should have."""
        moves = (
            ~(np.abs(arm - self._anchor) <= self.still) | (arm < self._low) | (arm > self._high)
        )  # at the first one too
        self._anchor = np.where(moves, arm, self._anchor)
        gained = h * _beyond(acceleration - self._then, self.doubt)
        self._speed = np.where(moves, _beyond(speed, self.crawl), self._speed + gained)
        self._then = np.where(moves, acceleration, self._then)
        self._gone = np.where(moves, 0.0, self._gone + h * self._speed)
        self._stood = np.where(moves, 0.0, self._stood + h)
        return np.flatnonzero((np.abs(self._gone) > self.expected) & (self._stood >= self.least - 1e-9))

    def _lasting(self, h: float, said: Sequence[str]) -> list[str]:
        """What the filter says and has said most of the time."""
        names = {*self._said, *said} - {ORDINARY}
        self._said = {n: max(self._said.get(n, 0.0) + (h if n in said else -h), 0.0) for n in names}
        self._said = {n: min(v, 2.0 * self.patience) for n, v in self._said.items() if v > 0.0}
        return [n for n, v in self._said.items() if v >= self.patience - 1e-9]

    @property
    def lost(self) -> str:
        """Why the state cannot be known any more; empty while it can."""
        joints = [f"{f.part}" for f in self.faults if f.kind == "stalled" and f.part in self.joints]
        if joints:
            return f"the encoder of {joints[0]} stands still"
        wheels = [n.split()[0] for n, v in self._said.items() if n.endswith("stalled") and v >= self.patience - 1e-9]
        if self.wheels - len(wheels) < LEAST_WHEELS:
            return f"the encoders of {' and '.join(sorted(wheels))} stand still, and {LEAST_WHEELS} are needed"
        return ""


def _beyond(values: Array, doubt: float) -> Array:
    """What of values is beyond ± ``doubt``."""
    left: Array = np.sign(values) * np.maximum(np.abs(values) - doubt, 0.0)
    return left
