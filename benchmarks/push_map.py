"""The push map of the ball robot: impulse at which it falls, over directions and lengths. Goes on where it was interrupted.

Usage: python benchmarks/push_map.py [--mode hand] [--directions 16] [--lengths 0.05 0.1 0.2 0.4] [--seed 200] [--file FILE]
"""

from __future__ import annotations

import argparse
import multiprocessing
import time
from pathlib import Path

import numpy as np

from wbmpc.experiments.push_map import MODES, measure, points, push_map


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mode", choices=list(MODES), default="hand")
    parser.add_argument("--directions", type=int, default=16)
    parser.add_argument("--lengths", type=float, nargs="+", default=[0.05, 0.1, 0.2, 0.4])
    parser.add_argument("--seed", type=int, default=200)
    parser.add_argument("--file", type=Path, default=Path("push_map.json"))
    given = parser.parse_args()
    todo, started, stands = points(given.mode, given.directions, tuple(given.lengths), given.seed), time.time(), []
    with multiprocessing.get_context("spawn").Pool() as pool:  # all cores
        results = push_map(todo, given.file, lambda left: pool.imap_unordered(measure, left))
        for k, (key, (low, high)) in enumerate(results, start=1):
            stands.append(low)
            falls = "never falls" if high is None else f"falls at {high:.1f} N s"
            print(
                f"{k} of {len(todo)}, {time.time() - started:.0f} s: {key}: stands at {low:.1f} N s, {falls}",
                flush=True,
            )
    print(f"impulse after which it stands: median {np.median(stands):.1f}, least {min(stands):.1f} N s")


if __name__ == "__main__":
    main()
