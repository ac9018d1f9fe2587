"""Wheels of a swerve base that turn about, one after another, while the base goes on.

A wheel at the end of its steering range has to go half a turn back and roll on the other way round. While it turns it cannot roll
where the base goes. Either the base stops (:mod:`wbmpc.bases.swerve.steering_planner`), which costs the way of a turn, or the wheel slips sideways
and the others carry the base on. Here the row of its side slip is lifted for the turn (``allow_side_slip`` of
:class:`wbmpc.ocp.residuals.Rolling`), and the turn is written into the plan, seconds ahead, where the wheel slips least: at
best while the base rests. The base's own plan stays as it is, so that the solver takes what is written at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.steering_planner import (
    NODES,
    POLL_PERIOD,
    ROLLS,
    Preview,
    SteeringGuess,
    SteeringPlan,
    speed,
    wheel_directions,
)
from wbmpc.model.robot import RobotModel
from wbmpc.model.wheels import wheel_velocities
from wbmpc.ocp import Reference
from wbmpc.solver import Trajectory

if TYPE_CHECKING:
    from wbmpc.mpc.mpc import MPC
    from wbmpc.mpc.references import References

#: Length of a turn [s] and of its ramps: speed and acceleration stay below those of the drives.
TURN, RAMP = 0.8, 0.12
#: How long before it [s] a turn is written at least: commands may change by little at once. Reserve [rad] of the range: plans turn
#: wheels by a little more than the preview asks for.
AHEAD, RESERVE = 0.2, 0.05
#: Share of the horizon in which turns are looked for (the end of a plan is still coming about); time [s] after a turn from which on
#: the plan shows which way round the wheel went.
SEEN, SETTLED = 0.8, 0.3
#: Costs [m] of a turn that overlaps another wheel's (two that slip leave little to hold the base by), of one that is too fast
#: together with the direction's own, and [m/s] of one that comes sooner than it has to. Slip [m] from which on the first two count.
TOGETHER, HURRY, EARLY, SLIPS = 1.0, 1.0, 1e-4, 1e-3
#: Edges of turns that the reference of the rolling rows has room for; a time [s] that never comes.
EDGES, NEVER = 32, 1e4
#: Time [s] for which a turn is remembered after its end.
PAST = 0.1
#: A plan this much [rad] behind the reserve of a wheel's range has let its limit give way.
BEYOND = 0.15


@dataclass(frozen=True)
class Turn:
    """``wheel`` turns by ``by`` [rad], half a turn, from ``start`` [s] on."""

    wheel: int
    start: float
    by: float

    @property
    def end(self) -> float:
        """[s]."""
        return self.start + TURN

    def share(self, t: np.ndarray) -> np.ndarray:
        """Which share of the turn is done at times ``t`` (k) [s]: constant speed between two ramps."""
        s, top = np.clip(t - self.start, 0.0, TURN), 1.0 / (TURN - RAMP)
        rising = 0.5 * top / RAMP * np.minimum(s, RAMP) ** 2
        falling = 0.5 * top / RAMP * np.maximum(s - (TURN - RAMP), 0.0) ** 2
        return np.asarray(rising + top * np.maximum(s - RAMP, 0.0) - falling)


def plan_turns(
    times: np.ndarray,
    way: np.ndarray,
    speeds: np.ndarray,
    limits: tuple[float, float],
    rate: float,
    earliest: float,
    busy: np.ndarray,
) -> list[tuple[float, float]]:
    """When [s] and by how much [rad] a wheel turns about, so that it slips least and stays in its range.

    Its direction ``way`` (k) [rad], continuous, and its speed (k) [m/s] at ``times`` (k) [s]; ``limits`` [rad]; ``rate`` [rad/s]
    that it can turn by; ``earliest`` [s]: no turn before; ``busy`` (k): a turn from there on overlaps another wheel's. A range that
    ends sooner than a wheel can turn about is left at the first moment at which it can.
    """
    turns: list[tuple[float, float]] = []
    path, first = way.copy(), 0
    cost = _costs(times, way, speeds, rate, busy)
    while True:
        # where the other way round is outside too, a turn would not help
        half = np.where(path[first:] > limits[1], -np.pi, np.pi)
        beyond = np.flatnonzero(_outside(path[first:], limits) & ~_outside(path[first:] + half, limits))
        if not beyond.size:
            return turns
        end, by = first + int(beyond[0]), float(half[beyond[0]])
        # from where on the other way round is good up to the end of this one
        outside = np.flatnonzero(_outside(path[: end + 1] + by, limits))
        begin = max(int(outside[-1]) + 1 if outside.size else 0, int(np.searchsorted(times, earliest)))
        chosen = min(begin, len(times) - 1)
        if begin < end:
            chosen = begin + int(np.argmin(cost(np.sign(by))[begin : end + 1]))
        turns.append((float(times[chosen]), by))
        path[chosen:] += by
        earliest = float(times[chosen]) + TURN
        first = max(int(np.searchsorted(times, earliest)), end)


def _outside(path: np.ndarray, limits: tuple[float, float]) -> np.ndarray:
    return np.asarray((path < limits[0]) | (path > limits[1]))


def _costs(
    times: np.ndarray, way: np.ndarray, speeds: np.ndarray, rate: float, busy: np.ndarray
) -> Callable[[float], np.ndarray]:
    """(sense of turning: ±1) -> costs (k) [m] of a turn from each of ``times`` (k) on."""
    slips = np.append(0.0, np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * np.diff(times)))
    # behind the last moment speeds go on as they are
    later, farther = np.append(times, times[-1] + TURN), np.append(slips, slips[-1] + TURN * speeds[-1])
    slips = np.interp(times + TURN, later, farther) - slips
    moments = np.linspace(0.0, TURN, 17)
    own = np.diff(np.interp(times[:, None] + moments, times, way), axis=1) / moments[1]
    turning = np.pi * np.diff(Turn(0, 0.0, np.pi).share(moments)) / moments[1]

    def cost(sense: float) -> np.ndarray:
        hurried = np.abs(own + sense * turning).max(axis=1) > rate
        return np.asarray(slips + (TOGETHER * busy + HURRY * hurried) * (slips > SLIPS) - EARLY * times)

    return cost


def fast_enough(robot: RobotModel) -> bool:
    """Whether the planner's limits let steering joints turn about within :data:`TURN`."""
    return bool(np.min(robot.limits.input_upper[robot.input["steer"]]) >= np.pi / (TURN - RAMP))


