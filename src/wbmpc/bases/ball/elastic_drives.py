"""Series elastic drives: a rotor, a spring and a torque loop between the command and the joint.

The rotor (inertia J reflected to the joint) turns at θ̇ against the housing, the joint at ψ̇; the spring between them has the
twist δ = θ − ψ:

    J θ̈ = τ_m − τ_s,    τ_s = k δ + d (θ̇ − ψ̇),    τ_m = τ_d + g (τ_d − k δ) − c (θ̇ − ψ̇),

τ_s acts on the joint. The same as two collinear hinges, rotor and spring, in MuJoCo; here without their joints, so that it also
fits drives that act on a ball joint. As in MuJoCo's ``armature`` the rotor's reaction on the housing is left out: with a gear
of ratio n it is 1 / n of the reflected torque.

A wheel passes no more than its traction T to what it drives. Where τ_s would be more it slips: τ_s = ± T, and what is left of the
twist goes with the wheel, which has no inertia of its own: k δ + d δ̇ = ± T. (The wheel is then faster than the joint by
(τ_s that it would need − T) / d: slip takes energy, it never gives any.)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.errors import InputError

#: What the motors can give, over the drive's limit: head room for the torque loop (assumed).
HEAD_ROOM = 2.0


class ElasticDrives:
    """Drives side by side; every argument has one entry per drive.

    ``stiffness`` k [N m/rad], ``rotor`` J [kg m²]. With the joint held, ``spring_damping`` is the damping ratio of the rotor on
    its spring without a loop, which gives d; ``gain`` g and ``loop_damping`` (ratio that the loop adds to that of the spring,
    which gives c) are the torque loop's. ``limit`` [N m] cuts the target torques, ``lag`` [s] is their first-order lag,
    ``timestep`` [s] that of the physics: the loop runs once a step. ``traction`` [N m]: what reaches the joint at most (left out:
    everything). Raises :class:`InputError` for a spring without a rotor.
    """

    def __init__(
        self, stiffness: ArrayLike, rotor: ArrayLike, spring_damping: float, gain: float, loop_damping: float,
        limit: ArrayLike, lag: ArrayLike, timestep: float, traction: ArrayLike = np.inf,
    ) -> None:  # fmt: skip
        self.stiffness, self.rotor = np.asarray(stiffness, float), np.asarray(rotor, float)
        if not ((self.stiffness > 0.0).all() and (self.rotor > 0.0).all()):
            raise InputError(
                "elastic drives: stiffness and rotor inertia must be positive (plant.drives.wheel_rotor, .arm_rotor)"
            )
        self.gain, self.limit, self._h = gain, np.asarray(limit, float), timestep
        self.damping = 2.0 * spring_damping * np.sqrt(self.stiffness * self.rotor)
        self.loop_damping = 2.0 * loop_damping * np.sqrt(self.stiffness * (1.0 + gain) * self.rotor)
        self.traction = np.broadcast_to(np.asarray(traction, float), self.stiffness.shape)
        # share of the twist's distance to its rest that is left after a step of slip
        with np.errstate(divide="ignore"):
            self._left = np.exp(-timestep * self.stiffness / self.damping)
        lags = np.asarray(lag, float)
        self._blend = np.where(lags > 0.0, 1.0 - np.exp(-timestep / np.where(lags > 0.0, lags, 1.0)), 1.0)
        steps = [self._exact(k, j, d) for k, j, d in zip(self.stiffness, self.rotor, self.damping, strict=True)]
        self._step = np.array(steps).reshape(-1, 2, 4)
        self.reset(np.zeros(self.stiffness.size), np.zeros(self.stiffness.size))

    def _exact(self, k: float, j: float, d: float) -> Array:
        """One step of (δ, θ̇) for held (τ_m, ψ̇), (2, 4): the exponential of the linear equations."""
        from scipy.linalg import expm  # slow to import

        a, b = np.array([[0.0, 1.0], [-k / j, -d / j]]), np.array([[0.0, -1.0], [1.0 / j, d / j]])
        whole = expm(self._h * np.block([[a, b], [np.zeros((2, 4))]]))
        return np.asarray(whole[:2])

    def reset(self, torque: ArrayLike, speed: ArrayLike) -> None:
        """Springs wound up for ``torque`` (n) [N m], rotors at the joints' speed (n) [rad/s]."""
        self.target, self.speed = np.array(torque, float), np.array(speed, float)
        self.twist = self.target / self.stiffness
        self.torque = self.target.copy()

    def step(self, command: ArrayLike, speed: ArrayLike) -> Array:
        """Torques (n) [N m] on the joints over the next step, for commands (n) and the joints' speeds (n) [rad/s] now."""
        joint = np.asarray(speed, float)
        self.target += self._blend * (np.clip(command, -self.limit, self.limit) - self.target)
        previous = self.stiffness * self.twist
        relative = self.speed - joint
        motor = self.target + self.gain * (self.target - previous) - self.loop_damping * relative
        motor = np.clip(motor, -HEAD_ROOM * self.limit, HEAD_ROOM * self.limit)
        twist, rotor = self.twist, self.speed
        self.twist, self.speed = np.einsum("nij,jn->in", self._step, np.array([twist, rotor, motor, joint]))
        # the mean over the step: what acts is not half a step old
        spring = 0.5 * (previous + self.stiffness * self.twist)
        self.torque = spring + 0.5 * self.damping * (relative + self.speed - joint)
        slips = np.abs(self.torque) > self.traction
        if slips.any():
            self._slip(slips, twist, rotor, motor)
        return self.torque

    def _slip(self, slips: Array, twist: Array, speed: Array, motor: Array) -> None:
        """Another step from ``twist`` and rotor ``speed`` under the ``motor`` torque for the drives that slip (n)."""
        passed = np.copysign(np.where(slips, self.traction, 0.0), self.torque)
        rest = passed / self.stiffness
        self.torque = np.where(slips, passed, self.torque)
        self.speed = np.where(slips, speed + self._h * (motor - passed) / self.rotor, self.speed)
        self.twist = np.where(slips, rest + self._left * (twist - rest), self.twist)
