"""How the time of an iteration grows: with the intervals, the joints and the limits of a torque-driven arm."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Literal

import casadi as ca
import numpy as np

from wbmpc.benchmark.peers import peer_statistics, prepare
from wbmpc.benchmark.problems import Problem, suite_bench
from wbmpc.benchmark.race import ours
from wbmpc.model.tree import Frame
from wbmpc.ocp import Constraint, residuals, sets
from wbmpc.studies.race.multibody import Multibody
from wbmpc.studies.race.robots import rezero_bench, swerve_bench
from whole_race.crocoddyl_peer import crocoddyl_figures, torque_arm_spec
from whole_race.torque_arm import torque_arm

INTERVALS = (25, 50, 100, 200, 400)
JOINTS = (6, 12, 18)
LIMITS = {"boxes": (0, 12, 24, 36), "general": (12, 36)}
Note = Callable[[str], None]


def limited_arm(rows: int, kind: str, intervals: int = 50) -> Problem:
    """The arm of six joints with ``rows`` (a multiple of 12) hard limits per node: of single variables (``kind`` "boxes":
    torques, then rates, then angles), or "general": both sides of a slanted coordinate of a point on every link."""
    problem = torque_arm(6, intervals)
    groups: list[tuple[str, Any, float]] = []
    if kind == "boxes":
        slices = (lambda s: s.u, lambda s: s.x[6:], lambda s: s.x[:6])
        groups = [
            (name, f, w) for name, f, w in zip(("torque", "rate", "angle"), slices, (60.0, 20.0, 6.0), strict=True)
        ]
    else:
        dynamics = problem.ocp.dynamics
        assert isinstance(dynamics, Multibody)
        frames = [Frame(k, np.array([0.05, 0.05, 0.1]), np.eye(3)) for k in range(6)]

        def coordinate(s: Any, axis: int) -> Any:
            places = [dynamics.chain(s.x).frame_pose(f).position for f in frames]
            return ca.vertcat(*[p[axis] + 0.3 * p[(axis + 1) % 3] for p in places])

        groups = [(a, lambda s, i=i: coordinate(s, i), 2.0) for i, a in enumerate("xyz")]  # type: ignore[misc]
    for name, function, width in groups[: rows // 12]:
        box = sets.Box(-np.full(6, width), np.full(6, width))
        at: Literal["path", "path+terminal"] = "path" if name == "torque" else "path+terminal"
        problem.ocp.add(Constraint(f"{name}_limit", residuals.Expression(6, function), box, at=at, hard=True))
    return suite_bench(problem)


def _row(problem: Problem, solver: str, figures: dict[str, Any], **more: Any) -> dict[str, Any]:
    t = problem.solver.problem
    size = {"nx": t.nx, "nu": t.nu, "intervals": t.ocp.intervals}
    return {"problem": problem.name, "solver": solver, **size, **more, **figures}


def _all(problem: Problem, repeat: int, peers: Iterable[str], **more: Any) -> list[dict[str, Any]]:
    """Rows of our solver and the peers on one problem."""
    figures = ours(problem, repeat)[2]
    kept = ("iteration_ms", "success", "iterations", "how", "error")
    few = lambda f: {k: f[k] for k in kept if k in f}
    rows = [_row(problem, "wbmpc SQP", few(figures), **more)]
    names = list(peers)
    if names:
        prepared = prepare(problem)
        rows += [_row(problem, n, few(peer_statistics(n, prepared, problem)), **more) for n in names]
    return rows


def _crocoddyl(specs: list[tuple[Problem, dict[str, Any]]]) -> list[dict[str, Any]]:
    figures = crocoddyl_figures([spec for _, spec in specs])
    if isinstance(figures, str):
        return [_row(p, "crocoddyl", {"success": False, "error": figures}) for p, _ in specs]
    kept = ("iteration_ms", "success", "iterations", "error")
    return [_row(p, "crocoddyl", {k: f[k] for k in kept if k in f}) for (p, _), f in zip(specs, figures, strict=True)]


def over_intervals(repeat: int, peers: Iterable[str], note: Note) -> list[dict[str, Any]]:
    """The arm of six joints by all solvers, both robots by ours."""
    rows, specs = [], []
    for n in INTERVALS:
        note(f"{n} intervals")
        problem = suite_bench(torque_arm(6, n))
        rows += _all(problem, repeat, peers)
        specs.append((problem, torque_arm_spec(6, n)))
        rows += _all(swerve_bench(n), repeat, ()) + _all(rezero_bench(n, horizon=1.3), repeat, ())
    return rows + _crocoddyl(specs)


def over_joints(repeat: int, peers: Iterable[str], note: Note) -> list[dict[str, Any]]:
    """Arms of 6, 12 and 18 joints, 50 intervals."""
    rows, specs = [], []
    for joints in JOINTS:
        note(f"{joints} joints")
        problem = suite_bench(torque_arm(joints, 50))
        rows += _all(problem, repeat, peers, joints=joints)
        specs.append((problem, torque_arm_spec(joints, 50)))
    return rows + [{**r, "joints": r["nu"]} for r in _crocoddyl(specs)]


def over_limits(repeat: int, peers: Iterable[str], note: Note) -> list[dict[str, Any]]:
    """The arm of six joints with 0 to 36 hard limits per node. crocoddyl has no hard limits of this kind."""
    rows = []
    for kind, counts in LIMITS.items():
        for count in counts:
            note(f"{count} hard limits ({kind})")
            rows += _all(limited_arm(count, kind), repeat, peers, limits=count, kind=kind)
    return rows


def slope(rows: list[dict[str, Any]], by: str, solver: str = "wbmpc SQP", problem: str = "") -> float | None:
    """Exponent of the time over ``by``, from a straight line through the logarithms: 1 is linear."""
    chosen = [
        r
        for r in rows
        if r["solver"] == solver and r["problem"].startswith(problem) and "iteration_ms" in r and r[by] > 0
    ]
    if len(chosen) < 2:
        return None
    return float(np.polyfit(np.log([r[by] for r in chosen]), np.log([r["iteration_ms"] for r in chosen]), 1)[0])
