"""The search of the regulators' gains. Truth: made-up robots of known strength, power of the push by finite differences, speeds
by impulse over mass."""

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
from regulator_search import BODY, MODELLED, RAISE, ModelledRobot, race, search

from wbmpc.studies.minniti2019.push_once import Outcome
from wbmpc.studies.minniti2019.recovery import NEAR


@pytest.fixture(scope="module")
def robot() -> ModelledRobot:
    return ModelledRobot("hand")


class Known:
    """Comes back to 0.01 m times the impulse [N s] and the distance of its gains from 0.5, in powers of e: the nearer, the harder
    the pushes that it recovers from. ``tried``: gains."""

    mode = "hand"

    def __init__(self, settings: Any) -> None:
        self.settings, self.tried = settings, []

    def controller(self, scheduled: bool, gains: dict[str, float]) -> dict[str, float]:
        self.tried.append(gains)
        return gains

    def away(self, gains: dict[str, float]) -> float:
        return float(np.sqrt(sum(np.log(v / 0.5) ** 2 for v in gains.values())))

    def losses(self, gains: dict[str, float], impulse: float, maximum: float = np.inf) -> list[float]:
        error = 1e-3 * impulse * self.away(gains)
        return [error / (1.0 + error)] * len(MODELLED)


def test_walks_go_downhill_and_their_pushes_get_harder(robot: ModelledRobot) -> None:
    known = Known(robot.settings)
    found = search(known, "lqr", 3, 120, 3)  # type: ignore[arg-type]
    assert known.tried[0] == json.loads(push_map.GAINS.read_text())["hand"]["lqr"]
    assert [f[0] for f in found] == sorted((f[0] for f in found), reverse=True)
    for impulse, best in found:
        recovered = NEAR / (1e-3 * known.away(best))  # N s, by the formula above
        assert impulse - RAISE < recovered and impulse > 50.0
        assert known.away(best) < 1.0  # e-fold in all six together: one draw in a million from the whole space
    other = Known(robot.settings)
    again = search(other, "scheduled-lqr", 3, 120, 3)  # type: ignore[arg-type]
    assert [f for f in again if f in found]  # what is from anywhere; the gains that there were may differ


def test_a_robot_that_falls_later_or_rests_nearer_loses_less(
    robot: ModelledRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fall after 1.4 of 7 s is 1.8; an end effector 0.25 m off is 0.25/1.25 = 0.2; five directions, until it is too much."""
    states = np.tile(robot.home, (2800, 1))
    monkeypatch.setattr(robot, "pushed", lambda controller, direction, impulse, seconds: states)
    monkeypatch.setattr(regulator_search, "MODELLED", (0.0, 1.0))
    controller: Any = None
    assert robot.losses(controller, 10.0) == [0.0, 0.0]
    states[-1, 0] += 0.25
    assert robot.losses(controller, 10.0) == pytest.approx([0.2, 0.2])
    assert len(robot.losses(controller, 10.0, maximum=0.1)) == 1
    states = states[:560]
    assert robot.losses(controller, 10.0) == pytest.approx([1.8, 1.8])


def test_the_race_is_won_by_the_strongest_and_leaves_the_others_early() -> None:
    """Made-up sets by what they recover from in four tasks [N s]; from 30 on, 10 N s harder each time. At 50 N s the third does
    three tasks; those after it are left as soon as they cannot do more than that."""
    strength = {
        1.0: (31, 35, 32, 39),
        2.0: (31, 29, 99, 99),
        3.0: (44, 58, 52, 57),
        4.0: (99, 99, 99, 41),
        5.0: (45, 45, 99, 99),
    }
    runs: list[tuple[float, float, int]] = []

    def recovers(tried: dict[str, float], impulse: float, task: int) -> bool:
        runs.append((tried["hand"], impulse, task))
        return impulse < strength[tried["hand"]][task]

    assert race([{"hand": k} for k in strength], 30.0, recovers, 4) == (50.0, 3, {"hand": 3.0})
    assert [r for r in runs if r[0] == 2.0] == [(2.0, 40.0, k) for k in range(4)]  # the first does none there
    assert [r for r in runs if r[0] == 4.0] == [(4.0, 50.0, k) for k in range(4)]  # as many: the first of them stays
    assert [r for r in runs if r[0] == 5.0] == [(5.0, 50.0, 0)]


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
ROLLS_AWAY = {
    "end_effector": 2.92e-4,
    "torque": 4220.0,
    "arm": 0.039,
    "posture": 60.0,
    "damping": 0.936,
    "max_error": 0.174,
}


def test_to_stand_is_not_to_come_back(robot: ModelledRobot) -> None:
    """40 N s are 1.7 m/s for 23 kg; the end effector is back within 5 cm after 7 s, or the robot is metres away. No wheels stop 320 N s at
    once: that is 14 m/s."""
    controller = robot.controller(False, ROLLS_AWAY)
    pushed = robot.pushed(controller, 0.0, 40.0, 0.2)
    assert len(pushed) == 80 and pushed[-1, robot.robot.base.nq] == pytest.approx(40.0 / 23.0, rel=0.5)
    assert 3.0 / 4.0 < robot.loss(controller, 0.0, 40.0) < 1.0  # beyond 3 m
    assert 1.0 < robot.loss(controller, 0.0, 320.0) <= 2.0
    assert robot.loss(robot.controller(False, {}), 0.0, 10.0) < NEAR / (1.0 + NEAR)


def test_gains_that_were_found_are_the_maps(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(push_map, "GAINS", tmp_path / "gains.json")
    push_map.GAINS.write_text("{}")
    assert push_map.settings_of("ball", "scheduled-lqr") == ("controller=scheduled-lqr",)
    push_map.write_gains("ball", "scheduled-lqr", {"torque": 20.0, "max_error": 0.05})
    push_map.write_gains("hand", "lqr", {"torque": 3.0})
    given = push_map.settings_of("ball", "scheduled-lqr")
    assert given == (
        "controller=scheduled-lqr",
        "baseline.scheduled_lqr.torque=20",
        "baseline.scheduled_lqr.max_error=0.05",
    )
    assert push_map.settings_of("hand", "scheduled-lqr") == ("controller=scheduled-lqr",)
    assert push_map.settings_of("hand", "mpc") == ()


def test_the_summary_compares_direction_by_direction() -> None:
    """Medians of each, and of the ratios: 200/100, 150/150, 90/100; a direction that only one has does not count, and one in which
    the other never recovers is reported, not divided by. Farther than 3 m the ball went where the robot did not recover."""
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
    from wbmpc.studies.minniti2019.baselines import RegulatorSettings

    assert set(regulator_search.SPACE["lqr"]) == set(RegulatorSettings.model_fields)
