"""Random problems of every kind of constraint, solved by our solver and by IPOPT: do they agree?

Usage: python benchmarks/random_problems.py [--seeds 0-149] [--show]

Every seed draws a system (one to six states, one to four inputs, sines and products), a grid of 1 to 100 intervals, costs, and some of:
hard bounds and rows, discs, obstacles, multiplier rows, barriers, equalities of every kind, switched modes; starts inside and outside.
Nothing is tuned to the seed, guesses are the start held. IPOPT gets the same discretised problem, with the L1 slacks of hard state
rows as unknowns of its own. It is started where ours ended (is that an optimum?) and from our guess (which optimum, or none?).
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

from wbmpc.benchmark.program import Stages, sampled
from wbmpc.model import Equations
from wbmpc.ocp import (
    AugmentedLagrangian, Constraint, Cost, Mode, ModeSchedule, OptimalControlProblem, RelaxedBarrier, SmoothL1, residuals, sets,
)  # fmt: skip
from wbmpc.ocp.rows import Kind, Place
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
    told: str


# ---------------------------------------------------------------------- what is drawn
def _system(r: np.random.Generator, nx: int, nu: int, switched: bool) -> Equations:
    a, b = r.normal(size=(nx, nx)), r.normal(size=(nx, nu))
    a *= min(1.0, 2.0 / np.abs(np.linalg.eigvals(a)).max())
    c, d = 0.4 * r.normal(size=(nx, nx)), 0.2 * r.normal(size=(nx, nx)) * r.integers(0, 2)

    def f(x: ca.SX, u: ca.SX, w: ca.SX | None = None, m: ca.SX | None = None) -> ca.SX:
        gain = 1.0 if m is None else m[0]
        return ca.DM(a) @ x + gain * (ca.DM(b) @ u) + ca.DM(c) @ ca.sin(x) + ca.DM(d) @ x * u[0]

    names = lambda n: [str(i) for i in range(n)]
    return Equations({"x": names(nx)}, {"u": names(nu)}, f, mode={"m": ["gain"]} if switched else {})


def _hard(r: np.random.Generator, nx: int, nu: int, slack: float) -> list[Constraint]:
    """Bounds, straight rows, discs, obstacles."""
    u, x = float(10 ** r.uniform(-0.3, 1.0)), float(r.uniform(0.3, 1.5))
    mixed, center = r.normal(size=(1, nx + nu)), r.normal(size=min(nx, 2))
    all_of = lambda s: ca.vertcat(s.x, s.u)
    place = lambda s: s.x[: len(center)] - ca.DM(center)
    found = [
        (0.8, Constraint("u", Rows(nu, lambda s: s.u), sets.Box(-u, u), hard=True)),
        (0.5, Constraint("x", Rows(1, lambda s: s.x[:1]), sets.Box(-x, x), hard=True, at="all", slack=slack)),
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
        (0.15, Constraint("al x", Rows(1, lambda s: bound + s.x[nx - 1]), sets.NonNegative(), at="all", penalty=m)),
        (0.25, Constraint("soft", Rows(1, lambda s: bound - s.x[0]), sets.NonNegative(), at="all", penalty=barrier)),
        (0.25 * (nu > 1), Constraint("eq", Rows(1, straight), modes=modes)),
        (0.1 * (nu > 1), Constraint("eq al", Rows(1, lambda s: s.u[0] - 0.3 * s.u[1] * ca.cos(s.x[0])), penalty=m)),
        (0.2, Constraint("end", Rows(1, lambda s: s.x[0] - 0.1), at="terminal")),
        (0.05, Constraint("hold", Rows(1, lambda s: s.x[nx - 1] - 0.05))),
    ]
    return [c for share, c in found if r.random() < share]


def draw(seed: int) -> Drawn:
    """The problem of a seed."""
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
    ocp.add(Cost("state", goal, float(10 ** r.uniform(-1, 2)), at="all", **norm))
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
    return Drawn(ocp, x0, schedule, other[how](), f"{how}, nx {nx}, nu {nu}, N {n}{', switched' if switched else ''}: {terms}")


# ---------------------------------------------------------------------- the same for IPOPT
class Found(NamedTuple):
    """What IPOPT says: whether it solved, cost, trajectories, the largest L1 slack."""

    solved: bool
    cost: float
    x: np.ndarray
    u: np.ndarray
    slack: float
    told: str


def _closed(place: Place) -> list[float]:
    """Weight of the L1 slack of every row; infinite where there is none."""
    return [r.penalty if r.kind is Kind.HARD else np.inf for r in place.rows]


class Rival:
    """The discretised problem of a solver that has sampled its modes, for IPOPT. Unknowns: stages (x, u, slacks), the end (x, slacks)."""

    def __init__(self, solver: Solver, x0: np.ndarray) -> None:
        t, s = solver.problem, sampled(solver)
        stages, n, nx, nu = Stages(t), t.ocp.intervals, t.nx, t.nu
        self.n, self.nx, self.nu = n, nx, nu
        path, end = _closed(t.path), _closed(t.end)
        self.p, self.e = [i for i, c in enumerate(path) if np.isfinite(c)], [i for i, c in enumerate(end) if np.isfinite(c)]
        self.weights = np.array([path[i] for i in self.p]), np.array([end[i] for i in self.e])
        self.h, local = s.h, nx + t.equality.shape[0]
        zs, last = ca.MX.sym("z", nx + nu + len(self.p), n), ca.MX.sym("last", nx + len(self.e))
        x, u, slack = zs[:nx, :], zs[nx : nx + nu, :], zs[nx + nu :, :]
        given = [x, u, ca.DM(s.p[:-1].T), ca.repmat(ca.DM(s.w), 1, n), ca.DM(s.h[None, :])]
        rows = stages.constraint().map(n)(*given)
        cost = ca.sum2(stages.cost().map(n)(*given)) + stages.end()[0](last[:nx], ca.DM(s.p[-1]), ca.DM(s.w))
        for i, row in enumerate(self.p):
            rows[local + row, :] += slack[i, :]
            cost += path[row] * ca.dot(ca.DM(s.h), slack[i, :].T)
        ends = stages.end_rows()[0](last[:nx], ca.DM(s.p[-1]), ca.DM(s.w))
        for i, row in enumerate(self.e):
            ends[row] += last[nx + i]
            cost += end[row] * last[nx + i]
        gaps = rows[:nx, :] + ca.horzcat(x[:, 1:], last[:nx])
        g = ca.vertcat(x[:, 0] - x0, ca.vec(ca.vertcat(gaps, rows[nx:, :])), ends)
        equal = np.array([True] * local + [r.kind is Kind.EQUAL for r in t.path.rows])
        upper = np.tile(np.where(equal, 0.0, np.inf), (n, 1))
        lower = np.zeros_like(upper)
        for i, row in enumerate(t.path.rows):  # the measured state is as it is
            if row.state_only:
                lower[0, local + i], upper[0, local + i] = -np.inf, np.inf
        tail = np.where([r.kind is Kind.EQUAL for r in t.end.rows], 0.0, np.inf)
        self.upper = np.concatenate([np.zeros(nx), upper.ravel(), tail])
        self.lower = np.concatenate([np.zeros(nx), lower.ravel(), np.zeros(len(tail))])
        unknowns = ca.vertcat(ca.vec(zs), last)
        self.least = np.concatenate([
            np.tile(np.concatenate([np.full(nx + nu, -np.inf), np.zeros(len(self.p))]), n),
            np.full(nx, -np.inf), np.zeros(len(self.e)),
        ])  # fmt: skip
        self.rows = ca.Function("rows", [unknowns], [g])
        self.cost = ca.Function("cost", [unknowns], [cost])
        self.program = {"x": unknowns, "f": cost, "g": g}

    def vector(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Trajectories as unknowns, with the slacks that they need."""
        table = np.hstack([x[:-1], u, np.zeros((self.n, len(self.p)))])
        z = np.concatenate([table.ravel(), x[-1], np.zeros(len(self.e))])
        g = np.array(self.rows(z)).ravel()
        width = (len(g) - self.nx - self.end_size) // self.n
        rows = g[self.nx : self.nx + self.n * width].reshape(self.n, width)
        hard = width - self.path_size
        table[:, self.nx + self.nu :] = np.maximum(-rows[:, [hard + i for i in self.p]], 0.0)
        if self.p:
            first = np.isneginf(self.lower[self.nx : self.nx + width])[[hard + i for i in self.p]]
            table[0, self.nx + self.nu :][first] = 0.0
        ends = g[len(g) - self.end_size :]
        return np.concatenate([table.ravel(), x[-1], np.maximum(-ends[self.e], 0.0)])

    path_size: int
    end_size: int

    def solve(self, z: np.ndarray, near: bool) -> Found:
        """From ``z``; ``near``: it is thought to be a solution."""
        options = {"print_time": 0, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.max_iter": 1000, "ipopt.tol": 1e-9}
        options |= {"ipopt.bound_relax_factor": 0.0, "ipopt.max_cpu_time": 30.0, "ipopt.constr_viol_tol": 1e-8}
        if near:
            options |= {"ipopt.mu_init": 1e-6, "ipopt.bound_push": 1e-7, "ipopt.slack_bound_push": 1e-7}
        other = ca.nlpsol("other", "ipopt", self.program, options)
        found = other(x0=z, lbx=self.least, ubx=np.inf, lbg=self.lower, ubg=self.upper)
        end = np.array(found["x"]).ravel()
        cut = self.n * (self.nx + self.nu + len(self.p))
        table, last = end[:cut].reshape(self.n, -1), end[cut:]
        slack = max([0.0, *table[:, self.nx + self.nu :].ravel(), *last[self.nx :]])
        x = np.vstack([table[:, : self.nx], last[: self.nx]])
        return Found(
            bool(other.stats()["success"]), float(found["f"]), x, table[:, self.nx : self.nx + self.nu], float(slack),
            str(other.stats()["return_status"]),
        )  # fmt: skip


def rival(solver: Solver, x0: np.ndarray) -> Rival:
    """The problem as the solver has last seen it."""
    found = Rival(solver, x0)
    found.path_size, found.end_size = len(solver.problem.path.rows), len(solver.problem.end.rows)
    return found


# ---------------------------------------------------------------------- who is right
def verdict(ours: Solution, other: Rival, x0: np.ndarray) -> tuple[str, str]:
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
    g = np.array(other.rows(z)).ravel()
    outside = float(np.maximum(np.maximum(other.lower - g, g - other.upper), 0.0).max())
    cost = float(other.cost(z))
    if outside > 10.0 * MET:
        return "ours violates", f"{ours.status.name}, by {outside:.3g}"
    near = other.solve(z, near=True)
    scale = SAME * (1.0 + abs(cost))
    moved = np.abs(near.x - ours.x).max()
    said = f"{ours.status.name}, cost {cost:.9g}, IPOPT {near.cost:.9g} from there (moved {moved:.2g}, {near.told}), {cold.cost:.9g} cold ({cold.told})"
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
    solver.guess(drawn.x0)
    return solver, solver.solve(drawn.x0)


def other_settings(drawn: Drawn) -> str:
    """Which settings of ours solve what the drawn ones do not."""
    others = {"1000 iterations": replace(drawn.settings, iterations=1000)}
    if drawn.ocp.integrator == "rk2":
        others["hessian='exact'"] = SQP(hessian="exact", iterations=300)
    for name, settings in others.items():
        if attempt(drawn, settings)[1].status in (Status.CONVERGED, Status.RELAXED):
            return f"; ours with {name}"
    return "; ours with nothing that was tried"


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", default="0-149")
    parser.add_argument("--show", action="store_true", help="every problem, not only those that differ")
    given = parser.parse_args(arguments)
    first, _, last = given.seeds.partition("-")
    classes: collections.Counter[str] = collections.Counter()
    iterations: list[int] = []
    start = time.process_time()
    for seed in range(int(first), int(last or first) + 1):
        drawn = draw(seed)
        solver, ours = attempt(drawn, drawn.settings)
        found, said = verdict(ours, rival(solver, drawn.x0), drawn.x0)
        if found.endswith("IPOPT solves it"):
            found += other_settings(drawn)
        classes[found] += 1
        iterations += [ours.iterations] if ours.status in (Status.CONVERGED, Status.RELAXED) else []
        if given.show or not found.startswith("same"):
            print(f"{seed} [{drawn.told}] {found}: {said}", flush=True)
    print(f"{sum(classes.values())} problems, {time.process_time() - start:.0f} s of processor time")
    for name, count in classes.most_common():
        print(f"{count:5d}  {name}")
    print(f"iterations of ours: median {np.median(iterations):g}, 95 % {np.percentile(iterations, 95):g}, most {max(iterations)}")


if __name__ == "__main__":
    main(sys.argv[1:])
