"""MuJoCo does not read the clock in a simulated robot's physics steps. Truth: its own statistics of its parts."""

from __future__ import annotations

import mujoco
import numpy as np

from wbmpc import load_robot
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.plant import SwervePlant


def test_the_parts_of_a_physics_step_are_not_timed() -> None:
    mujoco.set_mjcb_time(None)  # as MuJoCo's package does by itself: it has its clock
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data)
    assert data.timer[0].duration > 0.0, "MuJoCo times itself by default"
    plant = SwervePlant(load_robot("swerve-ur10").description)
    plant.step(SwerveCommand.stop(), 5)
    assert np.all([timer.duration == 0.0 for timer in plant.data.timer])
