"""This solver against acados in turn on one core: cold starts to a common residual, one real-time iteration, and warm ticks.

acados' settings are searched for every measure (:data:`CHOICES`, one after the other) and its best count; ours are the defaults but
for the barrier parameter of ticks (:data:`BARRIERS`).
A tick costs a solver as many iterations as bring its first input within :data:`INPUT_ERRORS` of the converged one: at equal plan
quality. All start a tick from their own last plan, shifted, at the same states.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from time import process_time
from typing import Any

import numpy as np

from wbmpc.benchmark.peers import Measure, to_equal_residual, within
from wbmpc.benchmark.problems import Problem
from wbmpc.benchmark.program import Program, Samples, sampled
from wbmpc.benchmark.race import single_iteration
from wbmpc.solver import SQP, InteriorPoint
from wbmpc.studies.race.robots import rezero_bench, swerve_bench
from whole_race.acados_peer import Acados, AcadosProblem, NoAcados, Settings, build_description

Array = np.ndarray
Note = Callable[[str], None]
#: What is searched of acados, one after the other from the best so far; −2, −4: N / 2, N / 4 stages of the condensed QP.
CHOICES: dict[str, tuple[Any, ...]] = {
    "blocks": (0, -2, -4, 10, 5),
    "mode": ("SPEED_ABS", "SPEED", "BALANCE"),
    "mu0": (1.0, 1e2, 1e-1, 1e-2),
    "tolerance": (1e-8, 1e-6, 1e-4),
    "warm": (0, 1, 2),
    "merit": (False, True),
}
#: What is searched of ours.
BARRIERS = (1e-3, 1e-4, 1e-5)
#: A first input is right when it is this near to the converged one, as a share of the input's range.
INPUT_ERRORS = (1e-2, 1e-3)
#: Ticks of a closed loop, time between them [s], ticks between two disturbances, most iterations of a tick and of a cold start.
TICKS, PERIOD, EVERY, MOST, COLD = 100, 0.02, 20, 30, 60
#: A problem's figures take no longer than this [s].
SECONDS = 1800.0
#: Noise per tick of the states that are pushed: noise of wheel angles would make the rows of closed brakes contradict each other.
NOISE = 1e-4
#: Optimality and violation of what counts as a converged plan, whose input others are compared with.
SETTLED = 1e-5
#: Least factors that are wanted: median and worst warm tick, cold start.
MEDIAN, WORST, COLD_GOAL = 6.0, 4.0, 4.0


@dataclass(frozen=True)
class Scenario:
    """A closed loop: a problem, and what is pushed every ``EVERY`` ticks: a group of the state, which of its numbers, by how much,
    with random signs."""

    problem: str
    pushes: str
    make: Callable[[], Problem]
    push: tuple[str, tuple[int, ...], float]

    @property
    def name(self) -> str:
        return f"{self.problem}, {self.pushes}"


SCENARIOS = (
    Scenario("ball robot", "mild pushes", rezero_bench, ("base_velocity", (0, 1), 0.05)),
    Scenario("ball robot", "hard pushes", rezero_bench, ("base_velocity", (0, 1), 0.4)),
    Scenario("swerve, brakes open", "hard pushes", partial(swerve_bench, brakes="open"), ("base", (0, 1), 0.05)),
    Scenario("swerve, brakes closed", "hard pushes", swerve_bench, ("base", (0, 1), 0.05)),
)


# ---------------------------------------------------------------------- search
def search(score: Callable[[Settings], float], n: int, keys: tuple[str, ...]) -> tuple[Settings, float]:
    """The settings of least score (infinite: failed), one key after the other."""
    best, least = Settings(), np.inf
    for i, key in enumerate(keys):
        for value in CHOICES[key]:
            value = max(n // -value, 1) if key == "blocks" and value < 0 else value
            tried = replace(best, **{key: value})
            if i and tried == best:
                continue
            found = score(tried)
            if found < least:
                best, least = tried, found
    return best, least


# ---------------------------------------------------------------------- cold starts
def _guess(problem: Problem, n: int) -> tuple[Array, Array]:
    return np.tile(problem.x0, (n + 1, 1)), np.tile(problem.u0, (n, 1))


def cold_start(problem: Problem, shared: AcadosProblem, measure: Measure, repeat: int = 15) -> list[dict[str, Any]]:
    """From the common guess to the common residual: fewest iterations, then times in turn; ours first."""
    start = _guess(problem, shared.program.n)
    residual = lambda x, u: measure(x, u, problem.x0)

    def ours(iterations: int) -> Callable[[], tuple[float, Array, Array]]:
        few = single_iteration(problem.solver, *start, replace(problem.solver.settings, iterations=iterations))

        def solve() -> tuple[float, Array, Array]:
            few.warm_start(*start)
            few.reset()
            elapsed = processor_time(lambda: few.iterate(problem.x0))
            found = few.trajectory()
            return elapsed, found.x, found.u

        return solve

    def theirs(settings: Settings, iterations: int) -> Callable[[], tuple[float, Array, Array]]:
        solver = Acados(shared, settings, iterations)

        def solve() -> tuple[float, Array, Array]:
            solver.reset()
            solver.warm_start(*start)
            time = solver.solve(problem.x0)[1]
            return time, *solver.trajectory()

        return solve

    def fewest(make: Callable[[int], Callable[[], tuple[float, Array, Array]]]) -> dict[str, Any]:
        def attempt(iterations: int) -> tuple[float, Array, Array]:
            solve = make(iterations)
            return min((solve() for _ in range(3)), key=lambda found: found[0])

        return to_equal_residual(attempt, COLD, residual)

    settings, least = search(
        lambda s: fewest(partial(theirs, s)).get("equal_ms", np.inf),
        shared.program.n,
        ("blocks", "mode", "mu0", "tolerance", "merit"),
    )
    counts = [fewest(f).get("equal_iterations") for f in (ours, partial(theirs, settings))]
    if None in counts or not np.isfinite(least):
        return [{"iterations": c} for c in counts]
    runs = [ours(counts[0]), theirs(settings, counts[1])]
    times = np.array([[run()[0] for run in runs] for _ in range(repeat)])
    rows = [{"iterations": c, "ms": float(t)} for c, t in zip(counts, times.min(axis=0), strict=True)]
    rows[1]["settings"] = str(settings)
    return rows


def processor_time(call: Callable[[], Any]) -> float:
    """Of one call [ms]."""
    start = process_time()
    call()
    return 1e3 * (process_time() - start)


# ---------------------------------------------------------------------- one iteration
def one_iteration(problem: Problem, shared: AcadosProblem, x: Array, u: Array, repeat: int) -> list[dict[str, Any]]:
    """Preparation and feedback in one, at the solution (x, u); ours first."""
    single = single_iteration(problem.solver, x, u)

    def theirs(settings: Settings) -> Acados:
        solver = Acados(shared, settings, real_time=True)
        solver.warm_start(x, u)
        return solver

    def score(settings: Settings) -> float:
        solver = theirs(settings)
        return min(solver.solve(problem.x0)[1] for _ in range(max(repeat // 10, 5)))

    settings, _ = search(score, shared.program.n, ("blocks", "mode", "mu0", "tolerance", "warm"))
    solver, times = theirs(settings), np.empty((repeat, 2))
    single.iterate(problem.x0)
    for i in range(repeat):
        times[i] = processor_time(lambda: single.iterate(problem.x0)), solver.solve(problem.x0)[1]
    rows: list[dict[str, Any]] = [{"ms": float(t)} for t in times.min(axis=0)]
    rows[1]["settings"] = str(settings)
    return rows


# ---------------------------------------------------------------------- ticks
@dataclass(frozen=True)
class Loop:
    """A closed loop of converged inputs: states (K, nx), inputs (K, nu), first plan, parameters of every tick, inputs' ranges (nu)."""

    states: Array
    inputs: Array
    first: tuple[Array, Array]
    samples: list[Samples]
    scale: Array


