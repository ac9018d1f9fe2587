"""Figures of a run computed once more from what it wrote, by other means than the experiments use."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from toys import robot
from wbmpc import compare
from wbmpc.log import Log
from wbmpc.report import write_run
from wbmpc.studies.minniti2019.step_goals import STEPS


def archive(result, folder: Path) -> tuple[dict[str, float], dict[str, np.ndarray]]:  # type: ignore[no-untyped-def]
    files = write_run(result, folder)
    saved = json.loads(Path(files["metrics"]).read_text())["metrics"]
    with np.load(files["log"]) as log:
        return {n: m["value"] for n, m in saved.items()}, {n: log[n] for n in log.files}


def without_units(log: Log) -> set[str]:
    """Channels of a log of which plots know no unit for some component."""
    run = compare.Run(Path(), {}, {c: log.array(c) for c in log.channels}, labels=log.names, units=log.units)
    return {c for c in log.channels if not all(compare._components(run, c)[1])}


def check_track(track, folder: Path) -> None:  # type: ignore[no-untyped-def]
    m, log = archive(track, folder)
    use = log["hand.time"] >= 2.0
    apart = lambda name: np.sqrt(((log[name] - log["hand_reference"]) ** 2).sum(axis=1))
    assert m["hand_error_mean_odometry"] == pytest.approx(apart("hand_odometry")[use].mean(), rel=1e-12)
    assert m["hand_error_max_odometry"] == pytest.approx(apart("hand_odometry")[use].max(), rel=1e-12)
    assert m["hand_error_mean_world"] == pytest.approx(apart("hand")[use].mean(), rel=1e-12)
    assert m["wheel_slip_max"] == log["wheel_slip"][use].max()
    base = log["base"]
    way = sum(np.linalg.norm(b - a) for a, b in zip(base[:-1, :2], base[1:, :2], strict=True))
    assert m["base_path_length"] == pytest.approx(way, rel=1e-9)
    for name, channel in (("", "base_odometry"), ("_wheels", "base_wheels"), ("_release", "base_release")):
        lost = np.linalg.norm(log[channel][-1, :2] - base[-1, :2])
        assert m[f"odometry_drift_ratio{name}"] == pytest.approx(lost / way, rel=1e-9)
    # speeds of the joints: those of their angles, which the encoders report
    speeds = np.gradient(log["arm"], log["arm.time"], axis=0)
    late = log["arm.time"] > 1.0
    np.testing.assert_allclose(log["joint_speed"][late, -6:], speeds[late], atol=0.05)
    assert np.corrcoef(log["joint_speed"][late, -6], speeds[late, 0])[0, 1] > 0.9


def check_steps(steps, folder: Path) -> None:  # type: ignore[no-untyped-def]
    m, log = archive(steps, folder)
    t, end_effector, s = log["hand.time"], log["hand"], steps.settings
    ball = robot("rezero")
    home = ball.pose(ball.home)[0]
    lead, worst, rises = s["mpc"]["horizon"] if s["preview"] else 0.0, [], []
    for k, step in enumerate(STEPS):
        leave = s["settle_time"] + (k + 1) * s["hold_time"] - lead
        goal = home + np.array(step.move)
        last = (t >= leave - 1.0) & (t < leave)
        worst.append(np.linalg.norm(log["hand_estimated"][last] - goal, axis=1).mean())
        if any(step.move):
            previous = home + np.array(STEPS[k - 1].move if k else (0, 0, 0))
            window = (t >= leave - s["hold_time"]) & (t < leave)
            gone = (end_effector[window] - previous) @ (goal - previous) / np.sum((goal - previous) ** 2)
            first = lambda level, g=gone, w=window: t[w][np.argmax(g > level)]
            rises.append(first(0.9) - first(0.1))
    assert m["steady_position_error_max"] == pytest.approx(max(worst), rel=1e-9)
    assert m["rise_time_max"] >= max(rises) - 1e-12
    assert m["rise_time_max"] == pytest.approx(max(rises), abs=0.3)  # the two rotations are not among these
    assert m["tilt_max"] == log["tilt"].max()
    assert m["wheel_torque_max"] == np.abs(log["torque"][:, :3]).max()
