"""Torque over speed. Truth: the line on paper; a rotor under full torque that comes to the no-load speed and not beyond."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from wbmpc.bases.ball.messages import BallCommand
from wbmpc.bases.ball.perturbation import BallPerturbation
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.model.robot import load_robot
from wbmpc.simulation.speed_torque import NO_LOAD, SpeedTorque

ROTOR = """<mujoco><worldbody><body><joint name="j" type="hinge"/><geom size="0.1" mass="1"/></body></worldbody>
<actuator><motor name="m" joint="j" forcerange="-2 2"/></actuator></mujoco>"""


@pytest.mark.parametrize(
    ("speed", "asked", "given"),
    [(0.0, 9.0, 2.0), (10.0, 9.0, 2.0), (11.25, 9.0, 1.0), (12.5, 9.0, 0.0), (20.0, 9.0, 0.0), (20.0, -9.0, -2.0), (-11.25, -9.0, -1.0)],
)  # fmt: skip
def test_torque_falls_on_a_line_to_the_no_load_speed_and_brakes_in_full(
    speed: float, asked: float, given: float
) -> None:
    model = mujoco.MjModel.from_xml_string(ROTOR)
    data = mujoco.MjData(model)
    drives = SpeedTorque(model, data, {"m": 10.0})
    for v in (15.0, speed):  # what was reduced is given back
        data.qvel[0], data.ctrl[0] = v, asked
        mujoco.mj_step1(model, data)
        drives.apply()
        mujoco.mj_fwdActuation(model, data)
    assert NO_LOAD == 1.25 and data.actuator_force[0] == pytest.approx(given)


def test_the_ball_robot_s_arm_does_not_run_away_under_full_torque() -> None:
    robot = load_robot("rezero")
    plant = BallPlant(robot.description, perturbation=BallPerturbation.none())
    fastest = 0.0
    for _ in range(40):
        plant.step(BallCommand(np.array([0.0, 0.0, 0.0, 20.0, 0.0, 0.0])), 5)
        fastest = max(fastest, plant.truth().joint_speeds["arm_yaw"])
    assert 4.0 < fastest < 1.05 * NO_LOAD * 4.0
