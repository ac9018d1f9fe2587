"""Hard limits in closed loop: both robots in scenarios that press against them, by variants of the solver.

Usage: python benchmarks/hard_limits.py [--seeds 300-319] [--few 10] [--scenarios NAME …] [--variants NAME …] [--out DIR]
Runs that DIR/runs.jsonl already has of this source are not done again, so that an interrupted study goes on where it was.
Seeds 0 to 9 were used for tuning; 200 to 219 are for reporting. docs/results/limits-and-race.md explains the figures.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import multiprocessing
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from limit_figure import write_figure
from limit_scenarios import SCENARIOS, VARIANTS, Rig, Variant
from rich.console import Console
from rich.table import Table

import wbmpc
from wbmpc.bases.swerve.plant import STEER_SPEED
from wbmpc.benchmark.race import iteration_times
from wbmpc.report import versions
from wbmpc.simulation.lockstep import run_lockstep
from wbmpc.solver.solution import COLUMNS

#: What counts as outside a limit [share of the range].
OUTSIDE = 1e-3
#: Figure: (heading, unit, factor, goal for the worst run or None); less is better.
FIGURES: dict[str, tuple[str, str, float, float | None]] = {
    "command_excess": ("commands over", "%", 100.0, 1e-3),
    "acceleration_excess": ("accelerations over", "%", 100.0, 1e-3),
    "plan_input_excess": ("planned inputs over", "%", 100.0, 1e-3),
    "plan_state_excess": ("planned states over", "%", 100.0, 1e-3),
    "state_excess": ("states over", "%", 100.0, None),
    "return_time": ("states back after", "s", 1.0, 0.5),
    "clamped": ("ticks clamped", "%", 100.0, 0.01),
    "failed": ("failed", "", 1.0, 0.0),
    "hand_error": ("end effector error", "mm", 1e3, None),
    "stalled": ("solves stalled", "%", 100.0, None),
    "iterations": ("iterations", "", 1.0, None),
}
#: A solve whose last step was cut below this has stalled.
STALLED = 0.1
Runs = dict[str, dict[str, list[dict[str, float]]]]
Job = tuple[str, str, int]


class Bounds:
    """Excess over bounds (n) as a share of the range; open bounds are left out."""

    def __init__(self, lower: np.ndarray, upper: np.ndarray) -> None:
        self.index = np.flatnonzero(np.isfinite(upper - lower))
        self.lower, self.upper = lower[self.index], upper[self.index]

    def excess(self, values: np.ndarray) -> np.ndarray:
        """For (…, n): how far each is outside, 0 inside."""
        v, width = values[..., self.index], self.upper - self.lower
        return np.maximum(np.maximum(v - self.upper, self.lower - v), 0.0) / width


@dataclass
class Recorder:
    """Figures of one run, gathered at every controller tick."""

    rig: Rig
    times: list[float] = field(default_factory=list)
    command: list[float] = field(default_factory=list)
    clamped: list[float] = field(default_factory=list)
    acceleration: float = 0.0
    state: list[np.ndarray] = field(default_factory=list)
    plan_state: float = 0.0
    plan_input: float = 0.0
    error: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        limits = self.rig.robot.limits
        self.x = Bounds(limits.state_lower, limits.state_upper)
        self.u = Bounds(limits.input_lower, limits.input_upper)
        self.swerve = self.rig.robot.description.base.type == "swerve"
        self.drive = self.u
        if self.swerve:  # the planner leaves the steering servo a reserve up to the drives' own limit
            upper = limits.input_upper.copy()
            upper[self.rig.robot.input["steer"]] = STEER_SPEED
            self.drive = Bounds(-upper, upper)
        self._plan: Any = None
        self._last: np.ndarray | None = None
        self._pending = sorted(self.rig.events, key=lambda e: e[0])

    def __call__(self, t: float, command: Any, plans: Any) -> None:
        """One tick; also lets the events happen that are due."""
        while self._pending and self._pending[0][0] <= t + 1e-9:
            self._pending.pop(0)[1]()
        rig, plan = self.rig, plans.current
        if plan is not self._plan:
            self._plan = plan
            self.plan_state = max(self.plan_state, float(self.x.excess(plan.x[1:]).max()))
            self.plan_input = max(self.plan_input, float(self.u.excess(plan.u).max()))
        self.times.append(t)
        planned = float(self.u.excess(plan.feedforward(self._clock(t))).max())
        self.command.append(max(planned, float(self.drive.excess(self._sent(command)).max())))
        self.clamped.append(self._cut(command))
        self._accelerate(command)
        self.state.append(self.x.excess(self._measured()))
        if len(self.times) % 4 == 0:
            self.error.append(float(np.linalg.norm(self._end_effector() - rig.goal(t))))

    def _accelerate(self, command: Any) -> None:
        """Excess of what the drives' commands change by from tick to tick over what accelerations allow (swerve robot)."""
        if not self.swerve:
            return
        given, maximum = self.rig.robot.input, self.rig.robot.limits.input_rate * self.rig.timing.period
        now = np.concatenate([command.steer, command.wheel, command.arm])
        if self._last is not None:
            allowed = np.concatenate([maximum[given[g]] for g in ("steer", "wheel", "arm")])
            self.acceleration = max(self.acceleration, float(np.max(np.abs(now - self._last) / allowed)) - 1.0)
        self._last = now

    def _clock(self, t: float) -> float:
        """The plan's time: a swerve robot's runs ahead by the drives' lag."""
        return t + self.rig.controller.tracking.settings.lag if self.swerve else t

    def _target(self) -> np.ndarray:
        return self.rig.controller.target[: self.rig.robot.input.size]

    def _cut(self, command: Any) -> float:
        """Share of the range by which the command differs from what feedback or steering servo asked for."""
        if self.swerve:
            return float(self.drive.excess(self._target()).max())
        width = (self.drive.upper - self.drive.lower)[: command.torque.size]
        return float(np.max(np.abs(command.torque - self._target()[: command.torque.size]) / width))

    def _sent(self, command: Any) -> np.ndarray:
        if not self.swerve:
            return command.torque
        given, out = self.rig.robot.input, self._target().copy()
        out[given["wheel"]], out[given["steer"]], out[given["arm"]] = command.wheel, command.steer, command.arm
        return out

    def _measured(self) -> np.ndarray:
        """The state as the sensors give it; of the ball robot without its noise."""
        if self.swerve:
            return self.rig.controller.state()
        return self.rig.plant.state() + self.rig.plant.offset

    def _end_effector(self) -> np.ndarray:
        """End effector position; of the swerve robot in its estimated frame."""
        truth = self.rig.plant.truth()
        if not self.swerve:
            return truth.tool
        x, y, yaw = self.rig.controller.estimator.odometry.pose
        c, s = np.cos(yaw), np.sin(yaw)
        along, across, _ = truth.tool_in_base
        return np.array([x + c * along - s * across, y + s * along + c * across, truth.tool[2]])


