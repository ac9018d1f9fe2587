"""Plots of the live view. Truth: a run of known times and peaks; the limits in the robots' files, by joint."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from wbmpc import lie
from wbmpc.model.robot import load_robot
from wbmpc.robots import load_description
from wbmpc.stability import configuration_positions
from wbmpc.view.actuator_load import SHARES, Loads
from wbmpc.view.history import POINTS, SAMPLES, SPAN, History, Trail
from wbmpc.view.named_configuration import NamedConfiguration, configuration_text
from wbmpc.view.snapshot import TRAIL, errors, status_text
from wbmpc.view.user_commands import Controls

pytest.importorskip("viser")
from wbmpc.view.panel import plotted
from wbmpc.view.replay_plots import POINTS as POINTS_OF_REPLAYS
from wbmpc.view.replay_plots import marked, thinned


@pytest.mark.parametrize("pictures", [30, 230, 2000])
def test_plots_show_the_last_seconds_of_the_run_however_slowly_it_goes(pictures: int) -> None:
    """Pictures come by the wall clock: of a run slower than real time there are more to a second of its own time."""
    history, peaks = History(), []
    for k in range(40 * pictures):
        t = k / pictures
        peak = 5.0 if abs(t - 33.0) < 0.4 / pictures else 0.0
        peaks.append(peak)
        history.add(np.array([t, peak, np.nan]))
    rows = history.rows
    assert max(peaks) == 5.0 and rows[:, 1].max() == 5.0 and np.isnan(rows[:, 2]).all()
    assert rows[-1, 0] - rows[0, 0] == pytest.approx(SPAN, abs=0.2) and len(rows) <= SAMPLES + 1
    for _ in range(2 * SAMPLES):  # paused: pictures of one moment
        history.add(np.array([rows[-1, 0], 0.0, 0.0]))
    assert len(history.rows) == len(rows)
    history.add(np.array([0.0, 1.0, 1.0]))  # restarted
    np.testing.assert_array_equal(history.rows, [[0.0, 1.0, 1.0]])


def test_shares_of_the_limits_by_group() -> None:
    robot = load_description("swerve-ur10")
    joints = ["leg_LF", "leg_RB", "steer_LF", "wheel_RB", "elbow_joint", "wrist_1_joint", "another"]
    loads = Loads(robot, joints)
    assert loads.groups == ("arm", "legs", "steering", "wheels")
    shares = loads.shares(np.array([0.1, -0.2, 1.0, 8.0, 1.57, 0.0, 1e3]))
    assert list(shares.values()) == pytest.approx([0.5, 0.5, 0.2, 0.8, *[np.nan] * 4], nan_ok=True)
    assert tuple(shares) == SHARES


def test_groups_of_a_base_that_is_not_ours() -> None:
    """Names and number of groups are what its description says."""
    axes = {f"axis {k}": [f"axis_{k}"] for k in range(9)}
    base = SimpleNamespace(joint_groups=lambda: axes, captions={n: n for n in axes}, torque_limits=lambda limits: [])
    limits = SimpleNamespace(velocity={f"axis_{k}": 2.0 for k in range(9)})
    robot: Any = SimpleNamespace(base=base, limits=limits, arm=SimpleNamespace(joints=["elbow"]))
    loads = Loads(robot, [f"axis_{k}" for k in range(9)])
    assert loads.groups == tuple(axes)[: len(SHARES)]
    assert list(loads.shares(0.1 * np.arange(9.0)).values()) == pytest.approx(0.05 * np.arange(8.0))
    figures = plotted(Controls("t", (), False, False, loads.groups))
    lines = next(found for title, found in figures.items() if title.startswith("Speeds / limits"))
    assert [(place, name) for place, name, *_ in lines] == list(zip(SHARES, loads.groups, strict=True))


def test_shares_of_a_ball_robot() -> None:
    """Its wheels are limited by a torque (4 N m), which comes first among the drives; its arm's joints by 4 rad/s."""
    loads = Loads(load_description("rezero"), ["arm_yaw", "arm_shoulder", "arm_elbow"])
    assert loads.groups == ("arm", "drives")
    shares = loads.shares(np.array([1.0, -2.0, 0.0]), np.array([1.0, -3.0, 0.0, 18.0, 0.0, 0.0]))
    assert list(shares.values()) == pytest.approx([0.5, 0.75, *[np.nan] * 6], nan_ok=True)
    assert np.isnan(loads.shares(np.zeros(3))[SHARES[1]])


