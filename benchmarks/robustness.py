"""Experiments over seeds and under loads that the controller does not know of: masses, a slope, cables, a slippery floor, delays.

Usage: python benchmarks/robustness.py [--seeds 200-219] [--conditions NAME …] [--robot ball] [--only NAME …] [--workers N] [--out DIR] [--report]
       [--publish goals loads]
Every run is a process of its own; what is finished in DIR is not run again, so that an interrupted study goes on where it
was (seed by seed). DIR gets table.json, table.md, goals.md (experiments and their variants against their goals) and
robustness.png. Left out, --only is all experiments of the robot; conditions of other robots and variants of other experiments are passed
over. --publish puts the tables of goals and of loads, with the commits that the runs are of, into docs/results/swerve.md or ball.md.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from goals import commits, goal_rows, goals_markdown, number, order_statistics, publish

from wbmpc.configuration import configure
from wbmpc.registry import REGISTRY
from wbmpc.report import versions, write_run
from wbmpc.reproduce import Job, parse_seeds, run_all

DOCS = Path(__file__).parents[1] / "docs"
#: How the names of a robot's experiments begin.
PREFIX = {"swerve": "swerve", "ball": "rezero"}
#: What the robot carries and where it stands, by name: settings besides those of the protocol (friction 0.6 to 0.9, 10 ms).
SWERVE: dict[str, tuple[str, ...]] = {
    "protocol": (),
    "end effector 5 kg": ("plant.payload=5",),
    "end effector 10 kg": ("plant.payload=10",),
    "body 75 kg": ("plant.body_payload=75",),
    "body 150 kg": ("plant.body_payload=150",),
    "slope 3 deg": ("plant.slope=0.05236",),
    "delay 5 ms": ("mpc.computation_delay=0.005",),
    "delay 25 ms": ("mpc.computation_delay=0.025",),
    "all at once": ("plant.payload=10", "plant.body_payload=150", "plant.slope=0.05236", "mpc.computation_delay=0.025"),
}
BALL: dict[str, tuple[str, ...]] = {
    "protocol": (),
    "floor 0.4": ("plant.friction=0.4",),
    "floor 1.1": ("plant.friction=1.1",),
    "end effector 0.5 kg": ("payload=0.5",),
    "end effector 1 kg": ("payload=1.0",),
    "cables 5 mm": ("plant.floor_cables=0.005",),
    "late 2 ms": ("plant.actuator_dead_time=0.002",),
    "late 8 ms": ("plant.actuator_dead_time=0.008",),
    "late 15 ms": ("plant.actuator_dead_time=0.015",),
}
#: Variants of an experiment that the protocol asks for: (experiment, settings, goals other than those of the experiment).
VARIANTS: dict[str, tuple[str, tuple[str, ...], dict[str, float]]] = {
    "vertical": ("swerve-track", ("variant=vertical",), {}),
    "peaks": ("swerve-track", ("variant=peaks",), {}),
    "radii with a common factor": ("swerve-track", ("plant.wheel_radius=0.002",), {}),
    "calibrated arm": ("swerve-track", ("plant.joint_offset=0",), {"hand_error_mean_odometry": 2e-4}),
    "odometry only": ("swerve-plaster", ("localization=none",), {}),
    "ten minutes": ("swerve-fixed", ("random_time=600",), {}),
}
#: Variants that take so long that only the first of the seeds runs them.
ONCE = ("ten minutes",)
CONDITIONS = {**SWERVE, **BALL, **{n: settings for n, (_, settings, _) in VARIANTS.items()}}


def conditions_of(name: str) -> dict[str, tuple[str, ...]]:
    """Conditions of an experiment's robot, and variants of the experiment."""
    own = {n: settings for n, (experiment, settings, _) in VARIANTS.items() if experiment == name}
    more = (
        BALL if name.startswith("rezero") else SWERVE if name.startswith("swerve") and name not in PROTOCOL_ONLY else {}
    )
    return {"protocol": (), **more, **own}


