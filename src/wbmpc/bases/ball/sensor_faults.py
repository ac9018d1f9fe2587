"""A ball robot's sensors that fail, and wheels that slip: what the estimator found out, and joints that should have moved.

A tracker of angles cannot distinguish a joint at rest from a frozen encoder: both read the same. What distinguishes them is the
model: under the torques that are sent the joint would have turned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.ball.compilation import compiled, step
from wbmpc.bases.ball.self_contact import SelfContact
from wbmpc.checks import not_negative
from wbmpc.kernel.ir import Floats
from wbmpc.kernel.step import bind, zeros


@compiled
def deadband(value: float, doubt: float) -> float:
    """What of a value is beyond ± ``doubt``."""
    return max(value - doubt, 0.0) - max(-value - doubt, 0.0)


#: Motions [rad] that is none (a few counts), and that must be seen; speed [rad/s] that is none; doubt [rad/s²] of accelerations: what
#: friction holds a joint against is less; how long [s] an encoder must have stood.
STILL, EXPECTED, CRAWL, DOUBT, STOOD = 1.5e-4, 0.02, 0.05, 2.0, 0.02
#: So long [s] the estimator has to say what it says of wheels.
PATIENCE = 0.05


class Encoders(NamedTuple):
    """Joints (n), their encoders, and what a monitor remembers of them."""

    n: int
    arm: Floats  # (n) [rad], readings
    surprised: Floats  # (n), 1 for readings that are far from the expected ones
    speed: Floats  # (n) [rad/s], of the joints by their tracker
    acceleration: Floats  # (n) [rad/s²], by the model
    anchor: Floats  # (n) [rad], where an encoder stands
    believed: Floats  # (n) [rad/s], by how much the joint must be faster than at the anchor
    gone: Floats  # (n) [rad], how far it must have moved
    then: Floats  # (n) [rad/s²], acceleration at the anchor
    stood: Floats  # (n) [s]
    low: Floats  # (n) [rad], readings beyond which a joint rests at a stop
    high: Floats
    standing: Floats  # (n), 1 for encoders that should have moved


@step
def watch(e: Encoders, h: float, doubted: bool, known: bool) -> tuple[bool, int]:
    """Whether a reading came as a surprise and moved (one that did not move is what is looked for); how many encoders, marked in
    ``standing`` (n), have not moved though they should have: counted again after such a reading and while that is ``doubted``, not
    at all while accelerations are not ``known``."""
    surprise, count = False, 0
    for i in range(e.n):
        if e.surprised[i] > 0.0 and abs(e.arm[i] - e.anchor[i]) > STILL:
            surprise = True
    if not known:
        return surprise, 0
    for i in range(e.n):
        stands = abs(e.arm[i] - e.anchor[i]) <= STILL and e.arm[i] >= e.low[i] and e.arm[i] <= e.high[i]
        if stands and not (doubted or surprise):
            e.believed[i] += h * deadband(e.acceleration[i] - e.then[i], DOUBT)
            e.gone[i] += h * e.believed[i]
            e.stood[i] += h
        else:  # at the first reading too
            e.anchor[i], e.believed[i], e.then[i] = e.arm[i], deadband(e.speed[i], CRAWL), e.acceleration[i]
            e.gone[i], e.stood[i] = 0.0, 0.0
        e.standing[i] = 1.0 if abs(e.gone[i]) > EXPECTED and e.stood[i] >= STOOD - 1e-9 else 0.0
        if e.standing[i] > 0.0:
            count += 1
    return surprise, count


#: With fewer wheel encoders than this the ball's place is not known any more: the inertial unit alone drifts.
MIN_WHEELS = 2
#: As near as this [rad] to its stop a joint may stand whatever its drive does.
NEAR = 0.01
#: What the floor lets happen in ordinary runs: the ball spins when the robot yaws hard.
ORDINARY = "ball spins"
#: So long [s] after a surprising reading a joint's speed is not believed.
DOUBTED = 0.03
#: What ends a run, and after how long [s]: the state is extrapolated from the last good readings. (A unit that repeats itself may
#: be a message that is late; who waits for messages has a limit of its own.) While the ball slips, its place is the inertial
#: unit's: 0.4 s of an error of 0.1 m/s² and 2 mrad are 10 mm.
ENDS = {
    "imu exceeds": 0.02, "imu jumps": 0.02, "imu repeats": 0.1, "encoder jumps": 0.02, "ball slips": 0.4,
}  # fmt: skip
#: So many messages in a row it takes at least, however seldom they come.
IN_A_ROW = 3
#: The messages of what is found, by part and kind. What contradicts rolling beyond one wheel or a spin about the vertical may be
#: the ball, or an inertial unit that is off (its zero, its scale): the messages are the same.
MESSAGES = {
    "encoder stalled": "the encoder of {} stands still", "encoder jumps": "the encoder of {} jumps",
    "imu exceeds": "the inertial unit exceeds its range", "imu repeats": "the inertial unit stands still",
    "imu jumps": "the inertial unit jumps", "ball slips": "the ball slips or the inertial unit is wrong",
}  # fmt: skip


@dataclass(frozen=True)
class EncoderFault:
    """At ``time`` [s] a ``part`` (wheel, arm joint, the ball, the inertial unit: ``imu``) turned out to be ``stalled``, to slip, to
    ``jump``; or the unit to exceed its range, or to repeat itself: ``str()`` is the message."""

    time: float
    part: str
    kind: str

    def __str__(self) -> str:
        return f"{message_of(self.part, self.kind)} ({self.time:.2f} s)"


def message_of(part: str, kind: str) -> str:
    """What is wrong with a part, without the time."""
    return MESSAGES.get(_general(part, kind), f"{part} {kind}").format(part)


def _general(part: str, kind: str) -> str:
    """The key of a part's fault in :data:`ENDS` and :data:`MESSAGES`."""
    return f"encoder {kind}" if part not in ("imu", "ball") and kind in ("stalled", "jumps") else f"{part} {kind}"


