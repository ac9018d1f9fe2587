"""Robots on fixed wheels: files of one's own, driving them in MuJoCo, and a line to follow in the closed loop."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import yaml

from wbmpc import Reference, lie
from wbmpc.bases import base_type
from wbmpc.bases.planar_motion.messages import PlanarCommand
from wbmpc.bases.planar_motion.plant import PlanarPlant
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.robots import load_spec
from wbmpc.simulation.any_perturbation import AnyPerturbation
from wbmpc.simulation.lockstep import run_lockstep

#: Height [m] of the body's frame over the ground, and radius [m] of the wheels of files written here.
HEIGHT, RADIUS = 0.15, 0.08
#: A wheel: its place (x, y) [m] and its axis (3) in the axes of the body.
Wheel = tuple[tuple[float, float], tuple[float, float, float]]


def write_robot(
    folder: Path,
    wheels: list[Wheel],
    base: dict[str, Any],
    *,
    raised: float = 0.0,
    shape: str = "cylinder",
    extra: str = "",
) -> Path:
    """A YAML and an MJCF with an arm of two joints. ``raised`` [m]: by how much the last wheel hangs higher; ``shape`` of the
    wheels; ``extra``: attributes of their joints."""
    bodies = ""
    for i, ((x, y), axis) in enumerate(wheels):
        z = RADIUS - HEIGHT + (raised if i == len(wheels) - 1 else 0.0)
        turned = np.zeros(4)
        mujoco.mju_quatZ2Vec(turned, np.array(axis, float))
        bodies += f"""
      <body name="body{i}" pos="{x} {y} {z}">
        <inertial pos="0 0 0" mass="1.5" diaginertia="0.004 0.004 0.004"/>
        <joint name="w{i}" axis="{axis[0]} {axis[1]} {axis[2]}"{extra}/>
        <geom type="{shape}" size="{RADIUS} 0.02 0.02" quat="{" ".join(map(str, turned))}"/>
      </body>"""
    folder.mkdir(exist_ok=True)
    (folder / "robot.xml").write_text(f"""<mujoco>
  <compiler angle="radian" autolimits="true"/>
  <worldbody>
    <body name="chassis" pos="0 0 {HEIGHT}">
      <inertial pos="0 0 0.05" mass="25" diaginertia="0.8 0.8 1.2"/>{bodies}
      <body name="shoulder" pos="0 0 0.1">
        <inertial pos="0 0 0.05" mass="2" diaginertia="0.01 0.01 0.01"/>
        <joint name="pan" axis="0 0 1" range="-3 3"/>
        <body name="upper" pos="0 0 0.2">
          <inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
          <joint name="lift" axis="0 1 0" range="-2 2"/>
          <site name="tip" pos="0.3 0 0"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>""")
    names = [f"w{i}" for i in range(len(wheels))]
    speeds = {"pan": 2.0, "lift": 2.0, **dict.fromkeys(names, 12.0)}
    description = {
        "name": "own",
        "model": "robot.xml",
        "base": {"body": "chassis", "wheels": names, **base},
        "arm": {"joints": ["pan", "lift"], "tool": "tip"},
        "home": {"lift": 0.3},
        "limits": {"velocity": speeds, "effort": {"pan": 100.0, "lift": 100.0}},
    }
    path = folder / "robot.yaml"
    path.write_text(yaml.safe_dump(description))
    return path


def ideal_plant(robot: RobotModel) -> PlanarPlant:
    """A plant like the model, with perfect sensors."""
    plant: PlanarPlant = base_type(robot.description.base.type).plant(robot, AnyPerturbation.none(), 0)
    return plant


def drive(plant: PlanarPlant, wheel: np.ndarray, seconds: float) -> np.ndarray:
    """How the base (dx, dy, dyaw) moved in its own axes in the world while the wheels turned at rates (n) [rad/s], and stopped."""
    previous, arm = plant.truth().pose, len(plant.description.arm.joints)
    plant.step(PlanarCommand(wheel, np.zeros(arm)), round(seconds / plant.timestep))
    plant.step(PlanarCommand(np.zeros(len(wheel)), np.zeros(arm)), round(0.2 / plant.timestep))
    return lie.se2_log(previous, plant.truth().pose)


def kinematics_error(robot: RobotModel) -> float:
    """Largest distance [m] between the end effector of model and file at random states, by MuJoCo's own kinematics of the file."""
    description = robot.description
    model = load_spec(description).compile()
    data, rng, worst = mujoco.MjData(model), np.random.default_rng(0), 0.0
    body = model.body(description.base.body)
    for _ in range(10):
        x = rng.uniform(-1.5, 1.5, robot.state.size)
        for name, angle in zip(description.arm.joints, x[3:], strict=True):
            data.joint(name).qpos[0] = angle
        mujoco.mj_kinematics(model, data)
        tool = data.site(description.arm.tool).xpos - body.pos
        c, s = np.cos(x[2]), np.sin(x[2])
        expected = [x[0] + c * tool[0] - s * tool[1], x[1] + s * tool[0] + c * tool[1], body.pos[2] + tool[2]]
        worst = max(worst, float(np.abs(robot.pose(x)[0] - expected).max()))
    return worst


def follow_line(name: str, seed: int, length: float = 2.0, seconds: float = 7.0) -> tuple[float, float, float]:
    """The end effector follows a straight line ahead, ``length`` [m] in ``seconds`` [s]: largest error [mm] by the estimate and in
    the world, and how far [m] the base drove."""
    robot = load_robot(name)
    system = base_type(robot.description.base.type).system(robot, seed)
    start, orientation = robot.pose(robot.home)
    share = np.linspace(0.0, 1.0, 101)
    line = start + length * np.outer(share**2 * (3.0 - 2.0 * share), [1.0, 0.0, 0.0])
    times = np.concatenate([[0.0], 0.5 + seconds * share])
    system.mpc.reference["end_effector"] = Reference.poses(
        times, np.vstack([start, line]), np.tile(orientation, (102, 1))
    )
    errors: list[tuple[float, float]] = []

    def record(t: float, command: Any, plans: Any) -> None:
        if round(t / system.timing.period) % 20 == 0:
            goal, truth = system.mpc.reference["end_effector"].at(t)[:3], system.plant.truth()
            estimate = robot.pose(system.controller.state())[0]
            errors.append((float(np.linalg.norm(estimate - goal)), float(np.linalg.norm(truth.tool - goal))))

    ending = run_lockstep(system.plant, system.controller, system.mpc, system.timing, seconds + 1.0, record)
    assert not ending.reason, ending.reason
    estimated, world = 1e3 * np.max(errors, axis=0)
    return float(estimated), float(world), float(np.hypot(*system.plant.truth().pose[:2]))


class Constant:
    """A policy of one input forever."""

    end = 1.0

    def __init__(self, u: np.ndarray) -> None:
        self.u = u

    def feedforward(self, t: float) -> np.ndarray:
        return self.u.copy()
