"""What touches what. Truth: geometry on paper (where a post stands against a wrist), gravity (a robot that falls lies on its hull)."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from wbmpc.bases import base_type
from wbmpc.bases.ball.messages import BallCommand
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.model.robot import load_robot
from wbmpc.simulation.any_perturbation import AnyPerturbation
from wbmpc.simulation.contacts import FLOOR, HULL, OBSTACLE, ROLLS
from wbmpc.simulation.lockstep import Ending

IDEAL = AnyPerturbation.none()
SWERVE, BALL = load_robot("swerve-ur10"), load_robot("rezero")
STOP = SwerveCommand.stop(4, 6)


def post(at: np.ndarray) -> object:
    """A post of 4 cm by 4 cm with its middle ``at`` (2) [m]."""

    def edit(spec: mujoco.MjSpec) -> None:
        spec.worldbody.add_geom(
            name="post", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.02, 0.02, 1.0], pos=[*at, 1.0], **OBSTACLE
        )

    return edit


def test_a_post_is_in_the_way_and_every_touch_is_counted_once() -> None:
    free = SwervePlant(SWERVE.description, perturbation=IDEAL)
    wrist = free.data.body("wrist_3_link").xpos[:2].copy()
    free.step(STOP, 200)
    assert free.world.contacts.touches == []
    hit = SwervePlant(SWERVE.description, perturbation=IDEAL, edit=post(wrist + [0.0, 0.03]), settle=0.0)  # type: ignore[arg-type]
    for _ in range(20):
        hit.step(STOP, 5)
    touches = hit.world.contacts.touches
    pairs = [(t.first, t.second) for t in touches]
    assert ("world", "wrist_3_link") in pairs and {second.partition("_")[0] for _, second in pairs} == {"wrist"}
    assert len(set(pairs)) == len(pairs)  # each is one event as long as it lasts
    assert hit.world.contacts.clearance < 0.0
    ending = Ending.of(hit)
    assert ending.contacts[0].touches == touches and not ending.fell


def test_the_clearance_is_the_distance_to_the_nearest_obstacle() -> None:
    """The body is 0.4 m wide to each side, the post begins 20 mm beside it."""
    plant = SwervePlant(SWERVE.description, perturbation=IDEAL, edit=post(np.array([0.0, 0.44])))  # type: ignore[arg-type]
    plant.step(STOP, 5)
    assert plant.world.contacts.clearance == pytest.approx(0.02, abs=1e-3) and plant.world.contacts.touches == []


def test_a_ball_robot_without_torques_lies_on_the_floor_in_the_end() -> None:
    plant = BallPlant(BALL.description, perturbation=IDEAL)
    for _ in range(1200):
        plant.step(BallCommand(np.zeros(6)), 5)
    contacts = plant.world.contacts
    assert plant.fell and contacts.grounded and any("base" in (t.first, t.second) for t in contacts.touches)
    lowest = min(plant.data.geom_xpos[g, 2] for g in range(1, plant.model.ngeom))
    assert lowest > -0.01  # nothing has sunk into the floor


@pytest.mark.parametrize("name", ["swerve-ur10", "swerve-mabi", "differential-ur10", "mecanum-ur10", "rezero"])
def test_every_body_of_a_built_in_robot_collides_but_for_neighbors(name: str) -> None:
    """Each body has a shape that collides, or rollers that stand for it; what is excluded is drawn in each other at home."""
    robot = load_robot(name)
    plant = base_type(robot.description.base.type).plant(robot, IDEAL, 0)
    m = plant.model
    solid = {int(m.geom_bodyid[g]) for g in range(m.ngeom) if m.geom_contype[g] & (HULL["contype"] | ROLLS | FLOOR)}
    drawn = {int(b) for b in m.geom_bodyid}
    assert drawn <= solid
    names = {tuple(sorted((m.body(int(s) >> 16).name, m.body(int(s) & 0xFFFF).name))) for s in m.exclude_signature}
    assert names == ({("mabi_forearm", "mabi_upper_arm")} if name == "swerve-mabi" else set())
    plant.world.contacts.update(0.0)
    assert plant.world.contacts.touches == []
