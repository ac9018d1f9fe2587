"""What the end effector carries, weighed by the torques of the arm's drives.

Drives that hold an arm still in a base that feels the acceleration a (9.81 m/s² upwards at rest) give the torques
τ = ∂/∂q Σ mᵢ aᵀ pᵢ(q) over the links' centers of mass p, and for a mass m at the end effector m ∂/∂q aᵀ p_c(q) more: by virtual work.
What the drives report less the model's own share determines m, by least squares over the joints.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.checks import finite, not_negative, numbers
from wbmpc.errors import InputError
from wbmpc.model.kinematics import Chain, constant
from wbmpc.model.robot import RobotModel

_WHO = "payload estimator"
#: Time [s] between two weighings; largest speed of a joint [rad/s or m/s] and of the base's turn [rad/s] of a robot that is weighed: beyond
#: them the arm's own inertia counts.
INTERVAL, STILL, TURNS = 0.02, 0.1, 0.2
#: Standard deviation of what a drive reports less what the model says, over its limit: torque constants, friction, masses of links.
SPREAD = 0.02
#: Time [s] after which old weighings count 1/e; standard deviation [kg] beyond which one says nothing.
MEMORY, SURE = 0.3, 2.0


class ArmScale:
    """Mass [kg] at the ``center`` (3) [m] in the end effector's axes of a robot whose arm's drives report their torques.

    ``mass`` is ``known`` until the arm has been still for long enough, and is kept while it moves, or where it stands so that its drives do
    not feel a mass (an end effector above its shoulder). Raises :class:`InputError` for an arm of which a limit of torque is missing.
    """

    def __init__(self, robot: RobotModel, center: ArrayLike = (0.0, 0.0, 0.0), known: float = 0.0) -> None:
        not_negative(_WHO, known=known)
        names = robot.state.groups["arm"]
        efforts = robot.description.limits.effort
        missing = [name for name in names if not 0.0 < efforts.get(name, 0.0) < np.inf]
        if missing:
            raise InputError(
                f"{robot.description.name}: weighing a payload needs limits of torque ('limits.effort', or of the URDF) of all "
                f"joints of the arm; missing: {', '.join(missing)}"
            )
        self.mass = float(known)
        self._center = numbers(_WHO, "center", center, 3)
        self._weights = 1.0 / (SPREAD * np.array([efforts[name] for name in names])) ** 2
        self._torques = _holding_torques(robot, self._center)
        self._start, self._arm = robot.home.copy(), robot.state["arm"]
        self._last: tuple[float, Array] | None = None
        self._information, self._seen = 0.0, 0.0

    @property
    def deviation(self) -> float:
        """Standard deviation [kg] of the mass; infinite before anything was weighed."""
        return float(1.0 / np.sqrt(self._information)) if self._information > 0.0 else np.inf

    def update(self, t: float, arm: Array, effort: Array, accel: Array, gyro: Array) -> bool:
        """Take in measurements at time t [s]: positions (m) of the arm's joints, their drives' torques (m) [N m or N], acceleration (3)
        [m/s²] and rates (3) [rad/s] of the inertial unit in axes of the base. Without torques (0) nothing is weighed. Returns whether the
        mass may have changed. Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be; nothing is taken in then."""
        finite(_WHO, t=t)
        m = self._weights.size
        arm, effort = numbers(_WHO, "arm", arm, m), numbers(_WHO, "effort", effort, m if np.size(effort) else 0)
        accel, gyro = numbers(_WHO, "accel", accel, 3), numbers(_WHO, "gyro", gyro, 3)
        if self._last is None or t < self._last[0]:
            self._last = (t, arm)
            return False
        h = t - self._last[0]
        if h < INTERVAL - 1e-9:
            return False
        speed = float(np.abs(arm - self._last[1]).max()) / h
        self._last = (t, arm)
        if speed > STILL or float(np.abs(gyro).max()) > TURNS or not effort.size:
            return False
        return self._weigh(arm, effort, accel, min(h, MEMORY))

    def _weigh(self, arm: Array, effort: Array, accel: Array, h: float) -> bool:
        """One weighing of a still arm, ``h`` [s] after the one before."""
        self._start[self._arm] = arm
        own, each = (np.asarray(part).ravel() for part in self._torques(self._start, accel))
        pull = self._weights * each
        information = float(pull @ each)
        if information * SURE**2 < 1.0:
            return False
        kept = float(np.exp(-h / MEMORY))
        self._information = kept * self._information + (1.0 - kept) * information
        self._seen = kept * self._seen + (1.0 - kept) * float(pull @ (effort - own))
        self.mass = max(self._seen / self._information, 0.0)
        return True


def _holding_torques(robot: RobotModel, center: Array) -> ca.Function:
    """Function (x, a) -> torques (m) of the arm's drives that hold the links, and those of 1 kg at ``center``, in a base that feels the
    acceleration a (3) [m/s²] in its own axes."""
    x, a = ca.SX.sym("x", robot.state.size), ca.SX.sym("a", 3)
    whole = robot.base.chain(x)
    chain = Chain(whole.links, {i: whole.values[i] for i in whole.moving})
    links = ca.SX(0)
    for i, link in enumerate(chain.links):
        if link.mass > 0.0:
            position, turn = chain.link_place(i)
            links += link.mass * ca.dot(a, position + turn @ constant(link.com))
    position, turn = chain.frame_place(robot.tree.frames[robot.tool])
    held = ca.dot(a, position + turn @ constant(center))
    arm = x[robot.state["arm"].start : robot.state["arm"].stop]
    return ca.Function("holding", [x, a], [ca.densify(ca.gradient(v, arm)) for v in (links, held)])
