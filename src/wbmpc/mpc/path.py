"""Progress along a path in an MPC: the path near every node of the next solve, and a plan's own progress where nothing measures it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from wbmpc.arrays import Array
from wbmpc.checks import not_negative, positive
from wbmpc.errors import InputError, unknown_name
from wbmpc.model.augment import WithPath
from wbmpc.mpc.guess import predicted
from wbmpc.mpc.policy import InputLimits, Policy
from wbmpc.ocp import OptimalControlProblem, Path, Reference
from wbmpc.ocp.symbols import FollowsPath
from wbmpc.solver import Solver, Trajectory

#: References along a path: values (n, width) at arc lengths s (n) [m].
Along = Callable[[Array], Array]
#: Near its end the desired speed falls in proportion to what is left [1/s]: that ends a plan softly, and without overshoot where a robot
#: brakes later than ``acceleration`` says.
ENDING = 6.0
#: Step [s] of progress that is foreseen.
STEP = 0.05


@dataclass(frozen=True)
class Following:
    """What is followed: see :meth:`PathProgress.follow`."""

    path: Path
    speed: Reference
    acceleration: float
    along: dict[str, Along] = field(default_factory=dict)

    def target(self, times: Array, s: Array) -> Array:
        """Of :class:`wbmpc.residuals.Progress` at ``times`` (n) [s] and progress s (n) [m]: (n, 3).

        v = √(2 a (left − a / 2 k²)), and k · left at the very end, if that is less than the speed that is asked for.
        """
        asked = np.array([float(self.speed.at(t)[0]) for t in times])
        left, a, k = np.maximum(self.path.end - s, 0.0), self.acceleration, ENDING
        soft = a / k**2
        root = np.sqrt(2.0 * a * np.maximum(left, soft) - a * soft)
        stop, slope = np.where(left < soft, k * left, root), np.where(left < soft, -k, -a / root)
        ends = stop < asked
        return np.stack([s, np.where(ends, stop, asked), np.where(ends, slope, 0.0)], axis=1)


class PathProgress:
    """The path of an MPC (``mpc.path``). ``active``: whether its problem has progress along one; ``dynamics``: what is observed and
    commanded, without it."""

    def __init__(self, ocp: OptimalControlProblem, solver: Solver, limits: InputLimits) -> None:
        self._solver, self.active = solver, isinstance(ocp.dynamics, WithPath)
        self.dynamics: Any = ocp.dynamics.dynamics if isinstance(ocp.dynamics, WithPath) else ocp.dynamics
        self._n, self._m = self.dynamics.state.size, self.dynamics.input.size
        terms = {name: term.residual for name, term in ocp.terms.items()}
        of = lambda what: [n for n, r in terms.items() if isinstance(r, FollowsPath) and r.follows == what]
        self._contours, self._speeds, self._accelerations = of("pose"), of("speed"), of("acceleration")
        self._references = [n for n in solver.problem.references.slices if n not in self._contours]
        follower: Any = terms[self._contours[0]] if self._contours else None
        #: The frame that follows the path, empty where the problem has no progress along one; whether it is the end effector's.
        self.frame = str(getattr(follower, "frame", ""))
        self.of_end_effector = getattr(getattr(follower, "robot", None), "tool", self.frame) == self.frame
        #: What is followed; None before :meth:`follow`.
        self.following: Following | None = None
        self._start: float | None = None
        self._t = 0.0  # when the last plan starts
        self._kept = np.any(limits.matrix[:, : self._m] != 0.0, axis=1) | ~self.active
        self.limits = limits if not self.active else self._own(limits)

    def _own(self, limits: InputLimits) -> InputLimits:
        m, kept = self._m, self._kept
        return InputLimits(limits.lower[:m], limits.upper[:m], limits.matrix[kept, :m], limits.offset[kept])

    # ------------------------------------------------------------------ what is followed
    def follow(
        self, path: Path, speed: float | Reference, acceleration: float = 1.0, *, start: float | None = 0.0,
        along: dict[str, Along] | None = None,
    ) -> None:  # fmt: skip
        """Follow ``path`` with ``speed`` [m/s] along it where limits and obstacles allow it, from ``start`` [m] of it on (None: from where
        progress is). ``speed`` may be a :class:`wbmpc.Reference` of one number over time; ``acceleration`` [m/s²]: the largest of progress.

        ``along``: references that go with the path, functions of arc lengths (n) [m] with values (n, width) by name. Another path needs
        no other compilation. Call it between two updates, and before the first one. Raises :class:`InputError` for a problem without a
        :class:`wbmpc.WithPath` and for values that cannot be meant.
        """
        if not self.active:
            raise InputError(
                "mpc.path.follow: the problem has no progress along a path; valid: one on wbmpc.WithPath(dynamics)"
            )
        if not isinstance(path, Path):
            raise InputError(f"mpc.path.follow: a Path is needed, got {type(path).__name__}")
        if not isinstance(speed, Reference):
            not_negative("mpc.path.follow", speed=speed)
            speed = Reference.constant([float(speed)])
        if speed.values.shape[1] != 1:
            raise InputError(
                f"mpc.path.follow: a reference of one speed is needed, got {speed.values.shape[1]} numbers"
            )
        positive("mpc.path.follow", acceleration=acceleration)
        if start is not None:
            not_negative("mpc.path.follow", start=start)
        for name in along or {}:
            if name not in self._references:
                raise unknown_name("reference", name, self._references, where="mpc.path.follow, along")
        with self._solver.exclusive:
            self._take(Following(path, speed, float(acceleration), dict(along or {})), start)

    def _take(self, following: Following, start: float | None) -> None:
        self.following = following
        if start is not None:
            self._start = float(start)
        begin = np.array([0.0 if start is None else start])
        for name in self._contours:
            self._solver.set_reference(name, Reference.constant(following.path.expansion(begin)))
        for name in self._speeds:
            self._solver.set_reference(name, Reference.constant(following.target(np.zeros(1), begin)))
        for name in self._accelerations:
            self._solver.set_reference(name, Reference.constant([following.acceleration]))

    # ------------------------------------------------------------------ in and out
    def wide(self, x: Array, delta: float = 0.0) -> Array:
        """A state or states (…, nx without the path) with progress: that of the last plan, ``delta`` [s] old, or where :meth:`follow` has
        set it."""
        x = np.asarray(x, float)
        if not self.active:
            return x
        plan = self._solver.trajectory(copy=False)
        own = np.array([np.interp(delta, plan.grid, plan.x[:, self._n + i]) for i in range(2)])
        if self._start is not None:
            own[0] = self._start
        return np.concatenate([x, np.broadcast_to(own, (*x.shape[:-1], 2))], axis=-1)

    def wide_input(self, u: Array) -> Array:
        """An input or inputs (…, nu without the path) with none along the path."""
        u = np.asarray(u, float)
        return np.concatenate([u, np.zeros((*u.shape[:-1], 1))], axis=-1) if self.active else u

    def begun(self) -> None:
        """A solve has started from the progress that :meth:`follow` has set."""
        self._start = None

    def own_policy(self, policy: Policy) -> Policy:
        """A policy on what is observed and commanded."""
        if not self.active:
            return policy
        n, m, kept = self._n, self._m, self._kept
        cut = lambda a: None if a is None or not kept.any() else a[..., kept]
        return replace(
            policy, x=policy.x[:, :n], u=policy.u[:, :m], gain=policy.gain[:, :m, :n], limits=self.limits,
            active=cut(policy.active), moving=cut(policy.moving),
        )  # fmt: skip

    # ------------------------------------------------------------------ before a solve
    def refresh(self, t: float, delta: float) -> None:
        """Expand the path for a solve at ``t`` [s] that goes on from a plan which is ``delta`` [s] old."""
        following = self.following
        if following is None:
            raise InputError(
                "mpc: there is no path to follow: mpc.path.follow(path, speed) comes before the first update"
            )
        self._t = t
        times, states = predicted(self._solver, t, delta)
        if self._start is not None:
            states = states.copy()
            states[:, self._n] += self._start - states[0, self._n]
        s = np.minimum(states[:, self._n], following.path.end)
        s = s if following.path.periodic else np.maximum(s, 0.0)
        expansion, target = following.path.expansion(s), following.target(times, s)
        for name in self._contours:
            self._solver.set_reference(name, Reference(times, expansion))
        for name in self._speeds:
            self._solver.set_reference(name, Reference(times, target))
        for name, values in following.along.items():
            self._solver.set_reference(name, Reference(times, values(s)))

    def progress(self, t: float) -> float:
        """Where the last plan is on the path [m] at time ``t`` [s]. Raises :class:`InputError` for a problem without a path."""
        if not self.active:
            raise InputError("mpc.path.progress: the problem has none; valid: one on wbmpc.WithPath(dynamics)")
        plan, since = self._solver.trajectory(copy=False), t - self._t
        if since < 0.0:
            return float(plan.x[0, self._n] + since * plan.x[0, self._n + 1])
        return float(np.interp(since, plan.grid, plan.x[:, self._n]))

    def desired(self, t: float, since: Array, most: tuple[Array, Array] | None = None) -> Array:
        """Progress (n) [m] at ``since`` (n) [s] after ``t`` [s] if nothing but the desired speed, the largest acceleration and ``most``
        limits it: progress (k) [m], rising, and the largest speed (k) [m/s] there."""
        following = self.following
        if following is None:
            raise InputError("mpc.path.desired: nothing is followed; valid: after mpc.path.follow(path, speed)")
        s = self.progress(t) if self._start is None else self._start
        speed, times, found = 0.0, np.append(np.arange(0.0, since.max() + STEP, STEP), np.inf), []
        for now in times[:-1]:
            found.append(s)
            target = float(following.target(np.array([t + now]), np.array([s]))[0, 1])
            if most is not None:
                target = min(target, *np.interp([s, s + speed * STEP], *most).tolist())
            speed = min(speed + following.acceleration * STEP, max(target, 0.0))
            s += speed * STEP
        return np.interp(since, times[:-1], found)

    def write(self, trajectory: Trajectory, way: Array) -> None:
        """Set progress in a guess: ``way`` (N + 1) [m] from where it starts."""
        h, (s, speed) = np.diff(trajectory.grid), trajectory.x[:, -2:].T  # the path is at the end of state and input
        s[:] = s[0] + way
        speed[:-1] = np.diff(way) / h
        speed[-1] = speed[-2]
        trajectory.u[:, -1] = np.diff(speed) / h

    def pose(self, t: float) -> Array:
        """Pose (7) on the path at that progress: position (3) [m] and quaternion (4)."""
        if self.following is None:
            raise InputError("mpc.path.pose: nothing is followed; valid: after mpc.path.follow(path, speed)")
        pose: Array = self.following.path.at([self.progress(t)])[0]
        return pose
