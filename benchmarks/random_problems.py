"""Random problems of every kind of constraint, solved by our solver and by IPOPT: do they agree?

Usage: python benchmarks/random_problems.py [--kind random|structured] [--seeds 0-149] [--show]

Every seed draws a system (one to six states, one to four inputs, sines and products), a grid of 1 to 100 intervals, costs, and
some of: hard bounds and rows, discs, obstacles, multiplier rows, barriers, equalities of every kind, switched modes; starts inside
and outside. Guesses are the start held. IPOPT gets the same discretized problem (``ipopt_baseline.py``) and is started where ours
ended (is that an optimum?) and from our guess (which optimum, or none?).
"""

from __future__ import annotations

import argparse
import collections
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np
import structured_problems
from ipopt_baseline import IpoptBaseline

from wbmpc.model.ode import Ode
from wbmpc.ocp import (
    AugmentedLagrangian,
    Constraint,
    Cost,
    Mode,
    ModeSchedule,
    OptimalControlProblem,
    RelaxedBarrier,
    SmoothL1,
    residuals,
    sets,
)
from wbmpc.solver import ILQR, SQP, Solution, Solver, Status

Rows = residuals.Expression
#: Costs [of 1 + |cost|] that count as equal, and violations that count as met.
SAME, MET = 1e-6, 1e-6


class Drawn(NamedTuple):
    """A problem, its start, its modes, and how it is solved."""

    ocp: OptimalControlProblem
    x0: np.ndarray
    schedule: ModeSchedule | None
    settings: SQP
    kind: str


# ---------------------------------------------------------------------- what is drawn
def _system(r: np.random.Generator, nx: int, nu: int, switched: bool) -> Ode:
    a, b = r.normal(size=(nx, nx)), r.normal(size=(nx, nu))
    a *= min(1.0, 2.0 / np.abs(np.linalg.eigvals(a)).max())
    c, d = 0.4 * r.normal(size=(nx, nx)), 0.2 * r.normal(size=(nx, nx)) * r.integers(0, 2)

    def f(x: ca.SX, u: ca.SX, w: ca.SX | None = None, m: ca.SX | None = None) -> ca.SX:
        gain = 1.0 if m is None else m[0]
        return ca.DM(a) @ x + gain * (ca.DM(b) @ u) + ca.DM(c) @ ca.sin(x) + ca.DM(d) @ x * u[0]

    names = lambda n: [str(i) for i in range(n)]
    return Ode({"x": names(nx)}, {"u": names(nu)}, f, mode={"m": ["gain"]} if switched else {})


def _hard(r: np.random.Generator, nx: int, nu: int, slack: float) -> list[Constraint]:
    """Bounds, straight rows, discs, obstacles."""
    u, x = float(10 ** r.uniform(-0.3, 1.0)), float(r.uniform(0.3, 1.5))
    mixed, center = r.normal(size=(1, nx + nu)), r.normal(size=min(nx, 2))
    all_of = lambda s: ca.vertcat(s.x, s.u)
    place = lambda s: s.x[: len(center)] - ca.DM(center)
    found = [
        (0.8, Constraint("u", Rows(nu, lambda s: s.u), sets.Box(-u, u), hard=True)),
        (0.5, Constraint("x", Rows(1, lambda s: s.x[:1]), sets.Box(-x, x), hard=True, at="path+terminal", slack=slack)),
        (0.3, Constraint("mixed", Rows(1, lambda s: ca.DM(mixed) @ all_of(s)), sets.Box(-2.0, 3.0), hard=True, slack=slack)),
        (0.15, Constraint("disc", Rows(1, lambda s: u * u - ca.sumsqr(s.u)), sets.NonNegative(), hard=True)),
        (0.15, Constraint("round", Rows(1, lambda s: 4.0 * x * x - ca.sumsqr(s.x)), sets.NonNegative(), hard=True, slack=slack)),
        (0.15, Constraint("away", Rows(1, lambda s: ca.sumsqr(place(s)) - 0.04), sets.NonNegative(), hard=True, slack=slack)),
    ]  # fmt: skip
    return [c for share, c in found if r.random() < share]


