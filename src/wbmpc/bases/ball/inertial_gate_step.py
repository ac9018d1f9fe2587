"""One message of an inertial unit, compiled: whether it can be true. The arrays are those of :func:`wbmpc.bases.ball.filter.gate_arrays`.

``message`` (6): gyro [rad/s], accelerometer [m/s²]; ``given``: the one before; ``last``: the last one that counted.
"""

from __future__ import annotations

from enum import IntEnum

from wbmpc.bases.ball.compilation import step
from wbmpc.kernel.ir import Floats

#: A gyro or an accelerometer whose three numbers were the same to the bit so often in a row, and for so long [s], has stopped:
#: noise forbids it. (A few repeats are a unit that is slower than the encoders.)
REPEATS, STANDS = 10, 0.025
#: More than this [rad/s], [m/s²] from one message to the next is a jump: beyond hits that are true. (Pushes of 200 N: 0.07 and 8;
#: the ball runs onto cables of 5 mm: 0.24 and 70.)
TURN, PUSH = 1.0, 90.0
#: What the rates [rad/s] and forces [m/s²] of a message that does not count may differ by from those of the last good one.
UNKNOWN_TURN, UNKNOWN_PUSH = 1.0, 20.0
#: What :func:`judge` says of a message; who knows more than the unit's messages may call one that jumps wrong.
FINE, EXCEEDS, STOPPED, JUMPS = 0, 1, 2, 3
#: The same in words.
FAULTS = ("", "exceeds", "repeats", "jumps")


class Gate(IntEnum):
    """Entries of the array ``gate``: whether there was a message, and one that counted, whether the last one jumped; how often gyro and
    accelerometer said the same in a row, and for how long [s]; from what on they exceed their range."""

    GIVEN = 0
    COUNTED = 1
    JUMPED = 2
    SAME = 3
    DURATION = 5
    FULL = 7


@step
def judge(message: Floats, given: Floats, last: Floats, gate: Floats, h: float) -> tuple[int, bool, float, float]:
    """A message ``h`` [s] after the one before: what is wrong with it, whether it is farther from the last one that counted than a robot on
    its wheels can get it, and the squares of how far it is, of turning and of push."""
    exceeds, stands = False, False
    for k in range(2):
        same = gate[Gate.GIVEN] > 0.0
        for i in range(3 * k, 3 * k + 3):
            same = same and message[i] == given[i]
            exceeds = exceeds or abs(message[i]) >= gate[Gate.FULL + k]  # units that are at their end say just that
            given[i] = message[i]
        gate[Gate.SAME + k] = gate[Gate.SAME + k] + 1.0 if same else 0.0
        gate[Gate.DURATION + k] = gate[Gate.DURATION + k] + h if same else 0.0
        stands = stands or (gate[Gate.SAME + k] >= REPEATS and gate[Gate.DURATION + k] >= STANDS - 1e-9)
    gate[Gate.GIVEN] = 1.0
    jumps, turned, pushed = False, 0.0, 0.0
    for i in range(3):
        turn, push = message[i] - last[i], message[3 + i] - last[3 + i]
        jumps = jumps or abs(turn) > TURN or abs(push) > PUSH
        turned += turn * turn
        pushed += push * push
    return EXCEEDS if exceeds else STOPPED if stands else FINE, jumps and gate[Gate.COUNTED] > 0.0, turned, pushed
