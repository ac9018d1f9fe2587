"""One static scene, three ways to keep clear of it: our hard rows, the same rows as relaxed barriers, and mink's collision limit.

Usage: python benchmarks/obstacle_peers.py [--robot swerve-ur10] [--seed 0] [--json FILE]
The scene, the path and the robot are those of `obstacles-static`, without physics, lag or noise: the end effector is to follow a clock's
reference that waits for nobody. Relaxed barriers are how OCS2 and perceptive_mpc keep clear (Pankert and Hutter, "Perceptive Model
Predictive Control for Continuous Mobile Manipulation", 2020). mink (https://github.com/kevinzakka/mink, `pip install mink daqp`; left out
where it is not installed) solves one step of inverse kinematics per update, with the weights of our cost and the same limits of speed. Its base
moves in all directions at once: it knows of no wheels.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

from wbmpc.experiment import run_parts
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.route import base_part
from wbmpc.obstacles.scene import SceneObstacle
from wbmpc.ocp import Constraint, OptimalControlProblem, RelaxedBarrier
from wbmpc.robots import load_spec
from wbmpc.simulation.contacts import FIXED, enable
from wbmpc.simulation.obstacles import SimulatedObstacles
from wbmpc.tasks.following import Task
from wbmpc.tasks.loop import Surroundings, closed_loop
from wbmpc.tasks.obstacles import Among, static_scene

Array = np.ndarray
#: μ and δ [m] of the relaxed barriers.
BARRIERS = ((1e-2, 1e-3), (1.0, 1e-2), (10.0, 1e-2))
#: mink: period [s]; from which distance [m] its rows act; its default gain. Its rows bound displacements of a period by gain · distance /
#: period, which is no bound before the margin is passed: with gain · period a period takes no more than that share of the distance.
PERIOD, DETECTED, GAIN = 0.005, 0.3, 0.85
#: Joints of the base that mink moves: along x, y, about z.
PLANAR = ("base_x", "base_y", "base_yaw")


@dataclass
class Figures:
    """Of one run: the least true ``clearance`` [m]; the end effector's errors [m]; the median time of an ``update`` [s]; updates
    without a solution; ``reason``: why it ended early."""

    name: str
    clearance: float = np.nan
    rms: float = np.nan
    largest: float = np.nan
    update: float = np.nan
    failures: int = 0
    reason: str = ""

    def errors(self, off: Array, times: Array) -> None:
        """Of distances (n) [m] from the reference and times (m) [s] of updates."""
        self.rms, self.largest = float(np.sqrt(np.mean(off**2))), float(off.max())
        self.update = float(np.median(times))


@dataclass
class Job:
    """What all have to do: the ``settings`` of the task with its ``scene``, the references until ``end`` [s], which count from ``since`` [s]."""

    settings: Among
    seed: int
    task: Task = field(init=False)
    scene: list[SceneObstacle] = field(init=False)

    def __post_init__(self) -> None:
        self.task = Task(self.settings, obstacles=True)
        self.robot, self.end, self.since = self.task.robot, self.task.end, self.settings.settle_time
        self.scene = static_scene(self.settings, self.robot, self.seed)
        self.references = {name: self.task.mpc.reference[name] for name in ("end_effector", "state")}


def with_barriers(ocp: OptimalControlProblem, barrier: RelaxedBarrier) -> None:
    """The problem's clearance rows become costs; an MPC that is built afterwards has them so."""
    term = ocp.terms["clearance"]
    assert isinstance(term, Constraint)
    ocp.terms["clearance"] = Constraint(term.name, term.residual, term.set, at=term.at, penalty=barrier)


