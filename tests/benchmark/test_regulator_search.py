"""The search of the regulators' gains. Truth: a made-up robot of known strength, power of the push by finite differences, what the
wheels can stop at most (linear, by `Balance`)."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

import push_map
import regulator_search
from regulator_search import BODY, DIRECTIONS, ModelledRobot, search

from wbmpc.experiments.rezero_push import Outcome


@pytest.fixture(scope="module")
def robot() -> ModelledRobot:
    return ModelledRobot("hand")


class Known:
    """Stands less than 200 N s the farther its gains are from 0.1; ``tried``: gains; ``least``: what it had to reach."""

    mode = "hand"

    def __init__(self, settings: Any) -> None:
        self.settings, self.tried, self.least = settings, [], []

    def agent(self, scheduled: bool, gains: dict[str, float]) -> dict[str, float]:
        self.tried.append(gains)
        return gains

    def impulse(self, gains: dict[str, float], least: float, standing: bool = False) -> float:
        self.least.append(least)
        return float(200.0 * np.exp(-0.1 * sum(np.log(v / 0.1) ** 2 for v in gains.values())))


def test_the_best_of_all_that_were_tried_comes_first(robot: ModelledRobot) -> None:
    known = Known(robot.settings)
    found = search(known, "lqr", 8, 3)  # type: ignore[arg-type]
    assert len(found) == len(known.tried) == 17
    assert known.tried[0] == json.loads(push_map.GAINS.read_text())["hand"]["lqr"]
    assert [f[0] for f in found] == sorted((f[0] for f in found), reverse=True)
    assert found[0][0] == max(known.impulse(g, 0.0) for g in known.tried)
    assert known.least[16] == pytest.approx(0.5 * max(known.impulse(g, 0.0) for g in known.tried[:16]))
    other = Known(robot.settings)
    search(other, "scheduled-lqr", 8, 3)  # type: ignore[arg-type]
    assert other.tried[1:9] == known.tried[1:9]


def test_the_push_does_the_work_of_a_force_at_the_base(robot: ModelledRobot) -> None:
    """Generalised force · speeds is force · velocity of the base's centre of mass."""
    base, rng = robot.robot.base, np.random.default_rng(0)
    q, v, force = robot.home[: base.nq] + 0.2 * rng.normal(size=base.nq), rng.normal(size=base.nq), rng.normal(size=2)
    com = base.tree.links[BODY].com
    assert base.tree.links[BODY].mass > 15.0  # the base's body and nothing else

    def place(q: np.ndarray) -> np.ndarray:
        yaw, pitch, roll = q[2:5]
        c, s = np.cos, np.sin
        z = np.array([[c(yaw), -s(yaw), 0], [s(yaw), c(yaw), 0], [0, 0, 1]])
        y = np.array([[c(pitch), 0, s(pitch)], [0, 1, 0], [-s(pitch), 0, c(pitch)]])
        x = np.array([[1, 0, 0], [0, c(roll), -s(roll)], [0, s(roll), c(roll)]])
        out: np.ndarray = q[:2] + (z @ y @ x @ com)[:2]
        return out

    velocity = (place(q + 1e-6 * v) - place(q - 1e-6 * v)) / 2e-6
    assert robot.generalised(q, force) @ v == pytest.approx(force @ velocity, rel=1e-6)


#: Wheels that hardly do anything: found by a search for what stands, wherever it goes.
ROLLS_AWAY = {"hand": 2.92e-4, "torque": 4220.0, "arm": 0.039, "posture": 60.0, "damping": 0.936, "most": 0.174}


def test_what_stands_and_what_no_controller_can_stop(robot: ModelledRobot) -> None:
    agent = robot.agent(False, ROLLS_AWAY)
    assert robot.stands(agent, DIRECTIONS[0], 40.0)
    assert not robot.stands(agent, DIRECTIONS[0], 320.0)
    assert robot.impulse(agent, 320.0, standing=True) == 0.0  # a first look, no bisection


