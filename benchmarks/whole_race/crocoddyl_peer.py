"""crocoddyl, in an environment of its own, on the nearest problems that its compiled classes can express.

It takes no symbolic functions: a model of ours would run in Python, which is no race. So:
torque arm: the same links, goal, weights and grid; its RK2 also integrates the costs at the interval's middle.
Ball robot: the same links with virtual joints of the base; all eight joints are actuated (in place of three wheels, three
arm joints and an end effector force), quadratic end effector costs, no limits. Swerve: it has no kinematic model with rolling rows, so only
linear-quadratic problems of the same size, without equality rows: a lower bound.
"""

from __future__ import annotations

import json
import subprocess
import venv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from wbmpc.kernel.cache import UntrustedCache, trusted_file, trusted_folder
from wbmpc.model.robot import load_robot
from wbmpc.model.tree import Link
from whole_race.torque_arm import (
    ANGLE,
    ARMATURE,
    END_EFFECTOR_WEIGHT,
    LENGTH,
    RATE,
    TORQUE,
    torque_arm_links,
)
from whole_race.torque_arm import torque_arm as arm

REQUIREMENTS = ("crocoddyl", "pin<4.1")


def environment(install: bool = True, seconds: float = 300.0) -> Path | str:
    """The Python of crocoddyl's environment, made when it is not there; a message when that fails."""
    try:
        folder = trusted_folder("crocoddyl")
    except (OSError, UntrustedCache) as error:
        return f"its environment has no safe directory: {error}"
    python = folder / "bin" / "python"
    if trusted_file(folder / "ready"):
        return python
    if not install:
        return "its environment has not been made"
    try:
        venv.create(folder, with_pip=True, clear=True)
        command = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *REQUIREMENTS]
        subprocess.run(command, check=True, capture_output=True, timeout=seconds)
        subprocess.run([str(python), "-c", "import crocoddyl"], check=True, capture_output=True, timeout=60)
    except (OSError, subprocess.SubprocessError) as error:
        return f"it could not be installed: {str(error)[:150]}"
    (folder / "ready").touch(mode=0o600)
    return python


def _links(links: Sequence[Link]) -> list[dict[str, Any]]:
    keys = ("name", "parent", "kind", "axis", "position", "rotation", "mass", "com", "inertia")
    plain = lambda value: value.tolist() if isinstance(value, np.ndarray) else value
    return [{k: plain(getattr(link, k)) for k in keys} for link in links]


def torque_arm_spec(joints: int, intervals: int, integrator: str = "rk2", repeat: int = 30) -> dict[str, Any]:
    """:func:`whole_race.torque_arm` for the child."""
    problem = arm(joints, intervals)
    hand, state = problem.references["end_effector"].values[0], problem.references["state"].values[0]
    return {
        "kind": "multibody",
        "integrator": integrator,
        "links": _links(torque_arm_links(joints)),
        "armature": ARMATURE,
        "tip": {"link": joints - 1, "position": [0.0, 0.0, LENGTH / joints], "rotation": np.eye(3).tolist()},
        "hand": {"position": hand.tolist(), "weight": [END_EFFECTOR_WEIGHT] * 3},
        "reference": state.tolist(),
        "state_weight": [ANGLE] * joints + [RATE] * joints,
        "torque": [0.0] * joints,
        "torque_weight": [TORQUE] * joints,
        "x0": problem.x0.tolist(),
        "u0": problem.u.tolist(),
        "horizon": problem.ocp.horizon,
        "intervals": intervals,
        "repeat": repeat,
    }


def ball_robot_spec(intervals: int, integrator: str = "rk2", repeat: int = 30) -> dict[str, Any]:
    """The ball robot's links with every joint actuated, a step of the end effector."""
    robot = load_robot("rezero")
    home, _ = robot.base.numeric.equilibrium(robot.home[robot.state["arm"]])
    tree = robot.tree
    position, _ = robot.pose(home)
    tool, n = tree.frames[robot.tool], len(tree.links)
    # the horizontal inertia of the ball's spin has no place in a rigid-body tree and is left out
    return {
        "kind": "multibody",
        "integrator": integrator,
        "links": _links(tree.links),
        "armature": 0.0,
        "tip": {"link": tool.link, "position": tool.position.tolist(), "rotation": tool.rotation.tolist()},
        "hand": {
            "position": (position + np.array([0.1, 0.0, 0.0])).tolist(),
            "weight": [300.0] * 3,
            "orientation": np.eye(3).tolist(),
            "turn_weight": [60.0, 60.0, 3.0],
            "speed_weight": [1.0] * 3 + [0.2] * 3,
        },
        "reference": home.tolist(),
        "state_weight": [0.0, 0.0, 1.0, 0.0, 0.0] + [0.0] * (n - 5) + [1.0, 1.0, 0.5, 2.0, 2.0] + [0.2] * (n - 5),
        "torque": [0.0] * n,
        "torque_weight": [0.05] * n,
        "x0": home.tolist(),
        "u0": [0.0] * n,
        "horizon": 0.02 * intervals,
        "intervals": intervals,
        "repeat": repeat,
    }


def lq_spec(nx: int, nu: int, intervals: int, repeat: int = 30) -> dict[str, Any]:
    """A linear-quadratic problem of crocoddyl's own numbers."""
    return {"kind": "lqr", "nx": nx, "nu": nu, "intervals": intervals, "repeat": repeat}


def crocoddyl_figures(specs: Sequence[dict[str, Any]], seconds: float = 60.0) -> list[dict[str, Any]] | str:
    """The child's figures, one for each problem; a message when there are none."""
    python = environment()
    if isinstance(python, str):
        return python
    script = Path(__file__).with_name("crocoddyl_child.py")
    variables = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PATH": "/usr/bin:/bin"}
    try:
        done = subprocess.run(
            [str(python), str(script)],
            input=json.dumps(list(specs)),
            capture_output=True,
            text=True,
            timeout=seconds,
            env=variables,
        )
    except subprocess.TimeoutExpired:
        return f"no answer in {seconds:.0f} s"
    if done.returncode:
        return (done.stderr.splitlines() or [f"ended with exit status {done.returncode}"])[-1][:200]
    answers: list[dict[str, Any]] = json.loads(done.stdout[done.stdout.index("[") :])
    return answers