#: Figures that are shown beside all with a goal: (metric, factor, unit).
SHOWN: dict[str, tuple[tuple[str, float, str], ...]] = {
    "swerve-track": (
        ("hand_error_mean_odometry", 1e3, "mm"),
        ("hand_error_mean_world", 1e3, "mm"),
        ("odometry_drift_ratio", 100.0, "%"),
    ),
    "swerve-unified": (("hand_error_rms", 1e3, "mm"), ("hand_error_rms_world", 1e3, "mm")),
    "swerve-fixed": (
        ("tracking_error_rms_mpc", 1e3, "mm"),
        ("tracking_error_rms_ik", 1e3, "mm"),
        ("wheel_slip_max_mpc", 1.0, "m/s"),
    ),
    "rezero-steps": (
        ("steady_position_error_max", 1e3, "mm"),
        ("steady_position_error_world_max", 1e3, "mm"),
        ("rise_time_max", 1.0, "s"),
        ("fell", 1.0, "1"),
    ),
    "rezero-push-hand": (
        ("not_recovered", 1.0, "1"),
        ("rest_error_world_max", 1e3, "mm"),
        ("hand_error_max", 1e3, "mm"),
        ("tilt_max", 180.0 / np.pi, "deg"),
        ("fell", 1.0, "1"),
    ),
    "rezero-push-ball": (
        ("not_recovered", 1.0, "1"),
        ("rest_error_world_max", 1e3, "mm"),
        ("ball_travel_max", 1e3, "mm"),
        ("tilt_max", 180.0 / np.pi, "deg"),
        ("fell", 1.0, "1"),
    ),
    "rezero-wholebody": (
        ("ball_error_rms_wholebody", 1e3, "mm"),
        ("steady_hand_error_max", 1e3, "mm"),
        ("steady_ball_offset_max", 1e3, "mm"),
        ("fell", 1.0, "1"),
    ),
    "rezero-taskspace": (
        ("hand_error_integral_mpc", 1.0, "m s"),
        ("hand_error_integral_taskspace", 1.0, "m s"),
        ("torque_squared_ratio", 1.0, "1"),
        ("falls_taskspace", 1.0, "1"),
    ),
    "rezero-door": (
        ("force_error_ratio_low", 100.0, "%"),
        ("force_error_ratio_high", 100.0, "%"),
        ("touch_peak", 1.0, "N"),
        ("rest_hand_swing", 1e3, "mm"),
        ("rest_hand_error", 1e3, "mm"),
        ("fell", 1.0, "1"),
    ),
    "rezero-frequency": (
        ("torque_error_ratio", 1.0, "1"),
        ("rise_time_ratio", 1.0, "1"),
        ("rise_time_plain", 1.0, "s"),
        ("rise_time_shaped", 1.0, "s"),
        ("fell_shaped", 1.0, "1"),
    ),
    "rezero-circle": (("hand_error_rms", 1e3, "mm"), ("ball_error_rms", 1e3, "mm"), ("fell", 1.0, "1")),
    "swerve-drive": (
        ("base_position_error_rms", 1e3, "mm"),
        ("baseline_position_error_rms", 1e3, "mm"),
        ("leg_angle_error_rms", 180.0 / np.pi, "deg"),
    ),
}
#: Those that have no MPC, or none whose delay could be set, run under the protocol only.
PROTOCOL_ONLY = ("swerve-stability", "swerve-brakes", "swerve-wobble", "swerve-calibrate", "swerve-plaster")


@dataclass(frozen=True)
class Cell:
    """One experiment under one condition over all seeds that are finished."""

    experiment: str
    condition: str
    runs: tuple[dict[str, Any], ...]

    @property
    def completed(self) -> int:
        return sum(bool(r["completed"]) for r in self.runs)

    def statistics(self) -> dict[str, dict[str, Any]]:
        """By metric: median, 5 %, 95 %, worst (largest) and goal. A figure that is not finite counts as infinite."""
        out = {}
        for name in dict.fromkeys(n for r in self.runs for n in r["metrics"]):
            having = [r for r in self.runs if name in r["metrics"]]
            _, low, middle, high, worst = order_statistics(r["metrics"][name]["value"] for r in having)
            goal = having[0]["targets"].get(name, {}).get("goal")
            unit = having[0]["metrics"][name]["unit"]
            out[name] = {
                "unit": unit,
                "median": middle,
                "p5": low,
                "p95": high,
                "worst": worst,
                "goal": goal,
            }
        return out


def place(out: Path, condition: str, name: str, seed: int) -> Path:
    """The directory of a run."""
    return out / condition.replace(" ", "-") / name / f"seed{seed}"


