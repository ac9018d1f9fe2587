"""State of a ball-balancing base from wheel encoders and an inertial unit, in the manner of the two-state implicit filter.

Source: Bloesch, Burri, Sommer, Siegwart, Hutter: "The Two-State Implicit Filter", RA-L 2018: no prediction, only residuals
between two consecutive states; the older one is marginalised. Here the residuals are inertial increments (strapdown), rolling
of the ball without slip, wheel encoders, and the floor's height. docs/explanation/ball-robot.md has the equations.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.stats import chi2

from wbmpc import lie
from wbmpc.bases.ball.filter_state import BA, BG, A, BallGeometry, BallNoise, BallState, P, V, cross, rotation_of, skew
from wbmpc.bases.ball.gap import GAP, GAP_LEAN, bridged, spreads
from wbmpc.bases.base import InertialDescription
from wbmpc.checks import covariance as checked_covariance
from wbmpc.checks import finite, numbers
from wbmpc.errors import InputError, NotFinite
from wbmpc.estimation.inertial import UNKNOWN, InertialGate

Array = NDArray[np.float64]
GRAVITY = np.array([0.0, 0.0, 9.81])
#: Probability of more than this surprise without a fault; variance [rad²] of rows that count for nothing; what a wheel must
#: have turned [rad] before an encoder that does not move is called stalled: one that stays within so many counts.
GATE, ANY, STALLED, STILL = 1e-4, 1.0, 1e-2, 3.0
#: Variance [m², rad²] of what is called exact.
_EXACT = 1e-14
UP = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])  # ẑ ×


@dataclass(frozen=True)
class _Explained:
    """A state linearised at ``guess``, its ``error`` and ``covariance``, the ``faults`` that explain the readings; ``loose``:
    whether wheels, or the ball, slip in it."""

    guess: BallState
    error: Array
    covariance: Array
    faults: tuple[str, ...]
    loose: bool


class BallFilter:
    """Error state (16 + wheels): position, velocity of the inertial unit, attitude (base axes), gyro and accelerometer bias,
    log of the wheels' radius factor, wheel angles. ``covariance`` belongs to it.

    ``surprise``: what the redundant rows cost at the last update, chi-square with ``freedom`` = wheels + 1 degrees.
    ``faults`` of the last update, each a part and what it does: where rolling contradicts the inertial unit beyond :data:`GATE`,
    or an encoder stands while its wheel turns, those rows count for nothing; a message of the inertial ``unit`` that cannot be
    true (``imu exceeds``, ``repeats``, ``jumps``) leaves its rates and forces at those of the last good one, to :data:`UNKNOWN`.
    """

    def __init__(
        self, geometry: BallGeometry, position: ArrayLike, rotation: ArrayLike, noise: BallNoise,
        unit: InertialDescription | None = None,
    ) -> None:  # fmt: skip
        n = self._n = len(geometry.turn)
        self.geometry, self.noise = geometry, noise
        position = np.array([*numbers("ball filter", "position", np.asarray(position)[:2], 2), 0.0])
        numbers("ball filter", "rotation", np.ravel(rotation), 9)
        self.state = BallState(position, np.zeros(3), np.array(rotation, float), wheel=np.zeros(n))
        s = noise
        spread = np.concatenate([
            [s.start, s.start, s.floor], [s.speed] * 3, [s.tilt] * 3, [s.gyro_bias] * 3, [s.accel_bias] * 3, [s.scale], [1.0] * n,
        ])  # fmt: skip
        self.covariance = np.diag(spread**2)
        # what is known of the start is its heading: the uncertain axes are those of the world's horizontal
        about = self.state.rotation.T @ np.diag([s.tilt, s.tilt, s.start]) ** 2 @ self.state.rotation
        self.covariance[A, A] = about
        self.freedom, self.surprise = n + 1, 0.0
        self.faults: tuple[str, ...] = ()
        self._gate = float(chi2.isf(GATE, self.freedom))
        self._inertial = InertialGate(unit or InertialDescription(), self.state.rotation.T @ GRAVITY)
        self._still = STILL * np.sqrt(12.0) * noise.encoder
        self._read, self._turned, self._stalled = np.zeros(n), np.zeros(n), np.zeros(n, dtype=bool)
        self._rows = 16 + 2 * n + 1  # bias walks 6, scale 1, turning 3, push 3, shift 3, rolling n, encoders n, floor 1
        self._first = True
        self._turning = 0.0  # the torque about the vertical that lasts [N m]
        self.rate = np.zeros(3)

    # ------------------------------------------------------------------ update
    def update(
        self, interval: float, wheel: ArrayLike, gyro: ArrayLike, accel: ArrayLike, turning: float = 0.0
    ) -> BallState:
        """The state after a message: encoders (n) [rad], and averages of gyro and accelerometer over ``interval`` [s];
        ``turning`` [N m]: torque of the wheels on the ball about the vertical. A message that is not newer than the last one
        (``interval`` ≤ 0) is ignored. Over a gap (:data:`wbmpc.bases.ball.gap.GAP`) only the wheels count: nothing is
        integrated, and position, heading, lean and velocity are known as little as that module states.

        Raises :class:`NotFinite` for readings that are not finite, or from which no state follows."""
        finite("ball filter", interval=interval, turning=turning)
        w, *message = (
            numbers("ball filter", name, value, size)
            for name, value, size in (("wheel", wheel, self._n), ("gyro", gyro, 3), ("accel", accel, 3))
        )
        if self._first:
            self.state.wheel, self._read, self._first = w.copy(), w.copy(), False
            self.covariance[16:, 16:] = np.eye(self._n) * self.noise.encoder**2
        if interval <= 0.0:
            return self.state
        if interval > GAP:
            self._bridge(interval, w)
            return self.state
        self._turning += (1.0 - np.exp(-interval / self.noise.lasting)) * (turning - self._turning)
        try:
            best = self._weighed(interval, w, np.stack(message))
        except np.linalg.LinAlgError as error:
            raise NotFinite(
                f"ball filter: no state follows from wheels {w}, gyro and accel {message} ({error})"
            ) from error
        turned = best.guess.wheel - self.state.wheel
        self.state, self.covariance, self.faults = best.guess.moved(best.error), best.covariance, best.faults
        self.rate = self._inertial.last[0] - self.state.gyro_bias
        self._detect_stalled(w, turned)
        return self.state

    def _bridge(self, h: float, wheel: Array) -> None:
        """Go on after a gap: the readings that follow say the rest."""
        x, g, p = self.state, self.geometry, self.covariance
        shift, yaw = bridged(np.exp(-x.scale) * g.turn, g.radius, x.rotation, wheel - x.wheel)
        about = lie.euler_zyx_to_rotation(yaw, 0.0, 0.0)
        position, turning, velocity = spreads(h, shift, yaw)
        self.state = BallState(
            x.position + shift, shift / h, about @ x.rotation, x.gyro_bias, x.accel_bias, wheel.copy(), x.scale
        )
        known = p[P, P].copy()
        heading = float(self.state.rotation[2] @ p[A, A] @ self.state.rotation[2])
        for part in (P, V, A, slice(16, None)):  # what was known together is not any more
            p[part, :], p[:, part] = 0.0, 0.0
        up = self.state.rotation[2]
        p[P, P] = known + np.diag([position**2, position**2, self.noise.floor**2])
        p[V, V] = velocity**2 * np.eye(3)
        p[A, A] = GAP_LEAN**2 * np.eye(3) + (heading + turning**2 - GAP_LEAN**2) * np.outer(up, up)
        p[16:, 16:] = self.noise.encoder**2 * np.eye(self._n)
        self._inertial.reset()
        self._turning, self.faults, self._read = 0.0, (), wheel.copy()
        self._turned[:] = 0.0

    def _weighed(self, h: float, wheel: Array, message: Array) -> _Explained:
        """What a ``message`` (2, 3) of the inertial unit and the wheels say; without the message if it cannot be true.

        One that jumps while the wheels contradict it cannot, if the wheels agree with each other: a spike, not three wheels.
        """
        unit = self._inertial
        if fault := unit.judge(h, message):
            return self._explained(h, wheel, unit.last, fault)
        persists = unit.persists(message)
        best = self._explained(h, wheel, message)
        if persists or (best.loose and unit.jumps(message)):
            without = self._explained(h, wheel, unit.last, "jumps")
            if not without.loose:
                unit.reject()
                return without
        unit.accept(message)
        return best

    def _explained(self, h: float, wheel: Array, message: Array, fault: str = "") -> _Explained:
        """The newer state under the mildest explanation of the rows: no fault, the ball spins on the floor, one
        wheel slips, the ball slips. If none is good enough the best one counts. ``fault``: why the inertial message is another
        one's, which says little."""
        gyro, accel = message
        guess = self._integrated(self.state, h, gyro, accel)
        r, jx, jy, q = self._linearised(self.state, guess, h, wheel, accel)
        if fault:
            q[0:3, 0:3], q[3:6, 3:6] = ((unknown * h) ** 2 * np.eye(3) for unknown in UNKNOWN)
        elif not self._inertial.jumps(message):
            # a mean says the less of a motion, the more it changes to the next; spikes are judged, not believed a little less
            for rows, new, old in zip((slice(0, 3), slice(3, 6)), message, self._inertial.last, strict=True):
                q[rows, rows] += (self.noise.change * h) ** 2 * float((new - old) @ (new - old)) * np.eye(3)
        rolling = slice(16, 16 + self._n)
        plain, known = q[rolling, rolling].copy(), np.diag(np.where(self._stalled, ANY, 0.0))
        certain = (
            *((f"imu {fault}",) if fault else ()),
            *(f"wheel_{i} stalled" for i in np.flatnonzero(self._stalled)),
        )
        best: _Explained | None = None
        lowest = np.inf
        for faults, more in self._explanations():
            q[rolling, rolling] = plain + known + more
            error, covariance, cost = self._solved(r, jx, jy, q)
            if not faults:
                self.surprise = cost
            if cost < lowest:
                lowest, best = cost, _Explained(guess, error, covariance, certain + faults, bool(faults))
            if lowest < self._gate:
                break
        if best is None:
            raise np.linalg.LinAlgError("the residuals are not finite")
        return best

    def _explanations(self) -> Iterator[tuple[tuple[str, ...], Array]]:
        """Faults of rolling, the likely ones first, and the variance [rad²] that they give to the wheels' increments."""
        n = self._n
        yield (), np.zeros((n, n))
        spin = self.geometry.turn @ self.state.rotation[2]  # of the base about the vertical
        yield ("ball spins",), ANY * np.outer(spin, spin)
        for i in np.flatnonzero(~self._stalled):
            yield (f"wheel_{i} slips",), ANY * np.diag(np.eye(n)[i])
        yield ("ball slips",), ANY * np.eye(n)

    def _detect_stalled(self, wheel: Array, expected: Array) -> None:
        """An encoder that stays within a few counts (one may flicker) while its wheel must have turned by :data:`STALLED`."""
        moves = np.abs(wheel - self._read) > self._still
        self._turned = np.where(moves, 0.0, self._turned + expected)
        self._stalled = ~moves & (np.abs(self._turned) > STALLED)
        self._read = np.where(moves, wheel, self._read)

    def _integrated(self, x: BallState, h: float, gyro: Array, accel: Array) -> BallState:
        """The next state by strapdown integration and rolling: where the residuals are linearised."""
        turn = h * (gyro - x.gyro_bias)
        rotation = x.rotation @ rotation_of(turn)
        middle = x.rotation @ rotation_of(0.5 * turn)
        velocity = x.velocity + h * (middle @ (accel - x.accel_bias) - GRAVITY)
        shift = 0.5 * h * (x.velocity + velocity) - (rotation - x.rotation) @ self.geometry.mount
        rolled = self._rolled(middle, shift, turn)
        wheel = x.wheel + np.exp(-x.scale) * (self.geometry.turn @ rolled)
        return BallState(x.position + shift, velocity, rotation, x.gyro_bias, x.accel_bias, wheel, x.scale)

    def _rolled(self, middle: Array, shift: Array, turn: Array) -> Array:
        """Turning (3) [rad] of the ball relative to the base, base axes, when it rolls by ``shift`` (3) [m]."""
        rolled: Array = middle.T @ (UP @ shift) / self.geometry.radius - turn
        return rolled

    def _linearised(
        self, x: BallState, y: BallState, h: float, wheel: Array, accel: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Residuals r between the states x and y, their slopes by the errors of x and of y, the covariance of their noise."""
        s, g, n, m = self.noise, self.geometry, self._n, self._rows
        size = 16 + n
        r, jx, jy, q = np.zeros(m), np.zeros((m, size)), np.zeros((m, size)), np.zeros((m, m))
        turned = x.rotation.T @ y.rotation
        turn = lie.quaternion_log(lie.rotation_to_quaternion(turned))
        middle = x.rotation @ rotation_of(0.5 * turn)
        one = np.eye(3)
        # turning: Log(Rxᵀ Ry) − h (gyro − bias): zero at the guess
        jx[0:3, A], jy[0:3, A], jx[0:3, BG] = -turned.T, one, h * one
        q[0:3, 0:3] = one * s.gyro**2 * h
        # push: vy − vx − h (R (accel − bias) − g): zero at the guess
        jy[3:6, V], jx[3:6, V] = one, -one
        jx[3:6, A], jx[3:6, BA] = h * middle @ skew(accel - x.accel_bias), h * middle
        q[3:6, 3:6] = one * s.accel**2 * h
        # shift: py − px − h/2 (vx + vy) + (Ry − Rx) mount: zero at the guess
        jy[6:9, P], jx[6:9, P], jy[6:9, V], jx[6:9, V] = one, -one, -0.5 * h * one, -0.5 * h * one
        jy[6:9, A], jx[6:9, A] = -y.rotation @ skew(g.mount), x.rotation @ skew(g.mount)
        q[6:9, 6:9] = one * s.path**2
        # walks of the biases, and the scale
        for k, (part, walk) in enumerate(((BG, s.gyro_walk), (BA, s.accel_walk))):
            rows = slice(9 + 3 * k, 12 + 3 * k)
            jy[rows, part], jx[rows, part], q[rows, rows] = one, -one, one * walk**2 * h
        kept = np.exp(-h / s.scale_time)
        r[15], jy[15, 15], jx[15, 15] = y.scale - kept * x.scale, 1.0, -kept
        q[15, 15] = s.scale**2 * (1.0 - kept**2)
        # rolling: wheel increments − turn · (ball's turning − base's): zero at the guess
        shift = y.position - x.position
        across = middle.T @ UP / g.radius
        factor = np.exp(-x.scale) * g.turn
        rolling, by_half = slice(16, 16 + n), 0.5 * skew(across @ shift)
        jy[rolling, 16:], jx[rolling, 16:] = np.eye(n), -np.eye(n)
        jy[rolling, P], jx[rolling, P] = -factor @ across, factor @ across
        jy[rolling, A], jx[rolling, A] = factor @ (one - by_half), -factor @ (turned.T + by_half)
        jx[rolling, 15] = factor @ self._rolled(middle, shift, turn)
        slip = g.turn @ middle.T
        spin = s.spin**2 + (s.creeping * self._turning) ** 2
        q[rolling, rolling] = slip @ np.diag([s.creep**2, s.creep**2, spin]) @ slip.T * h
        # encoders: what they read was true a little before
        speed = (y.wheel - x.wheel) / h
        encoders = slice(16 + n, 16 + 2 * n)
        r[encoders] = y.wheel - s.age * speed - wheel
        jy[encoders, 16:], jx[encoders, 16:] = (1.0 - s.age / h) * np.eye(n), s.age / h * np.eye(n)
        q[encoders, encoders] = np.eye(n) * s.encoder**2 + s.jitter**2 * np.outer(speed, speed)
        # floor
        r[-1], jy[-1, 2], q[-1, -1] = y.position[2], 1.0, s.floor**2
        return r, jx, jy, q

    def _solved(self, r: Array, jx: Array, jy: Array, q: Array) -> tuple[Array, Array, float]:
        """Error of the newer state, its covariance and the cost of the redundant rows: the older one is marginalised."""
        factor = cholesky(q + jx @ self.covariance @ jx.T, lower=True, check_finite=False)
        white = solve_triangular(factor, np.column_stack([jy, r]), lower=True, check_finite=False)
        slope, rest = white[:, :-1], white[:, -1]
        information = cholesky(slope.T @ slope, lower=True, check_finite=False)
        error = -cho_solve((information, True), slope.T @ rest, check_finite=False)
        covariance = cho_solve((information, True), np.eye(slope.shape[1]), check_finite=False)
        left = rest + slope @ error
        return error, 0.5 * (covariance + covariance.T), float(left @ left)

    def know_lean(self, up: ArrayLike, spread: float) -> None:
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

    def know_place(self, wrong: ArrayLike, covariance: ArrayLike) -> None:
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

    # ------------------------------------------------------------------ what is asked for
    @property
    def ball_velocity(self) -> Array:
        """Velocity (3) [m/s] of the ball's centre, world axes."""
        x = self.state
        velocity: Array = x.velocity - x.rotation @ cross(self.rate, self.geometry.mount)
        return velocity
