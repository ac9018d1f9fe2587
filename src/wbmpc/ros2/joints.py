"""Joint states of a bus: matched by name, checked, sorted by groups; and what the inertial unit says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from wbmpc.bases.base import WHEELS
from wbmpc.errors import InputError, NotFinite
from wbmpc.estimation.repetition import RESTS, TURNS
from wbmpc.model.robot import RobotModel
from wbmpc.ros2.convert import check_numbers, read_vector, seconds
from wbmpc.ros2.settings import RosSettings, joint_groups

#: A joint, or a base, may move this often its speed limit, and by this [m, rad] besides, between two messages.
SPEED_FACTOR, SPEED_REST = 2.0, 0.05
#: A base does not turn faster than this often its limit, or 1 rad/s, whoever drives it: a gyro that says so says nothing.
TURN_FACTOR = 5.0
#: So long [s] joints that go on may not have been heard where their time went back.
_MISSED = 0.1
#: Time that goes back by more than this [s] is of another clock: a simulator that was restarted, or a clock that was set. Less is a
#: message that another one has overtaken.
OVERTAKEN = 0.02
#: A message that jumps is a fault of its own if the next one is farther from it than this [rad]; else both say the truth.
_AGREE = 0.3

#: Messages whose arrivals are apart by less than this share of what their stamps are apart have waited; without messages for longer than
#: the other one [s] others may be waiting, for at most so long [s].
AT_ONCE, SILENCE, _LONGEST = 0.2, 0.1, 60.0
#: Joint states that come so much [s] after their stamps leave a robot that balances no margin, once that has lasted for so long [s].
LATE, LASTS = 0.03, 0.1
#: Drives with commands above this [rad/s or m/s] turn some encoder within this time [s].
_MOVES, _STARTS = 0.2, 0.3


class Series(NamedTuple):
    """How often encoders, and simulations, have restarted: angles of two series do not say how far a wheel has turned between them, and
    in another simulation the robot is at its beginning again."""

    encoders: int = 0
    simulations: int = 0


FIRST = Series()


@dataclass(frozen=True)
class JointSample:
    """Positions [rad] by group as of the message's ``stamp`` [s], of a series."""

    stamp: float
    groups: dict[str, np.ndarray]
    series: Series = FIRST


@dataclass(frozen=True)
class OnBus:
    """What a measurement of a base on wheels has on a bus besides. ``turning`` [rad/s]: mean yaw rate since the measurement before, None where
    the gyro does not cover that time; ``origin`` [s]: where on the bus's clock the zero of the runner's is; ``series`` of the encoders;
    ``stamp`` [s] of the message."""

    turning: float | None = None
    origin: float = 0.0
    series: Series = FIRST
    stamp: float = 0.0


