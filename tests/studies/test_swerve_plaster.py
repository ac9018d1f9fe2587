"""`swerve-plaster`. Truth: accelerations by finite differences, volumes of the sprayed coat, passes and stops made by hand;
one short line in physics."""

from __future__ import annotations

import numpy as np
import pytest

from wbmpc.log import Log
from wbmpc.model.robot import load_robot
from wbmpc.studies.pankert2022 import plaster_wall as wall
from wbmpc.studies.pankert2022.plaster import EXPERIMENT
from wbmpc.studies.pankert2022.plaster_figures import coat, judged, metrics, pass_spread, stops
from wbmpc.studies.pankert2022.plaster_wall import Lines, SwervePlasterSettings


def test_the_way_is_that_of_the_paper_and_gentle() -> None:
    lines = Lines(10, 0.7, 1.0)
    assert 10 * lines._curve[0][-1] == pytest.approx(10 * (5 * 3.5 + 4 * np.pi * 0.075), rel=1e-3)  # about 180 m
    t = np.arange(0.0, lines.start + 2 * lines.pass_time + 1.0, 0.01)
    p = lines.point(t)
    v = np.gradient(p, 0.01, axis=0)
    a = np.gradient(v, 0.01, axis=0)
    # where a speed's slope has a corner, differences show it spread over two steps; the table has kinks of 5 mm in the arcs
    assert np.percentile(np.linalg.norm(a, axis=1), 99) < 2.05
    assert np.linalg.norm(v, axis=1).max() == pytest.approx(0.7, rel=1e-3)
    assert p.min() > -0.08 and p[:, 0].max() < 3.58 and p[:, 1].max() == pytest.approx(0.6, abs=1e-6)
    # the second pass is the first one backwards
    there, back = lines.start + 3.0, lines.start + 2 * lines.pass_time - 3.0
    np.testing.assert_allclose(lines.point(np.array([there])), lines.point(np.array([back])), atol=1e-6)


def test_what_is_sprayed_is_on_the_wall() -> None:
    end_effector = np.tile([1.5, wall.WALL - 0.1, 0.9], (100, 1))
    along, up, thick = coat(end_effector, 0.01)
    assert thick.sum() * wall.GRID**2 == pytest.approx(1.0, rel=0.01)  # 1 s at a rate of 1
    k, i = np.unravel_index(int(np.argmax(thick)), thick.shape)
    assert (along[i], up[k]) == pytest.approx((1.5, 0.9), abs=wall.GRID)
    far = coat(end_effector - [0.0, 0.05, 0.0], 0.01)[2]
    assert far.sum() == pytest.approx(thick.sum(), rel=0.01) and far.max() < 0.6 * thick.max()


def test_even_lines_make_an_even_coat_and_a_missing_one_a_gap() -> None:
    x = np.arange(0.0, wall.LENGTH, 0.007) + wall.AHEAD
    line = lambda k: np.stack([x, 0 * x + wall.WALL - 0.1, 0 * x + wall.LOWEST + k * wall.APART], axis=1)
    even = judged(*coat(np.vstack([line(k) for k in range(5)]), 0.01))
    assert even.std() / even.mean() < 0.02
    missing = judged(*coat(np.vstack([line(k) for k in (0, 1, 3, 4)]), 0.01))
    assert missing.std() / missing.mean() > 0.2 and np.mean(missing < wall.GAP * missing.mean()) > 0.03


def test_spread_is_that_of_the_passes() -> None:
    lines = Lines(4, 0.7, 1.0)
    t = np.arange(0.0, lines.end, 0.01)
    number, s = lines.arc(t)
    # what all passes share does not count; ±2 mm from pass to pass does
    across = 0.03 * np.sin(s) + np.where(number % 2, 0.002, -0.002)
    assert pass_spread(lines, t, across) == pytest.approx(0.002, rel=0.02)


def test_a_stop_is_counted() -> None:
    t = np.arange(0.0, 10.0, 0.01)
    target = np.stack([0.5 * t, 0 * t, 0 * t], axis=1)
    held = target.copy()
    held[(t > 4.0) & (t < 5.0)] = held[400]
    assert stops(t, target, target) == 0 and stops(t, held, target) == 1


def test_a_short_wall(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wall, "LENGTH", 0.6)
    monkeypatch.setattr(wall, "ENDS", 0.2)
    monkeypatch.setattr(wall, "LINES", 3)
    settings = SwervePlasterSettings(passes=2, settle_time=0.5, calibration="none", terrain=False)
    result = EXPERIMENT.run(settings, 0)
    assert result.completed, result.reason
    m = {k: v.value for k, v in result.metrics.items()}
    assert 1e-4 < m["hand_error_rms"] < 0.01 and 1e-4 < m["hand_error_rms_world_normal"] < 0.01
    assert m["path_length"] == pytest.approx(2 * (3 * 0.6 + 2 * np.pi * 0.075), rel=0.02)
    assert 0.08 < m["wall_distance_min"] < 0.1 and m["stops"] == 0.0 and 0 < m["pass_spread_rms"] < 0.003


def test_the_switch_stops_the_hand_before_the_wall(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wall, "NEAREST", 0.2)
    monkeypatch.setattr(wall, "LENGTH", 0.6)
    settings = SwervePlasterSettings(passes=1, settle_time=0.0, calibration="none", localization="none", terrain=False)
    result = EXPERIMENT.run(settings, 0)
    assert not result.completed and "switch stopped it" in result.reason


@pytest.mark.parametrize("passes", [1, 2])
def test_one_pass_differs_from_nothing(passes: int) -> None:
    """The spread of passes is a figure only where there are two."""
    references, log = wall.WallReferences(SwervePlasterSettings(passes=passes), load_robot("swerve-ur10")), Log()
    for t in np.arange(references.lines.start, references.lines.end, 0.05):
        end_effector = references.end_effector(np.array([t]))[0]
        for name in ("hand", "hand_odometry", "hand_reference"):
            log.add(name, t, end_effector)
        for name in ("base", "base_odometry"):
            log.add(name, t, references.base(np.array([t]))[0])
        log.add("wheel_slip", t, np.zeros(4))
    spread = {k for k in metrics(log, references, True) if k.startswith("pass_spread")}
    assert spread == ({"pass_spread_rms", "pass_spread_rms_world"} if passes == 2 else set())
