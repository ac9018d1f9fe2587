"""State of a ball-balancing base from wheel encoders and an inertial unit, in the manner of the two-state implicit filter.

Source: Bloesch, Burri, Sommer, Siegwart, Hutter: "The Two-State Implicit Filter", RA-L 2018: no prediction, only residuals
between two consecutive states; the older one is marginalised. Here the residuals are inertial increments (strapdown), rolling
of the ball without slip, wheel encoders, and the floor's height. docs/explanation/ball-robot.md has the equations.

Gates of estimators: how large a weighed square of errors may be. (SciPy has it, and takes as long to import as a robot to load.)

A gap in time of the ball filter: what the wheels say about it, and how little is known afterwards.

Three wheels that do not slip turn with the ball relative to the base: two parts of that are the ball's way over the floor, the
third is the base's turning about the vertical, if the base leans as little as a robot that stands. See docs/explanation/ball-robot.md for the
same relation in the filter's rolling rows.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.bases.ball.filter_solve import process
from wbmpc.bases.ball.filter_state import A, BallGeometry, BallNoise, BallState, P, V, skew
from wbmpc.bases.ball.filter_step import Noise, State
from wbmpc.bases.ball.inertial_gate_step import FAULTS, Gate
from wbmpc.bases.base import InertialDescription
from wbmpc.checks import covariance as checked_covariance
from wbmpc.checks import finite, numbers
from wbmpc.constants import GRAVITY
from wbmpc.errors import InputError, NotFinite
from wbmpc.kernel.step import bind

#: An interval longer than this [s] is a gap: what the inertial unit said at its end says nothing of the time before.
GAP = 0.1
#: After a gap: standard deviation by this share of the way and of the turn, and by so much in a second [m/s, rad/s] besides; of the
#: lean [rad]; of the velocity beside its mean over the gap [m/s].
GAP_SHARE, GAP_SPEED, GAP_TURN = 0.2, 0.05, 0.1
GAP_LEAN, GAP_VELOCITY = 0.1, 0.5


def bridged(turn: Array, radius: float, rotation: Array, wheel: Array) -> tuple[Array, float]:
    """Way (3) [m] of the ball and turn [rad] of an upright base about the vertical, for wheels that turned by ``wheel`` (n) [rad];
    ``turn`` (n, 3): wheel speeds over the ball's rate relative to the base, ``rotation`` of the base before."""
    rolled = np.linalg.lstsq(turn, wheel, rcond=None)[0]
    yaw = -float(rolled[2])
    heading = lie.rotation_to_euler_zyx(rotation)[0] + 0.5 * yaw
    c, s = np.cos(heading), np.sin(heading)
    about = np.array([c * rolled[0] - s * rolled[1], s * rolled[0] + c * rolled[1]])
    return radius * np.array([about[1], -about[0], 0.0]), yaw


def spreads(h: float, shift: Array, yaw: float) -> tuple[float, float, float]:
    """Standard deviations after a gap of ``h`` [s]: position [m], yaw [rad], velocity [m/s]."""
    way = float(np.linalg.norm(shift))
    return GAP_SHARE * way + GAP_SPEED * h, GAP_SHARE * abs(yaw) + GAP_TURN * h, GAP_VELOCITY + way / h


def filter_arrays(geometry: BallGeometry, noise: BallNoise) -> dict[str, Array]:
    """Everything by its name in :class:`wbmpc.bases.ball.filter_step.Filter`."""
    n = len(geometry.turn)
    size, m, state = 16 + n, 17 + 2 * n, State.WHEEL + n
    sizes = {"x": state, "y": state, "z": state, "gyro": 3, "accel": 3}
    sizes |= {"wheel": n, "read": n, "way": n, "gone": n, "stalled": n, "spin": n, "plain": n * n, "slip": 3 * n}
    sizes |= {"rate": 3, "turn": 3, "turned": 9, "half": 9, "middle": 9, "after": 9, "shift": 3, "pushed": 3}
    sizes |= {"p": size * size, "jx": m * size, "jy": m * size, "q": m * m, "r": m, "moved": m * size}
    sizes |= {"w": m * (size + 1), "a": size * size, "inverse": size * size, "slope": size, "root": m * m}
    sizes |= {"error": size, "covariance": size * size, "best_error": size, "best_covariance": size * size}
    return {name: np.zeros(length) for name, length in sizes.items()} | {
        "mount": np.array(geometry.mount, float),
        "wheels": np.array(geometry.turn, float).flatten(),
        "noise": np.array([getattr(noise, entry.name.lower()) for entry in Noise], float),
    }


