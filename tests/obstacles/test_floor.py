"""What keeps arms off the floor. Truth: MuJoCo's distances of the file's shapes to a plane."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import wbmpc as wb
from clearing import write_arm
from wbmpc.default_problem import default_mpc, default_problem
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.obstacles import geometry
from wbmpc.obstacles.floor import floor_boxes, heights
from wbmpc.obstacles.geometry import rigid_link
from wbmpc.obstacles.pairs import draw_states
from wbmpc.ocp import Reference
from wbmpc.robots import load_spec
from wbmpc.tasks import goals


def lowest(robot: RobotModel, states: np.ndarray) -> np.ndarray:
    """Least distances (n, boxes) [m] of the shapes of each box's part to the plane z = 0, by MuJoCo."""
    spec = load_spec(robot.description, meshes=True)
    spec.worldbody.add_geom(name="ground", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[10, 10, 1])
    model = spec.compile()
    data, ground = mujoco.MjData(model), model.geom("ground").id
    links = [rigid_link(robot, box.name) for box in floor_boxes(robot)]
    of = {
        g: rigid_link(robot, n)
        for g in range(model.ngeom)
        if (n := model.body(int(model.geom_bodyid[g])).name) in robot.frames
    }
    found = np.full((len(states), len(links)), np.inf)
    for k, state in enumerate(states):
        for joint, value in zip(robot.state.groups["arm"], state[robot.state["arm"]], strict=True):
            data.qpos[model.jnt_qposadr[model.joint(joint).id]] = value
        mujoco.mj_kinematics(model, data)
        for geom, link in of.items():
            if link in links and geom != ground:
                distance = mujoco.mj_geomDistance(model, data, ground, geom, 10.0, np.zeros(6))
                found[k, links.index(link)] = min(found[k, links.index(link)], distance)
    return found


@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_boxes_are_around_the_shapes(name: str) -> None:
    robot = load_robot(name)
    states = draw_states(robot, 50, seed=3)
    assert floor_boxes(robot)
    above = lowest(robot, states) - heights(robot, list(floor_boxes(robot)), states)
    assert above.min() > -1e-6 and above.max() < 0.25


def test_plans_stay_off_the_floor() -> None:
    """A goal under the floor."""
    robot = load_robot("ur5")
    mpc, x, t = default_mpc(robot), robot.home.copy(), 0.0
    position, orientation = robot.pose(robot.home)
    mpc.reference["end_effector"] = Reference.poses([0.0], [[*position[:2], -0.1]], orientation)
    states = []
    for _ in range(150):
        policy = mpc.update(wb.Observation(t, x))
        x, t = mpc.simulate(x, policy(t), mpc.period), t + mpc.period
        states.append(x)
    assert 0.0 < lowest(robot, np.array(states)).min() < 0.1


def test_a_robot_file_may_say_that_there_is_no_floor(tmp_path: Path) -> None:
    assert "floor" in default_problem(load_robot(write_arm(tmp_path))).terms
    assert "floor" not in default_problem(load_robot(write_arm(tmp_path, "collision: {floor: false}"))).terms


def test_goals_are_drawn_off_the_floor() -> None:
    robot = load_robot("ur5")
    settings = goals.GoalsSettings(robot="ur5")
    states = np.concatenate([goals.random_states(robot, settings, seed) for seed in range(5)])
    assert lowest(robot, states).min() > 0.0


def test_shapes_that_cannot_be_read_are_named_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Plans need no shapes, but nothing said why the arm went into the floor."""

    def unreadable(robot: RobotModel) -> None:
        raise InputError(f"{robot.description.model}: mesh 'fore' has no vertices")

    monkeypatch.setattr(geometry, "_read", unreadable)
    robot = load_robot(write_arm(tmp_path))
    assert floor_boxes(robot) == floor_boxes(robot) == ()
    (said,) = [r.getMessage() for r in caplog.records if r.levelname == "WARNING"]
    assert "off the floor" in said and "arm.xml: mesh 'fore' has no vertices" in said
