"""The search of the baselines' gains and its tables. Truth: a made-up loss with a known least value, runs written by hand."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

import ball_baselines

from wbmpc.configuration import configure
from wbmpc.registry import REGISTRY


def test_the_search_gives_every_controller_as_many_runs_and_the_best_of_them(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    tried: dict[str, list[dict[str, float]]] = {}

    def distance(store: Any, task: str, controller: str, gains: dict[str, float], seed: int) -> float:
        tried.setdefault(controller, []).append(gains)
        return float(sum(np.log(v / 2.0) ** 2 for v in gains.values()))

    monkeypatch.setattr(ball_baselines, "loss", distance)
    for controller in ball_baselines.SPACE:
        best = ball_baselines.search(ball_baselines.Store(tmp_path / "runs"), "pushes", controller, [0], 6)
        own = tried[controller]
        assert len(own) == 13
        far = lambda gains: sum(np.log(v / 2.0) ** 2 for v in gains.values())
        assert far(best) == min(map(far, own)) < far(own[0])
        for gains in own[1:]:
            low_high = ball_baselines.SPACE[controller]
            assert all(0.99 * low_high[k][0] <= v <= 1.01 * low_high[k][1] for k, v in gains.items())
    assert tried["lqr"][1:7] == tried["scheduled-lqr"][1:7]


def test_every_gain_and_run_is_a_setting() -> None:
    for controller, space in ball_baselines.SPACE.items():
        for name, (low, _) in space.items():
            given = [f"controller={controller}", f"baseline.{controller.replace('-', '_')}.{name}={low!r}"]
            settings = configure(REGISTRY["rezero-steps"].config_type, given, "")
            own = getattr(settings.baseline, controller.replace("-", "_"))
            assert getattr(own, name) == low
    for name, given_run, shown in ball_baselines.RUNS.values():
        for given_controller in ball_baselines.CONTROLLERS.values():
            configure(REGISTRY[name].config_type, [*given_controller, *given_run], name)
        assert shown


def test_losses_count_what_is_missed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    figures = {
        "rezero-steps": {"fell": 0.0, "rise_time_max": 1.5, "steady_position_error_max": 0.1},
        "rezero-push-hand": {"fell": 1.0, "not_recovered": 2.0, "hand_error_max": None},
        "rezero-wholebody": {"fell": 0.0, "ball_error_rms_wholebody": 0.04, "hand_error_rms": None},
    }
    asked: list[list[str]] = []

    class Written(ball_baselines.Store):
        def run(self, name: str, seed: int, settings: Any) -> dict[str, Any]:
            configure(REGISTRY[name].config_type, settings, name)
            asked.append(list(settings))
            return {"metrics": figures[name]}

    store, gains = Written(tmp_path / "runs"), {"end_effector": 0.3}
    # a fall 4, rise 1.5 s, two powers of ten over 1 mm, two pushes, 2 m at most
    assert ball_baselines.loss(store, "pushes", "lqr", gains, 0) == pytest.approx(4.0 + 1.5 + 2.0 + 2.0 + 2.0)
    # 40 mm are two units, an infinite error the most there is
    assert ball_baselines.loss(store, "square", "lqr", gains, 0) == pytest.approx(2.0 + 20.0)
    assert all({"controller=lqr", "baseline.lqr.end_effector=0.3"} <= set(given) for given in asked)


def test_finished_runs_are_not_done_again_and_make_the_table(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    rows = []
    for seed, (lost, away, fell) in enumerate([(0.0, 0.2, 0.0), (4.0, None, 1.0), (1.0, 0.4, 0.0)]):
        metrics = {"not_recovered": lost, "hand_error_max": away, "tilt_max": 0.1, "fell": fell}
        rows.append({"name": "rezero-push-hand", "seed": seed, "settings": ["controller=lqr"], "metrics": metrics})
    file = tmp_path / "runs.jsonl"
    file.write_text("".join(json.dumps(r | {"reason": ""}) + "\n" for r in rows))
    monkeypatch.setattr(ball_baselines, "REGISTRY", {})  # nothing could be run
    text = ball_baselines.table(ball_baselines.Store(file), ["push-hand"], ["lqr"], [0, 1, 2], report=False)
    assert text.splitlines()[-1] == "| lqr | 3 | 1 | 1 (4) | 400 (∞) | 5.73 (5.73) |"