class JointReader:
    """JointState messages to samples; what is wrong with a message is an :class:`InputError`.

    ``confirmed``: of a robot that falls when its states are missing only the first message of a jump, also of its time, is
    wrong: a second one that agrees with it is true, for joints of a robot that is hit move faster than their drives can, and the
    clock of its computer may be set.
    """

    def __init__(self, robot: RobotModel, settings: RosSettings, confirmed: bool = False) -> None:
        groups = joint_groups(robot)
        self.groups = {g: [settings.bus_name(n) for n in names] for g, names in groups.items()}
        self.ignored = {*settings.ignore, *(settings.bus_name(n) for n in robot.description.couple)}
        self.names = [n for part in self.groups.values() for n in part]
        self._known = set(self.names)
        units = dict(zip((n for g in robot.state.groups.values() for n in g), robot.state.units, strict=True))
        self._units = [units.get(n, "rad") for part in groups.values() for n in part]
        self._speed = np.concatenate([settings.joint_speeds(robot, g) for g, names in groups.items() if names])
        self._order: tuple[list[str], np.ndarray] | None = None
        #: the message that the next one is compared with: stamp [s], positions, when it came [s]
        self.last: tuple[float, np.ndarray, float] | None = None
        self._confirmed = confirmed
        self._doubted: tuple[float, np.ndarray] | None = None
        self._gap = settings.safety.watchdog
        self.lateness = Lateness(settings.topics.joint_states if confirmed else "")

    def read(self, message: Any, now: float) -> JointSample:
        """Check and sort a message that came ``now`` [s]. A message that is older than the last one is an error too."""
        names = list(message.name)
        if self._order is None or self._order[0] != names:
            self._order = names, self._places(names)
        positions = np.asarray(message.position, float)
        if positions.size != len(names):
            raise InputError(f"joint states: {len(names)} names but {positions.size} positions")
        values, stamp = positions[self._order[1]], seconds(message.header.stamp)
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise NotFinite(f"joint states: the position of '{self.names[bad[0]]}' is not finite")
        check_numbers(values, "joint states")
        self._check_motion(stamp, values, now)
        self.last, self._doubted = (stamp, values, now), None
        groups, start = {}, 0
        for group, names in self.groups.items():
            groups[group] = values[start : start + len(names)]
            start += len(names)
        return JointSample(stamp, groups)

    def apart(self, one: JointSample, other: JointSample) -> bool:
        """Whether a joint is farther in one sample than in the other than it moves within :data:`_MISSED`."""
        groups = [g for g, names in self.groups.items() if names]
        moved = np.abs(np.concatenate([one.groups[g] - other.groups[g] for g in groups]))
        return bool(np.any(moved > SPEED_FACTOR * self._speed * _MISSED + SPEED_REST))

    def concerns(self, message: Any) -> bool:
        """Whether a message names one of our joints: others of a robot, as a gripper's, may have a publisher of their own."""
        return not self._known.isdisjoint(message.name)

    def reset(self) -> None:
        """The next message may be anywhere and at any time."""
        self.last = None

    def _places(self, names: list[str]) -> np.ndarray:
        missing = [n for n in self.names if n not in names]
        extra = [n for n in names if n not in self.names and n not in self.ignored]
        if missing:
            unused = f"; it has '{extra[0]}', which is not ours" if extra else ""
            raise InputError(f"joint states: joint '{missing[0]}' is missing{unused} (key 'joints' maps names)")
        if extra:
            raise InputError(
                f"joint states: joint '{extra[0]}' is not known (list it under key 'ignore' if it is not ours)"
            )
        twice = [n for n in self.names if names.count(n) > 1]
        if twice:
            raise InputError(f"joint states: joint '{twice[0]}' appears twice")
        return np.array([names.index(n) for n in self.names])

    def _check_motion(self, stamp: float, values: np.ndarray, now: float) -> None:
        last = self.last  # once: another thread may reset it
        if last is None:
            return
        interval, moved = stamp - last[0], np.abs(values - last[1])
        # a stamp far ahead is no time in which joints could move
        passed = min(interval, max(now - last[2], 0.0) + self._gap)
        far = moved - (SPEED_FACTOR * self._speed * passed + SPEED_REST)
        doubted, self._doubted = self._doubted, (stamp, values)
        # what only overtook others on its way is no clock that was set back
        if self._confirmed and doubted is not None and not -OVERTAKEN <= interval < 0.0:
            near = 0.0 <= stamp - doubted[0] <= self._gap and (interval >= 0.0 or stamp > doubted[0])
            if near and np.abs(values - doubted[1]).max() < _AGREE:
                return
        if interval < 0.0:
            raise InputError(f"joint states: their time went back by {-interval:.3f} s")
        if self._confirmed and interval > self._gap:
            raise InputError(f"joint states: their time jumped ahead by {interval:.3g} s")
        if np.any(far > 0.0):
            k = int(np.argmax(far))
            raise InputError(
                f"joint states: '{self.names[k]}' jumped by {moved[k]:.3g} {self._units[k]} in {1e3 * interval:.3g} ms, "
                "faster than it can move"
            )


