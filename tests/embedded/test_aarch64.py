"""Controllers that are exported for aarch64, run in an emulator of that processor. Truth: the loop in Python, whose code this machine runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import wbmpc as wb
from clearing import keep_clear, reach_problem, write_arm
from effort import thorough
from exported import trolley
from wbmpc.default_problem import default_mpc_settings, default_problem, make_mpc
from wbmpc.embedded import check as checks
from wbmpc.solver.controller import Result

pytest.importorskip("unicorn", reason="the emulator (pip install unicorn) is not installed")
from aarch64 import Controller


def reaching(folder: Path) -> wb.MPC:
    """An arm of three joints that keeps clear of its own foot: nearest points, braking plans and poses are in its code too."""
    robot = wb.load_robot(write_arm(folder))
    ocp = reach_problem(robot)
    keep_clear(ocp, wb.residuals.SelfClearance(robot, [("foot", "fore"), ("foot", "upper")], margin=0.02))
    mpc = wb.MPC(ocp, rate=25.0)
    mpc.reference["end_effector"] = wb.Reference.poses([0.0], [0.1, 0.0, 0.1], [1, 0, 0, 0])
    mpc.reset(robot.home)
    return mpc


def gallery(name: str) -> wb.MPC:
    """A robot of the gallery whose tool is to go half a meter ahead, by the default problem."""
    robot, settings = wb.load_robot(name), default_mpc_settings()
    mpc = make_mpc(default_problem(robot, settings), settings)
    position, orientation = robot.pose(robot.home)
    mpc.reference["end_effector"] = wb.Reference.poses([0.0], position + [0.5, 0.0, 0.0], orientation)
    mpc.reset(robot.home)
    return mpc


@pytest.mark.parametrize(
    "name", ["trolley", "arm", *(pytest.param(name, marks=thorough) for name in ("panda-omni", "fetch"))]
)
def test_a_controller_does_what_python_does(tmp_path: Path, name: str) -> None:
    mpc = trolley() if name == "trolley" else reaching(tmp_path) if name == "arm" else gallery(name)
    done = wb.export(mpc, tmp_path / "out", prefix="own", target="aarch64", samples=8)
    controller, u, apart = Controller(done), np.zeros(len(mpc.ocp.dynamics.input.names)), []
    assert controller("update", 0.0, mpc.solver.trajectory().x[0]) == Result.NOT_CREATED
    assert controller.create() == Result.OK
    for observed, expected in zip(*checks.record(mpc, 25), strict=True):
        t, x = float(observed[0]), observed[1:].copy()
        assert controller("update", t, x) == expected[0]
        assert controller("policy", t + 0.5 * mpc.period, x, u) == Result.OK
        apart.append(np.abs(u - expected[1:]) / (1.0 + np.abs(expected[1:])))
    assert np.abs(u).max() > 0.0
    assert np.max(apart) <= checks.LARGEST and np.median(apart) <= checks.MEDIAN
    # angles of joints reach foreign functions, the barrier's logarithms are the code's own
    assert name == "trolley" or {"sin", "cos", "sincos"} & set(controller.code.calls)
    assert "log" not in controller.code.calls
