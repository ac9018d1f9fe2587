"""The world in which mink moves a robot. Truth: the robot model's own kinematics, and the limits of its file."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np

import wbmpc as wb
from wbmpc.tasks.obstacles import Among, static_scene

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
import obstacle_peers


def test_each_number_is_under_its_head() -> None:
    found = obstacle_peers.Figures("hard rows", 0.03, 0.004, 0.02, 0.0071, 2, "stuck")
    shown = obstacle_peers.table(SimpleNamespace(robot="r", seed=0), [found])  # type: ignore[arg-type]
    cells = {str(column.header): next(iter(column.cells)) for column in shown.columns}
    assert cells["clearance [mm]"] == "30.0" and cells["update [ms]"] == "7.10" and cells["failed"] == "2"
    assert all(cells.values())


def test_the_same_state_is_the_same_pose_and_the_same_limits() -> None:
    robot = wb.load_robot("swerve-ur10")
    world = obstacle_peers.KinematicWorld(robot, static_scene(Among(robot="swerve-ur10"), robot, 0))
    data, state = mujoco.MjData(world.model), robot.home + np.random.default_rng(0).uniform(-0.5, 0.5, robot.home.size)
    data.qpos[:] = world.positions(state)
    world.around.place(data, 0.0)
    mujoco.mj_kinematics(world.model, data)
    position = getattr(data, world.kind)(robot.tool).xpos
    np.testing.assert_allclose(position - world.shift, robot.pose(state)[0], atol=1e-6)
    assert world.limits()["elbow_joint"] == 3.14 and world.limits()["base_yaw"] == 1.0
    assert len(world.held) + len(world.free) == world.model.nv
    assert len({world.model.geom_bodyid[g] for g in world.obstacles}) == 3 and not set(world.own) & set(world.obstacles)
