"""Steering of a swerve base: which way round the wheels go, and a guess for a base that is to move from rest.

A wheel rolls along a direction in two ways, ψ and ψ + π, and the steering's range ends at about ±π: which way round is a
combinatorial choice that a local optimizer does not make. :func:`plan_steering` makes it by a dynamic program over
the previewed motion.

At standstill the linearized rolling rows do not see the steering angles (their derivative is proportional to the speed):
a sideways goal with straight wheels is an exact stationary point. So, once, when the previewed motion begins while the
plan stands still, the trajectories start from rolling inverse kinematics: wheels turn first, then the base moves.

On the way the same is done from where wheels of the plan stop following the preview (a range ends, or a wheel would have to
turn by more than it can): up to there the plan is kept, and the stop in which they turn about is written into it seconds
ahead. Legs move meanwhile as the plan moves them.

The preview knows nothing of obstacles. Rows push a plan out of what stands; what moves a plan evades in time, which is not found again once
it is overwritten. Where the preview meets something that moves, a plan that moves is left as it is; in one that rests only the wheels
turn.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from wbmpc import lie
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.rolling import Rolling
from wbmpc.model.robot import RobotModel
from wbmpc.model.wheels import ModuleGeometry
from wbmpc.solver import Trajectory

if TYPE_CHECKING:
    from wbmpc.mpc.mpc import MPC

#: A plan slower than this [m/s] stands: the guess from rest may be used.
STANDS = 0.02
#: … and within this time [s] is not faster than :data:`UNDER_WAY`: one that turns back passes through rest, and goes on.
STANDS_TIME = 0.3
#: A plan faster than this [m/s] is under way: the guess from rest may be used at its next stand. Twice as fast as one that stands, so that a
#: plan that creeps gets one guess.
UNDER_WAY = 0.04
#: A preview faster than this [m/s] asks for a motion.
MOVING = 0.005
#: Lever [m] that turns a yaw rate into a speed: about that of the wheels of a base with its legs spread.
LEVER = 0.8

#: (times (n,) [s], pose (3)) -> body twists (n, 3) that the references ask for.
Preview = Callable[[np.ndarray, np.ndarray], np.ndarray]


def speed(twist: np.ndarray) -> np.ndarray:
    """A size [m/s] of body twists (..., 3)."""
    return np.asarray(np.hypot(twist[..., 0], twist[..., 1]) + LEVER * np.abs(twist[..., 2]))


#: A wheel that rolls slower than this [m/s] may point anywhere.
ROLLS = 0.05
#: A wheel that points farther than this [rad] from its direction does not follow the preview.
MISALIGNED = 0.3
#: So long [s] it may be misaligned: longer than a turn takes.
MISALIGNED_TIME = 0.9
#: Interval [s] at which a plan is checked.
POLL_PERIOD = 0.1
#: A plan that was rewritten is not checked for so long [s]: the solver first adapts it.
REWRITE_PAUSE = 0.6
#: Cost [m] of a stop besides the way that it loses: no stop without a reason.
STOP = 1e-3
#: Of two equal ways the one that stops later is taken (cost [m] per node): more is known by then.
EARLY_STOP = 1e-7
#: Nodes of the programme, dense enough that between two of them a direction turns by less than a quarter turn: coarser ones mistake which
#: way round it went.
NODES = 100
#: A wheel that rolls turns on without a stop by up to this [rad] from one node of the horizon to the next.
ROLLING_TURN = 0.8
#: A base at rest moves off once its wheels are within this [rad] of their directions.
ALIGNED = 0.03


@dataclass(frozen=True)
class SteeringPlan:
    """Steering angles ``steer`` (k, n) [rad] at ``times`` (k,) [s]; ``stops``: indices of the nodes before which the base
    has to stand while wheels turn round."""

    times: np.ndarray
    steer: np.ndarray
    stops: tuple[int, ...]

    def nearest(self, t: float, steer: np.ndarray) -> np.ndarray:
        """``steer`` (n), or the same direction of each wheel the other way round, as the plan has it at time ``t`` [s]."""
        k = min(int(np.searchsorted(self.times, t - 1e-9)), len(self.times) - 1)
        return np.asarray(steer + np.pi * np.round((self.steer[k] - steer) / np.pi))


def plan_steering(
    geometry: ModuleGeometry, leg: np.ndarray, steer: np.ndarray, times: np.ndarray, twists: np.ndarray,
    limits: tuple[np.ndarray, np.ndarray], rate: float, swing: ArrayLike = 0.0,
) -> SteeringPlan:  # fmt: skip
    """The ways round that lose least of the motion's way: a dynamic program over the nodes at which the base may stop.

    ``leg`` (n, or k, n) [rad, or m of those that slide]; ``steer`` (n) [rad] now; body ``twists`` (k, 3) at ``times`` (k,); ``limits``:
    lower and upper (n) [rad]; ``rate`` [rad/s] of a turn; ``swing`` (k, n) [1/s]: rates of the legs. Between two stops a wheel's
    angle is continuous and inside of its limits. A stop costs the time of half a turn times the speed there, nothing while the
    base rests; all wheels may turn round at it.
    """
    ways, speeds = wheel_directions(geometry, leg, steer, twists, swing)
    speeds = speeds.max(axis=1)
    ways[0] = steer + _wrapped(ways[0] - steer)
    ways = np.unwrap(ways, axis=0, period=np.pi)
    cost = np.append(speeds[0], np.minimum(speeds[1:], speeds[:-1])) * np.pi / rate + STOP
    low, high = _rounds(ways, *limits)
    starts = _cheapest(cost, _reach(low, high), _first(np.any((low > 0) | (high < 0), axis=1)))
    steered, stops, shift = np.empty_like(ways), [], np.zeros(geometry.modules)
    for j, k in zip(starts, [*starts[1:], len(times)], strict=True):
        # as few turns as possible; where the range is too small for a direction, the end is left to the limits
        minimum, maximum = low[j:k].max(axis=0), high[j:k].min(axis=0)
        previous, shift = shift, np.clip(shift, minimum, np.maximum(maximum, minimum))
        steered[j:k] = ways[j:k] + np.pi * shift
        if (shift != previous).any() and cost[j] > STOP:
            stops.append(j)
    return SteeringPlan(times, steered, tuple(stops))


def _wrapped(angle: np.ndarray) -> np.ndarray:
    """Within ±π/2, by half turns."""
    return np.asarray((angle + 0.5 * np.pi) % np.pi - 0.5 * np.pi)


def _rounds(ways: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest number (k, n) of half turns that keep each wheel in its range at each node."""
    return np.ceil((lower - ways) / np.pi - 1e-9), np.floor((upper - ways) / np.pi + 1e-9)