def closed_loop(scenario: Scenario, problem: Problem, ticks: int = TICKS, seed: int = 0) -> Loop:
    """States under converged inputs, noise and pushes; a tick without a converged plan is an error."""
    solver, rng = problem.solver, np.random.default_rng(seed)
    group, which, size = scenario.push
    pushed = [problem.solver.ocp.dynamics.state[group].start + i for i in which]
    solver.warm_start(*_guess(problem, solver.problem.ocp.intervals))
    solver.reset()
    x, states, inputs, samples = np.array(problem.x0, float), [], [], []
    for k in range(ticks):
        if k and k % EVERY == 0:
            x[pushed] += size * rng.choice([-1.0, 1.0], len(which))
        found = solver.solve(x, k * PERIOD)
        if not max(found.kkt, found.violation) <= SETTLED:
            raise RuntimeError(f"{scenario.name}: no converged plan at tick {k}: {found.status.name}")
        if k == 0:
            first = (found.x.copy(), found.u.copy())
        states.append(x.copy())
        inputs.append(found.u[0].copy())
        samples.append(sampled(solver, k * PERIOD))
        x = solver.simulate(x, found.u[0], PERIOD)
        x[pushed] += NOISE * rng.normal(size=len(pushed))
    u = np.array(inputs)
    return Loop(np.array(states), u, first, samples, input_scale(problem, u))


