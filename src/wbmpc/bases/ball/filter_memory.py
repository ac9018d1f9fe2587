"""The arrays of the compiled ball filter, and its steps."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.ball.filter_solve import process
from wbmpc.bases.ball.filter_state import BallGeometry, BallNoise, BallState
from wbmpc.bases.ball.filter_step import Noise, State
from wbmpc.kernel.step import Backend, Step, bind


class FilterMemory:
    """``arrays``: everything by its name in :class:`wbmpc.bases.ball.filter_step.Filter`, and a ``gate`` of the inertial unit
    (:func:`wbmpc.bases.ball.filter.gate_arrays`). ``constants``: of :func:`wbmpc.bases.ball.filter_solve.process`, which is
    ``process(h, torque, bound)``. The older state is the filter's."""

    def __init__(
        self, geometry: BallGeometry, noise: BallNoise, gate: dict[str, Array], backend: Backend, **constants: float
    ) -> None:
        self._made_of, self._constants = (geometry, noise, gate, backend), constants
        n = len(geometry.turn)
        size, m, state = 16 + n, 17 + 2 * n, State.WHEEL + n
        sizes = {"x": state, "y": state, "z": state, "gyro": 3, "accel": 3}
        sizes |= {"wheel": n, "read": n, "way": n, "gone": n, "stalled": n, "spin": n, "plain": n * n, "slip": 3 * n}
        sizes |= {"rate": 3, "turn": 3, "turned": 9, "half": 9, "middle": 9, "after": 9, "shift": 3, "pushed": 3}
        sizes |= {"p": size * size, "jx": m * size, "jy": m * size, "q": m * m, "r": m, "moved": m * size}
        sizes |= {"w": m * (size + 1), "a": size * size, "inverse": size * size, "slope": size, "root": m * m}
        sizes |= {"error": size, "covariance": size * size, "best_error": size, "best_covariance": size * size}
        self.arrays = (
            {name: np.zeros(length) for name, length in sizes.items()}
            | deepcopy(gate)
            | {
                "mount": np.array(geometry.mount, float),
                "wheels": np.array(geometry.turn, float).flatten(),
                "noise": np.array([getattr(noise, entry.name.lower()) for entry in Noise], float),
            }
        )
        self.process = self.step(process, **constants)

    def step(self, function: Callable[..., Any], **constants: float) -> Step:
        """A step of the filter on these arrays."""
        geometry, _, _, backend = self._made_of
        return bind(function, self.arrays, backend, n=len(geometry.turn), radius=float(geometry.radius), **constants)

    def __deepcopy__(self, memo: dict[int, object]) -> FilterMemory:
        """Steps of the copy work on its own arrays, and so do those of others on these."""
        geometry, noise, gate, backend = self._made_of
        made = FilterMemory(geometry, noise, gate, backend, **self._constants)
        for name, array in self.arrays.items():
            made.arrays[name][:] = array
            memo[id(array)] = made.arrays[name]
        return made

    @property
    def state(self) -> BallState:
        """The older state, a copy."""
        return _state_of(self.arrays["x"].copy())

    @state.setter
    def state(self, state: BallState) -> None:
        x = self.arrays["x"]
        x[State.POSITION : State.VELOCITY], x[State.VELOCITY : State.ROTATION] = state.position, state.velocity
        x[State.ROTATION : State.GYRO_BIAS] = state.rotation.ravel()
        x[State.GYRO_BIAS : State.ACCEL_BIAS], x[State.ACCEL_BIAS : State.SCALE] = state.gyro_bias, state.accel_bias
        x[State.SCALE], x[State.WHEEL :] = state.scale, state.wheel


def _state_of(z: Array) -> BallState:
    return BallState(
        z[State.POSITION : State.VELOCITY], z[State.VELOCITY : State.ROTATION],
        z[State.ROTATION : State.GYRO_BIAS].reshape(3, 3), z[State.GYRO_BIAS : State.ACCEL_BIAS],
        z[State.ACCEL_BIAS : State.SCALE], z[State.WHEEL :], float(z[State.SCALE]),
    )  # fmt: skip