class Waited:
    """How long messages of one publisher have waited in a process, or on a bus, that was held up: those that come at once after a silence
    are as far apart as their stamps say, as far as the silence has room for that. Else a stamp is no time: clocks are set. Once messages
    have come in time for as long as a ``silence`` [s], none waits any more."""

    def __init__(self, silence: float = SILENCE) -> None:
        self._silence, self._room, self._in_time = silence, 0.0, 0.0

    @property
    def others(self) -> bool:
        """Whether there is room for others that have waited, too."""
        return self._room > OVERTAKEN

    def interval(self, arrivals: float, stamps: float) -> float:
        """Time [s] between two messages whose arrivals and stamps are so far apart [s]: by their arrivals, where the second one has waited
        by their stamps."""
        waited = 0.0 <= arrivals < AT_ONCE * stamps and 0.0 < self._room >= stamps - arrivals - self._silence
        self._in_time += max(arrivals, 0.0)
        if waited or arrivals > self._silence:
            self._room, self._in_time = min(max(self._room + arrivals - max(stamps, 0.0), 0.0), _LONGEST), 0.0
        elif self._in_time > self._silence:  # a single one that took its time does not end what comes at once
            self._room = 0.0
        return stamps if waited else arrivals


class Lag:
    """Whether messages come later than they were sent, by more than :data:`OVERTAKEN` [s], because a process or a bus was held up. Slow
    messages that come as far apart as their stamps say end that: clocks drift."""

    def __init__(self) -> None:
        self._waited = Waited(OVERTAKEN)

    def late(self, arrivals: float, stamps: float) -> bool:
        """Of a message that came ``arrivals`` [s] after the one before, and whose stamp is ``stamps`` [s] after that one's."""
        if arrivals > OVERTAKEN >= abs(arrivals - stamps):
            self._waited = Waited(OVERTAKEN)
        else:
            self._waited.interval(arrivals, stamps)
        return self._waited.others


class Standstill:
    """Whether joint states, or those of the wheels alone, do not change, under new stamps, while drives of theirs have commands to move: a
    driver that has lost its encoders repeats what it read last, and where commands lead is unknown."""

    def __init__(self) -> None:
        self._all, self._wheels = _Unchanged(), _Unchanged()

    def lasts(self, sample: JointSample, rates: Mapping[str, np.ndarray]) -> bool:
        """Whether it has lasted too long by the stamp of a ``sample``: states that do not come at all are another fault; ``rates``: commands
        by group [rad/s or m/s]."""
        wheels = {WHEELS: sample.groups[WHEELS]} if WHEELS in sample.groups else {}
        found = [u.lasts(sample.stamp, g, rates) for u, g in ((self._all, sample.groups), (self._wheels, wheels))]
        return any(found)


class _Unchanged:
    """The same of some groups."""

    def __init__(self) -> None:
        self._values, self._since = np.zeros(0), np.inf

    def lasts(self, stamp: float, groups: Mapping[str, np.ndarray], rates: Mapping[str, np.ndarray]) -> bool:
        values = np.concatenate([*groups.values(), np.zeros(0)])
        fastest = max((np.abs(rates[g]).max(initial=0.0) for g in groups if g in rates), default=0.0)
        if fastest < _MOVES or not np.array_equal(values, self._values) or stamp < self._since:
            self._since = stamp
        self._values = values
        return stamp - self._since > _STARTS


