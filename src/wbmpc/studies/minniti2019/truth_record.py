"""What is recorded of a simulated ball robot at every tick, compiled into one call: see :class:`TruthRecord`.

Positions ``q`` and velocities ``v`` are MuJoCo's; m joints of the arm are at ``arm_q`` and ``arm_v`` in them. Rotations are (3, 3) by rows.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.ball.compilation import LIBRARY as BALL
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.ball.sensor_step import minimal_state
from wbmpc.kernel.ir import Floats, Integers
from wbmpc.kernel.library import Library
from wbmpc.kernel.step import bind
from wbmpc.log import Log, Rows
from wbmpc.simulation.compilation import LIBRARY as SIMULATION
from wbmpc.simulation.scene import from_base

#: Apart from the controller's steps, which need nothing of the simulator.
LIBRARY = Library(
    "record of the ball robot", packages=("bases/ball", "simulation", "kernel", "studies/minniti2019/truth_record.py"), modules=(__name__,),
    uses=(BALL, SIMULATION),
)  # fmt: skip
compiled, step = LIBRARY.compiled, LIBRARY.step
TURN = 2.0 * np.pi


@compiled
def quaternion_of(r: Floats, q: Floats) -> None:
    """Unit quaternion ``q`` (4) of the rotation ``r``, its scalar part not negative (Shepperd's method)."""
    a, e, i = r[0], r[4], r[8]
    trace = a + e + i
    largest = max(max(trace, a), max(e, i))
    if trace == largest:
        q[0], q[1], q[2], q[3] = 1.0 + trace, r[7] - r[5], r[2] - r[6], r[3] - r[1]
    elif a == largest:
        q[0], q[1], q[2], q[3] = r[7] - r[5], 1.0 + a - e - i, r[3] + r[1], r[6] + r[2]
    elif e == largest:
        q[0], q[1], q[2], q[3] = r[2] - r[6], r[1] + r[3], 1.0 + e - i - a, r[7] + r[5]
    else:
        q[0], q[1], q[2], q[3] = r[3] - r[1], r[2] + r[6], r[5] + r[7], 1.0 + i - a - e
    length = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    if q[0] < 0.0:
        length = -length
    for k in range(4):
        q[k] = q[k] / length


class Frames(NamedTuple):
    """Where base and end effector are in the simulated world."""

    base: Floats  # (3) [m]
    rotation: Floats  # (3, 3)
    tool: Floats  # (3) [m]
    tool_rotation: Floats  # (3, 3)


class Recorded(NamedTuple):
    """What is recorded: see :func:`truth`."""

    state: Floats
    hand: Floats
    hand_quaternion: Floats
    tilt: Floats
    seen: Floats
    turned: Floats


@step
def truth(
    m: int,
    height: float,
    q: Floats,
    v: Floats,
    arm_q: Integers,
    arm_v: Integers,
    at: Frames,
    found: Recorded,
    yaw_before: float,
) -> None:
    """``state`` in minimal coordinates, its yaw nearest to ``yaw_before`` [rad]; the end effector, ``hand`` (3) [m] ``height`` below the
    world's, and ``hand_quaternion`` (4), and as it is ``seen`` and ``turned`` from the base, whose ``tilt`` (1) [rad] is that of its
    z axis from the vertical."""
    state, hand, tilt, tool = found.state, found.hand, found.tilt, at.tool
    minimal_state(m, q, v, arm_q, arm_v, state)
    state[2] += TURN * np.floor((yaw_before - state[2]) / TURN + 0.5)
    w, x, y, z = q[3], q[4], q[5], q[6]
    tilt[0] = 2.0 * np.arcsin(min(np.sqrt((x * x + y * y) / (w * w + x * x + y * y + z * z)), 1.0))
    from_base(at.base, at.rotation, tool, at.tool_rotation, found.seen, found.turned)
    hand[0], hand[1], hand[2] = tool[0], tool[1], tool[2] - height
    quaternion_of(at.tool_rotation, found.hand_quaternion)


@step
def estimated(
    estimate: Floats, seen: Floats, turned: Floats, believed: Floats, product: Floats, hand_estimated: Floats,
    hand_quaternion_estimated: Floats,
) -> None:  # fmt: skip
    """The end effector (3) [m] and its quaternion (4) that is ``seen`` and ``turned`` like that from the base of a state ``estimate``;
    ``believed``, ``product``: room for rotations."""
    sy, cy = np.sin(estimate[2]), np.cos(estimate[2])
    sp, cp = np.sin(estimate[3]), np.cos(estimate[3])
    sr, cr = np.sin(estimate[4]), np.cos(estimate[4])
    r = believed
    r[0], r[1], r[2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    r[3], r[4], r[5] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    r[6], r[7], r[8] = -sp, cp * sr, cp * cr
    for i in range(3):
        hand_estimated[i] = 0.0
        if i < 2:
            hand_estimated[i] = estimate[i]
        for j in range(3):
            hand_estimated[i] += r[3 * i + j] * seen[j]
            product[3 * i + j] = 0.0
            for k in range(3):
                product[3 * i + j] += r[3 * i + k] * turned[3 * k + j]
    quaternion_of(product, hand_quaternion_estimated)


class TruthRecord:
    """Writes what a ``plant`` really does, and where its end effector is for an estimated state, into a ``log``: channels "state" (nx),
    "hand" (3) [m], "hand_quaternion" (4), "tilt" [rad]; where there is an estimator "estimate" (nx), "hand_estimated",
    "hand_quaternion_estimated"; and ``others``, channels by their width (None: one number), which are given with each row."""

    def __init__(
        self, log: Log, plant: BallPlant, others: Mapping[str, int | None], estimator: bool,
    ) -> None:  # fmt: skip
        self._plant, nx = plant, 10 + 2 * len(plant.description.arm.joints)
        widths: dict[str, int | None] = {"state": nx, "hand": 3, "hand_quaternion": 4, "tilt": None}
        if estimator:
            widths |= {"estimate": nx, "hand_estimated": 3, "hand_quaternion_estimated": 4}
        self._rows: Rows = log.together({**widths, **others})
        self.values = self._rows.values
        room = {"seen": np.zeros(3)} | {name: np.zeros(9) for name in ("turned", "believed", "product")}
        own = self.values | room | plant.memory
        self._truth = bind(truth, own, m=len(plant.description.arm.joints), height=plant.base.ball_radius)
        self._estimated = bind(estimated, own) if estimator else None

    def add(self, t: float, estimate: Array | None = None) -> None:
        """A row at time t [s] of the present; the others' :attr:`values` have been written. ``estimate`` (nx): what an estimator believes."""
        world = self._plant.world
        world.refresh()
        self._truth(world.counted_yaw)
        if self._estimated is not None:
            self.values["estimate"][:] = estimate
            self._estimated()
        self._rows.add(t)