def by_mpc(job: Job, name: str, barrier: RelaxedBarrier | None) -> Figures:
    """A closed loop of the robot's default MPC with hard rows, or with ``barrier``."""
    mpc, found = job.task.mpc, Figures(name)
    if barrier is not None:
        with_barriers(mpc.ocp, barrier)
        mpc = MPC(mpc.ocp, mpc.solver.settings, mpc.rate, guess=mpc.guess, obstacles=mpc.obstacles)
        for term, reference in job.references.items():
            mpc.reference[term] = reference
    scenario = closed_loop(
        job.robot, mpc, job.end, job.seed, job.settings, since=job.since, around=Surroundings(job.scene)
    )
    run = run_parts(scenario)
    log = scenario.log
    counted = log.times("end_effector") >= job.since
    off = np.linalg.norm(log.array("end_effector") - log.array("end_effector_reference"), axis=1)[counted]
    found.errors(off, np.array(mpc.statistics.solve_times))
    found.clearance = float(scenario.metrics(run)["obstacle_clearance_min"].value)
    found.failures, found.reason = mpc.statistics.failures, run.ending.reason
    return found


# ---------------------------------------------------------------------- mink
class KinematicWorld:
    """MuJoCo's model of a robot on a planar base among the obstacles of a scene. Its world has the floor at height 0."""

    def __init__(self, robot: RobotModel, scene: list[SceneObstacle]) -> None:
        description = robot.description
        self.robot, self.around = robot, SimulatedObstacles(scene, robot.description.base.ground)
        self.shift = np.array([0.0, 0.0, -robot.description.base.ground])
        spec = load_spec(description)
        body = spec.body(description.base.body)
        for joint, kind, axis in zip(PLANAR, ("SLIDE", "SLIDE", "HINGE"), np.eye(3), strict=True):
            body.add_joint(name=joint, type=getattr(mujoco.mjtJoint, f"mjJNT_{kind}"), axis=axis)
        self.around.edit(spec)
        enable(spec, description.home, description.model)
        self.model = m = spec.compile()
        self.around.bind(m)
        part = base_part(robot, "obstacle_peers")
        flat = [n for group in robot.state.groups.values() for n in group]
        flat[part] = PLANAR
        known = {m.joint(j).name for j in range(m.njnt)}
        #: (place in the robot's state, in qpos, in qvel) of what moves, and of wheels and all else that mink holds still
        self.joints = {
            n: (i, int(m.joint(n).qposadr[0]), int(m.joint(n).dofadr[0])) for i, n in enumerate(flat) if n in known
        }
        self.free = [*PLANAR, *description.arm.joints]
        self.kind = "site" if robot.tool in {m.site(k).name for k in range(m.nsite)} else "body"
        self.held = [dof for n, (_, _, dof) in self.joints.items() if n not in self.free]
        others = {m.body(b).id for b in range(m.nbody) if m.body_mocapid[b] >= 0}
        self.obstacles = [g for g in range(m.ngeom) if int(m.geom_bodyid[g]) in others]
        self.own = [g for g in np.flatnonzero(m.geom_conaffinity & FIXED).tolist() if g not in self.obstacles]

    def positions(self, state: Array) -> Array:
        """qpos of a state (nx)."""
        q = self.model.qpos0.copy()
        for place, at, _ in self.joints.values():
            q[at] = state[place]
        return q

    def limits(self) -> dict[str, float]:
        """Speeds of what moves [m/s], [rad/s]: those that our plans keep."""
        upper, names = self.robot.limits.input_upper, self.robot.input
        arm = dict(zip(names.groups["arm"], upper[names["arm"]], strict=True))
        return {**dict(zip(PLANAR, upper[names["base"]], strict=True)), **{n: float(arm[n]) for n in self.free[3:]}}


