"""Other ways, tried beside an MPC's own plan while its robot gets nowhere: the best of them becomes the way that the references take.

An MPC finds local optima: in front of a wall that stands head-on it waits, though there is a way on either side. Here a second MPC of
the same problem runs ahead of time on the model, with one solve for each update of the first: once with the references as they are, if
they did not wait (what is in the way may leave), and along other ways to behind what is in the way: left, right, back and on again. A way
counts if the robot gets on along it and keeps clear; the one that leaves the least to go wins. A base that can change its shape tries
ways in its narrowest one too, where it finds none as it is at home. Where none counts, the robot is stuck. What moves past the robot is
waited for.
"""

from __future__ import annotations

import itertools
import logging
import time
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wbmpc.arrays import Array
from wbmpc.checks import absolute_time
from wbmpc.clearance.lattice import Footprint, turn_go_turn, unwrapped
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.clearance import TOLERATED
from wbmpc.mpc.guess import predicted
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.reference_pacing import PacedReferences
from wbmpc.mpc.route import base_part, carried_states, carrying_base, set_carried, swung_poses, timed_route, weigh_base
from wbmpc.obstacles.world import Obstacles, Snapshot
from wbmpc.ocp import ModeSchedule, Reference
from wbmpc.solver import Solver
from wbmpc.types import Observation

if TYPE_CHECKING:
    from wbmpc.bases.base import Reshaping

_LOG = logging.getLogger("wbmpc")
#: References whose time goes on at less than this rate wait; who waits so long [s] starts a search; where it found nothing, the next one
#: starts so much later [s], and behind a winner, who may have to turn first, so much.
WAITS, PATIENCE, AGAIN, AFTER = 0.5, 0.3, 0.3, 3.0
#: Each way is run ahead in so many solves, so far [s] from one to the next.
SOLVES, STEP = 10, 0.3
#: So many of its first plans need not be clear: they start from one that goes on waiting in front of what is in the way, or into it.
FIRST = 4
#: How much nearer [m] to its end the robot is then, at least.
MOVED = 0.2
#: A robot that fits in another shape goes back to its way so far [m] ahead.
ONWARD = 1.0
#: So many radii before the first blocked place the robot turns onto its way past: more where its references are in there already.
BEFORE = (1.0, 2.0)
#: How far aside [m] a way past something may lead, in steps [m]; how far [m] the robot backs off first, and how often at most.
FARTHEST, ASIDE, BACK, BACKS = 2.5, 0.1, 0.35, 3
#: Headings that are checked at a place where the robot turns: legs that stick out by a meter pass 17 cm between two.
HEADINGS = 36
#: How densely [s] the reference is sampled to find what is in its way, and how far ahead [s] at most.
SAMPLED, AHEAD = 0.1, 60.0
#: Speeds [m/s], [rad/s] along other ways, from rest over a ramp [s]; what a turn counts [m/rad] beside ways.
SPEED, TURN_SPEED, RAMP, TURN = 0.3, 0.6, 0.5, 0.35


class _Way(NamedTuple):
    """Another way: base poses (n, 3) to where the references are at ``rejoin`` [s] of their time; none to stay on theirs. ``shape`` (nx):
    in which the robot goes there; None: as it is at home."""

    name: str
    poses: Array
    rejoin: float
    shape: Array | None = None