class Solves:
    """Iterations and last step length of every update of the rig's MPC."""

    def __init__(self, rig: Rig) -> None:
        self.counts: list[int] = []
        self.steps: list[float] = []
        solver = rig.mpc.solver
        solve = solver.iterate

        def noted(x0: np.ndarray, t0: float = 0.0, delta: float = 0.0) -> tuple[int, int]:
            status, count = solve(x0, t0, delta)
            self.counts.append(count)
            self.steps.append(float(solver.log[count - 1, COLUMNS["alpha"]]))
            return status, count

        solver.iterate = noted  # type: ignore[method-assign]


def longest(outside: np.ndarray, period: float) -> float:
    """Longest time [s] that any column of (ticks, states) stays outside."""
    maximum = 0
    for column in outside.T:
        edges = np.flatnonzero(np.diff(np.concatenate([[0], column.astype(int), [0]])))
        if edges.size:
            maximum = max(maximum, int(np.max(edges[1::2] - edges[::2])))
    return maximum * period


def run(scenario: str, variant: Variant, seed: int) -> dict[str, float]:
    """Figures of one run."""
    rig = SCENARIOS[scenario](variant, seed)
    record, solves = Recorder(rig), Solves(rig)
    ending = run_lockstep(rig.plant, rig.controller, rig.mpc, rig.timing, rig.duration, record)
    state = np.array(record.state)
    return {
        "command_excess": max(record.command),
        "acceleration_excess": record.acceleration,
        "plan_input_excess": record.plan_input,
        "plan_state_excess": record.plan_state,
        "state_excess": float(state.max()),
        "return_time": longest(state > OUTSIDE, rig.timing.period),
        "clamped": float(np.mean(np.array(record.clamped) > OUTSIDE)),
        "failed": float(bool(ending.reason) or rig.mpc.statistics.failures > 0),
        "hand_error": float(np.mean(record.error)),
        "stalled": float(np.mean(np.array(solves.steps) < STALLED)),
        "iterations": float(np.mean(solves.counts)),
    }


