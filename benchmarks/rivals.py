"""Gains of the rivals of `swerve-fixed`: a coordinate search on tuning seeds, for the least rms position error.

Usage: python benchmarks/rivals.py [--rival ik|four_wheel] [--seeds 0-1] [--random 20]
"""

from __future__ import annotations

import argparse

import numpy as np

from wbmpc.control import FourWheelSteeringAgent, RollingAgent
from wbmpc.experiments import swerve_fixed as fixed
from wbmpc.log import Log
from wbmpc.model import load_robot

GRID: dict[str, tuple[float, ...]] = {
    "lead": (0.0, 0.01, 0.02, 0.03),
    "base_gain": (1.0, 2.0, 4.0, 6.0, 8.0, 12.0, 16.0),
    "steer_gain": (5.0, 10.0, 15.0, 20.0, 30.0, 40.0),
    "look_ahead": (0.5, 1.0, 1.5, 2.0),
}
KINDS = {"ik": RollingAgent, "four_wheel": FourWheelSteeringAgent}


def error(name: str, gains: dict[str, float], seeds: range, random: float) -> float:
    """Rms position error [m] over all seeds."""
    settings, robot = fixed.SwerveFixedSettings(random=random), load_robot("swerve-fixed-ur10")

    fixed.CONTROLLERS[name] = fixed.rival(KINDS[name], **gains)
    squares = []
    for seed in seeds:
        log, reference = Log(), fixed.Motion.of(settings, seed)
        if fixed.drive(name, settings, seed, robot, reference, None, log).reason:
            return float("inf")
        squares.append(fixed.errors(log, name, reference)[1] ** 2)
    return float(np.sqrt(np.mean(np.concatenate(squares))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rival", default="ik", choices=sorted(KINDS))
    parser.add_argument("--seeds", default="0-1")
    parser.add_argument("--random", type=float, default=20.0)
    given = parser.parse_args()
    first, last = (int(v) for v in given.seeds.split("-"))
    gains = {"lead": 0.01, "base_gain": 2.0, "steer_gain": 10.0, "look_ahead": 1.0}
    best = error(given.rival, gains, range(first, last + 1), given.random)
    for _ in range(2):
        before = best
        for key, values in GRID.items():
            for value in values:
                if value == gains[key]:
                    continue
                found = error(given.rival, {**gains, key: value}, range(first, last + 1), given.random)
                print(f"{given.rival} { ({**gains, key: value}) }: {1e3 * found:.2f} mm", flush=True)
                if found < best:
                    best, gains = found, {**gains, key: value}
        if best > 0.98 * before:
            break
    print(f"best: {gains}: {1e3 * best:.2f} mm")


if __name__ == "__main__":
    main()
