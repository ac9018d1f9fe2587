"""What an arm's drives and encoders do in every physics step, compiled: see :class:`wbmpc.simulation.arm.ArmPlant`."""

from __future__ import annotations

from wbmpc.kernel.ir import Floats, Integers
from wbmpc.simulation.compilation import step


@step
def carry(m: int, dofs: Integers, qfrc_bias: Floats, qfrc_applied: Floats) -> None:
    """Feed the weight of the m joints whose velocities are at ``dofs`` forward to them [N m]."""
    for i in range(m):
        qfrc_applied[dofs[i]] = qfrc_bias[dofs[i]]


@step
def keep(
    n: int, rows: int, felt: int, places: Integers, qpos: Floats, history: Floats, newest: Integers, sensors: Integers,
    sensordata: Floats, sums: Floats,
) -> None:  # fmt: skip
    """The positions of n joints at ``places`` become the newest of the last ``rows`` ones, a ring: ``newest`` (2) is the number of its row,
    and how many are kept. What the ``sensors`` (felt) show goes to ``sums`` (felt + 1), whose last entry counts."""
    newest[0] = (newest[0] + 1) % rows
    newest[1] = min(newest[1] + 1, rows)
    for i in range(n):
        history[newest[0] * n + i] = qpos[places[i]]
    for i in range(felt):
        sums[i] += sensordata[sensors[i]]
    sums[felt] += 1.0