class WheelFlipGuess(SteeringGuess):
    """A :class:`SteeringGuess` under which the base does not stop for wheels on its way.

    The problem's rolling rows are ones with ``allow_side_slip`` of the name "rolling", whose reference this sets. ``turns``: those to come and
    under way.
    """

    def __init__(self, robot: RobotModel, preview: Preview) -> None:
        super().__init__(robot, preview)
        state, inputs = robot.state, robot.input
        self._fastest = float(np.min(robot.limits.input_upper[inputs["steer"]]))
        self._angle = np.arange(state.size)[state["steer"]]  # places in state and input
        self._rate, self._roll = (np.arange(inputs.size)[inputs[g]] for g in ("steer", "wheel"))
        self.turns: tuple[Turn, ...] = ()
        self._references: References | dict[str, Reference] = {}
        self._lifted: tuple[Turn, ...] | None = None
        # written before the last solve; a moment [s] behind them and the angle [rad] there
        self._new: tuple[Turn, ...] = ()
        self._mark = (0.0, 0.0)

    def bind(self, mpc: MPC) -> None:
        """Whose rolling rows' reference this sets."""
        super().bind(mpc)
        self._references = mpc.reference

    def __call__(self, t: float, x0: np.ndarray, trajectory: Trajectory) -> Trajectory | None:
        self.turns = tuple(turn for turn in self.turns if turn.end > t - PAST)
        self._drop_rejected(trajectory, t)
        found = super().__call__(t, x0, trajectory)
        self._lift()
        return found

    def _drop_rejected(self, trajectory: Trajectory, t: float) -> None:
        """Turns that were written before the last solve count no more if its plan was rejected: the plan before has none of them."""
        new, self._new = self._new, ()
        if new and abs(self._planned(trajectory, new[-1].wheel, self._mark[0]) - self._mark[1]) > 0.5 * np.pi:
            self.turns = tuple(turn for turn in self.turns if turn not in new)
            self._next_check = t + POLL_PERIOD

    def _planned(self, trajectory: Trajectory, wheel: int, t: float | np.ndarray) -> np.ndarray:
        """Angles [rad] of a wheel at times t [s] in the solver's trajectories."""
        return np.asarray(np.interp(t, trajectory.times, trajectory.x[:, self._angle[wheel]]))

    def _lift(self) -> None:
        """Set which wheels may slip when: the reference of the rolling rows."""
        if self.turns == self._lifted:
            return
        self._lifted = self.turns
        edges = sorted({edge for turn in self.turns for edge in (turn.start, turn.end)})[: EDGES - 1]
        times = np.array([-NEVER, *edges, *[NEVER] * (EDGES - 1 - len(edges))])
        values = np.zeros((EDGES, swerve_base(self.robot).geometry.modules))
        for k, edge in enumerate(edges, 1):
            values[k, [turn.wheel for turn in self.turns if turn.start <= edge < turn.end]] = 1.0
        self._references["rolling"] = Reference(times, values, "hold")

    def _stuck(self, trajectory: Trajectory, twists: np.ndarray) -> bool:
        """Whether the plan does not move as the preview's ``twists`` ask for, but for less than half of it."""
        h, planned = np.diff(trajectory.grid), trajectory.u[:, self.robot.input["base"]]
        stuck = bool(h @ speed(planned - twists[:-1]) > 0.5 * (h @ speed(twists[:-1])))
        if stuck:
            self.turns = ()
        return stuck

    def _continue_plan(self, trajectory: Trajectory, t: float, x0: np.ndarray) -> Trajectory | None:
        """The plan with turns written into it where wheels come to the end of their range; None without any."""
        if t < self._next_check - 1e-9:
            return None
        self._next_check = t + POLL_PERIOD
        times, ways, speeds = self._ways(t, float(trajectory.grid[-1]), x0)
        previous, written = self.turns, False
        for wheel in range(ways.shape[1]):
            written |= self._lead_back(trajectory, wheel, times, ways[:, wheel], speeds[:, wheel])
            self._turn(trajectory, wheel, times, ways[:, wheel], speeds[:, wheel])
        self._new = self.turns[len(previous) :]
        if self._new:
            when = min(self._new[-1].end + 0.1, float(trajectory.start + trajectory.grid[-1]) - 0.1)
            self._mark = (when, float(self._planned(trajectory, self._new[-1].wheel, when)))
        return trajectory if written or self._new else None

    def _angles(self, x0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        state, modules = self.robot.state, swerve_base(self.robot).geometry.modules
        return (x0[state["leg"]] if "leg" in state else np.zeros(modules)), x0[state["steer"]].copy()

    def _ways(self, t: float, horizon: float, x0: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Times (k) [s], directions (k, n) [rad], continuous from one near ``x0`` on, and speeds (k, n) [m/s] of the wheels."""
        times = t + np.linspace(0.0, horizon, NODES)
        leg, steer = self._angles(x0)
        twists = self.preview(times, x0[self.robot.state["base"]])
        ways, speeds = wheel_directions(swerve_base(self.robot).geometry, leg, steer, twists)
        ways[0] = steer + (ways[0] - steer + 0.5 * np.pi) % np.pi - 0.5 * np.pi
        return times, np.unwrap(ways, axis=0, period=np.pi), speeds

    def _turn(self, trajectory: Trajectory, wheel: int, times: np.ndarray, way: np.ndarray, speeds: np.ndarray) -> None:
        """Find the turns of one wheel behind those that are known, and write them into the plan."""
        earliest = max([times[0] + AHEAD, *(turn.end for turn in self.turns if turn.wheel == wheel)])
        known = earliest + SETTLED if earliest > times[0] + AHEAD else times[0]
        rolls, seen = np.flatnonzero((speeds > ROLLS) & (times >= known)), int(SEEN * len(times))
        if not rolls.size or rolls[0] >= seen:
            return
        # the way round is the plan's where it rolls; before, the wheel may be anywhere
        first = int(rolls[0])
        way = way + np.pi * np.round((self._planned(trajectory, wheel, times[first]) - way[first]) / np.pi)
        low, high = self.limits[0][wheel], self.limits[1][wheel]
        reserve = min(max(0.5 * (high - low - np.pi), 0.0), RESERVE)
        limits = low + reserve, high - reserve
        path = way[:seen].copy()
        path[:first] = np.clip(path[:first], *limits)
        found = plan_turns(times[:seen], path, speeds[:seen], limits, self._fastest, earliest, self._busy(times[:seen]))
        for turn in (Turn(wheel, *one) for one in found):
            self._write_turn(trajectory, turn, times, way)
            way = way + turn.by * turn.share(times)
            self.turns += (turn,)

    def _lead_back(
        self, trajectory: Trajectory, wheel: int, times: np.ndarray, way: np.ndarray, speeds: np.ndarray
    ) -> bool:
        """Whether a wheel was rewritten: one that the plan takes to the end of its range half a turn beside the way that turns are planned by.

        Where a wheel nearly rests its direction goes round by up to half a turn, and the plan may go round on the other side.
        From there on no turn is planned for the way that the plan is on.
        """
        own = [turn for turn in self.turns if turn.wheel == wheel]
        if speeds[0] <= ROLLS or any(turn.start < times[0] + AHEAD and times[0] < turn.end + SETTLED for turn in own):
            return False
        planned = self._planned(trajectory, wheel, times)
        path = way + np.pi * np.round((planned[0] - way[0]) / np.pi)
        for turn in own:
            path = path + (turn.by * turn.share(times) if turn.start > times[0] else 0.0)
        low, high = self.limits[0][wheel] + RESERVE, self.limits[1][wheel] - RESERVE
        apart = np.abs(planned - path) > 0.5 * np.pi
        apart[0] = False  # the way begins at the plan, to within a rounding error
        pressed = (
            _outside(planned, (low - BEYOND, high + BEYOND)) & ~_outside(path, (low, high)) & apart & (speeds > ROLLS)
        )
        pressed[int(SEEN * len(times)) :] = False
        if pressed.any():
            together = np.flatnonzero(~apart[: int(pressed.argmax())])
            nodes = trajectory.times
            angles = np.clip(np.interp(nodes, times, path), self.limits[0][wheel], self.limits[1][wheel])
            self._write_angles(trajectory, wheel, float(times[together[-1]]), angles)
        return bool(pressed.any())

    def _busy(self, times: np.ndarray) -> np.ndarray:
        """Whether a turn from each of ``times`` (k) [s] on overlaps another one."""
        busy = np.zeros(len(times), bool)
        for turn in self.turns:
            busy |= (times > turn.start - TURN) & (times < turn.end)
        return busy

    def _write_turn(self, trajectory: Trajectory, turn: Turn, times: np.ndarray, way: np.ndarray) -> None:
        """From the plan's angles over to half a turn beside the direction ``way`` (k) [rad] at ``times`` (k) [s]; speeds follow."""
        nodes = trajectory.times
        target = np.clip(np.interp(nodes, times, way) + turn.by, self.limits[0][turn.wheel], self.limits[1][turn.wheel])
        angles = trajectory.x[:, self._angle[turn.wheel]]
        self._write_angles(trajectory, turn.wheel, turn.start, angles + turn.share(nodes) * (target - angles))

    def _write_angles(self, trajectory: Trajectory, wheel: int, start: float, angles: np.ndarray) -> None:
        """A wheel's ``angles`` (N + 1) [rad] from time ``start`` [s] on into the plan; its speeds follow, the base's plan stays."""
        x, u, j = trajectory.x, trajectory.u, self._angle[wheel]
        nodes = trajectory.times
        later = nodes >= start
        x[later, j] = angles[later]
        first = max(int(np.searchsorted(nodes, start)) - 1, 0)
        u[first:, self._rate[wheel]] = (np.diff(x[:, j]) / np.diff(nodes))[first:]
        inputs, g = self.robot.input, swerve_base(self.robot).geometry
        for k in range(first, len(u)):
            leg, steer = self._angles(x[k])
            v = wheel_velocities(g, leg, u[k, inputs["base"]])[wheel]
            heading = (g.wheel_heading + g.leg_angles(leg) + steer)[wheel]
            u[k, self._roll[wheel]] = (v[0] * np.cos(heading) + v[1] * np.sin(heading)) / g.wheel_radius

    def plan(self, t: float, horizon: float, x0: np.ndarray, trajectory: Trajectory) -> SteeringPlan:
        """Which way round wheels of a base at rest go: that which leads on farthest. No stops."""
        times, ways, _ = self._ways(t, horizon, x0)
        limits = self.limits[0] + RESERVE, self.limits[1] - RESERVE
        choices, ends = np.array([0.0, -np.pi, np.pi]), []
        for by in choices:
            out = (ways + by < limits[0]) | (ways + by > limits[1])
            ends.append(np.where(out.any(axis=0), out.argmax(axis=0), len(times)))
        return _Within(times - t, ways + choices[np.argmax(ends, axis=0)], (), self.limits)


@dataclass(frozen=True)
class _Within(SteeringPlan):
    """A plan whose wheels stay within ``limits``: lower and upper (n) [rad]."""

    limits: tuple[np.ndarray, np.ndarray]

    def nearest(self, t: float, steer: np.ndarray) -> np.ndarray:
        """As :class:`SteeringPlan`; at the end of the range where the plan is beyond it."""
        return np.clip(super().nearest(t, steer), *self.limits)
