"""Other plans, tried beside an MPC's own while its robot gets nowhere: the best of them becomes the way that the references take.

An MPC finds local optima: in front of a pillar that stands head-on it waits, though there is a way on either side. Here a second solver
of the same problem starts from other guesses (left, right, back and on again), one solve for each update of the MPC. All are solved for
the same goal, the place behind what is in the way; so is the MPC's own plan, which counts as waiting. What costs clearly less than that,
and keeps clear of everything over its whole horizon, wins. Where nothing does, the robot is stuck.
"""

from __future__ import annotations

import logging
import time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wbmpc.checks import absolute_time
from wbmpc.clearance.lattice import Footprint, turn_go_turn, unwrapped
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.clearance import BARRIER_SHARE, FIRST_BARRIER, ClearanceRows
from wbmpc.mpc.guess import predicted
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.pace import PacedReferences
from wbmpc.mpc.route import base_part, carried_poses, carried_states, carrying_base, set_carried, timed_route
from wbmpc.obstacles.world import Snapshot
from wbmpc.ocp import Reference
from wbmpc.solver import Solver, Status
from wbmpc.solver.solution import COLUMNS

_LOG = logging.getLogger("wbmpc")
Array = NDArray[np.float64]
#: References that wait so long [s] start a search; where it finds nothing, the next one starts so much later [s].
PATIENCE, AGAIN = 0.3, 1.0
#: Solves of each guess.
SOLVES = 10
#: What the winner costs at most, as a share of waiting.
GAIN = 0.8
#: How far aside [m] a way past something is looked for, in steps [m]; how far [m] the robot backs off first.
ASIDE, STEP, BACK = 2.5, 0.1, 0.35
#: How densely [s] the reference is looked at for what is in its way, and how far ahead [s] at most.
LOOKED, AHEAD = 0.1, 60.0
#: Speeds [m/s], [rad/s] of the part of a way that lies beyond the winner's horizon.
SPEED, TURN_SPEED = 0.3, 0.6
_BAD = (Status.NOT_FINITE, Status.DIVERGED, Status.INPUT_INFEASIBLE, Status.EQUALITY_INFEASIBLE)


class _Found(NamedTuple):
    """Of a guess: what its plan costs, states (N + 1, nx), inputs (N, nu), the way of the base (n, 3) it began with."""

    cost: float
    x: Array
    u: Array
    way: Array


