"""Swerve bases that move by formula: what their encoders and gyro say, with slip and errors of known size."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wbmpc import lie
from wbmpc.bases.swerve.wheel_calibration import WheelCalibration
from wbmpc.bases.swerve.wheel_fit import WheelFit
from wbmpc.bases.swerve.wheel_odometry import Increment, Sample
from wbmpc.bases.swerve.wheel_record import WheelRecord
from wbmpc.model.wheels import ModuleGeometry


def fit_twist(
    geometry: ModuleGeometry, radius: np.ndarray, previous: Sample, now: Sample, weights: np.ndarray | None = None
) -> Increment:
    """The motion that fits two samples of true angles best; ``radius`` (n) [m]; ``weights`` (n) of the wheels (1 when left out)."""
    fitted = WheelFit(geometry, radius)
    memory = fitted.memory
    memory["before"][:], memory["now"][:] = np.concatenate(previous), np.concatenate(now)
    if weights is not None:
        memory["weights"][:] = weights
    fitted.run()
    return Increment.of(fitted)


def ring(modules: int, hinged: bool = True, radius: float = 0.1, slides: bool = False) -> ModuleGeometry:
    """Modules on a circle of 0.5 m, legs of 0.3 m that point outwards, on hinges or, where they slide, getting longer."""
    angle = 2.0 * np.pi * np.arange(modules) / modules + 0.3
    return ModuleGeometry(
        hinge=0.5 * np.stack([np.cos(angle), np.sin(angle)], axis=1),
        leg_length=np.full(modules, 0.3),
        leg_heading=angle,
        wheel_heading=angle,
        wheel_radius=radius,
        legs_move=hinged,
        slides=np.full(modules, float(slides)),
    )


def wandering(t: float) -> np.ndarray:
    """Body twist (vx, vy, ω) of a drive that turns left and right; never slow."""
    return np.array([0.30 + 0.05 * np.sin(1.1 * t), 0.12 * np.sin(0.7 * t), 0.25 * np.cos(0.5 * t)])


@dataclass
class Drawn:
    """One base on its way. ``slip`` [m/√s]: intensity of each wheel's displacement, along and across; ``zero`` [rad],
    ``radius`` (relative): standard deviations of what the encoders hide; gyro as in a data sheet; ``seed`` of all."""

    geometry: ModuleGeometry
    seed: int
    slip: float = 0.0
    zero: float = 0.0
    radius: float = 0.0
    gyro: float = 2e-4
    bias: float = 0.01
    motion: object = wandering
    period: float = 0.02
    length: float = 15.0
    poses: list[np.ndarray] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        n = self.geometry.modules
        self.zeros, self.factors = self.zero * self.rng.normal(size=n), 1.0 + self.radius * self.rng.normal(size=n)
        self.drift = self.bias * self.rng.normal()

    def velocities(self, leg: np.ndarray, rate: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Of the steer axes, as complex numbers in the body."""
        g = self.geometry
        arm = g.leg_length * np.exp(1j * (g.leg_heading + leg))
        return v[0] + 1j * v[1] + 1j * v[2] * (g.hinge @ [1, 1j] + arm) + 1j * rate * arm

    def legs(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Angles and rates: at rest, unless the legs have hinges."""
        phase = 0.4 * t + np.arange(self.geometry.modules)
        return 0.2 * np.sin(phase) * self.geometry.legs_move, 0.08 * np.cos(phase) * self.geometry.legs_move

    def __iter__(self):  # type: ignore[no-untyped-def]
        """Yields (time, leg, steer, wheel, gyro); ``poses`` has the truth of each message."""
        g, h, n = self.geometry, self.period, self.geometry.modules
        pose, wheel, heading = np.array([0.4, -0.3, 0.2]), np.zeros(n), None
        turned = np.zeros(n)
        for k in range(round(self.length / h) + 1):
            t = k * h
            leg, rate = self.legs(t)
            angle = np.angle(self.velocities(leg, rate, self.motion(t)))
            old, heading = (
                heading,
                angle if heading is None else heading + (angle - heading + np.pi) % (2 * np.pi) - np.pi,
            )
            if k:
                twist = self.motion(t - 0.5 * h)
                pose = lie.se2_step(pose, twist * h)
                previous, after = self.legs(t - h)[0], leg
                middle = self.velocities(0.5 * (previous + after), (after - previous) / h, twist)
                way = np.abs(middle) * h
                gyro = twist[2] + self.drift + self.gyro / np.sqrt(h) * self.rng.normal()
                # slip across: the wheel points beside its way; slip along: it rolls farther or less far than it goes
                beside, turned = turned, self.slip * np.sqrt(h) / way * self.rng.normal(size=n)
                lost = self.slip * np.sqrt(h) * self.rng.normal(size=n)
                chord = (way + lost) / np.cos(0.5 * (beside + turned))
                arc = chord / np.sinc((heading - old + turned - beside) / (2.0 * np.pi))
                wheel = wheel + arc / (g.wheel_radius * self.factors)
            else:
                gyro = self.motion(t)[2] + self.drift
            self.poses.append(pose)
            yield t, leg, heading + turned - g.wheel_heading - leg + self.zeros, wheel, gyro


#: Modules that are not on one circle: every zero and every radius shows in some motion.
UNEVEN = ring(4)
UNEVEN.hinge[:] += [[0.3, 0.0], [0.0, 0.1], [-0.1, -0.2], [0.1, 0.0]]


def record(base: Drawn, std: tuple[float, float, float], every: int = 5) -> WheelRecord:
    """What a localization and the encoders of that base say."""
    messages = list(base)
    times, leg, steer, wheel, gyro = (np.array(part) for part in zip(*messages, strict=True))
    places = np.array(base.poses[::every])
    seen = places + np.array(std) * base.rng.normal(size=places.shape)
    return WheelRecord(times, leg, steer, wheel, times[::every], seen, np.tile(std, (len(seen), 1)), gyro)


def prior() -> WheelCalibration:
    """Zeros and radii that may be wrong by 2 mrad and 0.2 %."""
    return WheelCalibration.unknown(UNEVEN, 2e-3, 2e-3, 0.0)