def _first(flags: np.ndarray) -> int:
    """Index of the first true one of ``flags`` (k), or k."""
    return int(np.argmax(flags)) if flags.any() else len(flags)


def _reach(low: np.ndarray, high: np.ndarray) -> list[int]:
    """From each node the first one (k) up to which no numbers of half turns, one for each wheel, are good for all nodes between."""
    count = len(low)
    # no more half turns than a range asks for: none at all where it has no end
    turns = np.arange(min(high.min(), 0.0), max(low.max(), 0.0) + 1.0)
    good = (low[:, :, None] <= turns) & (turns <= high[:, :, None])
    ends = np.where(good, count, np.arange(count)[:, None, None])
    ends = np.minimum.accumulate(ends[::-1], axis=0)[::-1]
    reach: list[int] = ends.max(axis=2, initial=0).min(axis=1).tolist()
    return reach


def _cheapest(costs: np.ndarray, reach: list[int], kept: int) -> list[int]:
    """First nodes of the parts into which stops of ``costs`` (k) divide the way: shortest path over the nodes.

    ``reach`` (k): where a part from each node ends at the latest; ``kept``: the same from the start on without a stop before
    it. Parts that can still reach on are a queue of rising cost: what comes later and is cheaper makes all before it useless.
    """
    cost: list[float] = costs.tolist()
    count = len(cost)
    if kept == count:
        return [0]
    source = [0] * (count + 1)
    starts, queue, best = [0.0] * count, deque[tuple[float, int]](), 0.0
    for k in range(count):
        start = best + cost[k]
        value = start - EARLY_STOP * k
        while queue and queue[-1][0] > value:
            queue.pop()
        queue.append((value, k))
        starts[k] = start
        if k < kept:
            continue
        # a part of one node is always possible: there may be no better way where the range is too small
        while queue[0][1] < k and reach[queue[0][1]] <= k:
            queue.popleft()
        source[k + 1] = queue[0][1]
        best = starts[source[k + 1]]
    parts = [source[count]]
    while parts[-1] > 0:
        parts.append(source[parts[-1]])
    return parts[::-1]


