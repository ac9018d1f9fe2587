"""Messages of an inertial unit that cannot be true. Truth: the rules, message by message; both back ends."""

from __future__ import annotations

import numpy as np
import pytest

from toys import made
from wbmpc.bases.ball.filter import forget, gate_arrays
from wbmpc.bases.ball.inertial_gate_step import FAULTS, Gate, judge
from wbmpc.bases.base import InertialDescription
from wbmpc.kernel.step import Backend, bind

UNIT, REST, H = InertialDescription(), np.array([0.0, 0.0, 9.81]), 0.0025


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_what_is_said_of_messages(backend: Backend) -> None:
    arrays, good = gate_arrays(UNIT, REST), np.array([0.1, 0.0, -0.1, 0.2, 0.0, 9.8])
    step = made(backend, bind, judge, arrays)

    def said(message: np.ndarray) -> tuple[str, bool]:
        arrays["message"][:] = message
        fault, jumps, *_ = step(H)
        return FAULTS[fault], jumps

    assert said(good) == ("", False)  # there is nothing yet that a first message could be far from
    arrays["last"][:], arrays["gate"][Gate.COUNTED] = good, 1.0
    assert said(good + [0.9, 0, 0, 0, 80.0, 0]) == ("", False)
    assert said(good + [0, 1.1, 0, 0, 0, 0]) == ("", True)
    assert said(good + [0, 0, 0, 0, 0, -91.0]) == ("", True)
    assert said(np.array([0, 0, UNIT.rate, 0, 0, 0.0]))[0] == "exceeds"
    for k in range(11):  # the first is new; from ten repeats on, 25 ms, it stands
        assert said(good)[0] == ("repeats" if k == 10 else "")
    assert said(good + [0, 0, 0, 1e-9, 0, 0])[0] == "repeats"  # one of both is enough: the gyro still says the same
    forget(arrays["gate"])
    assert said(good + np.array([3.0, 0, 0, 0, 0, 0])) == ("", False)


def test_how_far_a_message_is_from_the_last_one_that_counted() -> None:
    arrays = gate_arrays(UNIT, REST)
    arrays["message"][:] = 1.0, 2.0, 2.0, 3.0, 0.0, 9.81 + 4.0
    *_, turned, pushed = bind(judge, arrays)(H)
    assert turned == pytest.approx(9.0) and pushed == pytest.approx(25.0)
