"""A guess for the steering of a swerve base that is to move from rest.

At standstill the linearised rolling rows do not see the steering angles (their derivative is proportional to the speed):
a sideways goal with straight wheels is an exact stationary point. So, once, when the previewed motion begins while the
plan stands still, the trajectories start from rolling inverse kinematics: wheels turn first, then the base moves.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wbmpc import lie
from wbmpc.model import RobotModel, rolling_inverse_kinematics
from wbmpc.solver import Solver

#: Speeds [m/s] below which the guess is armed, above which it is armed again, and what counts as a previewed motion.
SLOW, FAST, MOVING = 0.02, 0.04, 0.005
#: Lever [m] that turns a yaw rate into a speed.
LEVER = 0.8

#: (times (n,) [s], pose (3)) -> body twists (n, 3) that the references ask for.
Preview = Callable[[np.ndarray, np.ndarray], np.ndarray]


def speed(twist: np.ndarray) -> np.ndarray:
    """A size [m/s] of body twists (..., 3)."""
    return np.asarray(np.hypot(twist[..., 0], twist[..., 1]) + LEVER * np.abs(twist[..., 2]))


class SteeringGuess:
    """Callable for :class:`wbmpc.mpc.MPC` (``guess=``)."""

    def __init__(self, robot: RobotModel, preview: Preview) -> None:
        self.robot, self.preview = robot, preview
        self.rate = float(np.min(robot.limits.input_upper[robot.input["steer"]])) * 0.6
        self._armed, self._done = True, False

    def __call__(self, solver: Solver, t: float, x0: np.ndarray) -> None:
        base = self.robot.input["base"]
        now = float(speed(solver.ws.u[0, base]))
        if now > FAST:
            self._armed, self._done = False, False
        elif now < SLOW:
            self._armed = True
        if not self._armed or self._done:
            return
        grid = solver.ws.grid
        twists = self.preview(t + grid, x0[self.robot.state["base"]])
        soon = speed(self.preview(t + np.array([0.0, 0.5, 1.0]), x0[self.robot.state["base"]]))
        if soon.max() < MOVING:
            return
        self._done = True
        self._write(solver, twists, x0)

    def _write(self, solver: Solver, twists: np.ndarray, x0: np.ndarray) -> None:
        state, given, geometry = self.robot.state, self.robot.input, self.robot.base.geometry
        grid, x, u = solver.ws.grid, solver.ws.x, solver.ws.u
        leg = x0[state["leg"]] if "leg" in state else np.zeros(geometry.modules)
        steer, pose = x0[state["steer"]].copy(), x0[state["base"]].copy()
        moving = np.flatnonzero(speed(twists) > MOVING)
        if not moving.size:
            return
        for k, h in enumerate(np.diff(grid)):
            # Where the reference rests, the wheels already turn to the motion that comes next (or stay after the last).
            later = moving[min(int(np.searchsorted(moving, k)), moving.size - 1)]
            wanted = twists[k] if k in moving else np.zeros(3)
            target, _ = rolling_inverse_kinematics(geometry, leg, steer, twists[later])
            rate = np.clip((target - steer) / h, -self.rate, self.rate)
            if np.abs(target - steer).max() > 0.03:
                wanted = np.zeros(3)
            x[k, state["base"]], x[k, state["steer"]] = pose, steer
            u[k, given["base"]], u[k, given["steer"]] = wanted, rate
            _, u[k, given["wheel"]] = rolling_inverse_kinematics(geometry, leg, steer, wanted)
            pose, steer = lie.se2_step(pose, wanted * h), steer + rate * h
        x[-1, state["base"]], x[-1, state["steer"]] = pose, steer