def by_mink(job: Job, name: str, gain: float) -> Figures:
    """Inverse kinematics step by step, with the weights of our cost."""
    import mink

    world, found = KinematicWorld(job.robot, job.scene), Figures(name)
    model, margin = world.model, job.robot.description.collision.margin
    ocp, state = job.task.mpc.ocp, job.references["state"]
    pose_weight, state_weight = (np.array(ocp.terms[n].expand(ocp.terms[n].weight)) for n in ("end_effector", "state"))
    costs = np.zeros(model.nv)
    for joint in world.free:
        place, _, dof = world.joints[joint]
        costs[dof] = np.sqrt(state_weight[place])
    tool, kind = job.robot.tool, world.kind
    effector = mink.FrameTask(tool, kind, np.sqrt(pose_weight[:3]), np.sqrt(pose_weight[3:]))
    posture = mink.PostureTask(model, costs)
    limits = [
        mink.ConfigurationLimit(model),
        mink.VelocityLimit(model, world.limits()),
        mink.CollisionAvoidanceLimit(model, [(world.own, world.obstacles)], gain, margin, DETECTED),
    ]
    still = [mink.DofFreezingTask(model, world.held)] if world.held else None
    now = mink.Configuration(model, world.positions(job.robot.home))
    off, times = [], []
    for k in range(round(job.end / PERIOD)):
        t = k * PERIOD
        world.around.place(now.data, t)
        now.update()
        goal = job.references["end_effector"].at(t)
        if t >= job.since:
            at = now.get_transform_frame_to_world(tool, kind).translation()
            off.append(float(np.linalg.norm(goal[:3] + world.shift - at)))
        world.around.distance(now.data)
        began = time.perf_counter()
        wanted = job.references["end_effector"].at(t + PERIOD)
        effector.set_target(mink.SE3(np.concatenate([wanted[3:], wanted[:3] + world.shift])))
        posture.set_target(world.positions(state.at(t + PERIOD)))
        try:
            speeds = mink.solve_ik(now, [effector, posture], PERIOD, "daqp", limits=limits, constraints=still)
        except mink.NoSolutionFound:
            speeds, found.failures = np.zeros(model.nv), found.failures + 1
        times.append(time.perf_counter() - began)
        now.integrate_inplace(speeds, PERIOD)
    found.errors(np.array(off), np.array(times))
    found.clearance = world.around.least
    return found


# ---------------------------------------------------------------------- the table
def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="swerve-ur10", help="a robot with a moving base that stands by itself")
    parser.add_argument("--seed", type=int, default=0, help="of the scene")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    args = parser.parse_args()
    settings = Among(robot=args.robot, plant="kinematic")
    runs: dict[str, Callable[[Job, str], Figures]] = {"hard rows": partial(by_mpc, barrier=None)}
    for mu, delta in BARRIERS:
        runs[f"relaxed barriers, μ {mu:g}, δ {1e3 * delta:g} mm"] = partial(by_mpc, barrier=RelaxedBarrier(mu, delta))
    if find_spec("mink") and find_spec("daqp"):
        runs |= {f"mink, gain {gain:.3g}": partial(by_mink, gain=gain) for gain in (GAIN, GAIN * PERIOD)}
    else:
        print("mink is left out: pip install mink daqp", file=sys.stderr)
    found = [run(Job(settings, args.seed), name) for name, run in runs.items()]
    Console(width=120).print(table(args, found))
    if args.json:
        args.json.write_text(json.dumps([asdict(f) for f in found], indent=1) + "\n")
    return 0


def table(args: argparse.Namespace, found: list[Figures]) -> Table:
    """All figures, one run a row."""
    made = Table(title=f"obstacles-static, {args.robot}, scene {args.seed}, kinematic")
    heads = (
        "",
        "clearance [mm]",
        "error rms [mm]",
        "error max [mm]",
        "update [ms]",
        "failed",
    )
    for head in heads:
        made.add_column(head, justify="right" if head else "left")
    for f in found:
        numbers = [f"{1e3 * v:.1f}" for v in (f.clearance, f.rms, f.largest)]
        name = f"{f.name}: {f.reason}" if f.reason else f.name
        made.add_row(name, *numbers, f"{1e3 * f.update:.2f}", str(f.failures))
    return made


if __name__ == "__main__":
    sys.exit(main())
