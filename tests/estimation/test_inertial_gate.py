"""Messages of an inertial unit that cannot be true. Truth: the rules, message by message; both back ends."""

from __future__ import annotations

import numpy as np
import pytest

from wbmpc.bases.base import InertialDescription
from wbmpc.estimation.inertial import InertialGate
from wbmpc.kernel.step import Backend

UNIT, REST, H = InertialDescription(), np.array([0.0, 0.0, 9.81]), 0.0025


def said(gate: InertialGate, message: np.ndarray) -> tuple[str, bool]:
    gate.message[:] = message
    assessment = gate.judge(H)
    return assessment.fault, assessment.jumps


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_what_is_said_of_messages(backend: Backend) -> None:
    gate, good = InertialGate(UNIT, REST, backend), np.array([0.1, 0.0, -0.1, 0.2, 0.0, 9.8])
    assert said(gate, good) == ("", False)  # there is nothing yet that a first message could be far from
    gate.accept()
    assert said(gate, good + [0.9, 0, 0, 0, 80.0, 0]) == ("", False)
    assert said(gate, good + [0, 1.1, 0, 0, 0, 0]) == ("", True)
    assert said(gate, good + [0, 0, 0, 0, 0, -91.0]) == ("", True)
    gate.reject()
    gate.message[:] = good + [0, 1.1, 0, 0, 0, 0]
    assert gate.persists(gate.judge(H))
    gate.accept()
    assert said(gate, np.array([0, 0, UNIT.rate, 0, 0, 0.0]))[0] == "exceeds"
    for k in range(11):  # the first is new; from ten repeats on, 25 ms, it stands
        assert said(gate, good)[0] == ("repeats" if k == 10 else "")
    assert (
        said(gate, good + [0, 0, 0, 1e-9, 0, 0])[0] == "repeats"
    )  # one of both is enough: the gyro still says the same
    gate.reset()
    assert said(gate, good + np.array([3.0, 0, 0, 0, 0, 0])) == ("", False)


def test_how_far_a_message_is_from_the_last_one_that_counted() -> None:
    gate = InertialGate(UNIT, REST)
    gate.message[:] = 1.0, 2.0, 2.0, 3.0, 0.0, 9.81 + 4.0
    assessment = gate.judge(H)
    assert assessment.turned == pytest.approx(9.0) and assessment.pushed == pytest.approx(25.0)