class Alternatives:
    """Tries other plans for ``mpc`` of ``robot``, a robot whose base moves, when its references, kept by ``pace``, wait for it.

    Call :meth:`advance` once before each update of the MPC, after that of ``pace``. ``stuck``: whether the last search found nothing;
    ``searches``: how many have ended; ``taken``: names of the winners with the times [s] when they won; ``computation`` [s]: of all of
    it. Raises :class:`InputError` for an MPC without obstacles or with progress along a path, and a base that does not move.
    """

    def __init__(self, mpc: MPC, robot: RobotModel, pace: PacedReferences) -> None:
        base_part(robot)
        if mpc.obstacles is None or mpc.path.active:
            raise InputError("alternatives: an MPC with obstacles, and without progress along a path, is needed")
        self._mpc, self._robot, self._pace = mpc, robot, pace
        self._solver = Solver(mpc.ocp, mpc.solver.settings)
        self._rows = ClearanceRows(mpc.ocp, self._solver, mpc.obstacles)
        self.stuck, self.searches, self.computation = False, 0, 0.0
        self.taken: list[tuple[float, str]] = []
        self._waits_since: float | None = None
        self._not_before = -np.inf
        self._goal, self._rejoin = np.zeros(3), 0.0
        self._guesses: list[tuple[str, Array]] = []
        self._found: dict[str, _Found] = {}
        self._solves = 0

    @property
    def searching(self) -> bool:
        """Whether a search is under way."""
        return bool(self._guesses)

    def advance(self, t: float) -> None:
        """At ``t`` [s]: notice that the robot waits, or go on with a search by one solve."""
        t, began = absolute_time("alternatives", t), time.perf_counter()
        if not self._pace.waits:
            self._waits_since, self.stuck = None, False
            self._guesses = []
            return
        if self._waits_since is None:
            self._waits_since = t
        if self.searching:
            self._solve(t)
        elif t >= max(self._waits_since + PATIENCE - 1e-9, self._not_before):
            self._begin(t)
        self.computation += time.perf_counter() - began

    # ------------------------------------------------------------------ what there is to try
    def _begin(self, t: float) -> None:
        world = self._mpc.obstacles
        assert world is not None
        snapshot = world.snapshot(t)
        still = Snapshot(tuple(o for o in snapshot.obstacles if not o.velocity.any()), snapshot.frames)
        margin = self._robot.description.collision.margin
        footprint, start = Footprint(self._robot, still, margin, t), self._start(t)[1][base_part(self._robot)]
        target = self._behind(footprint)
        self._found = {}
        if target is None:
            self._end(t)
            return
        self._rejoin, self._goal, blocked = target
        self._guesses = [("wait", start[None])]
        back = start - BACK * np.array([np.cos(start[2]), np.sin(start[2]), 0.0])
        for name, side in (("left", 1.0), ("right", -1.0)):
            past = self._past(footprint, start, blocked, side)
            if past is not None:
                self._guesses.append((name, _way([start, back, *past, self._goal])))
        self._guesses.append(("back", _way([start, back, self._goal])))
        self._solves = 0

    def _behind(self, footprint: Footprint) -> tuple[float, Array, Array] | None:
        """When [s, of the references] the robot, carried along, is clear again after what is in its way; where its base (3) is then; and
        where it is blocked (n, 3). None: up to their end it is not."""
        pace = self._pace
        times = np.arange(pace.time, min(pace.end, pace.time + AHEAD) + LOOKED, LOOKED)
        places = np.array([carrying_base(self._robot, pace.pose(float(at))) for at in times])
        clear = footprint.clear(unwrapped(places))
        if clear.all():  # what waits there is another part of the robot, or something that moves
            k = min(int(np.searchsorted(times, pace.time + self._mpc.ocp.horizon)), len(times) - 1)
            return float(times[k]), places[k], places[:1]
        first = int(np.argmin(clear))
        after = np.flatnonzero(clear[first:])
        if not after.size:
            return None
        k = first + int(after[0])
        return float(times[k]), places[k], places[first:k]

    def _past(self, footprint: Footprint, start: Array, blocked: Array, side: float) -> Array | None:
        """Two base poses (2, 3) between which the robot passes what blocks it on one side, as near as it can; None: there are none."""
        ahead = self._goal[:2] - start[:2]
        length = float(np.linalg.norm(ahead))
        if length < STEP:
            return None
        ahead /= length
        left, heading = np.array([-ahead[1], ahead[0]]), np.arctan2(ahead[1], ahead[0])
        along = (blocked[:, :2] - start[:2]) @ ahead
        line = start[:2] + np.linspace(min(along.min(), 0.0), max(along.max(), length), 25)[:, None] * ahead
        for aside in np.arange(STEP, ASIDE + 1e-9, STEP):
            poses = np.column_stack([line + side * aside * left, np.full(len(line), heading)])
            if footprint.clear(poses).all():
                return poses[[0, -1]]
        return None

    # ------------------------------------------------------------------ solves
    def _start(self, t: float) -> tuple[float, Array]:
        """How old [s] the MPC's plan is, and where it has the robot at ``t`` [s]."""
        plan = self._mpc.plan_start
        delta = 0.0 if plan is None else t - plan
        return delta, predicted(self._mpc.solver, t, delta)[1][0]

    def _solve(self, t: float) -> None:
        """One solve of the first guess; behind its last one the next guess is first."""
        name, way = self._guesses[0]
        solver, rows = self._solver, self._rows
        delta, x0 = self._start(t)
        if self._solves == 0:
            self._prepare(name, way, t, delta)
        rows.update_snapshot(t)
        rows.refresh(t, 0.0)
        with solver.barrier(FIRST_BARRIER * BARRIER_SHARE**self._solves):
            status, count = solver.run(np.ascontiguousarray(x0), t, 0.0)
        self._solves += 1
        bad = solver.status(status) in _BAD
        if self._solves < SOLVES and not solver.non_finite_part():
            return
        plan = solver.trajectory(copy=False)
        clear = rows.unsafe(t + plan.grid, plan.x, np.inf) is None
        if not bad and (clear or name == "wait"):
            cost = float(solver.log[max(count, 1) - 1][COLUMNS["cost"]])
            self._found[name] = _Found(cost, plan.x.copy(), plan.u.copy(), way)
        self._guesses.pop(0)
        self._solves = 0
        if not self._guesses:
            self._end(t)

    def _prepare(self, name: str, way: Array, t: float, delta: float) -> None:
        """Problem and guess: goal at the place behind what is in the way, states along ``way`` within the horizon."""
        solver, mpc = self._solver, self._mpc
        solver.ws.w[:] = mpc.solver.ws.w
        for term, reference in mpc.solver.references.items():
            solver.set_reference(term, reference)
        solver.set_schedule(mpc.solver.schedule)
        set_carried(solver, self._robot, np.array([t]), self._goal[None])
        grid = solver.node_times(t)
        states = predicted(mpc.solver, t, delta)[1].copy()
        inputs = np.zeros((len(grid) - 1, solver.problem.nu))
        if name == "wait":
            states[:] = states[0]
        else:
            times, base = timed_route(way, *self._speeds(way), ramp=0.5)
            part = base_part(self._robot)
            for k in range(3):
                states[:, part.start + k] = np.interp(grid, times, base[:, k])
        solver.warm_start(states, inputs)
        solver.reset()

    def _speeds(self, way: Array) -> tuple[float, float]:
        """With which a way fits into the horizon; the robot's limits cut the plan if they have to."""
        step = np.abs(np.diff(way, axis=0))
        horizon = 0.9 * self._mpc.ocp.horizon
        length, turn = float(np.linalg.norm(step[:, :2], axis=1).sum()), float(step[:, 2].sum())
        return 2.0 * max(length, 0.1) / horizon, 2.0 * max(turn, 0.1) / horizon

    # ------------------------------------------------------------------ the winner
    def _end(self, t: float) -> None:
        self.searches += 1
        self._not_before, self._guesses = t + AGAIN, []
        found = dict(self._found)
        waits = found.pop("wait", None)
        name = min(found, key=lambda n: found[n].cost, default="")
        self.stuck = not name or (waits is not None and found[name].cost > GAIN * waits.cost)
        if self.stuck:
            _LOG.warning("alternatives at %.3f s: nothing leads on, the robot is stuck", t)
            return
        _LOG.info("alternatives at %.3f s: the robot goes on by '%s'", t, name)
        self.taken.append((t, name))
        self._take(t, found[name])

    def _take(self, t: float, found: _Found) -> None:
        """The MPC goes on from a plan, and its references take the plan's way, then what is left of the guess, to where they rejoin."""
        part, robot, grid = base_part(self._robot), self._robot, self._mpc.solver.ocp.grid
        base = found.x[:, part]
        rest = _rest(found.way, base[-1])
        later, beyond = timed_route(rest, SPEED, TURN_SPEED, ramp=0.5)
        times = np.concatenate([grid, grid[-1] + later[1:]])
        base = unwrapped(np.concatenate([base, beyond[1:]]))
        poses = carried_poses(robot, base)
        for k, x in enumerate(found.x):
            poses[k, :3], poses[k, 3:] = robot.pose(x[: robot.state.size])
        ways = {
            "end_effector": Reference.poses(times, poses[:, :3], poses[:, 3:]),
            "state": Reference(times, carried_states(robot, base)),
        }
        self._pace.detour(ways, self._rejoin)
        self._mpc.resume(found.x, found.u, t)
        self._waits_since = None


def _way(poses: list[Array]) -> Array:
    """From pose to pose (3): a turn, straight on, a turn; from the first to the second as they lie."""
    parts = [np.array(poses[:2])]
    parts += [turn_go_turn(a, b)[1:] for a, b in zip(poses[1:-1], poses[2:], strict=True)]
    return unwrapped(np.concatenate(parts))


def _rest(way: Array, pose: Array) -> Array:
    """What is left of a way (n, 3) from a pose (3) on."""
    steps = np.diff(way[:, :2], axis=0)
    square = np.maximum(np.sum(steps**2, axis=1), 1e-12)
    share = np.clip(np.sum((pose[:2] - way[:-1, :2]) * steps, axis=1) / square, 0.0, 1.0)
    off = np.linalg.norm(way[:-1, :2] + share[:, None] * steps - pose[:2], axis=1)
    k = len(off) - 1 - int(np.argmin(off[::-1]))
    return unwrapped(np.concatenate([pose[None], way[k + 1 :]]))