class Repetition:
    """Joint states whose wheels repeat themselves, under new stamps, while the gyro turns: they do not say that the base stands, also where
    the other joints move, whose drives may be others. What comes after them says where the wheels went meanwhile.

    A base that has come to rest since is believed after :data:`~wbmpc.estimation.repetition.RESTS`: its wheels may have been blocked while
    others turned it.
    """

    def __init__(self) -> None:
        self._values: np.ndarray | None = None
        self._since, self._turned = np.inf, -np.inf  # stamps [s]: of the first one that repeats, and of the last turn

    def goes_on(self, sample: JointSample, turning: float) -> bool:
        """Whether a ``sample`` does not count; ``turning`` [rad/s]: of the newest reading of the gyro."""
        values = sample.groups.get(WHEELS, np.zeros(0))
        if not values.size:
            return False
        if self._values is None or not np.array_equal(values, self._values) or sample.stamp < self._since:
            self._values, self._since, self._turned = values, sample.stamp, -np.inf
            return False
        if abs(turning) > TURNS:
            self._turned = sample.stamp
        return sample.stamp - self._turned < RESTS

    def lasted(self, sample: JointSample) -> float:
        """Since when [s] the states of a ``sample`` are what they are."""
        return sample.stamp - self._since


class Lateness:
    """Whether joint states on ``topic`` come too late for a robot that would fall; empty: it would not. ``fault`` says so."""

    def __init__(self, topic: str) -> None:
        self.fault, self._topic, self._punctual = "", topic, -np.inf

    def note(self, stamp: float, now: float) -> None:
        """Joint states of ``stamp`` [s] have come ``now`` [s]."""
        if now - stamp <= LATE or stamp < self._punctual:
            self._punctual = stamp
        late = bool(self._topic) and stamp - self._punctual > LASTS
        self.fault = f"the joint states on {self._topic} come more than {LATE:g} s after their stamps" if late else ""


@dataclass(frozen=True)
class Inertial:
    """Gyro (3) [rad/s] and accelerometer (3) [m/s²] in axes of the base.

    Of several readings these are their means; ``turning`` (3) [rad/s] is the mean rate from the reading before them to the
    last one, by trapezoids, None where readings are missing in between."""

    gyro: np.ndarray
    accel: np.ndarray
    turning: np.ndarray | None = None


def mean_of(readings: Sequence[Inertial]) -> Inertial:
    """Means of one or more readings."""
    if len(readings) == 1:
        return readings[0]
    return Inertial(*(np.mean([getattr(i, n) for i in readings], axis=0) for n in ("gyro", "accel")))


def mean_rate(times: Sequence[float], rates: Sequence[np.ndarray], longest: float) -> np.ndarray | None:
    """Mean (3) [rad/s] of rates from the first of ``times`` [s] to the last, by trapezoids; None if one of the intervals is longer
    than ``longest`` [s], or times go back: of a clock that was set it is not known how much has passed. Times that stand still (of a
    unit without a clock) count as evenly spaced."""
    steps = np.diff(times)
    if steps.size == 0 or steps.max() > longest or steps.min() < 0.0:
        return None
    if steps.min() == 0.0:
        steps = np.ones(steps.size)
    middles = np.array([0.5 * (a + b) for a, b in pairwise(rates)])
    return np.asarray(steps @ middles / steps.sum())


def by_arrivals(rate: float | None, stamps: float, arrivals: float) -> float | None:
    """A mean ``rate`` [rad/s] over the time between two stamps [s] as one over that between their arrivals, by which estimators count:
    the angle stays. Messages may come in bursts, and those of a slow simulator take longer than their stamps say."""
    return rate if rate is None or stamps <= 0.0 or arrivals <= 0.0 else rate * stamps / arrivals


def read_imu(message: Any) -> Inertial:
    """An Imu message; an :class:`InputError` says what is wrong with one."""
    return Inertial(read_vector(message.angular_velocity, "imu"), read_vector(message.linear_acceleration, "imu"))


def check_turn(reading: Inertial, fastest: float) -> None:
    """Raise :class:`InputError` for a yaw rate of more than ``fastest`` [rad/s]: one such reading beside many good ones would teach an
    estimator a bias that the gyro does not have."""
    rate = float(reading.gyro[2])
    if abs(rate) > fastest:
        raise InputError(f"imu: it turns at {rate:.3g} rad/s, faster than a base does (at most {fastest:.3g})")