def input_scale(problem: Problem, u: Array) -> Array:
    """Range of every input: of its limits, else of its values in the loop."""
    t = problem.solver.problem
    low, high = np.full(t.nu, -np.inf), np.full(t.nu, np.inf)
    for row in t.path.boxes:
        i = row.variable - t.nx
        if i >= 0:
            at = -row.offset / row.sign
            low[i], high[i] = (max(low[i], at), high[i]) if row.sign > 0.0 else (low[i], min(high[i], at))
    spread = np.maximum(np.ptp(u, axis=0), np.abs(u).max(axis=0))
    return np.where(np.isfinite(high - low), high - low, np.maximum(spread, 1e-3))


#: (tick, whether it begins) → (milliseconds of a call, its iterations, first input)
Iterate = Callable[[int, bool], tuple[float, int, Array]]


def _pass(loop: Loop, iterate: Iterate, error: float) -> tuple[Array, Array, Array]:
    """Milliseconds and iterations of all ticks but the first, and which of them came within ``error``."""
    times, counts, met = np.zeros(len(loop.states)), np.zeros(len(loop.states), int), np.zeros(len(loop.states), bool)
    for k in range(1, len(loop.states)):
        near = False
        while not near and counts[k] < MOST:
            elapsed, done, u = iterate(k, counts[k] == 0)
            times[k] += elapsed
            counts[k] += done
            near = bool(np.all(np.abs(u - loop.inputs[k]) <= error * loop.scale))
        met[k] = near
    return times[1:], counts[1:], met[1:]


def our_iterations(problem: Problem, loop: Loop, barrier: float) -> Iterate:
    """A real-time solve per call from the shifted last plan, with as many iterations as it does by itself."""
    settings = SQP.real_time(interior_point=InteriorPoint("real_time", barrier))
    single = single_iteration(problem.solver, *loop.first, settings)
    for _ in range(5):  # its own multipliers
        single.iterate(loop.states[0])
    plan = single.trajectory(copy=False)

    def iterate(k: int, begins: bool) -> tuple[float, Array]:
        elapsed = processor_time(lambda: single.iterate(loop.states[k], k * PERIOD, PERIOD if begins else 0.0))
        return elapsed, single.effort.directions, plan.u[0]

    return iterate


def their_iterations(shared: AcadosProblem, loop: Loop, settings: Settings) -> Iterate:
    """The same of acados; its guess is shifted and its parameters are set outside of the time that counts."""
    solver = Acados(shared, settings, real_time=True)
    solver.warm_start(*loop.first)
    for _ in range(5):
        solver.solve(loop.states[0])
    times = np.concatenate([[0.0], np.cumsum(shared.program.samples.h)])

    def iterate(k: int, begins: bool) -> tuple[float, Array]:
        if begins:
            x, u = solver.trajectory()
            later = np.minimum(times + PERIOD, times[-1])
            moved = np.stack([np.interp(later, times, column) for column in x.T], axis=1)
            held = np.minimum(np.searchsorted(times, later[:-1] + 1e-9, side="right") - 1, len(u) - 1)
            solver.warm_start(moved, u[held])
            solver.set_parameters(loop.samples[k])
        elapsed = solver.solve(loop.states[k])[1]
        return elapsed, 1, solver.trajectory()[1][0]

    return iterate


def _summary(found: list[tuple[Array, Array, Array]], of: Array | None = None) -> dict[str, Any]:
    """Of passes through the same ticks: the least time of every tick counts, for others may use the machine.

    ``of``: the ticks (K,) of median and worst; all that were met when left out. None where there is none."""
    times, counts, met = np.min([f[0] for f in found], axis=0), found[0][1], found[0][2]
    of, out = met if of is None else of, {"missed": int((~met).sum())}
    if not of.any():
        return {**out, "median_ms": None, "worst_ms": None, "iterations_median": None, "iterations_worst": None}
    times, counts = times[of], counts[of]
    out |= {"median_ms": float(np.median(times)), "worst_ms": float(times.max())}
    return {**out, "iterations_median": float(np.median(counts)), "iterations_worst": int(counts.max())}