def jobs(out: Path, conditions: Iterable[str], names: Iterable[str], seeds: Iterable[int]) -> dict[Job, str]:
    """All runs with their conditions, seed by seed."""
    names, conditions, seeds = list(names), list(conditions), list(seeds)
    return {
        Job(name, seed, place(out, condition, name, seed)): condition
        for seed in seeds
        for condition in conditions
        for name in names
        if condition in conditions_of(name) and (condition not in ONCE or seed == seeds[0])
    }


def one(name: str, seed: int, directory: Path, settings: list[str]) -> int:
    """What the process of a run does."""
    experiment = REGISTRY[name]
    result = experiment.run(configure(experiment.config_type, settings, name), seed, None)
    write_run(result, directory)
    (directory / "log.npz").unlink()
    (directory / "cpu_seconds").write_text(f"{time.process_time():.0f}\n")
    return 0 if result.completed else 1


def cells(found: dict[Job, str]) -> list[Cell]:
    """What is finished, by experiment and condition."""
    runs: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for job, condition in found.items():
        if job.done:
            runs.setdefault((job.name, condition), []).append(json.loads((job.directory / "metrics.json").read_text()))
    return [Cell(name, condition, tuple(r)) for (name, condition), r in sorted(runs.items(), key=_order)]


def _order(item: tuple[tuple[str, str], Any]) -> tuple[str, int]:
    (name, condition), _ = item
    return name, list(CONDITIONS).index(condition)


def loads(found: list[Cell]) -> str:
    """A table for each experiment that ran under more than one condition: conditions down, figures across."""
    parts = []
    for name, shown in SHOWN.items():
        mine = [c for c in found if c.experiment == name and c.condition not in VARIANTS]
        if len(mine) < 2:
            continue
        heads = [f"{metric} [{unit}]" for metric, _, unit in shown]
        lines = [_row(["condition", "seeds", "completed", *heads]), _row(["---"] * (3 + len(heads)))]
        for cell in mine:
            s = cell.statistics()
            figures = [_figure(s[m], f) if m in s else "–" for m, f, _ in shown]
            lines.append(_row([cell.condition, str(len(cell.runs)), str(cell.completed), *figures]))
        of = commits(run for cell in mine for run in cell.runs)
        parts.append(f"### `{name}`\nCommit {of}.\n\n" + "\n".join(lines))
    return "\n\n".join(parts) + "\n"


def markdown(found: list[Cell]) -> str:
    """The tables of :func:`loads`; then all figures under the protocol."""
    protocol = [c for c in found if c.condition == "protocol"]
    parts = [f"#### `{c.experiment}`, protocol, {len(c.runs)} seeds\n" + _protocol(c) for c in protocol]
    return "\n\n".join([loads(found), *parts]) + "\n"


def _row(fields: Iterable[str]) -> str:
    return "| " + " | ".join(fields) + " |"


def _figure(s: dict[str, Any], factor: float) -> str:
    """Median (95 %, worst); bold where the 95 % value misses the goal."""
    text = f"{number(s['median'], factor)} ({number(s['p95'], factor)}, {number(s['worst'], factor)})"
    return f"**{text}**" if s["goal"] is not None and s["p95"] > s["goal"] else text


def _protocol(cell: Cell) -> str:
    lines = [_row(["metric", "unit", "median", "5 %", "95 %", "worst"]), _row(["---"] * 6)]
    for name, s in cell.statistics().items():
        lines.append(_row([name, s["unit"], *(number(s[k]) for k in ("median", "p5", "p95", "worst"))]))
    return "\n".join(lines)


def against_goals(found: list[Cell]) -> list[dict[str, Any]]:
    """Rows of the table of goals: the protocol and the variants, no payload."""
    rows = []
    for cell in found:
        if cell.condition == "protocol" or cell.condition in VARIANTS:
            name = cell.experiment + ("" if cell.condition == "protocol" else f", {cell.condition}")
            goals = VARIANTS[cell.condition][2] if cell.condition in VARIANTS else {}
            shown = [metric for metric, _, _ in SHOWN.get(cell.experiment, ())]
            rows += goal_rows(name, list(cell.runs), goals, shown)
    return rows


