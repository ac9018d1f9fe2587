"""Other robots on a ball from their descriptions alone: four wheels, steeper wheels, an arm of six joints. Truth: MuJoCo's physics
keeps them up or not, and the lean at rest is that of MuJoCo's center of mass."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from effort import some
from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.defaults import rezero_mpc, set_home_references
from wbmpc.bases.ball.estimator import BallEstimator
from wbmpc.bases.ball.fall_detection import FallPredictor
from wbmpc.bases.ball.perturbation import BallPerturbation
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.ball.sent_torques import DriveSettings
from wbmpc.bases.ball.settings import STEPS_AND_PUSHES, mpc_settings
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.ocp import Reference
from wbmpc.robots.description import DATA
from wbmpc.simulation.lockstep import run_lockstep
from wbmpc.types import Timing

WRIST = """<body name="wrist_{k}_link" pos="0 0 {z}"><inertial pos="0 0 0.02" mass="0.25" diaginertia="3e-3 3e-3 2e-3"/>
<joint name="wrist_{k}" axis="{axis}" range="-2 2"/>{inside}</body>"""
TOOL = '<site name="tool" pos="0 0 0.30" size="0.01"/>'


def variant(folder: Path, wheels: int, zenith: float, wrist: bool) -> RobotModel:
    """Rezero with other wheels and, if asked for, three more joints behind the forearm."""
    model, data = (DATA / "rezero.xml").read_text(), yaml.safe_load((DATA / "rezero.yaml").read_text())
    assert TOOL in model
    if wrist:
        inside = '<site name="tool" pos="0 0 0.06" size="0.01"/>'
        for k, axis, z in ((3, "0 0 1", 0.05), (2, "1 0 0", 0.05), (1, "0 0 1", 0.30)):
            inside = WRIST.format(k=k, axis=axis, z=z, inside=inside)
        model = model.replace(TOOL, inside)
        more = [f"wrist_{k}" for k in (1, 2, 3)]
        data["arm"]["joints"] += more
        data["home"] |= {"wrist_2": 0.4}
        data["limits"]["velocity"] |= dict.fromkeys(more, 4.0)
        data["limits"]["effort"] |= dict.fromkeys(more, 5.0)
    data["base"]["wheels"] |= {
        "zenith": float(zenith),
        "azimuths": [float(v) for v in 2.0 * np.pi * (np.arange(wheels) + 0.25) / wheels],
    }
    (folder / "robot.xml").write_text(model)
    (folder / "robot.yaml").write_text(yaml.safe_dump(data | {"model": "robot.xml", "name": "variant"}))
    return load_robot(folder / "robot.yaml")


@pytest.mark.parametrize(("wheels", "zenith", "wrist"), some([(4, 0.7, False), (3, 0.9, True)], [1]))
def test_it_balances_under_a_push(tmp_path: Path, wheels: int, zenith: float, wrist: bool) -> None:
    robot = variant(tmp_path, wheels, zenith, wrist)
    assert len(robot.input.groups["wheel"]) == wheels and len(robot.state.groups["arm"]) == (6 if wrist else 3)
    arm = robot.home[robot.state["arm"]]
    home, torque = robot.base.numeric.equilibrium(arm)
    settings = mpc_settings(barrier_mu=3e-2)
    mpc = rezero_mpc(robot, settings, STEPS_AND_PUSHES)
    set_home_references(mpc, robot, torque, home)
    mpc.reference["end_effector"] = Reference.poses([0.0], *robot.pose(home))
    plant = BallPlant(robot.description, home, torque, BallPerturbation(), seed=1)
    timing = Timing.of(plant.timestep, 400.0, settings.rate, settings.computation_delay)
    controller = BallController(
        robot,
        mpc,
        torque,
        timing.period,
        DriveSettings(0.02),
        True,
        BallEstimator(robot, home),
        FallPredictor(robot, arm),
    )
    mpc.reset(home, torque)
    seen: list[tuple[float, float, float, float]] = []

    def record(t: float, command: object, plans: object) -> None:
        plant.push([40.0, 40.0, 0.0] if 0.5 <= t < 0.6 else np.zeros(3))
        truth = plant.truth()
        away = float(np.linalg.norm(truth.tool - robot.pose(home)[0]))
        seen.append((t, truth.tilt, away, float(np.linalg.norm(plant.state()[:2]))))

    ending = run_lockstep(plant, controller, mpc, timing, 3.5, record)
    assert not ending.reason
    t, tilt, away, travel = np.array(seen).T
    # 57 N for 0.1 s give 0.2 m/s for 25 kg
    assert 0.02 < travel[(t > 0.5) & (t < 1.5)].max() < 0.5
    assert away[t > 3.0].max() < 0.05 and tilt[t > 3.0].max() < 0.3