#: Share of its range from which on a reading is no measurement.
FULL = 0.999


def gate_arrays(unit: InertialDescription, rest: Array) -> dict[str, Array]:
    """The arrays of :func:`~wbmpc.bases.ball.inertial_gate_step.judge` before the first message of a ``unit``, whose accelerometer reads
    ``rest`` (3) [m/s²] then."""
    gate = np.zeros(Gate.FULL + 2)
    gate[Gate.FULL :] = FULL * unit.rate, FULL * unit.acceleration
    return {"message": np.zeros(6), "given": np.zeros(6), "last": np.concatenate([np.zeros(3), rest]), "gate": gate}


def forget(gate: Array) -> None:
    """After a gap the next message may be any: it is no jump."""
    gate[: Gate.SAME] = 0.0


def chi_square_tail(square: float, freedom: int) -> float:
    """The probability that the sum of ``freedom`` squares of unit normal numbers is larger than ``square``.

    Source: Abramowitz and Stegun, Handbook of Mathematical Functions (1964), equations 26.4.4 and 26.4.5.
    """
    half = 0.5 * square
    if freedom % 2:
        terms = (half ** (i - 0.5) / math.gamma(i + 0.5) for i in range(1, (freedom + 1) // 2))
        return math.erfc(math.sqrt(half)) + math.exp(-half) * sum(terms)
    return math.exp(-half) * sum(half**i / math.factorial(i) for i in range(freedom // 2))


def chi_square_gate(freedom: int, probability: float) -> float:
    """The square that is exceeded with a ``probability`` between 0 and 1, by bisection."""
    low, high = 0.0, float(freedom)
    while chi_square_tail(high, freedom) > probability:
        low, high = high, 2.0 * high
    while low < (middle := 0.5 * (low + high)) < high:
        low, high = (middle, high) if chi_square_tail(middle, freedom) > probability else (low, middle)
    return high


_REST = np.array([0.0, 0.0, GRAVITY])
#: Probability of more than this surprise without a fault; what a wheel must have turned [rad] before an encoder that does not
#: move is called stalled: one that stays within so many counts.
GATE, STALLED, STILL = 1e-4, 1e-2, 3.0
#: Variance [m², rad²] of what is called exact.
_EXACT = 1e-14


class BallFilter:
    """Error state (16 + wheels): position, velocity of the inertial unit, attitude (base axes), gyro and accelerometer bias,
    log of the wheels' radius factor, wheel angles. ``covariance`` belongs to it.

    ``surprise``: what the redundant rows cost at the last update, chi-square with ``freedom`` = wheels + 1 degrees.
    ``faults`` of the last update, each a part and what it does: where rolling contradicts the inertial unit beyond :data:`GATE`,
    or an encoder stands while its wheel turns, those rows count for nothing; a message of the inertial ``unit`` that cannot be
    true (``imu exceeds``, ``repeats``, ``jumps``) leaves its rates and forces near those of the last good one.
    ``arrays``: everything by its name in :class:`wbmpc.bases.ball.filter_step.Filter`, for other steps to read, and a ``gate`` of the
    inertial unit (:func:`gate_arrays`).
    """

    def __init__(
        self, geometry: BallGeometry, position: ArrayLike, rotation: ArrayLike, noise: BallNoise,
        unit: InertialDescription | None = None,
    ) -> None:  # fmt: skip
        n = self._n = len(geometry.turn)
        self.geometry, self.noise = geometry, noise
        position = np.array([*numbers("ball filter", "position", np.asarray(position)[:2], 2), 0.0])
        numbers("ball filter", "rotation", np.ravel(rotation), 9)
        self.freedom, self.surprise = n + 1, 0.0
        gate = gate_arrays(unit or InertialDescription(), np.reshape(rotation, (3, 3)).T @ _REST)
        self.arrays = filter_arrays(geometry, noise) | gate
        self._gate = chi_square_gate(self.freedom, GATE)
        constants = {"still": STILL * math.sqrt(12.0) * noise.encoder, "largest_step": STALLED}
        self._process = bind(process, self.arrays, n=n, radius=float(geometry.radius), **constants)
        start = BallState(position, np.zeros(3), np.array(rotation, float), wheel=np.zeros(n))
        self.state, s = start, noise
        spread = np.concatenate([
            [s.start, s.start, s.floor], [s.speed] * 3, [s.tilt] * 3, [s.gyro_bias] * 3, [s.accel_bias] * 3, [s.scale], [1.0] * n,
        ])  # fmt: skip
        p = np.diag(spread**2)
        # what is known of the start is its heading: the uncertain axes are those of the world's horizontal
        p[A, A] = start.rotation.T @ np.diag([s.tilt, s.tilt, s.start]) ** 2 @ start.rotation
        self.covariance = p
        self.faults: tuple[str, ...] = ()
        self._first = True
        self._turning = 0.0  # the torque about the vertical that lasts [N m]

    @property
    def state(self) -> BallState:
        """The last estimate, a copy."""
        z = self.arrays["x"].copy()
        return BallState(
            z[State.POSITION : State.VELOCITY], z[State.VELOCITY : State.ROTATION],
            z[State.ROTATION : State.GYRO_BIAS].reshape(3, 3), z[State.GYRO_BIAS : State.ACCEL_BIAS],
            z[State.ACCEL_BIAS : State.SCALE], z[State.WHEEL :], float(z[State.SCALE]),
        )  # fmt: skip

    @state.setter
    def state(self, state: BallState) -> None:
        x = self.arrays["x"]
        x[State.POSITION : State.VELOCITY], x[State.VELOCITY : State.ROTATION] = state.position, state.velocity
        x[State.ROTATION : State.GYRO_BIAS] = state.rotation.ravel()
        x[State.GYRO_BIAS : State.ACCEL_BIAS], x[State.ACCEL_BIAS : State.SCALE] = state.gyro_bias, state.accel_bias
        x[State.SCALE], x[State.WHEEL :] = state.scale, state.wheel

    @property
    def covariance(self) -> Array:
        """Of its error (16 + n, 16 + n), a copy."""
        size = 16 + self._n
        return self.arrays["p"].reshape(size, size).copy()

    @covariance.setter
    def covariance(self, covariance: Array) -> None:
        self.arrays["p"][:] = covariance.reshape(-1)

    @property
    def rate(self) -> Array:
        """Angular velocity (3) [rad/s] of the base, base axes."""
        return self.arrays["rate"].copy()

    # ------------------------------------------------------------------ update
    def update(
        self, interval: float, wheel: ArrayLike, gyro: ArrayLike, accel: ArrayLike, turning: float = 0.0
    ) -> BallState:
        """The state after a message: encoders (n) [rad], and averages of gyro and accelerometer over ``interval`` [s];
        ``turning`` [N m]: torque of the wheels on the ball about the vertical. A message that is not newer than the last one
        (``interval`` ≤ 0) is ignored. Over a gap (:data:`wbmpc.bases.ball.filter.GAP`) only the wheels count: nothing is
        integrated, and position, heading, lean and velocity are known as little as that module states.

        Raises :class:`NotFinite` for readings that are not finite, or from which no state follows."""
        self.process(interval, wheel, gyro, accel, turning)
        return self.state

    def process(
        self, interval: float, wheel: ArrayLike, gyro: ArrayLike, accel: ArrayLike, turning: float = 0.0,
    ) -> None:  # fmt: skip
        """As :meth:`update`, for who reads the state elsewhere."""
        finite("ball filter", interval=interval, turning=turning)
        w = numbers("ball filter", "wheel", wheel, self._n)
        gyro, accel = numbers("ball filter", "gyro", gyro, 3), numbers("ball filter", "accel", accel, 3)
        if self._first:
            self._start(w)
        if interval <= 0.0:
            return
        if interval > GAP:
            self._bridge(interval, w)
            return
        a = self.arrays
        a["wheel"][:], a["message"][:3], a["message"][3:] = w, gyro, accel
        self._turning += (1.0 - math.exp(-interval / self.noise.lasting)) * (turning - self._turning)
        stalled = a["stalled"].tolist()
        choice, fault, self.surprise = self._process(interval, self._turning, self._gate)
        if choice < 0:
            raise NotFinite(f"ball filter: no state follows from wheels {w}, gyro {gyro} and accel {accel}")
        self.faults = self._named(choice, fault, stalled) if choice or fault or any(stalled) else ()

    def _start(self, wheel: Array) -> None:
        arrays, covariance = self.arrays, self.covariance
        arrays["x"][State.WHEEL :], arrays["read"][:] = wheel, wheel
        covariance[16:, 16:] = np.eye(self._n) * self.noise.encoder**2
        self.covariance, self._first = covariance, False

    def _bridge(self, h: float, wheel: Array) -> None:
        """Go on after a gap: the readings that follow say the rest."""
        x, g, p = self.state, self.geometry, self.covariance
        shift, yaw = bridged(np.exp(-x.scale) * g.turn, g.radius, x.rotation, wheel - x.wheel)
        about = lie.euler_zyx_to_rotation(yaw, 0.0, 0.0)
        position, turning, velocity = spreads(h, shift, yaw)
        self.state = moved = BallState(
            x.position + shift, shift / h, about @ x.rotation, x.gyro_bias, x.accel_bias, wheel.copy(), x.scale
        )
        known = p[P, P].copy()
        heading = float(moved.rotation[2] @ p[A, A] @ moved.rotation[2])
        for part in (P, V, A, slice(16, None)):  # what was known together is not any more
            p[part, :], p[:, part] = 0.0, 0.0
        up = moved.rotation[2]
        p[P, P] = known + np.diag([position**2, position**2, self.noise.floor**2])
        p[V, V] = velocity**2 * np.eye(3)
        p[A, A] = GAP_LEAN**2 * np.eye(3) + (heading + turning**2 - GAP_LEAN**2) * np.outer(up, up)
        p[16:, 16:] = self.noise.encoder**2 * np.eye(self._n)
        self.covariance = p
        forget(self.arrays["gate"])
        self._turning, self.faults = 0.0, ()
        self.arrays["read"][:], self.arrays["way"][:] = wheel, 0.0

    def _named(self, choice: int, fault: int, stalled: list[float]) -> tuple[str, ...]:
        """What is wrong with the inertial unit's message, which encoders stand, and what slips in an explanation
        (:func:`wbmpc.bases.ball.filter_solve.solve_robust`)."""
        slips = ("", "ball spins", *(f"wheel_{i} slips" for i in range(self._n)), "ball slips")[choice]
        stand = [f"wheel_{i} stalled" for i, stands in enumerate(stalled) if stands]
        return tuple(f for f in (f"imu {FAULTS[fault]}" if fault else "", *stand, slips) if f)

    def correct_lean(self, up: ArrayLike, spread: float) -> None:
        """A lean that is known from elsewhere: ``up`` (3) is the vertical in base axes, ± ``spread`` [rad].

        Near upright a horizontal bias of the accelerometer looks like a lean; this distinguishes them, as well as it is known.
        Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be.
        """
        up = numbers("ball filter", "up", up, 3)
        length = float(np.linalg.norm(up))
        if length == 0.0 or not 0.0 < spread < np.inf:
            raise InputError(f"ball filter: a lean needs a direction (3) and a positive spread, got {up} ± {spread}")
        # up = Rᵀ ẑ turns by up × error; of its three rows the horizontal ones of the base count
        slope = np.zeros((2, self.covariance.shape[0]))
        expected = self.state.rotation[2]
        slope[:, A] = skew(expected)[:2]
        self._correct(slope, (up / length - expected)[:2], spread**2 * np.eye(2))

    def correct_pose(self, wrong: ArrayLike, covariance: ArrayLike) -> None:
        """A pose that is known from elsewhere: ``wrong`` (3) is what it says minus the estimate, x, y [m] and yaw [rad], with a
        ``covariance`` (3, 3); with one of zeros it counts as exact. Raises :class:`InputError` (:class:`NotFinite`) for numbers
        that cannot be."""
        wrong, noise = numbers("ball filter", "place", wrong, 3), checked_covariance("ball filter", covariance)
        slope = np.zeros((3, self.covariance.shape[0]))
        slope[:2, P] = np.eye(3)[:2]
        _, pitch, roll = lie.rotation_to_euler_zyx(self.state.rotation)
        slope[2, A] = [lie.euler_zyx_rates(pitch, roll, axis)[0] for axis in np.eye(3)]  # of yaw by the base's turning
        self._correct(slope, wrong, noise + _EXACT * np.eye(3))

    def _correct(self, slope: Array, wrong: Array, noise: Array) -> None:
        """A Kalman update by rows ``slope`` (m, n) that are off by ``wrong`` (m), with a covariance ``noise`` (m, m)."""
        gain = np.linalg.solve(slope @ self.covariance @ slope.T + noise, slope @ self.covariance).T
        self.state = self.state.moved(gain @ wrong)
        keep = np.eye(len(gain)) - gain @ slope
        self.covariance = keep @ self.covariance @ keep.T + gain @ noise @ gain.T  # Joseph form
