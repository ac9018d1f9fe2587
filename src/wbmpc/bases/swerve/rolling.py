"""Rolling inverse kinematics of steered wheels for loops that ask for it tick by tick."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.bases.swerve.compilation import step
from wbmpc.kernel.ir import Floats
from wbmpc.kernel.step import bind
from wbmpc.model.wheels import ModuleGeometry

PI = float(np.pi)
#: A wheel that moves slower than this [m/s] stands, and keeps its direction.
STILL = 1e-9


class Modules(NamedTuple):
    """n modules, as :class:`wbmpc.model.wheels.ModuleGeometry` has them; ``moves``: 1 where legs move, else 0."""

    n: int
    hinge: Floats  # (n, 2) [m]
    length: Floats  # (n) [m]
    leg_heading: Floats  # (n) [rad]
    wheel_heading: Floats  # (n) [rad]
    slides: Floats  # (n)
    radius: float  # [m], of the wheels
    moves: float


@step
def roll(
    g: Modules, leg: Floats, steer: Floats, rate: Floats, target: Floats, wheel: Floats, vx: float, vy: float, turn: float,
) -> None:  # fmt: skip
    """Steering angles ``target`` (n) [rad], of the two of each wheel those nearest to ``steer`` (n), and speeds ``wheel`` (n) [rad/s] that
    roll a twist (vx, vy, ``turn``) with the legs at ``leg`` (n) moving at ``rate`` (n)."""
    for i in range(g.n):
        position, moving = g.moves * leg[i], g.moves * rate[i]
        turns = 1.0 - g.slides[i]
        angle = turns * position
        along = g.leg_heading[i] + angle
        c, s = np.cos(along), np.sin(along)
        reach = g.length[i] + g.slides[i] * position
        swing_x, swing_y = reach * c, reach * s
        x, y = g.hinge[2 * i] + swing_x, g.hinge[2 * i + 1] + swing_y
        speed_x = vx - turn * y + moving * (g.slides[i] * c - turns * swing_y)
        speed_y = vy + turn * x + moving * (g.slides[i] * s + turns * swing_x)
        heading = g.wheel_heading[i] + angle + steer[i]
        change = np.arctan2(speed_y, speed_x) - heading + 0.5 * PI
        change = change - PI * np.floor(change / PI) - 0.5 * PI
        if speed_x * speed_x + speed_y * speed_y < STILL * STILL:
            change = 0.0
        target[i] = steer[i] + change
        wheel[i] = (speed_x * np.cos(heading + change) + speed_y * np.sin(heading + change)) / g.radius


class Rolling:
    """:func:`wbmpc.model.wheels.rolling_inverse_kinematics` of one base, without NumPy's cost of each operation."""

    def __init__(self, geometry: ModuleGeometry) -> None:
        n, plain = geometry.modules, lambda values: np.array(values, float).ravel()
        a = self._arrays = {name: np.zeros(n) for name in ("leg", "steer", "rate", "target", "wheel")}
        modules = {
            "hinge": plain(geometry.hinge), "length": plain(geometry.leg_length), "leg_heading": plain(geometry.leg_heading),
            "wheel_heading": plain(geometry.wheel_heading), "slides": plain(geometry.slides),
        }  # fmt: skip
        constants = {"radius": float(geometry.wheel_radius), "moves": float(geometry.legs_move)}
        self._roll = bind(roll, a | modules, n=n, **constants)

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