def statistics(runs: list[dict[str, float]], figure: str) -> tuple[float, float]:
    """Median and largest value; of failures their number twice."""
    values = [r[figure] for r in runs]
    return (sum(values), sum(values)) if figure == "failed" else (float(np.median(values)), float(max(values)))


def cell(runs: list[dict[str, float]], figure: str) -> str:
    """Median (worst), red where the worst misses its goal."""
    _, _, factor, goal = FIGURES[figure]
    middle, worst = statistics(runs, figure)
    text = f"{worst:.0f}" if figure == "failed" else f"{middle * factor:.2g} ({worst * factor:.2g})"
    return f"[red]{text}[/red]" if goal is not None and worst > goal else text


def markdown(found: Runs) -> str:
    """The same table in Markdown."""
    units = [f"{h} [{u}]" if u else h for h, u, _, _ in FIGURES.values()]
    lines = ["| scenario | variant | seeds | " + " | ".join(units) + " |", "| --- " * (3 + len(units)) + "|"]
    for scenario, variants in found.items():
        for k, (name, runs) in enumerate(variants.items()):
            cells = [cell(runs, f).replace("[red]", "**").replace("[/red]", "**") for f in FIGURES]
            lines.append("| " + " | ".join(["" if k else scenario, name, str(len(runs)), *cells]) + " |")
    return "\n".join(lines) + "\n"


def table(found: Runs, seeds: str) -> Table:
    """All scenarios and variants: median (worst) over the seeds."""
    out = Table(
        title=f"Hard limits in closed loop, seeds {seeds}: median (worst); red: goal missed", title_justify="left"
    )
    out.add_column("scenario", no_wrap=True)
    out.add_column("variant", no_wrap=True)
    out.add_column("seeds", justify="right")
    for heading, unit, _, _ in FIGURES.values():
        out.add_column(f"{heading} [{unit}]".replace("[]", "").replace("[", r"\["), justify="right")
    for scenario, variants in found.items():
        for k, (name, runs) in enumerate(variants.items()):
            out.add_row("" if k else scenario, name, str(len(runs)), *(cell(runs, f) for f in FIGURES))
        out.add_section()
    return out


def to_json(found: Runs, seeds: str, times: dict[str, Any]) -> dict[str, Any]:
    """Every run and the statistics, SI units; shares of the range are not in percent."""
    numbers = {
        s: {
            v: {f: dict(zip(("median", "worst"), statistics(runs, f), strict=True)) for f in FIGURES}
            for v, runs in by.items()
        }
        for s, by in found.items()
    }
    goals = {f: goal for f, (_, _, _, goal) in FIGURES.items() if goal is not None}
    return {
        "seeds": seeds, "goals": goals, "statistics": numbers, "runs": found, "iteration": times, "versions": versions()
    }  # fmt: skip