def test_to_stand_is_not_to_come_back(robot: ModelledRobot) -> None:
    """40 N s are 1.7 m/s for 23 kg; the hand is back within 5 cm after 7 s, or the robot is metres away."""
    away = robot.pushed(robot.agent(False, ROLLS_AWAY), 0.0, 40.0, 7.0)
    assert away is not None and away[-1, 0] > 3.0
    assert away[round(0.2 / robot.period), robot.robot.base.nq] == pytest.approx(40.0 / 23.0, rel=0.5)
    assert not robot.recovers(robot.agent(False, ROLLS_AWAY), 0.0, 10.0)
    assert robot.recovers(robot.agent(False, {}), 0.0, 10.0)


def test_gains_that_were_found_are_the_maps(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(push_map, "GAINS", tmp_path / "gains.json")
    push_map.GAINS.write_text("{}")
    assert push_map.settings_of("ball", "scheduled-lqr") == ("controller=scheduled-lqr",)
    push_map.write_gains("ball", "scheduled-lqr", {"torque": 20.0, "most": 0.05})
    push_map.write_gains("hand", "lqr", {"torque": 3.0})
    given = push_map.settings_of("ball", "scheduled-lqr")
    assert given == ("controller=scheduled-lqr", "rival.scheduled_lqr.torque=20", "rival.scheduled_lqr.most=0.05")
    assert push_map.settings_of("hand", "scheduled-lqr") == ("controller=scheduled-lqr",)
    assert push_map.settings_of("hand", "mpc") == ()


def test_the_summary_compares_direction_by_direction() -> None:
    """Medians of each, and of the ratios: 200/100, 150/150, 90/100; a direction that only one has does not count, and one in which
    the other never recovers is told, not divided by. Farther than 3 m the ball went where the robot did not recover."""
    of = lambda *given: push_map.points("hand", 4, (0.2,), 0, given)
    todo = {"mpc": of(), "lqr": of("controller=lqr")}
    stands = {"mpc": (200.0, 150.0, 90.0, 170.0), "lqr": (100.0, 150.0, 100.0)}
    recovers = {"mpc": (80.0, 80.0, 90.0, 80.0), "lqr": (40.0, 20.0, 0.0)}

    def outcomes(back: float, up: float) -> dict[float, Outcome]:
        own = {i: Outcome(i <= up, i <= back, 3.0 if i <= back else 30.0) for i in (back, up) if i > 0.0}
        return own | {
            max(back, up) + 5.0: Outcome(False, False, 1.0),
            back + 5.0: Outcome(back + 5.0 <= up, False, 30.0),
        }

    done = {
        p.key: outcomes(back, up)
        for name in todo
        for p, back, up in zip(todo[name], recovers[name], stands[name], strict=False)
    }
    lines = push_map.summary(todo, done)
    assert lines == [
        "hand held, 0.2 s, mpc recovers: median 80, least 80, most 90 N s (4 of 4 directions)",
        "hand held, 0.2 s, mpc stands: median 160, least 90, most 200 N s (4 of 4 directions)",
        "  its ball goes 3.0 m at most where it recovers",
        "hand held, 0.2 s, lqr recovers: median 20, least 0, most 40 N s (3 of 4 directions)",
        "  mpc over lqr: median 3.00, least 2.00 (2), 1 where lqr never does",
        "hand held, 0.2 s, lqr stands: median 100, least 100, most 150 N s (3 of 4 directions)",
        "  mpc over lqr: median 1.00, least 0.90 (3)",
        "  its ball goes 3.0 m at most where it recovers",
    ]


def test_gains_from_the_command_line_of_the_search_are_settings() -> None:
    from wbmpc.experiments.rezero_rivals import RegulatorSettings

    assert set(regulator_search.SPACE["lqr"]) == set(RegulatorSettings.model_fields)
