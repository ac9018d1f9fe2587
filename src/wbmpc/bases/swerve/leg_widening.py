"""Legs that stand wider where the arm pulls: a stance is searched in which the zero-moment point stays well within the support.

The margin is that of the zero-moment point at rest, under the robot's weight, the weight that the end effector carries and what pushes it, as
the plan's constraints "stability" have them. A weight off the side of the body asks for other legs than one ahead of it, so the stance is
searched for the postures of the plan. Where home has been enough for a while the legs go back.
"""

from __future__ import annotations

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.bases.swerve.brake_control import reject_floating_way
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.constants import GRAVITY
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp.base_residuals import SupportMargin, WheelLoads
from wbmpc.stability import StanceOf
from wbmpc.stability.stances import beyond, climbed

#: Shares of the margin at home: another stance is searched below the first; of its way as much is gone as gives the second.
TOO_LITTLE, ENOUGH = 0.75, 0.9
#: Places of each leg that are tried in its range; rounds over all legs; shares of the way to the stance that was found.
PLACES, ROUNDS, SHARES = 15, 4, np.linspace(0.1, 1.0, 10)
#: What a meter beyond a limit, and a leg that goes all of its range, count against a meter of margin.
PASSED, AWAY = 20.0, 0.02
#: Postures of the plan that count, evenly over its horizon.
POSTURES = 6
#: Where no better stance was found, none is searched for so long [s]; for so long home has to be enough before legs go back.
PAUSE, BACK_AFTER = 2.0, 5.0


def knows_load(mpc: MPC) -> bool:
    """Whether plans know what the end effector carries: a user's constraint may be called "stability", too."""
    rows = mpc.ocp.terms.get("stability")
    return isinstance(getattr(rows, "residual", None), WheelLoads | SupportMargin)


class LegWidening:
    """How far the legs of a robot are to stand from their home for what its ``mpc`` plans; they turn with ``rate`` [per s]."""

    def __init__(self, robot: RobotModel, mpc: MPC, rate: float) -> None:
        self._robot, self._mpc, self._rate = robot, mpc, rate
        self._stance, self._leg = StanceOf(robot), robot.state["leg"]
        self._home = robot.home[self._leg]
        limits = robot.limits
        self._range = limits.state_lower[self._leg], limits.state_upper[self._leg]
        self._least = self._stance(robot.home).polygon_margin
        self._knows_load = knows_load(mpc)
        zero = np.zeros(self._home.size)
        self._from, self._to, self._begin, self._pause = zero, zero, -np.inf, -np.inf
        self._too_little = 0.0  # when [s] home was not enough last

    @property
    def moved(self) -> bool:
        """Whether the legs were moved from where they are asked to be."""
        return bool(self._to.any() or self._from.any())

    def offset(self, times: Array) -> Array:
        """What is added (k, n) [rad, or m of legs that slide] to where the legs are asked to be at ``times`` (k) [s]."""
        way = self._to - self._from
        longest = float(np.abs(way).max(initial=0.0))
        gone = np.clip((np.asarray(times) - self._begin) * self._rate / max(longest, 1e-9), 0.0, 1.0)
        return np.asarray(self._from + gone[:, None] * way)

    def look(self, t: float, begin: float) -> None:
        """Search another stance at ``t`` [s] if the plan's postures ask for one: legs set out for it at ``begin`` [s]."""
        arrived = np.array([max(t, self._begin + float(np.abs(self._to - self._from).max(initial=0.0)) / self._rate)])
        if not self._least > 0.0 or arrived[0] > t or t < self._pause:
            return
        postures, loads = self._planned(t)
        self._from = self._to
        now = self._home + self._to
        if self._margin(postures, loads, self._home) < ENOUGH * self._least:
            self._too_little = t
        elif self.moved and t - self._too_little > BACK_AFTER and not self._floats(now, self._home):
            self._to, self._begin = np.zeros(self._home.size), begin
            return
        if self._margin(postures, loads, now) >= TOO_LITTLE * self._least:
            return
        best = self._searched(postures, loads, now)
        ways = [now + share * (best - now) for share in SHARES]
        goal = next((w for w in ways if self._margin(postures, loads, w) >= ENOUGH * self._least), best)
        if np.abs(goal - now).max() < 1e-6 or self._floats(now, goal):
            self._pause = t + PAUSE
            return
        self._to, self._begin = goal - self._home, begin

    def _planned(self, t: float) -> tuple[Array, Array]:
        """Postures (k, nx) of the plan, with what acts on the end effector in them (k, 6): force [N] and moment [N m] of the world."""
        plan = self._mpc.solver.trajectory(copy=False)
        nodes = np.unique(np.linspace(0, len(plan.x) - 1, POSTURES).astype(int))
        postures, loads = plan.x[nodes, : self._robot.state.size].copy(), np.zeros((len(nodes), 6))
        if not self._knows_load:
            return postures, loads
        for k, x, load in zip(nodes, postures, loads, strict=True):
            row = self._mpc.reference["stability"].at(t + float(plan.grid[k]))
            load[:] = row[:6]
            if row.size > 6:
                weight, turn = np.array([0.0, 0.0, -row[6] * GRAVITY]), self._robot.pose(x, self._robot.tool)[1]
                load[:3] += weight
                load[3:] += np.cross(lie.quaternion_to_rotation(turn) @ row[7:10], weight)
        return postures, loads

    def _margin(self, postures: Array, loads: Array, legs: Array) -> float:
        """Least margin [m] of the support of all postures with ``legs`` (n)."""
        postures[:, self._leg] = legs
        return min(self._stance(x, load).polygon_margin for x, load in zip(postures, loads, strict=True))

    def _searched(self, postures: Array, loads: Array, start: Array) -> Array:
        """The legs (n) where no other place of a single leg is better: by coordinate ascent."""
        lower, upper = (np.clip(v, -np.pi, np.pi) for v in self._range)
        geometry = swerve_base(self._robot).geometry

        def score(legs: Array) -> float:
            away = float(np.mean(np.abs(legs - self._home) / (upper - lower)))
            return self._margin(postures, loads, legs) - PASSED * beyond(geometry, legs) - AWAY * away

        return climbed(score, start, lower, upper, PLACES, ROUNDS)

    def _floats(self, legs: Array, goal: Array) -> bool:
        """Whether the base would be held by nothing on the way, brakes open."""
        geometry = swerve_base(self._robot).geometry
        try:
            reject_floating_way(geometry, legs, goal, np.ones(legs.size), np.full(legs.size, self._rate))
        except InputError:
            return True
        return False
