"""Closed loops among obstacles. Truth of clearances: the robot's own file in MuJoCo beside the obstacles' shapes, at fine time steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

import wbmpc as wb
from wbmpc.model.robot import RobotModel
from wbmpc.robots import load_spec

#: States between two updates at which the truth is measured.
FINE = 4


class TrueDistance:
    """Least distance of all geoms of a robot's file to cylinders, boxes and capsules given as (type, size)."""

    def __init__(self, robot: RobotModel, obstacles: list[tuple[mujoco.mjtGeom, list[float]]]) -> None:
        self.robot = robot
        spec = load_spec(robot.description)
        for geom in spec.geoms:  # for who looks at the robot's own contacts
            geom.contype = geom.conaffinity = 1
        for k, (kind, size) in enumerate(obstacles):
            body = spec.worldbody.add_body(name=f"obstacle{k}", mocap=True)
            body.add_geom(type=kind, size=[*size, 0, 0][:3])
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        count = len(obstacles)
        bodies = [self.model.body(f"obstacle{k}").id for k in range(count)]
        self.others = [int(self.model.body_geomadr[b]) for b in bodies]
        self.own = [g for g in range(self.model.ngeom) if g not in self.others]
        self.mocap = [int(self.model.body_mocapid[b]) for b in bodies]

    def __call__(self, x: np.ndarray, places: list[np.ndarray]) -> float:
        """At a state (nx), with the obstacles' centers (3) [m]."""
        m, d, robot = self.model, self.data, self.robot
        body = robot.description.base.body
        if robot.description.base.moves:
            m.body_pos[m.body(body).id], m.body_quat[m.body(body).id] = robot.pose(x, body)
        for joint in range(m.njnt):
            name = m.joint(joint).name
            group = next((g for g, names in robot.state.groups.items() if name in names), None)
            if group is not None:
                d.qpos[m.jnt_qposadr[joint]] = x[robot.state.index(f"{group}.{name}")]
        for k, place in zip(self.mocap, places, strict=True):
            d.mocap_pos[k] = place
        mujoco.mj_kinematics(m, d)
        return min(mujoco.mj_geomDistance(m, d, g, o, 2.0, None) for g in self.own for o in self.others)


@dataclass(frozen=True)
class Ran:
    """Least true distance [m], the last state (nx), how far [m] the end effector is from its last target, and the MPC."""

    least: float
    x: np.ndarray
    missed: float
    mpc: wb.MPC


def run(
    mpc: wb.MPC,
    robot: RobotModel,
    truth: TrueDistance,
    places: Callable[[float], list[np.ndarray]],
    change: Callable[[float], None],
    duration: float,
    *,
    seen_from: float = 0.0,
    start: np.ndarray | None = None,
) -> Ran:
    """The model itself is the plant; ``change`` sets obstacles before each update; ``seen_from`` [s]: when distances begin to count."""
    x, least = (robot.home if start is None else start).copy(), np.inf
    for k in range(round(duration * mpc.rate)):
        t = k / mpc.rate
        change(t)
        policy = mpc.update(wb.Observation(t, x))
        for i in range(1, FINE + 1):
            x = mpc.solver.simulate(x, policy(t + (i - 1) / (FINE * mpc.rate), x), mpc.period / FINE)
            if t >= seen_from:
                least = min(least, truth(x, places(t + i * mpc.period / FINE)))
    target = mpc.reference["end_effector"].at(duration)[:3]
    return Ran(least, x, float(np.linalg.norm(robot.pose(x)[0] - target)), mpc)


ARM = """<mujoco><compiler angle="radian" autolimits="true"/><worldbody><body name="foot">
<geom type="cylinder" size="0.08 0.05" pos="0 0 0.05"/>
<body name="shoulder" pos="0 0 0.3"><joint name="pan" axis="0 0 1" range="-3 3"/><geom type="capsule" fromto="0 0 -0.1 0 0 0" size="0.05"/>
<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
<body name="upper"><joint name="lift" axis="0 1 0" range="-2 2"/><geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.04"/>
<inertial pos="0.2 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
<body name="fore" pos="0.4 0 0"><joint name="elbow" axis="0 1 0" range="-2.5 2.5"/><geom type="cylinder" fromto="0 0 0 0.35 0 0" size="0.035"/>
<inertial pos="0.2 0 0" mass="1" diaginertia="0.01 0.01 0.01"/><site name="tip" pos="0.35 0 0"/>
</body></body></body></body></worldbody></mujoco>"""


def write_arm(folder: Path, collision: str = "") -> Path:
    """A fixed arm of three joints: a YAML and an MJCF; ``collision``: that section of the YAML."""
    (folder / "arm.xml").write_text(ARM)
    path = folder / "arm.yaml"
    path.write_text(f"""name: arm
model: arm.xml
base: {{type: fixed, body: foot}}
arm: {{joints: [pan, lift, elbow], tool: tip}}
home: {{lift: -0.6, elbow: 0.9}}
limits: {{velocity: {{pan: 1.5, lift: 1.5, elbow: 1.5}}, acceleration: {{pan: 6, lift: 6, elbow: 6}}}}
{collision}
""")
    return path


def reach_problem(robot: RobotModel, horizon: float = 2.0, intervals: int = 20) -> wb.OptimalControlProblem:
    """The end effector's position, small rates and a posture as costs; speeds and ranges as hard limits."""
    ocp = wb.OptimalControlProblem(robot.dynamics(), horizon, intervals, first_interval=0.02)
    pose = wb.residuals.FramePose(robot, robot.tool)
    ocp.add(wb.Cost("end_effector", pose, [200.0] * 3 + [0.0] * 3, at="path+terminal"))
    ocp.add(wb.Cost("input", wb.residuals.Input(robot, reference=None), 1.0))
    ocp.add(wb.Cost("posture", wb.residuals.State(robot, ["arm"]), 0.5))
    limits, state = robot.limits, wb.residuals.State(robot, reference=None)
    speeds = wb.sets.Box(limits.input_lower, limits.input_upper)
    ocp.add(wb.Constraint("speeds", wb.residuals.Input(robot, reference=None), speeds, hard=True))
    ranges = wb.sets.Box(limits.state_lower, limits.state_upper)
    ocp.add(wb.Constraint("ranges", state, ranges, at="path+terminal", hard=True))
    return ocp


def keep_clear(ocp: wb.OptimalControlProblem, residual: wb.residuals.Residual, name: str = "clearance") -> None:
    """The rows as a hard constraint."""
    ocp.add(wb.Constraint(name, residual, wb.sets.NonNegative(), at="path+terminal", hard=True, slack=1e4))