def test_errors() -> None:
    turned = np.array([0.3, 0.0, 0.4, *lie.quaternion_about((0.0, 1.0, 0.0), 0.2)])
    found = errors(
        turned, np.array([0.0, 0, 0, 1, 0, 0, 0]), np.array([1.0, 2.0, 0.5, 1, 0, 0, 0]), np.array([1.0, 2.1, 3.0])
    )
    assert found == pytest.approx({"error": 0.5, "turn": 0.2, "base": 0.1})
    assert np.isnan([*errors(turned, np.full(7, np.nan), turned, np.full(3, np.nan)).values()]).all()


def test_a_trail_is_the_way_that_was_taken_and_stays_short() -> None:
    """Truth: points of a straight way of 10 m, in steps of 1 mm."""
    trail = Trail()
    for k in range(10_001):
        points = trail.add(np.array([0.001 * k, 0.0, 0.3]))
    assert len(points) <= POINTS + 1 <= TRAIL
    assert points[0, 0] == 0.0 and points[-1, 0] == pytest.approx(10.0)
    assert np.diff(points[:, 0]).max() < 0.2 and (np.diff(points[:, 0]) >= 0.0).all()
    assert len(trail.add(np.full(3, np.nan))) <= POINTS  # there is no pose now
    trail.reset()
    assert len(trail.add(np.zeros(3))) == 2


NAMES = ["H", "X", "A"]


@pytest.mark.parametrize("name", NAMES)
def test_the_configuration_of_legs_is_named(name: str) -> None:
    """Truth: the angles that a configuration asks for."""
    robot = load_robot("swerve-ur10")
    joints = [*robot.state.groups["wheel"], *robot.state.groups["leg"]]
    legs = NamedConfiguration(robot, joints)
    positions = np.concatenate([np.full(4, 7.0), configuration_positions(robot, name)])
    assert configuration_text(legs.number(positions), NAMES) == f"configuration: {name}"
    assert f"configuration: {name}" in status_text(
        {"error": np.nan, "margin": np.nan, "triangle_margin": np.nan, "configuration": legs.number(positions)}, NAMES
    )
    positions[5] += 0.2
    assert configuration_text(legs.number(positions), NAMES) == "between configurations"
    arm = load_robot("panda")
    assert configuration_text(NamedConfiguration(arm, list(arm.state.groups["arm"])).number(arm.home), NAMES) == ""


def test_a_replays_plots_keep_peaks_and_mark_the_moment() -> None:
    """Truth: the highest value, and the upright line's place and height, by hand."""
    times, values = np.arange(5000) / 100.0, np.zeros(5000)
    values[1234] = 9.0
    t, y = thinned(times, values)
    assert len(t) <= POINTS_OF_REPLAYS and y.max() == 9.0 and (np.diff(t) > 0.0).all()
    values[7] = np.nan  # no number at this time
    t, y = thinned(times, values)
    data = marked(t, [y, np.full(t.size, 2.0)], 20.0)
    assert all(np.isfinite(row).all() for row in data)
    assert data[0][data[-1] > 0.0].tolist() == [20.0] and data[-1].max() == 9.0
    assert (np.diff(data[0]) >= 0.0).all() and len({len(row) for row in data}) == 1
    np.testing.assert_array_equal(np.interp(t, data[0], data[1]), y)