class Alternatives:
    """Searches for alternative paths while the references of ``mpc``, which ``pace`` holds back, wait for ``robot``. Its base must be able
    to move and to turn in place.

    Call :meth:`advance` once before each update of the MPC, after that of ``pace``. ``failed``: number of consecutive searches without a
    result while a static obstacle held up the references; ``can_leave``: whether the robot was, in the last search, where it is clear as it is
    at home and had a place to turn behind it; ``searches``: number of finished searches; ``taken``: times [s] and names of the
    paths that were taken; ``computation`` [s]: time of all searches. During a detour, and where ``reshaping`` leads it through what is narrow,
    the base has a weight in the cost "state".
    ``reshaping``: changes the base's shape on the way (:meth:`wbmpc.bases.base.BaseType.reshaping`; None: its shape stays). Raises
    :class:`InputError` for an MPC without obstacles or with progress along a path, and a base that does not move or balances.
    """

    def __init__(self, mpc: MPC, robot: RobotModel, pace: PacedReferences, reshaping: Reshaping | None = None) -> None:
        base_part(robot)
        if mpc.obstacles is None or mpc.path.active or robot.base.balances:
            raise InputError(
                "alternatives: valid: an MPC with obstacles, without progress along a path, of a robot that does not balance"
            )
        self._mpc, self._robot, self._pace, self._reshaping = mpc, robot, pace, reshaping
        self._world = Obstacles()
        self._ahead = MPC(mpc.ocp, mpc.solver.settings, mpc.rate, plan_only_limits=True, obstacles=self._world)
        self.failed, self.searches, self.computation = 0, 0, 0.0
        self.can_leave = False
        self.taken: list[tuple[float, str]] = []
        self._waits_since: float | None = None
        self._not_before = -np.inf
        self._weights: list[float] | None = None  # of the states, before a way has given the base one
        #: until when [s, of the references] they are on another way
        self._until = -np.inf
        self._ways: list[_Way] = []
        self._found: list[tuple[float, _Way]] = []
        self._solves, self._t, self._x = 0, 0.0, np.zeros(0)

    @property
    def searching(self) -> bool:
        """Whether a search is under way."""
        return bool(self._ways)

    def advance(self, t: float) -> None:
        """At ``t`` [s]: start a search if the references wait, or continue the present one by one solve."""
        t, began = absolute_time("alternatives", t), time.perf_counter()
        if self._pace.time >= self._until > -np.inf:
            self._until = -np.inf
        self._weigh_base(self._until > -np.inf or (self._reshaping is not None and self._reshaping.narrow))
        if self._pace.rate >= WAITS or self._pace.time >= self._pace.end:
            self._waits_since, self.failed = None, 0
            self._ways = []
            return
        if not self.searching and self._pace.waits_for(t):  # it passes by; another way would be one for where it is now
            self._waits_since = None
            return
        if self._waits_since is None:
            self._waits_since = t
        if self.searching:
            self._go_on(t)
        elif t >= max(self._waits_since + PATIENCE - 1e-9, self._not_before):
            self._begin(t)
        self.computation += time.perf_counter() - began

    # ------------------------------------------------------------------ what there is to try
    def _begin(self, t: float) -> None:
        assert self._mpc.obstacles is not None
        snapshot = self._mpc.obstacles.snapshot(t)
        still = Snapshot(tuple(o for o in snapshot.obstacles if not o.velocity.any()), snapshot.frames)
        margin, robot = self._robot.description.collision.margin, self._robot
        footprint = Footprint(robot, still, margin, t)
        times, places = self._carried()
        clear = footprint.clear(places)
        if clear.all():  # nothing that stands is in its way: its arm lags behind, and time helps
            self._not_before = t + AGAIN
            return
        self._found, self._solves = [], 0
        start = self._now(t)[base_part(robot)]
        here = Footprint(robot, still, (1.0 - TOLERATED) * margin, t).clear(start[None])[0]
        self.can_leave = bool(here) and self._off(footprint, start) is not None
        found = self._ways_of(footprint, start, times, places, clear)
        if self._reshaping is not None:
            shape = self._reshaping.narrowest
            narrow = Footprint(robot, still, margin, t, shape)
            known = {way.name for way in found}
            more = self._ways_of(narrow, start, times, places, narrow.clear(places))
            found += [w._replace(name=f"{w.name}, narrow", shape=shape) for w in more if w.name not in known]
        self._ways = [_Way("wait", np.zeros((0, 3)), self._pace.time), *found]

    def _ways_of(
        self, footprint: Footprint, start: Array, times: Array, places: Array, clear: NDArray[np.bool_]
    ) -> list[_Way]:
        """Ways of a shape from a base pose (3) to behind the first of its ``places`` (n, 3) at ``times`` (n) [s] that is not ``clear`` (n),
        or, if all are, back to them from a place where it can turn."""
        back = self._off(footprint, start)
        if back is None:
            return []
        if clear.all():
            k = min(int(np.argmax(np.linalg.norm(places - start, axis=1) > ONWARD)) or len(places) - 1, len(places) - 1)
            again = _way([start, back, places[k]])
            return [_Way("back", again, float(times[k]))] if _clear(footprint, again[1:]) else []
        target = _behind(footprint, times, places, int(np.argmin(clear)))
        if target is None:
            return []
        rejoin, goal, end, blocked = target
        found = [
            (n, self._past(footprint, (start, back, goal), blocked, s)) for n, s in (("left", 1.0), ("right", -1.0))
        ]
        straight = _way([start, back, goal])
        found.append(("back", straight if _clear(footprint, straight[1:]) else None))
        return [_Way(n, unwrapped(np.vstack([way, end])), rejoin) for n, way in found if way is not None]

    def _now(self, t: float) -> Array:
        """Where the MPC's plan has the robot (nx of the problem) at ``t`` [s], or where it begins if that is later."""
        plan = self._mpc.plan_start
        return predicted(self._mpc.solver, t, 0.0 if plan is None else max(t - plan, 0.0))[1][0]

    def _off(self, footprint: Footprint, start: Array) -> Array | None:
        """The nearest place (3) behind the robot where it is clear when it is as at home, and can turn; None: there is none."""
        straight = np.array([np.cos(start[2]), np.sin(start[2]), 0.0])
        for k in range(1, BACKS + 1):
            place = start - k * BACK * straight
            if _can_turn(footprint, place[None])[0]:
                return place
        return None

    def _carried(self) -> tuple[Array, Array]:
        """Times (n) [s] of the references, and where the base (n, 3) is then that carries the end effector along."""
        pace = self._pace
        times = np.arange(pace.time, min(pace.end, pace.time + AHEAD) + SAMPLED, SAMPLED)
        return times, unwrapped(np.array([carrying_base(self._robot, pace.pose(float(at))) for at in times]))

    def _past(
        self, footprint: Footprint, places: tuple[Array, Array, Array], blocked: Array, side: float
    ) -> Array | None:
        """Base poses (n, 3) from a start, off to where it is clear, on one side past what blocks it (n, 3), as near as can be, to a goal;
        None: there are none."""
        start, back, goal = places
        ahead = goal[:2] - blocked[0, :2]
        length = float(np.linalg.norm(ahead))
        if length < ASIDE:
            return None
        ahead /= length
        left, heading = np.array([-ahead[1], ahead[0]]), np.arctan2(ahead[1], ahead[0])
        for aside, before in itertools.product(np.arange(ASIDE, FARTHEST + 1e-9, ASIDE), BEFORE):
            turns = blocked[0, :2] - before * footprint.radius * ahead
            past = np.column_stack([[turns, goal[:2]], [heading, heading]]) + np.array([*(side * aside * left), 0.0])
            if _clear(footprint, past):
                way = _way([start, back, *past, goal])
                if _clear(footprint, way[1:]):
                    return way
        return None

    # ------------------------------------------------------------------ runs ahead
    def _go_on(self, t: float) -> None:
        """One solve of the first way; behind its last one the next is first."""
        way = self._ways[0]
        if self._solves == 0:
            self._prepare(way, t)
        usable = self._ahead.advance(Observation(self._t, self._x))
        near = self._ahead.clearance
        clear = self._solves < FIRST or not near.frame or near.excess > -TOLERATED * near.margin
        if usable and clear:
            self._x, self._t = self._simulated(), self._t + STEP
        self._solves += 1
        if usable and clear and self._solves < SOLVES:
            return
        if usable and clear:
            left = self._left(way, self._x[base_part(self._robot)])
            if left < self._left(way, self._now(t)[base_part(self._robot)]) - MOVED:
                self._found.append((left, way))
        self._ways, self._solves = self._ways[1:], 0
        if not self._ways:
            self._end(t)

    def _prepare(self, way: _Way, t: float) -> None:
        """The second MPC goes on from the first one's plan, with references along a way."""
        mpc, ahead = self._mpc, self._ahead
        assert mpc.obstacles is not None
        self._world.take(mpc.obstacles.snapshot(t))
        start = t if mpc.plan_start is None else mpc.plan_start
        self._t, self._x = max(t, start), self._now(t).copy()
        _copy_constants(mpc.solver, ahead.solver)
        running = {"end_effector": self._pace.running(t)["end_effector"]}
        for term, reference in {**mpc.solver.references, **running}.items():
            ahead.solver.set_reference(term, reference)
        free = self._reshaping.free if way.shape is not None and self._reshaping is not None else None
        ahead.solver.set_schedule(mpc.solver.schedule if free is None else ModeSchedule((free,)))
        if len(way.poses):
            times, base = timed_route(way.poses, SPEED, TURN_SPEED, RAMP)
            poses = swung_poses(self._robot, times, base, self._x)
            set_carried(ahead.solver, self._robot, t + times, poses, carried_states(self._robot, base, way.shape))
        plan = mpc.solver.trajectory(copy=False)
        ahead.resume(plan.x, plan.u, start)

    def _simulated(self) -> Array:
        """Where the plan of the second MPC has the robot (nx) one step later."""
        plan, x, at = self._ahead.solver.trajectory(copy=False), self._x, 0.0
        for u, end in zip(plan.u, plan.grid[1:], strict=True):
            h = min(float(end), STEP) - at
            if h <= 1e-9:
                break
            x, at = self._ahead.solver.simulate(x, u, h), at + h
        return x

    def _left(self, way: _Way, pose: Array) -> float:
        """What is left to go [m] from a base pose (3): along a way, or straight to where the references end."""
        if not len(way.poses):
            goal = carrying_base(self._robot, self._pace.pose(self._pace.end))
            return float(np.linalg.norm(goal[:2] - pose[:2]))
        steps = np.diff(_rest(way.poses, pose), axis=0)
        end = carrying_base(self._robot, self._pace.pose(self._pace.end))
        beyond = float(np.linalg.norm(end[:2] - way.poses[-1, :2]))
        return float(np.linalg.norm(steps[:, :2], axis=1).sum() + TURN * np.abs(steps[:, 2]).sum()) + beyond

    # ------------------------------------------------------------------ the winner
    def _end(self, t: float) -> None:
        self.searches += 1
        self._not_before = t + AGAIN
        if not self._found and self._pace.waits_for(t):  # something has come since
            return
        self.failed = 0 if self._found else self.failed + 1
        if self.failed:
            _LOG.warning("alternatives at %.3f s: nothing leads on, the robot is stuck", t)
            return
        left, way = min(self._found, key=lambda f: f[0])
        _LOG.info("alternatives at %.3f s: the robot goes on by '%s', %.2f m are left", t, way.name, left)
        self.taken.append((t, way.name))
        if len(way.poses):
            self._take(t, way)

    def _take(self, t: float, way: _Way) -> None:
        """The references take a way, then go on where they rejoin; until there the base has a weight."""
        times, base = timed_route(way.poses, SPEED, TURN_SPEED, RAMP)
        poses = swung_poses(self._robot, times, base, self._now(t))
        ways = {"end_effector": Reference.poses(times, poses[:, :3], poses[:, 3:])}
        if self._weigh_base(True):
            ways["state"] = Reference(times, carried_states(self._robot, base))
        self._until = self._pace.time + float(times[-1])
        self._pace.detour(ways, way.rejoin)
        self._waits_since, self._not_before = None, t + AFTER

    def _weigh_base(self, on: bool) -> bool:
        """Give the base a weight in the cost "state", or take it away again; whether it has one now."""
        solver = self._mpc.solver
        if on and self._weights is None:
            part = solver.problem.constant.slices.get("path.state")
            before = [] if part is None else solver.constants[part].tolist()
            if weigh_base(solver, self._robot):
                self._weights = before
        elif not on and self._weights is not None:
            solver.set_weight("state", self._weights)
            self._weights = None
        return self._weights is not None