def _other(r: np.random.Generator, nx: int, nu: int, modes: tuple[str, ...] | None) -> list[Constraint]:
    """Multiplier rows, barriers, equalities; one of the kinds counts in one mode only."""
    m, rows = AugmentedLagrangian(float(10 ** r.uniform(0, 3))), r.normal(size=(2, nx + nu))
    bound = float(r.uniform(0.2, 2.0))
    barrier = RelaxedBarrier(float(10 ** r.uniform(-3, -1)), 0.05)
    straight = lambda s: ca.DM(rows[:1]) @ ca.vertcat(ca.sin(s.x), s.u) - 0.1
    found = [
        (0.2, Constraint("al", Rows(1, lambda s: bound - ca.sum1(s.u)), sets.NonNegative(), penalty=m, modes=modes)),
        (
            0.15,
            Constraint(
                "al x", Rows(1, lambda s: bound + s.x[nx - 1]), sets.NonNegative(), at="path+terminal", penalty=m
            ),
        ),
        (
            0.25,
            Constraint(
                "soft", Rows(1, lambda s: bound - s.x[0]), sets.NonNegative(), at="path+terminal", penalty=barrier
            ),
        ),
        (0.25 * (nu > 1), Constraint("eq", Rows(1, straight), modes=modes)),
        (0.1 * (nu > 1), Constraint("eq al", Rows(1, lambda s: s.u[0] - 0.3 * s.u[1] * ca.cos(s.x[0])), penalty=m)),
        (0.2, Constraint("end", Rows(1, lambda s: s.x[0] - 0.1), at="terminal")),
        (0.05, Constraint("hold", Rows(1, lambda s: s.x[nx - 1] - 0.05))),
    ]
    return [c for share, c in found if r.random() < share]


def draw(seed: int, kind: str = "random") -> Drawn:
    """The problem of a seed; ``kind`` "structured": see structured_problems.py."""
    if kind == "structured":
        ocp, start, own, what = structured_problems.draw(seed)
        return Drawn(ocp, start, None, own, what)
    r = np.random.default_rng(seed)
    nx, nu, n = int(r.integers(1, 7)), int(r.integers(1, 5)), int(r.choice([1, 2, 5, 10, 20, 50, 100]))
    switched, horizon = bool(r.random() < 0.25), float(r.uniform(0.3, 3.0))
    ocp = OptimalControlProblem(
        _system(r, nx, nu, switched), horizon, n, integrator="rk4" if r.random() < 0.3 else "rk2",
        first_interval=0.5 * horizon / n if n > 1 and r.random() < 0.4 else None,
        align_events=switched and n > 4 and bool(r.integers(0, 2)), modes=("a", "b") if switched else (),
    )  # fmt: skip
    curved = lambda s: ca.vertcat(s.x - 0.5, ca.sin(2.0 * s.x[0]) - s.x[nx - 1] ** 2)
    plain = lambda s: s.x - 0.5
    goal = Rows(nx + 1, curved) if r.random() < 0.3 else Rows(nx, plain)
    norm = {"norm": SmoothL1(0.3)} if r.random() < 0.2 else {}
    ocp.add(Cost("state", goal, float(10 ** r.uniform(-1, 2)), at="path+terminal", **norm))
    ocp.add(Cost("input", Rows(nu, lambda s: s.u), float(10 ** r.uniform(-3, 1))))
    modes = ("b",) if switched and r.random() < 0.5 else None
    for c in [*_hard(r, nx, nu, float(r.choice([10.0, 1e3, 1e5, np.inf]))), *_other(r, nx, nu, modes)]:
        ocp.add(c)
    schedule = None
    if switched:
        values = [Mode(name, {"m": (float(r.uniform(0.3, 1.5)),)}) for name in "aba"]
        schedule = ModeSchedule(tuple(values), tuple(np.sort(r.uniform(0.1, 0.9, 2)) * horizon))
    x0 = r.normal(size=nx) * r.choice([0.1, 0.5, 1.5])
    other: dict[str, Callable[[], SQP]] = {
        "SQP": SQP, "ILQR": ILQR, "filter": lambda: SQP(line_search="filter"), "exact": lambda: SQP(hessian="exact"),
    }  # fmt: skip
    how = str(r.choice(list(other), p=[0.7, 0.1, 0.1, 0.1]))
    how = "SQP" if how == "exact" and ocp.integrator == "rk4" else how
    terms = ", ".join(c.name for c in ocp.terms.values() if isinstance(c, Constraint))
    return Drawn(
        ocp, x0, schedule, other[how](), f"{how}, nx {nx}, nu {nu}, N {n}{', switched' if switched else ''}: {terms}"
    )


