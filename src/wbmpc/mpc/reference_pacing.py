"""References that wait for the robot: their time goes on as far as the plan can follow, and no farther."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.checks import absolute_time, numbers
from wbmpc.errors import InputError
from wbmpc.ocp import Reference

if TYPE_CHECKING:
    from wbmpc.mpc.mpc import MPC

#: Distance [m] of the end effector from its reference up to which time runs freely, and from which on it stands.
FREE, STANDING = 0.04, 0.2
#: What a plan may lack [m] of a margin at no cost, and what more of it stops the time.
TOLERATED, LACKING = 0.01, 0.05
#: How fast [1/s] the rate of time falls and rises.
FALL, RISE = 4.0, 1.0
#: A reference whose time goes on at less than the first rate counts as waiting, at less than the second it stands.
WAITS, STANDS = 0.1, 0.02


class PacedReferences:
    """Lets the references ``names`` of an MPC wait for the robot: their own ``time`` [s] equals the clock at ``start`` [s] and runs at
    ``rate`` (0 to 1) times the clock. ``detoured`` [s]: how much longer detours have made them. A robot that evades an obstacle or waits
    falls behind its reference, and a distant reference would pull it through the obstacle. The rate falls with the distance of the end
    effector from its reference, and with the clearance that the last plan lacks.
    """

    def __init__(self, mpc: MPC, names: Sequence[str] = ("end_effector", "state"), start: float = 0.0) -> None:
        if "end_effector" not in mpc.reference:
            raise InputError("paced references: the MPC needs a reference 'end_effector'")
        self._mpc, self._set_at = mpc, absolute_time("paced references: 'start'", start)
        found = {name: mpc.reference[name] for name in names if name in mpc.reference}
        self._whole = {name: reference for name, reference in found.items() if reference.times.size > 1}
        self._path = mpc.reference["end_effector"]
        self.time, self.rate = self._set_at, 1.0
        self.detoured = 0.0

    @property
    def delay(self) -> float:
        """How long [s] the references have waited."""
        return self._set_at - self.time

    @property
    def waits(self) -> bool:
        """Whether the references have almost stopped before their end."""
        return self.rate < WAITS and self.time < float(self._path.times[-1])

    @property
    def end(self) -> float:
        """When [s] the end effector's reference ends, in its own time."""
        return float(self._path.times[-1])

    def waits_for(self, t: float) -> str:
        """Name of the obstacle nearest to the last plan, if it moves at ``t`` [s]: waiting for it ends by itself. Empty if it is static."""
        world, name = self._mpc.obstacles, self._mpc.clearance.other
        if world is None or not name:
            return ""
        return name if any(o.name == name and o.velocity.any() for o in world.snapshot(t).obstacles) else ""

    def pose(self, time: float) -> Array:
        """The end effector's reference pose (7) at ``time`` [s] of the paced references."""
        return self._path.at(time)

    def running(self, t: float) -> dict[str, Reference]:
        """The references from ``t`` [s] on if they did not have to wait again."""
        return {n: Reference(r.times - self.time + t, r.values, r.kind) for n, r in self._whole.items()}

    def detour(self, ways: Mapping[str, Reference], rejoin: float) -> None:
        """Follow the paths ``ways``, whose times [s] count from now, to the point of the references at ``rejoin`` [s] of their own time,
        and continue there. The rate of time is 1."""
        before = self.end
        for name, way in ways.items():
            times, values = self.time + way.times, way.values
            if name in self._whole:
                old = self._whole[name]
                later = old.times > rejoin
                times = np.concatenate([times, times[-1] + old.times[later] - rejoin])
                values = np.concatenate([values, old.values[later]])
            self._whole[name] = Reference(times, values, way.kind)
        self._path, self.rate = self._whole["end_effector"], 1.0
        self.detoured += self.end - before

    def missed(self, position: ArrayLike) -> float:
        """Distance [m] of a position (3) [m] from the end of the end effector's reference."""
        return float(np.linalg.norm(np.asarray(position, float) - self._path.values[-1, :3]))

    def advance(self, t: float, position: ArrayLike) -> None:
        """Set the references for updates from ``t`` [s] on; ``position`` (3) [m] of the end effector. Call it once before each update."""
        t = absolute_time("paced references", t)
        h = max(t - self._set_at, 0.0)
        self._set_at, self.time = t, self.time + self.rate * h
        target = self._target_rate(numbers("paced references", "position", position, 3))
        self.rate = float(np.clip(target, self.rate - FALL * h, self.rate + RISE * h))
        for name, whole in self._whole.items():
            self._mpc.reference[name] = self._ahead(whole, t)

    def _target_rate(self, position: Array) -> float:
        behind = float(np.linalg.norm(position - self._path.at(self.time)[:3]))
        near, lack = self._mpc.clearance, 0.0
        if near.frame:
            lack = max(-near.excess - TOLERATED, 0.0)
        share = float(np.clip((STANDING - behind) / (STANDING - FREE), 0.0, 1.0))
        return share * max(1.0 - lack / LACKING, 0.0)

    def _ahead(self, whole: Reference, t: float) -> Reference:
        """A reference as it will be if the rate stays."""
        if self.rate < STANDS:
            return Reference(np.array([t]), whole.at(self.time)[None], whole.kind)
        end = self.time + self.rate * (self._mpc.ocp.horizon + 2.0 * self._mpc.period)
        inner = (whole.times > self.time) & (whole.times < end)
        times = np.concatenate([[self.time], whole.times[inner], [end]])
        values = np.concatenate([whole.at(self.time)[None], whole.values[inner], whole.at(end)[None]])
        return Reference(t + (times - self.time) / self.rate, values, whole.kind)
