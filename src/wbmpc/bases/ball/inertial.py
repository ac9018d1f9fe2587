"""An inertial unit's messages that cannot be true: beyond its range, the same ones again and again, far from the one before."""

from __future__ import annotations

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.ball.inertial_gate_step import Gate
from wbmpc.bases.base import InertialDescription

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