# ---------------------------------------------------------------------- who is right
def outcome(ours: Solution, other: IpoptBaseline, x0: np.ndarray) -> tuple[str, str]:
    """A class of outcomes, and what is to be said of this one."""
    cold = other.solve(other.vector(np.tile(x0, (other.n + 1, 1)), np.zeros((other.n, other.nu))), near=False)
    if ours.status not in (Status.CONVERGED, Status.RELAXED):
        warm = other.solve(other.vector(ours.x, ours.u), near=False) if np.isfinite(ours.x).all() else cold
        solved = [f for f in (cold, warm) if f.solved]
        said = f"{ours.status.name} after {ours.iterations}: {ours.detail[:140]}"
        if not solved:
            return "neither solves it", said
        said += f"; IPOPT {', '.join(f'{f.cost:.6g}' for f in solved)}"
        return f"{'called infeasible, ' if ours.status is Status.INFEASIBLE else ''}IPOPT solves it", said
    z = other.vector(ours.x, ours.u)
    outside, cost = other.outside(z), float(other.cost(z))
    if outside > 10.0 * MET:
        return "ours violates", f"{ours.status.name}, by {outside:.3g}"
    near = other.solve(z, near=True)
    scale = SAME * (1.0 + abs(cost))
    moved = np.abs(near.x - ours.x).max()
    said = f"{ours.status.name}, cost {cost:.9g}, IPOPT {near.cost:.9g} from there (moved {moved:.2g}, {near.kind})"
    said += f", {cold.cost:.9g} from the guess ({cold.kind})"
    if near.solved and near.cost < cost - scale:
        return "ours is no optimum", said
    if not near.solved and not (cold.solved and abs(cold.cost - cost) <= scale):
        return "IPOPT does not finish", said
    if (ours.status is Status.RELAXED) != (max(near.slack, 0.0) > 1e-5):
        return "wrong about giving way", f"{said}; IPOPT's slack {near.slack:.3g}"
    if cold.solved and cold.cost < cost - scale:
        return "same from there; IPOPT's own is better", said
    if not cold.solved or cold.cost > cost + scale:
        return "same from there; IPOPT's own is worse or none", said
    return "same", said


def attempt(drawn: Drawn, settings: SQP) -> tuple[Solver, Solution]:
    """Our solver's answer from the start held."""
    solver = Solver(drawn.ocp, settings, use_cache=False)
    if drawn.schedule is not None:
        solver.set_schedule(drawn.schedule)
    solver.warm_start(drawn.x0)
    return solver, solver.solve(drawn.x0)


def other_settings(drawn: Drawn) -> str:
    """Which settings of ours solve what the drawn ones do not."""
    others = {"1000 iterations": replace(drawn.settings, iterations=1000)}
    others["hessian='exact'"] = SQP(hessian="exact", iterations=300)
    for name, settings in others.items():
        if attempt(drawn, settings)[1].status in (Status.CONVERGED, Status.RELAXED):
            return f"; ours with {name}"
    return "; ours with nothing that was tried"


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", default="0-149")
    parser.add_argument("--kind", choices=("random", "structured"), default="random")
    parser.add_argument("--show", action="store_true", help="every problem, not only those that differ")
    given = parser.parse_args(arguments)
    first, _, last = given.seeds.partition("-")
    classes: collections.Counter[str] = collections.Counter()
    iterations: list[int] = []
    start = time.process_time()
    for seed in range(int(first), int(last or first) + 1):
        drawn = draw(seed, given.kind)
        solver, ours = attempt(drawn, drawn.settings)
        found, said = outcome(ours, IpoptBaseline(solver, drawn.x0), drawn.x0)
        if found.endswith("IPOPT solves it"):
            found += other_settings(drawn)
        classes[found] += 1
        iterations += [ours.iterations] if ours.status in (Status.CONVERGED, Status.RELAXED) else []
        if given.show or not found.startswith("same"):
            print(f"{seed} [{drawn.kind}] {found}: {said}", flush=True)
    print(f"{sum(classes.values())} problems, {time.process_time() - start:.0f} s of processor time")
    for name, count in classes.most_common():
        print(f"{count:5d}  {name}")
    if iterations:
        shares = f"median {np.median(iterations):g}, 95 % {np.percentile(iterations, 95):g}, most {max(iterations)}"
        print(f"iterations of ours: {shares}")
    else:
        print("none of ours converged")


if __name__ == "__main__":
    main(sys.argv[1:])