class BallReadings(NamedTuple):
    """What monitors of a ball robot compare: encoders ``arm`` (n) [rad] at ``time`` [s], ``speed`` (n) [rad/s] as estimated,
    ``acceleration`` (n) [rad/s²] as the model has it for the ``interval`` [s] before (None: not known yet), faults that the estimator
    reports, joints (n; 1 or 0) whose reading ``surprised`` it; the robot's ``state`` (nx), which a contact with itself is asked of."""

    time: float
    interval: float
    arm: Array
    speed: Array
    acceleration: Array | None
    estimator_faults: Sequence[str]
    surprised: Array | None = None
    state: Array | None = None


class EncoderMonitor:
    """Watches the encoders of ``wheels`` and of named arm ``joints`` (n).

    A joint's encoder is stalled when it has stayed within :data:`STILL` for :data:`STOOD` while the joint should
    have turned by :data:`EXPECTED`: by its speed at the last reading that moved, less :data:`CRAWL`, and by how much more
    the model says that it accelerates than it said then, less :data:`DOUBT`. (An unknown load makes the model
    accelerate a joint that stands, but no more from one moment to the next; friction holds a joint against less than the doubt.)
    At its ``stops``, lower and upper (n) [rad], a joint is not judged, nor one whose
    turn would bring the robot against itself (``contact``; None: that is not known). A reading after a gap counts as a third of
    that time (:data:`IN_A_ROW`): the torques in between are unknown. Wheels, the inertial unit and jumps are judged by the
    estimator; what it says of wheels counts once it has said so for :data:`PATIENCE`, of the others at once; what of it lasts as
    long as :data:`ENDS` has it ends the run. ``faults``: all that were reported, each part once.
    """

    def __init__(
        self, wheels: int, joints: Sequence[str], stops: tuple[Array, Array] | None = None,
        contact: SelfContact | None = None,
    ) -> None:  # fmt: skip
        not_negative("encoder monitor", wheels=wheels)
        self.joints, self.wheels = list(joints), wheels
        self.faults: list[EncoderFault] = []
        n = len(self.joints)
        low, high = stops or (np.full(n, -np.inf), np.full(n, np.inf))
        a = self._arrays = zeros(Encoders, n)
        a["low"][:], a["high"][:], a["anchor"][:] = low + NEAR, high - NEAR, np.nan
        self._watch = bind(watch, a, n=n)
        self._durations: dict[str, float] = {}
        self._contact = contact
        self._doubted_until = -np.inf

    def update(self, readings: BallReadings, /) -> list[EncoderFault]:
        """What is new."""
        t, interval, arm, speed, acceleration, estimator_faults, surprised, state = readings
        a = self._arrays
        a["arm"][:], a["surprised"][:] = arm, 0.0 if surprised is None else surprised
        if acceleration is not None:
            a["speed"][:], a["acceleration"][:] = speed, acceleration
        surprise, standing = self._watch(
            min(interval, STOOD / IN_A_ROW), t < self._doubted_until, acceleration is not None
        )
        if surprise:  # speeds, and what the model makes of them, are not to be believed
            self._doubted_until = t + DOUBTED
        if not (standing or estimator_faults or self._durations):
            return []
        stalled = self._stalled(t, state) if standing else []
        new = [EncoderFault(t, self.joints[i], "stalled") for i in stalled]
        new += [EncoderFault(t, *name.split()) for name in self._lasting(interval, estimator_faults)]
        known = {(f.part, f.kind) for f in self.faults}
        new = [f for f in new if (f.part, f.kind) not in known]
        self.faults += new
        return new

    def _stalled(self, t: float, state: Array | None) -> list[int]:
        """Joints that stand with nothing in their way; what the model makes of one that is held is not believed for a while."""
        standing = np.flatnonzero(self._arrays["standing"]).tolist()
        if self._contact is None or state is None:
            return standing
        free = [i for i in standing if not self._contact.closes(state, i, float(self._arrays["gone"][i]))]
        if len(free) < len(standing):
            self._doubted_until = t + DOUBTED
        return free

    def _lasting(self, h: float, estimator_faults: Sequence[str]) -> list[str]:
        """What the estimator says and, of wheels and ball, has said most of the time."""
        names = {*self._durations, *estimator_faults} - {ORDINARY}
        counts = {n: min(h, _ends(n) / IN_A_ROW) for n in names}
        self._durations = {
            n: max(self._durations.get(n, 0.0) + (c if n in estimator_faults else -c), 0.0) for n, c in counts.items()
        }
        self._durations = {n: min(v, self._maximum(n)) for n, v in self._durations.items() if v > 0.0}
        return [n for n, v in self._durations.items() if v >= self._report_delay(n) - 1e-9]

    def _maximum(self, name: str) -> float:
        """How long [s] counts: what was said for long is not over at once."""
        ends = _ends(name)
        return max(2.0 * PATIENCE, ends if np.isfinite(ends) else 0.0)

    def _report_delay(self, name: str) -> float:
        """How long [s] the estimator has to say so."""
        return 0.0 if name.endswith("jumps") or name.startswith("imu") else PATIENCE

    @property
    def lost(self) -> str:
        """Why the state cannot be known any more; empty while it can."""
        if not (self.faults or self._durations) and self.wheels >= MIN_WHEELS:
            return ""
        joints = [f"{f.part}" for f in self.faults if f.kind == "stalled" and f.part in self.joints]
        if joints:
            return message_of(joints[0], "stalled")
        lasting = [n for n, v in self._durations.items() if v >= _ends(n) - 1e-9]
        if lasting:
            return f"{message_of(*lasting[0].split())} for {_ends(lasting[0]):g} s"
        wheels = [n.split()[0] for n, v in self._durations.items() if n.endswith("stalled") and v >= PATIENCE - 1e-9]
        if self.wheels - len(wheels) < MIN_WHEELS:
            return f"the encoders of {' and '.join(sorted(wheels))} stand still, and {MIN_WHEELS} are needed"
        return ""


def _ends(name: str) -> float:
    """How long [s] this may be said without an end of the run; of wheels forever."""
    return ENDS.get(_general(*name.split()), np.inf)
