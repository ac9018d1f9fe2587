"""The ball robot's MPC against its baselines: gains by the same search on tuning seeds, tables on reporting seeds.

Usage: python benchmarks/ball_baselines.py [--search lqr … | all] [--draws 3] [--first 0]
       [--task pushes | square] [--seeds 200-203]
       [--runs NAME …] [--only CONTROLLER …] [--file FILE] [--report]
Without --search: the table. Every run is kept in FILE (JSON lines) and is not done again, in the search too.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from wbmpc.configuration import configure
from wbmpc.registry import REGISTRY
from wbmpc.reproduce import parse_seeds
from wbmpc.studies.minniti2019.push_map import Point, simulated

REGULATOR = {
    "end_effector": (1e-3, 1.0), "torque": (0.3, 1e3), "arm": (0.01, 30.0), "posture": (0.1, 300.0), "damping": (0.03, 30.0),
    "max_error": (0.03, 3.0),
}  # fmt: skip
SEPARATE = {
    "ball": (3.0, 300.0), "ball_speed": (0.5, 30.0), "tilt_rate": (0.5, 30.0), "wheel": (0.01, 2.0), "pace": (4.0, 40.0),
    "integral": (0.1, 6.0),
}  # fmt: skip
#: What is searched, by controller: lowest and highest value of each gain, on a logarithmic scale.
SPACE: dict[str, dict[str, tuple[float, float]]] = {
    "lqr": REGULATOR,
    "scheduled-lqr": REGULATOR,
    "separate": SEPARATE,
    "separate-integral": SEPARATE,
    "separate-aware": SEPARATE,
    "taskspace": {
        "end_effector": (1.5, 10.0), "turn": (1.5, 10.0), "ball": (5.0, 500.0), "ball_speed": (1.0, 50.0), "tilt": (5.0, 500.0),
        "wheel_torque": (0.1, 10.0), "balance": (0.1, 10.0),
    },
}  # fmt: skip
#: Controllers of the tables by name: settings.
CONTROLLERS: dict[str, tuple[str, ...]] = {
    "mpc": (),
    **{name: (f"controller={name}",) for name in SPACE},
    "mpc-actuators": ("tracking.kind=actuators",),
}
DEG = 180.0 / np.pi
STEPS = (("rise_time_max", 1.0, "s"), ("steady_position_error_max", 1e3, "mm"), ("tilt_max", DEG, "deg"))
#: Runs of the tables by name: experiment, settings, and what is shown: (metric, factor, unit).
RUNS: dict[str, tuple[str, tuple[str, ...], tuple[tuple[str, float, str], ...]]] = {
    "steps unseen": ("rezero-steps", ("preview=false",), STEPS),
    "push-hand": (
        "rezero-push-hand",
        (),
        (("not_recovered", 1.0, "of 6"), ("hand_error_max", 1e3, "mm"), ("tilt_max", DEG, "deg")),
    ),
    "push-ball": (
        "rezero-push-ball",
        (),
        (("not_recovered", 1.0, "of 6"), ("ball_travel_max", 1e3, "mm"), ("tilt_max", DEG, "deg")),
    ),
    "steps": ("rezero-steps", (), STEPS),
    "wholebody": (
        "rezero-wholebody",
        (),
        (("ball_error_rms_wholebody", 1e3, "mm"), ("hand_error_rms", 1e3, "mm"), ("feedback_share", 100.0, "%")),
    ),
    "circle": ("rezero-circle", (), (("hand_error_rms", 1e3, "mm"), ("ball_error_rms", 1e3, "mm"))),
}


class Store:
    """Finished runs in a file of JSON lines: by experiment, seed and settings."""

    def __init__(self, file: Path) -> None:
        self._file = file
        lines = file.read_text().splitlines() if file.exists() else []
        self.done: dict[tuple[Any, ...], dict[str, Any]] = {}
        for row in map(json.loads, lines):
            self.done[self._key(row)] = row

    @staticmethod
    def _key(row: dict[str, Any]) -> tuple[Any, ...]:
        return row["name"], row["seed"], tuple(row["settings"])

    def run(self, name: str, seed: int, settings: Iterable[str]) -> dict[str, Any]:
        """Metrics (None for infinite) of a run, from the file if it is there."""
        row: dict[str, Any] = {"name": name, "seed": seed, "settings": list(settings)}
        if self._key(row) not in self.done:
            experiment = REGISTRY[name]
            result = experiment.run(configure(experiment.config_type, row["settings"], name), seed, None)
            values = {k: m.value if np.isfinite(m.value) else None for k, m in result.metrics.items()}
            self._keep(row | {"reason": result.reason, "metrics": values})
        return self.done[self._key(row)]

    def recovers(self, point: Point, impulse: float) -> bool:
        """Whether a robot recovers from a push [N s] of the push map, from the file if it is there."""
        push = [f"{point.direction:.4f} rad", f"{point.length:g} s", f"{impulse:g} N s", *point.given]
        row: dict[str, Any] = {"name": f"push-map-{point.mode}", "seed": point.seed, "settings": push}
        if self._key(row) not in self.done:
            self._keep(row | {"reason": "", "metrics": {"recovers": float(simulated(point, impulse).recovers)}})
        return value(self.done[self._key(row)], "recovers") > 0.0

    def _keep(self, row: dict[str, Any]) -> None:
        self.done[self._key(row)] = row
        with self._file.open("a") as file:
            file.write(json.dumps(row) + "\n")


def value(row: dict[str, Any], metric: str) -> float:
    """A figure of a run; infinite for one that is not finite."""
    found = row["metrics"].get(metric)
    return float("inf") if found is None else float(found)


def pushes_loss(store: Store, given: list[str], seed: int) -> float:
    """Of the steps (nobody sees one before it comes) and of pushes of 200 N while the end effector is held, shortened, with the state of
    the simulator and noise: falls and pushes without recovery, rise time [s], powers of ten of the steady error over 1 mm, how
    far [m] the end effector was pushed."""
    steps = store.run(
        "rezero-steps", seed, [*given, "preview=false", "hold_time=2", "settle_time=1", "final_hold_time=0"]
    )
    pushed = store.run("rezero-push-hand", seed, [*given, "forces=[200]", "settle_time=1", "pause=4"])
    total = 4.0 * (value(steps, "fell") + value(pushed, "fell")) + min(value(steps, "rise_time_max"), 3.0)
    total += np.log10(np.clip(value(steps, "steady_position_error_max") / 1e-3, 1.0, 1e3))
    return float(total + value(pushed, "not_recovered") + min(value(pushed, "hand_error_max"), 2.0))


def square_loss(store: Store, given: list[str], seed: int) -> float:
    """Of the square with 1 kg that nobody knows of, shortened, with the state of the simulator and noise: falls, and the errors of
    ball and end effector in units of 20 mm rms."""
    run = store.run("rezero-wholebody", seed, [*given, "settle_time=4", "hold_time=1.5"])
    errors = (value(run, f"{what}_error_rms{which}") for what, which in (("ball", "_wholebody"), ("hand", "")))
    return float(20.0 * value(run, "fell") + sum(min(e / 0.02, 20.0) for e in errors))


NOISY = ("estimator=truth",)
#: What a search makes small, by task: its loss, an experiment whose settings have the gains that there are, settings of its runs.
TASKS: dict[str, tuple[Callable[[Store, list[str], int], float], str, tuple[str, ...]]] = {
    "pushes": (pushes_loss, "rezero-push-hand", NOISY),
    "square": (square_loss, "rezero-wholebody", NOISY),
}


def loss(store: Store, task: str, controller: str, gains: dict[str, float], seed: int) -> float:
    """Of a task with these gains."""
    key = controller.replace("-", "_")
    function, _, settings = TASKS[task]
    return function(
        store, [f"controller={controller}", *settings, *(f"baseline.{key}.{k}={v!r}" for k, v in gains.items())], seed
    )


def candidate(
    space: dict[str, tuple[float, float]], rng: np.random.Generator, best: dict[str, float] | None, step: float = 0.4
) -> dict[str, float]:
    """Gains drawn from the whole space, or about ``best``, by factors of exp(``step``) or so, to three digits."""
    out = {}
    for key, (low, high) in space.items():
        drawn = rng.uniform(np.log(low), np.log(high))
        if best is not None:
            drawn = np.clip(np.log(best[key]) + step * rng.normal(), np.log(low), np.log(high))
        out[key] = float(f"{np.exp(drawn):.3g}")
    return out


def search(store: Store, task: str, controller: str, seeds: list[int], draws: int, first: int = 0) -> dict[str, float]:
    """The best gains of a controller for a task: those that there are, ``draws`` from the whole space, as many about the best so
    far. Controllers with the same space get the same draws; another ``first`` gives others."""
    space, rng = SPACE[controller], np.random.default_rng(first)
    kind = REGISTRY[TASKS[task][1]].config_type()
    own = getattr(kind.baseline, controller.replace("-", "_"))
    best = {k: float(getattr(own, k)) for k in space}
    least = float("inf")
    for k in range(1 + 2 * draws):
        gains = candidate(space, rng, best if k > draws else None) if k else best
        found = sum(loss(store, task, controller, gains, seed) for seed in seeds)
        print(f"{task} {controller} {k} {gains}: {found:.3f}", flush=True)
        if found < least:
            least, best = found, gains
    print(f"{task} {controller} best: {best}: {least:.3f}", flush=True)
    return best


def markdown(rows: dict[str, list[dict[str, Any]]], label: str) -> str:
    """Controllers down, figures across: median (worst) of the seeds; how many fell."""
    shown = RUNS[label][2]
    heads = [f"{metric} [{unit}]" for metric, _, unit in shown]
    lines = ["| controller | seeds | fell | " + " | ".join(heads) + " |", "| --- " * (3 + len(heads)) + "|"]
    for controller, found in rows.items():
        figures = []
        for metric, factor, _ in shown:
            values = factor * np.array([value(r, metric) for r in found])
            middle = float(np.quantile(values, 0.5, method="nearest"))
            figures.append(" (".join("∞" if np.isinf(v) else f"{v:.3g}" for v in (middle, float(values.max()))) + ")")
        fell = sum(value(r, "fell") > 0.0 for r in found)
        lines.append(f"| {controller} | {len(found)} | {fell} | " + " | ".join(figures) + " |")
    return f"{label}, median (worst):\n\n" + "\n".join(lines)


def table(store: Store, labels: list[str], controllers: list[str], seeds: list[int], report: bool) -> str:
    """Runs what is missing (seed by seed) and writes the tables."""
    given = lambda label, controller: (*CONTROLLERS[controller], *RUNS[label][1])
    if not report:
        for seed in seeds:
            for label in labels:
                for controller in controllers:
                    row = store.run(RUNS[label][0], seed, given(label, controller))
                    print(f"{label} {seed} {controller}: {row['reason'] or 'completed'}", flush=True)
    parts = []
    for label in labels:
        have = {
            c: [r for s in seeds if (r := store.done.get((RUNS[label][0], s, given(label, c)))) is not None]
            for c in controllers
        }
        parts.append(markdown({c: rows for c, rows in have.items() if rows}, label))
    return "\n\n".join(parts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--search", nargs="+", choices=["all", *SPACE])
    parser.add_argument("--task", choices=list(TASKS), default="pushes", help="of the search")
    parser.add_argument("--seeds", help="as 200-203 or 200,205; left out: 0 for the search, 200-203 for the table")
    parser.add_argument("--draws", type=int, default=3, help="of the search: twice as many runs and one more")
    parser.add_argument(
        "--first", type=int, default=0, help="of the random numbers: another search goes on with others"
    )
    parser.add_argument("--runs", nargs="+", choices=list(RUNS), default=list(RUNS)[:3])
    parser.add_argument("--only", nargs="+", choices=list(CONTROLLERS), default=list(CONTROLLERS))
    parser.add_argument("--file", type=Path, default=Path("ball_baselines.jsonl"))
    parser.add_argument("--report", action="store_true", help="run nothing, write the table of what there is")
    given = parser.parse_args()
    store = Store(given.file)
    if given.search:
        for controller in SPACE if "all" in given.search else given.search:
            search(store, given.task, controller, list(parse_seeds(given.seeds or "0")), given.draws, given.first)
    else:
        seeds = list(parse_seeds(given.seeds or "200-203"))
        print(table(store, given.runs, given.only, seeds, given.report))


if __name__ == "__main__":
    main()
