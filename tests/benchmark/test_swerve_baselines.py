"""The search for the baselines' gains. Truth: a bowl with a known lowest point, trials that are counted."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

import swerve_baselines

LOWEST = {"lead": 0.02, "base_gain": 8.0, "steer_gain": 20.0, "look_ahead": 1.5}
START = {"lead": 0.0, "base_gain": 1.0, "steer_gain": 5.0, "look_ahead": 0.5}


class Bowl:
    def __init__(self) -> None:
        self.tried: list[dict[str, float]] = []

    def __call__(self, gains: dict[str, float]) -> float:
        self.tried.append(gains)
        return 1.0 + sum((gains[k] / LOWEST[k] - 1.0) ** 2 for k in LOWEST)


def test_search_finds_the_lowest_point() -> None:
    bowl = Bowl()
    assert swerve_baselines.search(START, swerve_baselines.GRIDS["ik"], 100, bowl) == (1.0, LOWEST)
    assert len({tuple(g.items()) for g in bowl.tried}) == len(bowl.tried)  # nothing twice


@pytest.mark.parametrize("sets", [1, 7, 20])
def test_search_ends_after_so_many_sets(sets: int) -> None:
    bowl = Bowl()
    best, gains = swerve_baselines.search(START, swerve_baselines.GRIDS["ik"], sets, bowl)
    assert len(bowl.tried) == sets
    assert best == min(Bowl()(g) for g in bowl.tried) == Bowl()(gains)