def tick_race(
    problem: Problem, shared: AcadosProblem, loop: Loop, error: float, passes: int = 3
) -> list[dict[str, Any]]:
    """Median and worst tick to the same error of the first input, of those that both meet, and how many each misses; ours first."""
    tried: list[tuple[Settings, dict[str, Any]]] = []

    def merit(iterate: Iterate) -> tuple[float, dict[str, Any]]:
        # plans that come too late are none: a setting that misses more is worse whatever it costs
        summary = _summary([_pass(loop, iterate, error)])
        return (summary["median_ms"] or 0.0) + 1e3 * summary["missed"], summary

    def score(settings: Settings) -> float:
        found, summary = merit(their_iterations(shared, loop, settings))
        tried.append((settings, summary))
        return found

    barrier = min(BARRIERS, key=lambda b: merit(our_iterations(problem, loop, b))[0])

    settings, _ = search(score, shared.program.n, ("blocks", "mode", "mu0", "tolerance", "warm"))
    fewest = min(s["missed"] for _, s in tried)
    worst = min((t for t in tried if t[1]["missed"] == fewest), key=lambda t: t[1]["worst_ms"] or np.inf)[0]
    found: dict[str, list[tuple[Array, Array, Array]]] = {"ours": [], "median": [], "worst": []}
    for _ in range(passes):
        found["ours"].append(_pass(loop, our_iterations(problem, loop, barrier), error))
        found["median"].append(_pass(loop, their_iterations(shared, loop, settings), error))
        if worst != settings:
            found["worst"].append(_pass(loop, their_iterations(shared, loop, worst), error))
    found["worst"] = found["worst"] or found["median"]
    # a tick that one of them misses has no equal error: it is counted, not timed
    both = np.logical_and.reduce([runs[0][2] for runs in found.values()])
    theirs, other = _summary(found["median"], both), _summary(found["worst"], both)
    if both.any() and other["worst_ms"] < theirs["worst_ms"]:  # the best of either count
        theirs |= {"worst_ms": other["worst_ms"], "iterations_worst": other["iterations_worst"]}
    ours = {**_summary(found["ours"], both), "settings": f"barrier={barrier:g}"}
    return [ours, {**theirs, "settings": str(settings), "settings_worst": str(worst)}]


# ---------------------------------------------------------------------- all
def _pair(rows: list[dict[str, Any]], key: str) -> dict[str, Any]:
    """Both rows, and how many times faster ours is; None where one of them has no time."""
    own, peer = (r.get(key) for r in rows)
    return {"ours": rows[0], "acados": rows[1], "ratio": peer / own if own and peer else None}


def problem_figures(scenarios: list[Scenario], repeat: int) -> dict[str, Any]:
    """All figures of scenarios of one problem."""
    problem = scenarios[0].make()
    shared = AcadosProblem(Program(problem.solver))
    measure, name = Measure(shared.program), problem.name
    out: dict[str, Any] = {
        "cold": [{"problem": name, **_pair(cold_start(problem, shared, measure), "ms")}],
        "ticks": [],
    }
    start = _guess(problem, shared.program.n)
    problem.solver.warm_start(*start)
    problem.solver.reset()
    solution = problem.solver.solve(problem.x0)
    rows = one_iteration(problem, shared, solution.x.copy(), solution.u.copy(), repeat)
    out["iteration"] = [{"problem": name, **_pair(rows, "ms")}]
    for scenario in scenarios:
        loop = closed_loop(scenario, problem)
        for error in INPUT_ERRORS:
            both = tick_race(problem, shared, loop, error)
            ratios = {f"{k}_ratio": _pair(both, f"{k}_ms")["ratio"] for k in ("median", "worst")}
            out["ticks"].append({"scenario": scenario.name, "error": error, **_pair(both, "median_ms"), **ratios})
    return out


def acados_race(repeat: int = 200, note: Note = lambda text: None) -> dict[str, Any]:
    """Figures of all scenarios, build and flags; ``error``: why there are none."""
    try:
        out: dict[str, Any] = {"build": build_description(), "cold": [], "iteration": [], "ticks": []}
    except NoAcados as missing:
        return {"error": str(missing)}
    groups: dict[str, list[Scenario]] = {}
    for scenario in SCENARIOS:
        groups.setdefault(scenario.problem, []).append(scenario)
    for scenarios in groups.values():
        note(f"acados: {scenarios[0].problem}")
        found = within(SECONDS, problem_figures, scenarios, repeat)
        if isinstance(found, str):
            out.setdefault("errors", []).append({"problem": scenarios[0].problem, "error": found})
            continue
        for key, rows in found.items():
            out[key] += rows
    return out


def goals(figures: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows for the race's goals."""
    rows = [
        (f"{r['problem']}: cold start, times faster than acados", r["ratio"], COLD_GOAL)
        for r in figures.get("cold", [])
    ]
    for r in figures.get("ticks", []):
        if r["error"] == INPUT_ERRORS[0]:
            rows.append((f"{r['scenario']}: median tick, times faster than acados", r["median_ratio"], MEDIAN))
            rows.append((f"{r['scenario']}: worst tick, times faster than acados", r["worst_ratio"], WORST))
    return [{"what": w, "value": v, "goal": g, "met": None if v is None else v >= g} for w, v, g in rows]
