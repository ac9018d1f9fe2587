"""Rolling inverse kinematics of steered wheels for loops that ask for it tick by tick."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.bases.swerve.rolling_step import roll
from wbmpc.kernel.step import Backend, bind
from wbmpc.model.wheels import ModuleGeometry


class Rolling:
    """:func:`wbmpc.model.wheels.rolling_inverse_kinematics` of one base, without NumPy's cost of each operation. ``backend``: machine code
    (:mod:`wbmpc.bases.swerve.rolling_step`), or the same source as ordinary Python."""

    def __init__(self, geometry: ModuleGeometry, backend: Backend = "compiled") -> None:
        n, plain = geometry.modules, lambda values: np.array(values, float).ravel()
        a = self._arrays = {name: np.zeros(n) for name in ("leg", "steer", "rate", "target", "wheel")}
        modules = {
            "hinge": plain(geometry.hinge), "length": plain(geometry.leg_length), "leg_heading": plain(geometry.leg_heading),
            "wheel_heading": plain(geometry.wheel_heading), "slides": plain(geometry.slides),
        }  # fmt: skip
        constants = {"radius": float(geometry.wheel_radius), "moves": float(geometry.legs_move)}
        self._roll = bind(roll, a | modules, backend, n=n, **constants)

    def __call__(
        self, leg: ArrayLike, steer: ArrayLike, twist: ArrayLike, leg_rate: ArrayLike = 0.0
    ) -> tuple[Array, Array]:
        """Steering angles (n) [rad], on the branch nearest to ``steer`` (n), and wheel speeds (n) [rad/s] that roll a ``twist`` (vx, vy, ω)
        with the legs at ``leg`` (n) moving at ``leg_rate`` (n, or one for all)."""
        a = self._arrays
        a["leg"][:], a["steer"][:], a["rate"][:] = leg, steer, leg_rate
        vx, vy, turn = np.asarray(twist, float).tolist()
        self._roll(vx, vy, turn)
        return a["target"].copy(), a["wheel"].copy()