def source() -> str:
    """Fingerprint of what the figures depend on: the package and the scenarios."""
    files = [*Path(wbmpc.__file__).parent.rglob("*.py"), *Path(__file__).parent.glob("limit_scenarios.py")]
    return hashlib.sha256(b"".join(f.read_bytes() for f in sorted(files))).hexdigest()[:16]


def jobs(scenarios: list[str], variants: list[str], seeds: range, few: int) -> list[Job]:
    """What is to be run: the first variant on all seeds, the others, for comparison, on the first ``few``."""
    first = [(s, variants[0], k) for k in seeds for s in scenarios]
    return first + [(s, v, k) for k in seeds[:few] for v in variants[1:] for s in scenarios]


def do(job: Job) -> tuple[Job, dict[str, float]]:
    scenario, variant, seed = job
    return job, run(scenario, VARIANTS[variant], seed)


def kept(path: Path, code: str) -> dict[Job, dict[str, float]]:
    """The runs of this source that a file has."""
    found = {}
    for line in path.read_text().splitlines() if path.exists() else []:
        entry = json.loads(line)
        if entry["source"] == code:
            found[entry["scenario"], entry["variant"], entry["seed"]] = entry["figures"]
    return found


def results(target: list[Job], path: Path, workers: int) -> dict[Job, dict[str, float]]:
    """Figures of all runs; those that the file has are read, the others done and appended."""
    code = source()
    found = kept(path, code)
    left = [job for job in target if job not in found]
    with multiprocessing.Pool(workers) as pool, path.open("a") as file:
        for n, (job, figures) in enumerate(pool.imap_unordered(do, left), 1):
            found[job] = figures
            entry = dict(zip(("scenario", "variant", "seed"), job, strict=True))
            file.write(json.dumps({"source": code, **entry, "figures": figures}) + "\n")
            file.flush()
            print(f"{n}/{len(left)} {', '.join(map(str, job))}", file=sys.stderr, flush=True)
    return found


def grouped(found: dict[Job, dict[str, float]], target: Iterable[Job]) -> Runs:
    """By scenario, then variant, in the order of the tables above."""
    target = sorted(target, key=lambda j: (list(SCENARIOS).index(j[0]), list(VARIANTS).index(j[1]), j[2]))
    out: Runs = {}
    for scenario, variant, seed in target:
        out.setdefault(scenario, {}).setdefault(variant, []).append(found[scenario, variant, seed])
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", default="300-319", help="first-last")
    parser.add_argument("--few", type=int, default=20, help="so many seeds for all variants but the first")
    parser.add_argument("--scenarios", nargs="*", default=list(SCENARIOS), choices=list(SCENARIOS))
    parser.add_argument("--variants", nargs="*", default=list(VARIANTS), choices=list(VARIANTS))
    parser.add_argument("--report", action="store_true", help="no runs: table and figure of those that there are")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--out", type=Path, default=Path("runs/hard-limits"), help="directory of runs and figures")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    first, last = (int(s) for s in given.seeds.split("-"))
    target = jobs(given.scenarios, given.variants, range(first, last + 1), given.few)
    path = given.out / "runs.jsonl"
    done = kept(path, source()) if given.report else results(target, path, given.workers)
    found = grouped(done, [job for job in target if job in done])
    times = iteration_times()
    console = Console(width=None if sys.stdout.isatty() else 220)
    console.print(table(found, given.seeds))
    for name, t in times.items():
        console.print(
            f"{name}: one iteration {t['hard_ms']:.3f} ms hard, {t['unlimited_ms']:.3f} ms without limits, ratio {t['ratio']:.2f}"
        )
    text = json.dumps(to_json(found, given.seeds, times), indent=2, allow_nan=False)
    (given.out / "hard-limits.json").write_text(text + "\n")
    (given.out / "hard-limits.md").write_text(markdown(found))
    for path in write_figure(found, given.out):
        console.print(f"figure: {path}")


if __name__ == "__main__":
    main()