def _way(poses: list[Array]) -> Array:
    """From the first pose (3) to the second as they lie, then from pose to pose: a turn, straight on, a turn."""
    parts = [np.array(poses[:2])]
    parts += [turn_go_turn(a, b)[1:] for a, b in itertools.pairwise(poses[1:])]
    return unwrapped(np.concatenate(parts))


def _clear(footprint: Footprint, way: Array) -> bool:
    """Whether the robot is clear at poses (n, 3) of a way and between them."""
    dense = np.concatenate([np.linspace(a, b, 20) for a, b in itertools.pairwise(way)])
    return bool(footprint.clear(dense).all())


def _can_turn(footprint: Footprint, places: Array) -> NDArray[np.bool_]:
    """Whether (n) the robot is clear at places (n, 3) whatever its heading is."""
    turned = np.repeat(places, HEADINGS, axis=0)
    turned[:, 2] += np.tile(np.arange(HEADINGS) * 2.0 * np.pi / HEADINGS, len(places))
    return np.asarray(footprint.clear(turned).reshape(-1, HEADINGS).all(axis=1))


def _behind(footprint: Footprint, times: Array, places: Array, first: int) -> tuple[float, Array, Array, Array] | None:
    """When [s] the robot, carried to places (n, 3) at ``times`` (n) [s] of which the ``first`` blocked one is given, is behind what blocks
    it; where its base (3) can turn then; the places (m, 3) from there on, where it is clear; and where it is blocked (k, 3). Where the way
    ends so near to what blocks it that it cannot turn any more, it turns farther ahead and goes straight back to the end. None: neither
    is possible."""
    after = np.flatnonzero(_can_turn(footprint, places[first:]))
    if after.size:
        k = first + int(after[0])
        return float(times[k]), places[k], places[k:k], places[first:k]
    end = places[-1]
    ahead = np.array([np.cos(end[2]), np.sin(end[2]), 0.0])
    ahead *= -1.0 if (end - places[first])[:2] @ ahead[:2] < 0.0 else 1.0
    farther = end + np.arange(ASIDE, FARTHEST + 1e-9, ASIDE)[:, None] * ahead
    after = np.flatnonzero(_can_turn(footprint, farther))
    if not after.size or not _clear(footprint, np.array([farther[after[0]], end])):
        return None
    return float(times[-1]), farther[after[0]], end[None], places[first:]


def _rest(way: Array, pose: Array) -> Array:
    """What is left of a way (n, 3) from a pose (3) on."""
    weight = np.array([1.0, 1.0, TURN])
    steps = np.diff(way, axis=0) * weight
    off = (pose - way[:-1]) * weight
    off[:, 2] = TURN * np.angle(np.exp(1j * (pose[2] - way[:-1, 2])))
    share = np.clip(np.sum(off * steps, axis=1) / np.maximum(np.sum(steps**2, axis=1), 1e-12), 0.0, 1.0)
    distance = np.linalg.norm(share[:, None] * steps - off, axis=1)
    k = len(distance) - 1 - int(np.argmin(distance[::-1]))
    here = way[k] + share[k] * np.diff(way, axis=0)[k]
    return np.concatenate([here[None], way[k + 1 :]])


def _copy_constants(source: Solver, target: Solver) -> None:
    """Give ``target`` the weights and model parameters of another solver of the same problem."""
    constants = source.constants
    for key, part in source.problem.constant.slices.items():
        at, _, name = key.partition(".")
        if name:
            target.set_weight(name, constants[part].tolist(), "path" if at == "path" else "terminal")
        else:
            target.set_parameters(constants[part])
