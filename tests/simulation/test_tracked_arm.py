"""Zeros of the arms of any robots. Truth: those that the simulated robot was made with, and where MuJoCo has its end effectors."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from wbmpc.bases import base_type
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.robots.couplings import put_followers
from wbmpc.simulation import tracked_arm
from wbmpc.simulation.arm import ArmPlant
from wbmpc.tasks.loop import make_system
from wbmpc.tasks.reference_drive import arm_zeros
from wbmpc.tasks.settings import TaskSettings


def made(name: str, seed: int = 0) -> tuple[RobotModel, ArmPlant]:
    robot = load_robot(name)
    plant = base_type(robot.description.base.type).plant(robot, None, seed)
    assert isinstance(plant, ArmPlant)
    return robot, plant


def misses(robot: RobotModel, plant: ArmPlant) -> list[float]:
    """How far [m] every end effector is from where encoders that read home say that it is, in axes of the base."""
    data, body = mujoco.MjData(plant.model), plant.model.body(robot.description.base.body).id
    places = [int(plant.model.joint(n).qposadr[0]) for n in robot.description.arm.joints]
    found = []
    for offset in (plant.offsets["arm"], np.zeros(len(places))):
        data.qpos[:] = plant.data.qpos
        data.qpos[places] = robot.home[robot.state["arm"]] - offset
        put_followers(plant.model, data)
        mujoco.mj_kinematics(plant.model, data)
        axes = data.xmat[body].reshape(3, 3)
        at = [tracked_arm._place(plant.model, data, frame) for frame in robot.tools.values()]
        found.append([(p - data.xpos[body]) @ axes for p in at])
    return list(np.linalg.norm(np.subtract(*found), axis=1))


@pytest.mark.parametrize(
    "name", ["fetch", "pr2", "panda", "telescope-ur10"]
)  # a lift; two arms; no base that moves; legs
def test_end_effectors_are_where_calibrated_encoders_say(name: str) -> None:
    """By the tracker's noise of 0.1 mm over 24 postures; joints that move no end effector keep what they had."""
    robot, plant = made(name)
    before, truth = misses(robot, plant), plant.data.qpos.copy()
    plant.set_zeros(arm_zeros(robot, plant, 0))
    after = misses(robot, plant)
    assert len(before) == len(robot.tools) and min(before) > 0.5e-3 and max(after) < 0.12e-3
    np.testing.assert_array_equal(plant.data.qpos, truth)
    # and the next message has it
    read = plant.measure().state if name == "panda" else plant.measure().arm
    true = plant.truth().state[robot.state["arm"]]
    assert read - true == pytest.approx(plant.offsets["arm"], abs=1e-4)


def test_a_run_with_a_calibration_has_encoders_without_the_zeros_that_show() -> None:
    robot = load_robot("panda")
    kind, left = base_type("fixed"), []
    for calibration in ("none", "drive"):
        settings = TaskSettings(robot="panda", plant={"calibration": calibration})
        left += misses(robot, make_system(robot, kind.mpc(robot), settings, 3).plant)
    assert left[0] > 0.5e-3 and left[1] < 0.1e-3


def test_parts_are_not_in_each_other_where_the_arm_is_tracked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Truth: MuJoCo's contacts of a robot whose postures are taken anywhere."""
    robot, plant = made("fetch")
    seen = tracked_arm.track_arm(robot, plant, 5, 1)[0]
    assert (np.abs(seen - robot.home[robot.state["arm"]]) < tracked_arm.SPREAD + 0.01).all()
    touching, calls = tracked_arm._touching, list[int]()

    def never_free(model: mujoco.MjModel, data: mujoco.MjData) -> set[tuple[int, int]]:
        calls.append(1)
        return touching(model, data) | {(-1, len(calls))}

    monkeypatch.setattr(tracked_arm, "_touching", never_free)
    with pytest.raises(InputError, match=r"fetch: of 1000 postures .* 0 are without parts"):
        tracked_arm.track_arm(robot, plant, 5, 1)