def wheel_directions(
    geometry: ModuleGeometry, leg: np.ndarray, steer: np.ndarray, twists: np.ndarray, swing: ArrayLike = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Steering angles (k, n) of the wheels' directions, and their speeds (k, n) [m/s], 0 where they rest, for legs at ``leg`` (n, or k, n)
    with rates ``swing`` (k, n). A wheel that rests already has the direction that comes next (or keeps its last)."""
    s = geometry.steer_axes(leg)
    own = geometry.leg_motions(leg, s) * geometry.leg_positions(swing)[..., None]
    vx = twists[:, :1] - twists[:, 2:] * s[..., 1] + own[..., 0]
    vy = twists[:, 1:2] + twists[:, 2:] * s[..., 0] + own[..., 1]
    speeds = np.hypot(vx, vy)
    angle = np.arctan2(vy, vx) - geometry.wheel_heading - geometry.leg_angles(leg)
    count, moving = len(twists), speeds > MOVING
    index = np.where(moving, np.arange(count)[:, None], count)
    later = np.minimum.accumulate(index[::-1], axis=0)[::-1]
    earlier = np.maximum.accumulate(np.where(moving, index, -1), axis=0)
    source = np.where(later < count, later, earlier)
    angle = np.where(source >= 0, np.take_along_axis(angle, np.maximum(source, 0), axis=0), steer)
    return angle, np.where(moving, speeds, 0.0)


class SteeringGuess:
    """Callable for :class:`wbmpc.mpc.mpc.MPC` (``guess=``)."""

    def __init__(self, robot: RobotModel, preview: Preview) -> None:
        self.robot, self.preview = robot, preview
        steer = robot.state["steer"]
        self.rate = float(np.min(robot.limits.input_upper[robot.input["steer"]])) * 0.6
        self.limits = (robot.limits.state_lower[steer], robot.limits.state_upper[steer])
        self._armed, self._done = True, False
        self._next_check = -np.inf
        self._mpc: MPC | None = None
        self._rolling = Rolling(swerve_base(robot).geometry)

    def bind(self, mpc: MPC) -> None:
        """Whose moving obstacles the guess keeps clear of."""
        self._mpc = mpc

    def __call__(self, t: float, x0: np.ndarray, trajectory: Trajectory) -> Trajectory | None:
        base = self.robot.input["base"]
        speeds = speed(trajectory.u[trajectory.grid[:-1] < STANDS_TIME, base])
        if speeds[0] > UNDER_WAY:
            self._armed, self._done = False, False
        elif speeds[0] < STANDS:
            self._armed = bool(speeds.max() <= UNDER_WAY)
        if not self._armed or self._done:
            return self._continue_plan(trajectory, t, x0)
        grid = trajectory.grid
        twists = self.preview(t + grid, x0[self.robot.state["base"]])
        soon = speed(self.preview(t + np.array([0.0, 0.5, 1.0]), x0[self.robot.state["base"]]))
        if soon.max() < MOVING or not self._stuck(trajectory, twists):
            return None
        self._done, self._next_check = True, t + REWRITE_PAUSE
        plan = self.plan(t, float(grid[-1]), x0, trajectory)
        found = self._written(trajectory, twists, x0, plan)
        if self._is_clear(t, found):
            return found
        if speed(trajectory.u[:, base]).max() > UNDER_WAY:  # the plan has its own way
            return None
        return self._written(trajectory, twists, x0, plan, rests=True)

    def _is_clear(self, t: float, trajectory: Trajectory) -> bool:
        """Whether trajectories from ``t`` [s] on keep clear of what moves."""
        return self._mpc is None or self._mpc.evades(t + trajectory.grid, trajectory.x)

    def _stuck(self, trajectory: Trajectory, twists: np.ndarray) -> bool:
        """Whether a base at rest needs a plan from inverse kinematics for ``twists`` (N + 1, 3)."""
        return True

    def _continue_plan(self, trajectory: Trajectory, t: float, x0: np.ndarray) -> Trajectory | None:
        """Where wheels of the plan stop following the preview, as at the end of their range, the plan with a stop written into the rest
        of it; else None."""
        if t < self._next_check:
            return None
        self._next_check = t + POLL_PERIOD
        grid = trajectory.grid
        twists = self.preview(t + grid, x0[self.robot.state["base"]])
        lost = self._lost(trajectory, twists, x0)
        if lost is None:
            return None
        plan = self.plan(t, float(grid[-1]), x0, trajectory)
        stop = int(np.searchsorted(grid, plan.times[plan.stops[0]])) if plan.stops else lost
        found = self._written(trajectory, twists, x0, plan, max(min(stop, lost) - 1, 0))
        if not self._is_clear(t, found):
            return None
        self._next_check = t + REWRITE_PAUSE
        return found

    def _lost(self, trajectory: Trajectory, twists: np.ndarray, x0: np.ndarray) -> int | None:
        """First node from which on a wheel of the plan points elsewhere than the preview's ``twists`` ask for."""
        grid, steer = trajectory.grid, x0[self.robot.state["steer"]]
        leg, swing = self._legs(trajectory, grid)
        ways, speeds = wheel_directions(swerve_base(self.robot).geometry, leg, steer, twists, swing)
        off = np.abs(_wrapped(ways - trajectory.x[:, self.robot.state["steer"]])) > MISALIGNED
        off &= speeds > ROLLS
        since = np.full(off.shape[1], np.nan)
        for k, now in enumerate(off):
            since = np.where(now, np.where(np.isnan(since), grid[k], since), np.nan)
            if np.any(grid[k] - since >= MISALIGNED_TIME):
                return int(np.searchsorted(grid, np.nanmin(since)))
        return None

    def plan(self, t: float, horizon: float, x0: np.ndarray, trajectory: Trajectory) -> SteeringPlan:
        """Which way round the wheels go over a horizon [s] of the preview, with legs as in ``trajectory``; times from ``t`` on."""
        times, steer = np.linspace(0.0, horizon, NODES), x0[self.robot.state["steer"]].copy()
        twists = self.preview(t + times, x0[self.robot.state["base"]])
        leg, swing = self._legs(trajectory, times)
        return plan_steering(swerve_base(self.robot).geometry, leg, steer, times, twists, self.limits, self.rate, swing)

    def _legs(self, trajectory: Trajectory, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Angles and rates (k, n) of the legs in a plan at ``times`` (k) [s] after its start."""
        state, inputs = self.robot.state, self.robot.input
        if "leg" not in state:
            still = np.zeros((len(times), swerve_base(self.robot).geometry.modules))
            return still, still
        grid = trajectory.grid
        k = np.clip(np.searchsorted(grid, times, side="right") - 1, 0, len(grid) - 2)
        rates = trajectory.u[k, inputs["leg"]]
        return trajectory.x[k, state["leg"]] + rates * (times - grid[k])[:, None], rates

    def _written(
        self, trajectory: Trajectory, twists: np.ndarray, x0: np.ndarray, plan: SteeringPlan, start: int = 0,
        rests: bool = False,
    ) -> Trajectory:  # fmt: skip
        """Trajectories from node ``start`` on by rolling inverse kinematics, the wheels as in ``plan``; ``rests``: all but the wheels."""
        state, inputs = self.robot.state, self.robot.input
        grid, x, u = trajectory.grid, trajectory.x.copy(), trajectory.u.copy()
        found = replace(trajectory, x=x, u=u)
        legs, swings = self._legs(trajectory, grid)
        leg, steer, pose = legs[start], x0[state["steer"]].copy(), x0[state["base"]].copy()
        if start > 0:
            pose, steer = x[start, state["base"]].copy(), x[start, state["steer"]].copy()
        rolling, moving = start > 0, np.flatnonzero(speed(twists) > MOVING)
        if not moving.size:
            return found
        for k, h in enumerate(np.diff(grid)[start:], start):
            # Where the reference rests, the wheels already turn to the motion that comes next (or stay after the last).
            later = moving[min(int(np.searchsorted(moving, k)), moving.size - 1)]
            desired = twists[k] if k in moving else np.zeros(3)
            target, _ = self._rolling(leg, steer, twists[later], swings[later])
            target = plan.nearest(grid[later], target)
            rate = np.clip((target - steer) / h, -self.rate, self.rate)
            # from rest the wheels come first; a wheel of a base that rolls turns on unless it has to turn round
            rolling = bool(np.abs(target - steer).max() <= (ROLLING_TURN if rolling else ALIGNED))
            moves = rolling and not rests
            swing = swings[k] if moves else np.zeros(leg.size)
            if not moves:
                desired = np.zeros(3)
            x[k, state["base"]], x[k, state["steer"]] = pose, steer
            u[k, inputs["base"]], u[k, inputs["steer"]] = desired, rate
            _, u[k, inputs["wheel"]] = self._rolling(leg, steer, desired, swing)
            if "leg" in state:
                x[k, state["leg"]], u[k, inputs["leg"]] = leg, swing
            pose, steer, leg = lie.se2_step(pose, desired * h), steer + rate * h, leg + swing * h
        x[-1, state["base"]], x[-1, state["steer"]] = pose, steer
        if "leg" in state:
            x[-1, state["leg"]] = leg
        return found
