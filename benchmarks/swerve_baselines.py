"""Gains of the baselines of `swerve-fixed` and `swerve-drive`: a coordinate search on tuning seeds, for the least rms position error.

Usage: python benchmarks/swerve_baselines.py [--baseline ik|four_wheel|tour] [--seeds 0-1] [--random 20] [--sets 31] [--out DIR]
Starts from the gains that the experiment has, and ends after so many sets of gains. The four-wheel base is judged by the motions
that it can do (forward, turning); sideways ones would hide its gains. `tour`: the inverse kinematics on the tour of `swerve-drive`.
DIR/NAME.md gets every trial and the best; trials that it has are not run again.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from wbmpc.log import Log
from wbmpc.model.robot import load_robot
from wbmpc.studies.pankert2022 import drive as swerve_drive
from wbmpc.studies.pankert2022 import fixed
from wbmpc.studies.pankert2022.drive_missions import SwerveDriveSettings
from wbmpc.studies.pankert2022.fixed_figures import errors
from wbmpc.studies.pankert2022.fixed_motions import Motion, Name, SwerveFixedSettings
from wbmpc.studies.pankert2022.rolling import FourWheelSteeringController, RollingController

_FIXED: dict[str, tuple[float, ...]] = {
    "lead": (0.0, 0.01, 0.02, 0.03),
    "base_gain": (1.0, 2.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0),
    "steer_gain": (5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 60.0),
    "look_ahead": (0.5, 1.0, 1.5, 2.0, 2.5, 3.0),
}
GRIDS: dict[str, dict[str, tuple[float, ...]]] = {
    "ik": _FIXED,
    "four_wheel": _FIXED,
    "tour": {
        "steer_gain": (15.0, 20.0, 30.0, 40.0, 60.0),
        "base_gain": (2.0, 4.0, 6.0, 8.0, 12.0),
        "leg_gain": (2.0, 4.0, 8.0, 16.0, 24.0),
        "lead": (0.0, 0.01, 0.02, 0.03),
        "look_ahead": (0.0, 1.0),
    },
}
#: What each baseline is judged by; ``None``: all motions, and random twists after them.
MOTIONS: dict[str, tuple[Name, ...] | None] = {"ik": None, "four_wheel": ("forward", "turning")}
#: The robot stands only so long [s] before a trial.
REST = 2.0
KINDS = {"ik": RollingController, "four_wheel": FourWheelSteeringController}


def error(name: str, gains: dict[str, float], seeds: range, random: float) -> float:
    """Rms position error [m] over all seeds."""
    squares = [_tour(gains, seed) if name == "tour" else _motions(name, gains, seed, random) for seed in seeds]
    return float(np.sqrt(np.mean(np.concatenate(squares))))


def _tour(gains: dict[str, float], seed: int) -> np.ndarray:
    """Squares [m²] of the position error on the tour."""
    given = {f"baseline_{key}": value for key, value in gains.items()}
    settings = SwerveDriveSettings.model_validate({"settle_time": REST, **given})
    error = swerve_drive.baseline_on_tour(settings, seed)
    return np.asarray(np.sum(error[:, :2] ** 2, axis=1))


def _motions(name: str, gains: dict[str, float], seed: int, random: float) -> np.ndarray:
    """Squares [m²] of the position error on the motions by which a baseline is judged, infinite if it did not get through them."""
    robot, motions = load_robot("swerve-fixed-ur10"), MOTIONS[name]
    settings = SwerveFixedSettings(random_time=random, settle_time=REST)
    if motions is not None:
        settings = settings.model_copy(update={"motions": motions, "random": 0.0})
    fixed.CONTROLLERS[name] = fixed.baseline(KINDS[name], **gains)
    log, reference = Log(), Motion.of(settings, seed)
    if fixed.drive(name, settings, seed, robot, reference, settings.estimation(robot, seed), None, log).ending.reason:
        return np.full(1, np.inf)
    return np.asarray(errors(log, name, reference, "odometry")[1] ** 2)


def _start(name: str) -> dict[str, float]:
    """The gains that the experiment has."""
    if name != "tour":
        return dict(fixed.GAINS[name])
    settings = SwerveDriveSettings()
    return {key: float(getattr(settings, f"baseline_{key}")) for key in GRIDS[name]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--baseline", default="ik", choices=sorted(GRIDS))
    parser.add_argument("--seeds", default="0-1")
    parser.add_argument("--random", type=float, default=20.0)
    parser.add_argument("--sets", type=int, default=31, help="of gains that are tried")
    parser.add_argument("--out", type=Path, default=Path("runs/baselines"))
    given = parser.parse_args()
    first, last = (int(v) for v in given.seeds.split("-"))
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / f"{given.baseline}-{given.seeds}-{given.random:g}.jsonl"
    known = {tuple(e["gains"].items()): float(e["error"]) for e in map(json.loads, _lines(path))}

    def trial(gains: dict[str, float]) -> float:
        key = tuple(gains.items())
        if key not in known:
            known[key] = error(given.baseline, gains, range(first, last + 1), given.random)
            with path.open("a") as file:
                file.write(json.dumps({"gains": gains, "error": known[key]}) + "\n")
            print(f"{given.baseline} {gains}: {1e3 * known[key]:.2f} mm", flush=True)
        return known[key]

    grid = GRIDS[given.baseline]
    best, gains = search(_start(given.baseline), grid, given.sets, trial)
    print(f"best of {len(known)} sets: {gains}: {1e3 * best:.2f} mm")
    path.with_suffix(".md").write_text(table(list(grid), known, gains))


def search(
    gains: dict[str, float],
    grid: dict[str, tuple[float, ...]],
    sets: int,
    trial: Callable[[dict[str, float]], float],
) -> tuple[float, dict[str, float]]:
    """The least error [m] and its gains, one after the other over the grid, until ``sets`` were tried or a round gains nothing."""
    tried = {tuple(gains.items())}
    best = trial(gains)
    while True:
        previous = best
        for key, values in grid.items():
            for value in values:
                candidate = {**gains, key: value}
                if tuple(candidate.items()) in tried:
                    continue
                if len(tried) == sets:
                    return best, gains
                tried.add(tuple(candidate.items()))
                found = trial(candidate)
                if found < best:
                    best, gains = found, candidate
        if best > 0.98 * previous:
            return best, gains


def table(names: list[str], known: dict[tuple[tuple[str, float], ...], float], best: dict[str, float]) -> str:
    """Every trial by its error, the best one in bold."""
    lines = ["| " + " | ".join([*names, "rms [mm]"]) + " |", "| " + " | ".join(["---"] * (len(names) + 1)) + " |"]
    for key, found in sorted(known.items(), key=lambda item: item[1]):
        figure = f"**{1e3 * found:.2f}**" if dict(key) == best else f"{1e3 * found:.2f}"
        lines.append("| " + " | ".join([*(f"{dict(key)[n]:g}" for n in names), figure]) + " |")
    return "\n".join(lines) + "\n"


def _lines(path: Path) -> list[str]:
    return path.read_text().splitlines() if path.exists() else []


if __name__ == "__main__":
    main()