def write(found: list[Cell], failed: dict[Job, str], out: Path) -> None:
    """table.json, table.md, goals.md and, where matplotlib is installed, robustness.png."""
    out.mkdir(parents=True, exist_ok=True)
    goals = against_goals(found)
    rows = [
        {
            "experiment": c.experiment,
            "condition": c.condition,
            "settings": list(CONDITIONS[c.condition]),
            "seeds": [r["seed"] for r in c.runs],
            "completed": c.completed,
            "reasons": [r["reason"] for r in c.runs if r["reason"]],
            "metrics": c.statistics(),
        }
        for c in found
    ]
    lost = [{"run": str(j.directory.relative_to(out)), "reason": reason} for j, reason in failed.items()]
    data = json.loads(
        json.dumps({"goals": goals, "cells": rows, "failed": lost, "versions": versions()}),
        parse_constant=lambda _: None,
    )
    (out / "table.json").write_text(json.dumps(data, indent=2, allow_nan=False) + "\n")
    (out / "table.md").write_text(markdown(found))
    (out / "goals.md").write_text(goals_markdown(goals))
    try:
        figure(found, out / "robustness.png")
    except ImportError:
        print("matplotlib is not installed: no figure")


def figure(found: list[Cell], path: Path) -> None:
    """First figure of each experiment: every run a point, conditions along the axis, the goal dashed."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    names = [n for n in SHOWN if any(c.experiment == n for c in found)]
    if not names:
        return
    conditions = [c for c in CONDITIONS if any(cell.condition == c for cell in found)]
    drawing, axes = plt.subplots(
        len(names), figsize=(10, 2.4 * len(names)), sharex=True, squeeze=False, layout="constrained"
    )
    for axis, name in zip(axes[:, 0], names, strict=True):
        metric, factor, unit = SHOWN[name][0]
        for cell in (c for c in found if c.experiment == name):
            values = [r["metrics"].get(metric, {}).get("value") for r in cell.runs]
            values = [factor * v for v in values if v is not None]
            at = conditions.index(cell.condition) + np.linspace(-0.25, 0.25, max(len(values), 2))[: len(values)]
            axis.plot(at, values, ".", color="#1f5fa8")
            goal = cell.statistics().get(metric, {}).get("goal")
            if goal is not None and cell.condition == "protocol":
                axis.axhline(factor * goal, color="0.3", linestyle="--", linewidth=1)
        axis.set_ylabel(f"{name}\n{metric} [{unit}]", fontsize=7)
        axis.set_ylim(bottom=0.0)
        axis.grid(axis="y", alpha=0.3)
    axes[-1, 0].set_xticks(range(len(conditions)), conditions, fontsize=8)
    drawing.savefig(path, dpi=100)
    plt.close(drawing)


def main() -> None:
    if sys.argv[1:2] == ["--one"]:
        name, seed, directory, *settings = sys.argv[2:]
        sys.exit(one(name, int(seed), Path(directory), settings))
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", default="200-219", help="as 200-219, 3 or 1,5-7")
    usual = [c for c in CONDITIONS if c not in VARIANTS]
    parser.add_argument("--conditions", nargs="*", default=usual, choices=list(CONDITIONS), metavar="NAME")
    parser.add_argument("--robot", choices=list(PREFIX), default="swerve", help="whose experiments")
    parser.add_argument("--only", nargs="*", choices=list(REGISTRY), help="default: all of the robot in the table")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("runs/robustness"))
    parser.add_argument("--report", action="store_true", help="run nothing, write what there is")
    parser.add_argument("--publish", nargs="*", default=[], choices=["goals", "loads"], help="tables that go into docs")
    given = parser.parse_args()
    only = given.only or [n for n in SHOWN if n.startswith(PREFIX[given.robot])]
    found = jobs(given.out, given.conditions, only, parse_seeds(given.seeds))

    def make(job: Job) -> list[str]:
        settings = CONDITIONS[found[job]]
        return [sys.executable, __file__, "--one", job.name, str(job.seed), str(job.directory), *settings]

    failed: dict[Job, str] = {}
    if not given.report:
        failed = run_all(list(found), given.workers, lambda _, note: print(note, flush=True), make)
    write(cells(found), failed, given.out)
    for job, reason in failed.items():
        print(f"{job.directory}: {reason}")
    robot = next(robot for robot, prefix in PREFIX.items() if only[0].startswith(prefix))
    if "goals" in given.publish:
        publish(
            DOCS / "results" / f"{robot}.md", f"{robot} goals", goals_markdown(against_goals(cells(found))), r"\| `"
        )
    if "loads" in given.publish:
        publish(DOCS / "results" / f"{robot}.md", f"{robot} loads", loads(cells(found)), "### ")
    for name in ("goals.md", "table.md"):
        print((given.out / name).read_text())


if __name__ == "__main__":
    main()
