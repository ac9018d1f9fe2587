"""The simulated door. Truth: its equation of motion in closed form, statics, MuJoCo's own contact forces."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from toys import robot
from wbmpc.bases.ball.messages import BallCommand
from wbmpc.bases.ball.perturbation import BallPerturbation
from wbmpc.errors import InputError
from wbmpc.studies.force_tip import ForceSensor
from wbmpc.studies.minniti2019.door_plant import Door, DoorPlant

ROBOT = robot("rezero")
HOME, TORQUE = ROBOT.base.numeric.equilibrium(ROBOT.home[ROBOT.state["arm"]])
HAND = ROBOT.pose(HOME)[0]


def plant(gap: float = 0.0, sensor: ForceSensor | None = None, **door) -> DoorPlant:  # type: ignore[no-untyped-def]
    place = Door((HAND[0] + gap + 0.04, HAND[1] + 0.7), **door)
    ideal = BallPerturbation.none(actuator_time_constant=0.0)
    return DoorPlant(ROBOT.description, place, HOME, TORQUE, ideal, sensor=sensor or ForceSensor(0.0, 0.0))


def pushed_door(seconds: float, torque: float, **door) -> DoorPlant:  # type: ignore[no-untyped-def]
    """The panel under a torque [N m] of a force at its middle, the robot out of reach."""
    p = plant(gap=1.0, **door)
    for _ in range(round(seconds / p.timestep)):
        p.push(torque / 0.4 * p.normal, body="door")
        p.step(BallCommand(TORQUE))
    return p


def test_door_moves_by_its_equation() -> None:
    """I φ̈ + d φ̇ = τ − friction − closer: φ̇ = ω∞ (1 − exp(−d t / I))."""
    p = pushed_door(0.5, 6.0)
    inertia, damping, left = 12.0 * (0.64 + 0.0004) / 3.0, 12.0, 6.0 - 1.5 - 2.0
    final, rate = left / damping, damping / inertia
    assert p.door.inertia == pytest.approx(inertia)
    assert p.rate == pytest.approx(final * (1.0 - np.exp(-0.5 * rate)), rel=0.01)
    assert p.angle == pytest.approx(final * (0.5 - (1.0 - np.exp(-0.5 * rate)) / rate), rel=0.02)
    # seen from its hinge the closed panel points along -y, and opens away from the robot
    assert p.normal == pytest.approx([np.cos(p.angle), np.sin(p.angle), 0.0])


@pytest.mark.parametrize(("torque", "opens"), [(3.0, False), (4.0, True)])
def test_friction_and_closer_hold_the_door(torque: float, opens: bool) -> None:
    assert (pushed_door(0.5, torque).angle > 0.01) is opens


def test_sticking_door_gives_way_once_and_locked_one_never() -> None:
    assert pushed_door(0.4, 6.0, breakaway=4.5).angle < 1e-3
    loose = pushed_door(0.4, 7.5, breakaway=4.5)
    assert loose.angle > 0.02 and loose.model.dof_frictionloss[loose._dof] == 1.5
    locked = pushed_door(0.2, 500.0, locked=True)
    assert locked.angle == 0.0 and locked.rate == 0.0


def test_robot_with_a_lean_pushes_the_door_and_the_sensor_reads_it() -> None:
    """At the model's equilibrium under 8 N on its end effector the robot presses 8 N on a locked door; the sensor's reading is that
    force and the tip's weight; the panel feels the opposite."""
    state, torque = ROBOT.base.numeric.equilibrium(HOME[5:8], force=(-8.0, 0.0, 0.0))
    end_effector = ROBOT.pose(state)[0]
    door = Door((end_effector[0] + 0.0395, end_effector[1] + 0.7), locked=True)
    ideal = BallPerturbation.none(actuator_time_constant=0.0)
    p = DoorPlant(ROBOT.description, door, state, torque, ideal, sensor=ForceSensor(0.0, 0.0))
    p.step(BallCommand(torque), 300)
    force, reading = p.contact_force(), p.truth().tool_rotation @ p.measure().force
    assert force[0] == pytest.approx(8.0, abs=1.0)
    assert reading + [0.0, 0.0, 0.05 * 9.81] == pytest.approx(-force, abs=0.1)


def recomputed(p: DoorPlant, previous: mujoco.MjData) -> np.ndarray:
    """MuJoCo's force (3) on the panel in the state before a step, under what acted in it."""
    previous.ctrl[:], previous.qfrc_applied[:] = p.data.ctrl, p.data.qfrc_applied
    mujoco.mj_forward(p.model, previous)
    total, local = np.zeros(3), np.zeros(6)
    for c in range(previous.ncon):
        contact = previous.contact[c]
        if {contact.geom1, contact.geom2} == {p._tip, p._panel}:
            mujoco.mj_contactForce(p.model, previous, c, local)
            total += (1.0 if contact.geom2 == p._panel else -1.0) * contact.frame.reshape(3, 3).T @ local[:3]
    return total


def test_force_on_the_panel_is_that_of_the_last_step_from_the_first_touch_on() -> None:
    """Whatever is asked of the plant in between: that looks for the contacts of the next step, which have no forces yet."""
    state, torque = ROBOT.base.numeric.equilibrium(HOME[5:8], force=(-8.0, 0.0, 0.0))
    end_effector = ROBOT.pose(state)[0]
    p = DoorPlant(
        ROBOT.description,
        Door((end_effector[0] + 0.0405, end_effector[1] + 0.7)),
        state,
        torque,
        BallPerturbation.none(actuator_time_constant=0.0),
    )
    assert not p.contact_force().any()
    previous, found = mujoco.MjData(p.model), []
    for _ in range(120):
        mujoco.mj_copyState(p.model, p.data, previous, int(mujoco.mjtState.mjSTATE_INTEGRATION))
        p.step(BallCommand(torque))
        p.measure(), p.truth()
        found.append(p.contact_force())
        assert found[-1] == pytest.approx(recomputed(p, previous), abs=1e-3)
    touches = np.linalg.norm(found, axis=1) > 0.0
    assert not touches[0] and touches[-1]


def test_sensor_has_noise_and_bias_of_its_seed() -> None:
    p = plant(gap=1.0, sensor=ForceSensor(noise=0.3, bias=0.5))
    q = plant(gap=1.0)
    rest = []
    for _ in range(200):
        for one in (p, q):
            one.step(BallCommand(TORQUE), 5)
        rest.append(p.measure().force - q.measure().force)
    assert np.std(rest, axis=0) == pytest.approx([0.3] * 3, rel=0.25)
    bias = np.mean(rest, axis=0)
    assert np.all(np.abs(bias) < 0.5 + 0.1) and np.abs(bias).max() > 0.1
    assert p.measure() is p.measure()


@pytest.mark.parametrize(
    ("wrong", "said"), [({"opening": 0.5}, "opening"), ({"mass": 0.0}, "mass"), ({"grip": -1.0}, "grip")]
)
def test_impossible_doors_are_rejected(wrong: dict[str, float], said: str) -> None:
    with pytest.raises(InputError, match=said):
        Door((0.0, 0.0), **wrong)
