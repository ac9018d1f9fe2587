"""Legs that fold where it is narrow: as wide as the clearance along the base's reference allows, with brakes that open for it. Where the arm
pulls they stand wider (:class:`wbmpc.bases.swerve.leg_widening.LegWidening`), as far as there is room.

Gradients of distances are local: a leg in front of a wall may as well fold to the wrong side. So leg angles are references that look
ahead. At each place of the base's reference the base moves aside and turns as little as its body needs, and each leg turns from where it is
asked to be towards the body's axis as little as its own parts need; how fast legs turn is limited, so that they fold in good time. A brake
is open while its leg's reference turns, and until the leg is folded as far.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wbmpc.arrays import Array
from wbmpc.bases.swerve.brake_control import BRAKE_DELAY, BrakeControl
from wbmpc.bases.swerve.leg_widening import LegWidening
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.clearance.nearest import Finder, Poses
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.obstacles.geometry import robot_geometry
from wbmpc.obstacles.world import Snapshot
from wbmpc.ocp import Mode, Reference

Ints = NDArray[np.int64]
#: Interval [s] of the places of the reference that are checked.
CHECK_INTERVAL = 0.2
#: Time [s] beyond the horizon up to which places are checked: legs begin to fold before the horizon reaches what is narrow.
BEYOND_HORIZON = 4.0
#: Interval [s] at which the check is repeated: obstacles may have been seen meanwhile.
REFRESH_PERIOD = 0.2
#: Shares of the way of a leg that are tried, from where it is asked to be to where it is narrowest.
SHARES = np.linspace(0.0, 1.0, 13)
#: Ways aside [m] and turns [rad] of the base that are tried, to the left and to the right; length [m] by which a turn counts as a way. Of those
#: that are clear the shortest is taken.
ASIDE, TURNS, YAW_LENGTH = 0.03 * np.arange(-8, 9), 0.04 * np.arange(-3, 4), 0.5
#: What is asked for beyond the margin [m].
GAP = 0.02
#: Distances [m] beyond this count as this.
REACH = 0.3
#: Legs fold beyond the body's axis by so much [rad]: wheels come under the body.
INWARD = 0.12
#: Legs turn with this share of their speed limit.
LEG_SPEED_SHARE = 0.6
#: The base moves aside and turns so fast [m/s], [rad/s].
OFF_SPEED = np.array([0.05, 0.1])
#: Legs are folded so long [s] before they have to be: one that lags behind comes in front of what it is to pass, and stays there.
FOLDED_AHEAD = 1.0
#: A leg that is farther [rad] from its narrowest place than it is to be is not folded yet: its brake stays open.
FOLDED = 0.03
#: Brakes open so long [s] before their leg turns, and close so long after.
OPEN_BEFORE, OPEN_AFTER = 0.3, 0.6


class LegFolding:
    """References of the legs and ``brakes`` for a robot with hinged legs whose ``mpc`` keeps clear of obstacles or upright; ``delay`` [s]: of
    brakes."""

    def __init__(self, robot: RobotModel, mpc: MPC, delay: float = BRAKE_DELAY) -> None:
        self.robot, self._mpc = robot, mpc
        self.brakes = BrakeControl(robot, delay=delay, changed=mpc.set_schedule)
        self._finder = Finder(robot_geometry(robot), REACH, deep=False)
        self._leg = robot.state["leg"]
        self._of_leg, self._body = self._parts()
        geometry = swerve_base(robot).geometry
        asked = robot.home[self._leg]
        straight = np.round((geometry.leg_heading + asked) / np.pi) * np.pi - geometry.leg_heading
        limits = robot.limits
        lower, upper = limits.state_lower[self._leg], limits.state_upper[self._leg]
        folded = straight + np.sign(straight - asked) * INWARD
        # a leg that slides is narrowest where it is shortest
        self._narrow = np.where(geometry.slides > 0.0, lower, np.clip(folded, lower, upper))
        self.narrowest = robot.home.copy()
        self.narrowest[self._leg] = self._narrow
        self.free = Mode("unfolding", {"brake": (1.0,) * geometry.modules})
        #: legs at one end of the body fold alike
        self._pair = geometry.hinge[:, 0] > 0.0
        self._rate = LEG_SPEED_SHARE * float(limits.input_upper[robot.input["leg"]].min())
        self._widening = LegWidening(robot, mpc, self._rate)
        self._looked, self.narrow = -np.inf, False
        self._turned = np.full(geometry.modules, -np.inf)  # when each leg's reference turned last
        self._ahead: tuple[Array, Array, Array] | None = None  # times (k), shares (k, n), off (k, 2)
        self._asked: Reference | None = None
        self._set: Reference | None = None

    def _parts(self) -> tuple[list[Ints], Ints]:
        """Indices of the geometry's frames that hang on each leg, and of those that carry no arm and no leg."""
        robot, geometry = self.robot, self._finder.geometry
        links = robot.tree.links
        joints = [robot.tree.joint(n) for n in robot.state.groups["leg"]]

        def above(link: int) -> set[int]:
            found = set()
            while link >= 0:
                found.add(link)
                link = links[link].parent
            return found

        chains = [above(robot.tree.frames[f].link) for f in geometry.frames]
        of_leg = [np.flatnonzero([joint in chain for chain in chains]) for joint in joints]
        arm = {robot.tree.joint(n) for n in robot.state.groups["arm"]}
        body = np.flatnonzero([not chain & (arm | set(joints)) for chain in chains])
        return of_leg, body

    def attach(self, controller: Any) -> None:
        """Let a controller that has brakes follow these."""
        if hasattr(controller, "brakes"):
            controller.brakes = self.brakes
            controller.supervision.report = self.brakes.accept

    def update(self, t: float, ahead: Reference | None = None) -> None:
        """Set the reference "state" and the brakes for updates from ``t`` [s] on. ``ahead``: that reference as it goes on if it does not wait:
        what is in the way of legs makes it wait, and they would not fold for where it does not lead then."""
        reference = self._mpc.reference["state"]
        if reference is not self._set:
            self._asked = reference
        assert self._asked is not None
        world = self._mpc.obstacles
        if t >= self._looked + REFRESH_PERIOD - 1e-9:
            self._looked = t
            self._widening.look(t, t + OPEN_BEFORE)
            there = Snapshot() if world is None else world.snapshot(t)
            still = tuple(o for o in there.obstacles if not o.velocity.any())  # who walks by is evaded or waited for
            self._plan_folding(t, Snapshot(still, there.frames), self._asked, ahead)
        times = _times(t, self._mpc.ocp.horizon + 2.0 * self._mpc.period + CHECK_INTERVAL)
        values, wider = np.array([self._asked.at(float(at)) for at in times]), self._widening.offset(times)
        values[:, self._leg] += wider
        shares, off = self._planned(times)
        values, asked = self._moved(values, off), values[:, self._leg].copy()
        values[:, self._leg] += shares * (self._narrow - asked)
        legs = self._mpc.solver.trajectory(copy=False).x[0, self._leg]
        lacks = (legs - values[0, self._leg]) * np.sign(asked[0] - self._narrow) > FOLDED
        if self._widening.moved:
            lacks |= np.abs(legs - values[0, self._leg]) > FOLDED
        turns = (np.abs(shares[1] - shares[0]) > 1e-3) | (np.abs(wider[1] - wider[0]) > 1e-3)
        self._turned = np.where(turns | lacks, t, self._turned)
        self._set = Reference(times, values)
        self._mpc.reference["state"] = self._set

    def _planned(self, times: Array) -> tuple[Array, Array]:
        if self._ahead is None:
            return np.zeros((len(times), len(self._turned))), np.zeros((len(times), 2))
        at, *found = self._ahead
        shares, off = (np.stack([np.interp(times, at, s) for s in values.T], axis=1) for values in found)
        return shares, off

    # ------------------------------------------------------------------ what is ahead
    def _plan_folding(self, t: float, snapshot: Snapshot, asked: Reference, running: Reference | None) -> None:
        times = _times(t, self._mpc.ocp.horizon + BEYOND_HORIZON)
        states = self._along(asked, times)
        shares, off = self.needed(snapshot, times, states)
        if running is not None:
            shares = np.maximum(shares, self.needed(snapshot, times, self._along(running, times))[0])
        ahead = [
            np.vstack([shares[k:], np.repeat(shares[-1:], k, axis=0)])
            for k in range(round(FOLDED_AHEAD / CHECK_INTERVAL) + 1)
        ]
        shares = np.max(ahead, axis=0)
        speeds = np.abs(self._narrow - states[:, self._leg]).max(axis=0)
        rate = self._rate / np.maximum(speeds, 1e-3)
        shares_now, off_now = (now[0] for now in self._planned(times[:1]))
        folded = _all_reachable(shares, times, rate, shares_now)
        moved = _all_reachable(np.maximum(off, 0.0), times, OFF_SPEED, np.maximum(off_now, 0.0))
        moved -= _all_reachable(np.maximum(-off, 0.0), times, OFF_SPEED, np.maximum(-off_now, 0.0))
        self._ahead, self.narrow = (times, folded, moved), bool((folded > 1e-3).any())
        self._schedule(times, folded)

    def _along(self, reference: Reference, times: Array) -> Array:
        states = np.array([reference.at(float(at))[: self.robot.state.size] for at in times])
        states[:, self._leg] += self._widening.offset(times)
        return states

    def needed(self, snapshot: Snapshot, times: Array, states: Array) -> tuple[Array, Array]:
        """Of base poses in ``states`` (k, nx) at ``times`` (k) [s]: shares (k, n) of each leg's way to its narrowest angle, and how far
        off (k, 2) the base has to be: aside [m] and turned [rad]; zeros where the body does not pass either."""
        target = float(self.robot.description.collision.margin) + GAP
        off, passes = self._passing(snapshot, times, states, target)
        turned = np.repeat(self._moved(states, off), len(SHARES), axis=0)
        asked = turned[:, self._leg]
        turned[:, self._leg] = asked + np.tile(SHARES, len(times))[:, None] * (self._narrow - asked)
        legs = self._distances(snapshot, np.repeat(times, len(SHARES)), turned, self._of_leg)
        clear = legs.reshape(len(times), len(SHARES), -1) >= target
        shares = np.where(clear.any(axis=1), SHARES[np.argmax(clear, axis=1)], 1.0) * passes[:, None]
        for pair in (self._pair, ~self._pair):
            shares[:, pair] = shares[:, pair].max(axis=1, keepdims=True, initial=0.0)
        return shares, off

    def _passing(
        self, snapshot: Snapshot, times: Array, states: Array, target: float
    ) -> tuple[Array, NDArray[np.bool_]]:
        """How far off (k, 2) the body is clear by ``target`` [m], or by as much as it can be, and whether (k) it passes there. Only places
        where it is not clear as it is are searched: the nearest place off that is as good as any is taken."""
        off = np.zeros((len(times), 2))
        best = self._distances(snapshot, times, states, [self._body])[:, 0]
        narrow = np.flatnonzero(best < target)
        if not narrow.size:
            return off, np.ones(len(times), bool)
        tried = np.stack(np.meshgrid(ASIDE, TURNS), axis=-1).reshape(-1, 2)
        tried = tried[np.argsort(np.abs(tried) @ [1.0, YAW_LENGTH], kind="stable")]
        at, count = np.repeat(narrow, len(tried)), len(tried)
        moved = self._moved(states[at], np.tile(tried, (len(narrow), 1)))
        found = self._distances(snapshot, times[at], moved, [self._body])[:, 0].reshape(-1, count)
        capped = np.minimum(found, target)
        passes = best > 0.0
        passes[narrow] = capped.max(axis=1) > 0.0
        off[narrow] = np.where(passes[narrow, None], tried[np.argmax(capped, axis=1)], 0.0)
        return off, passes

    def _moved(self, states: Array, off: Array) -> Array:
        """States (k, nx) with the base ``off`` (k, 2): aside [m] and turned [rad]."""
        out, base = states.copy(), self.robot.state["base"].start
        out[:, base] -= np.sin(states[:, base + 2]) * off[:, 0]
        out[:, base + 1] += np.cos(states[:, base + 2]) * off[:, 0]
        out[:, base + 2] += off[:, 1]
        return out

    def _distances(self, snapshot: Snapshot, times: Array, states: Array, groups: list[Ints]) -> Array:
        """Least distance (n, groups) [m] of each group of frames to any obstacle, :data:`REACH` at most."""
        poses = Poses(times, *self._finder.kinematics(states))
        frames = len(self._finder.geometry.frames)
        limit = np.full((len(times), frames, len(snapshot.obstacles)), -np.inf)
        limit[:, np.concatenate(groups)] = REACH
        found = self._finder.find(snapshot, poses, limit).distance
        return np.stack([found[:, g].min(axis=(1, 2), initial=REACH) for g in groups], axis=1)

    def _schedule(self, times: Array, shares: Array) -> None:
        """Open the brake of each leg while its reference turns."""
        turns = np.zeros(shares.shape, bool)
        turns[:-1] = np.abs(np.diff(shares, axis=0)) > 1e-3
        turns[:-1] |= np.abs(np.diff(self._widening.offset(times), axis=0)) > 1e-3
        is_open = times[:, None] <= self._turned + OPEN_AFTER + 1e-9
        for k in np.flatnonzero(turns.any(axis=1)):
            near = (times >= times[k] - OPEN_BEFORE - 1e-9) & (times <= times[k] + OPEN_AFTER + 1e-9)
            is_open[near] |= turns[k]
        changes = [0, *(np.flatnonzero((is_open[1:] != is_open[:-1]).any(axis=1)) + 1)]
        self.brakes.replace([(float(times[k]), is_open[k].astype(float)) for k in changes])


def _times(t: float, duration: float) -> Array:
    return np.asarray(t + CHECK_INTERVAL * np.arange(round(duration / CHECK_INTERVAL) + 1), float)


def _all_reachable(needed: Array, times: Array, rates: Array, start: Array) -> Array:
    """:func:`_reachable` of each column of ``needed`` (k, n)."""
    found = [_reachable(n, times, r, b) for n, r, b in zip(needed.T, rates, start, strict=True)]
    return np.stack(found, axis=1)


def _reachable(needed: Array, times: Array, rate: float, start: float) -> Array:
    """The least curve above ``needed`` (k) that changes by ``rate`` at most, as far as it can be reached from ``start``."""
    slack = rate * np.abs(times[:, None] - times[None, :])
    minimum = (needed[None, :] - slack).max(axis=1)
    room = rate * (times - times[0])
    return np.asarray(np.clip(minimum, start - room, start + room))
