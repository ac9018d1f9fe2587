"""What a simulation with a solver's integrator is asked for, checked before compiled code reads it."""

from __future__ import annotations

import math

import numpy as np

from wbmpc.checks import not_negative, real_number, real_numbers
from wbmpc.errors import InputError, NotFinite
from wbmpc.ocp.problem import SystemDynamics

#: So many steps at most are simulated in one call.
SIMULATED = 64


def simulation_arguments(
    dynamics: SystemDynamics, x: np.ndarray, u: np.ndarray, h: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """State (nx), inputs (nu) or (k, nu) of ``dynamics`` and step [s] as arrays of floats and a float.

    Raises :class:`InputError` for other shapes and for what is no number, or a step below 0, and :class:`NotFinite`.
    """
    x, u, nx, nu = real_numbers("simulate", x), real_numbers("simulate", u), dynamics.state.size, dynamics.input.size
    if x.shape != (nx,) or u.ndim not in (1, 2) or u.shape[-1] != nu:
        raise InputError(f"simulate: {nx} states and {nu} inputs are needed, got shapes {x.shape} and {u.shape}")
    # one sum is the quick check: dozens of calls in a controller's tick; one that is not finite may be of large numbers
    if type(h) is float and h >= 0.0 and math.isfinite(h + sum(x.tolist()) + sum(u.ravel().tolist())):
        return x, u, h
    h = real_number("simulate: the step", h)
    not_negative("simulate", step=h)
    for names, values in ((dynamics.state.names, x), (dynamics.input.names, u)):
        bad = np.argwhere(~np.isfinite(values))
        if bad.size:
            raise NotFinite(
                f"simulate: '{names[int(bad[0][-1])]}' must be finite, got {values[tuple(map(int, bad[0]))]}"
            )
    return x, u, h
