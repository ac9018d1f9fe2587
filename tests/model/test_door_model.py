"""The door in the planner's model. Truth: finite differences of plane geometry along motions, the door's equation by hand."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import casadi as ca
import mujoco
import numpy as np
import pytest

from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.studies.minniti2019.door_model import DoorGeometry, WithDoor, place_of
from wbmpc.studies.minniti2019.door_plant import HALF_THICKNESS, Door, DoorPlant
from wbmpc.studies.minniti2019.door_residuals import BodyClearance

ROBOT = load_robot("rezero", contact="force")
HOME, TORQUE = ROBOT.base.numeric.equilibrium(ROBOT.home[ROBOT.state["arm"]])
HAND = ROBOT.pose(HOME)[0]


def geometry(opening: float) -> DoorGeometry:
    return DoorGeometry((HAND[0] + 0.1, HAND[1] + 0.7 * opening), -opening * np.pi / 2, opening, 0.04)


def system(opening: float = 1.0):  # type: ignore[no-untyped-def]
    """(dynamics, its ẋ as a function of x, u and moves, parameters)."""
    door = WithDoor(ROBOT, opening)
    w = door.parameters.vector({"place": place_of(geometry(opening)), "impedance": [2.5, 10.0, 3.0]})
    x, u, m = ca.SX.sym("x", 18), ca.SX.sym("u", 9), ca.SX.sym("m", 1)
    f = ca.Function("f", [x, u, m], [door(x, u, ca.DM(w), m)])
    return door, f, w


def some_state(seed: int) -> tuple[np.ndarray, np.ndarray]:
    r = np.random.default_rng(seed)
    x = np.concatenate([HOME + 0.1 * r.normal(size=16), [0.3 + 0.2 * r.random(), 0.2 * r.normal()]])
    return x, np.concatenate([TORQUE, [-8.0, 1.0, 2.0]]) + 0.3 * r.normal(size=9)


@pytest.mark.parametrize("opening", [1.0, -1.0])
def test_touching_end_effector_shows_the_angle(opening: float) -> None:
    g = geometry(opening)
    for angle in (0.0, 0.4, 1.2):
        end_effector = g.place(angle, 0.65, 0.7)
        assert g.angle(end_effector) == pytest.approx(angle, abs=1e-12)
        assert g.lever(end_effector, angle) == pytest.approx(0.65) and g.gap(end_effector, angle) == pytest.approx(
            0.0, abs=1e-12
        )
        ahead = (g.place(angle + 1e-6, 0.65, 0.7) - g.place(angle - 1e-6, 0.65, 0.7)) / 2e-6
        assert g.rate(end_effector, 0.3 * ahead, angle) == pytest.approx(0.3, rel=1e-6)
        assert g.directions(angle)[1] @ (g.place(angle + 1e-3, 0.65, 0.7) - end_effector) > 0.0  # it opens that way
    with pytest.raises(InputError, match="cannot touch"):
        g.angle([*g.hinge, 0.0])


def test_door_obeys_its_equation() -> None:
    _, f, _ = system()
    x, u = some_state(1)
    g, end_effector = geometry(1.0), ROBOT.pose(x[:16])[0]
    push = -g.directions(x[16])[1] @ u[6:]
    resistance = 3.0 * np.tanh(x[17] / max(0.05, 0.03 * 3.0 / 2.5))
    moving = (g.lever(end_effector, x[16]) * push - 10.0 * x[17] - resistance) / 2.5
    assert np.array(f(x, u, 1.0)).ravel()[16:] == pytest.approx([x[17], moving])
    assert np.array(f(x, u, 0.0)).ravel()[16:] == pytest.approx([x[17], -x[17] / 0.05])


@pytest.mark.parametrize("opening", [1.0, -1.0])
def test_contact_rows_are_the_derivatives_of_the_place_on_the_panel(opening: float) -> None:
    """The symbolic first and second derivatives against differences of the plane geometry along the motion itself."""
    door, f, w = system(opening)
    g = geometry(opening)
    sx, su, sm = ca.SX.sym("x", 18), ca.SX.sym("u", 9), ca.SX.sym("m", 1)
    motion = ca.Function("c", [sx, su, sm], list(door.contact_motion(sx, su, ca.DM(w), sm)))

    def place(x: np.ndarray) -> np.ndarray:
        end_effector = ROBOT.pose(x[:16])[0]
        return np.array([g.gap(end_effector, x[16]), g.lever(end_effector, x[16]), end_effector[2]])

    x, u = some_state(2)
    rate = lambda x: np.array(f(x, u, 1.0)).ravel()

    def moved(h: float) -> np.ndarray:  # Runge-Kutta 4
        k1 = rate(x)
        k2 = rate(x + h / 2 * k1)
        k3 = rate(x + h / 2 * k2)
        return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + h * k3))

    h = 1e-3
    now, previous, after = place(x), place(moved(-h)), place(moved(h))
    found = [np.array(v).ravel() for v in motion(x, u, 1.0)]
    assert found[0] == pytest.approx(now, abs=1e-12)
    assert found[1] == pytest.approx((after - previous) / (2 * h), rel=1e-3, abs=1e-4)
    assert found[2] == pytest.approx((after - 2 * now + previous) / h**2, rel=2e-3, abs=1e-2)


def test_jacobian_is_the_derivative() -> None:
    door, f, w = system()
    sx, su, sm = ca.SX.sym("x", 18), ca.SX.sym("u", 9), ca.SX.sym("m", 1)
    jacobian = ca.Function("j", [sx, su, sm], [door.jacobian(sx, su, ca.DM(w), sm)[1]])
    x, u = some_state(3)
    z, found = np.concatenate([x, u]), np.array(jacobian(x, u, 1.0))
    for k in range(27):
        d = np.zeros(27)
        d[k] = 1e-6
        change = (np.array(f(*np.split(z + d, [18]), 1.0)) - np.array(f(*np.split(z - d, [18]), 1.0))).ravel() / 2e-6
        assert found[:, k] == pytest.approx(change, rel=1e-4, abs=1e-4)


def test_robot_without_the_force_as_an_input_is_rejected() -> None:
    with pytest.raises(InputError, match="force as an input"):
        WithDoor(load_robot("rezero"))


def test_body_clearance_is_no_more_than_what_the_physics_measures() -> None:
    """Against MuJoCo's distances from a wide panel to the shapes of base, ball and elbow, in postures that lean and turn."""
    wide = Door((HAND[0] + 6.0, HAND[1] + 10.0), width=20.0)
    plant, dynamics = DoorPlant(ROBOT.description, wide, HOME, TORQUE), WithDoor(ROBOT)
    model, data = plant.model, plant.data
    shapes = [g for g in range(model.ngeom) if model.geom_contype[g]]
    body = [g for g in shapes if model.body(model.geom_bodyid[g]).name in ("base", "ball")]
    elbow = next(g for g in shapes if model.body(model.geom_bodyid[g]).name == "arm_forearm_link")
    place = place_of(replace(geometry(1.0), hinge=wide.hinge))
    w = dynamics.parameters.vector({"place": place, "impedance": [2.5, 10.0, 3.0]})
    x, r = ca.SX.sym("x", 18), np.random.default_rng(4)
    rows = BodyClearance(dynamics, HALF_THICKNESS, 0.0)
    symbols: Any = SimpleNamespace(all_x=x, parameters=ca.DM(w), reference=ca.DM([0.0]))
    clearance = ca.Function("clearance", [x], [rows(symbols)])
    for _ in range(6):
        state = HOME + np.concatenate(
            [0.2 * r.normal(size=3), 0.15 * r.normal(size=2), 0.3 * r.normal(size=3), np.zeros(8)]
        )
        plant._place(state, TORQUE)
        data.qpos[model.joint("door").qposadr[0]] = angle = r.uniform(0.0, 0.4)
        mujoco.mj_kinematics(model, data)
        found = np.array(clearance(np.concatenate([state, [angle, 0.0]]))).ravel()
        measured = {g: mujoco.mj_geomDistance(model, data, model.geom("door").id, g, 10.0, np.zeros(6)) for g in shapes}
        nearest = min(measured[g] for g in body)
        # on the safe side; the base is not as wide everywhere as where its wheels are
        assert nearest - 0.12 < found[:2].min() <= nearest
        assert measured[elbow] - 0.05 < found[2] <= measured[elbow]
