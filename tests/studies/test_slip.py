"""`slip`: sliding at physics steps, the grip that a robot trusts, the figures. Truth: material points of MuJoCo's bodies between two steps, a
block on a table by Coulomb's law, MuJoCo's force sensor, series on paper."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from archives import without_units
from effort import thorough
from wbmpc.bases.ball.messages import BallCommand
from wbmpc.bases.ball.perturbation import BallPerturbation
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.ocp import residuals
from wbmpc.registry import REGISTRY
from wbmpc.simulation.lockstep import Ending
from wbmpc.studies.force_tip import TIP_RADIUS
from wbmpc.studies.minniti2019 import press as pressing
from wbmpc.studies.minniti2019.door_plant import HALF_THICKNESS, Door
from wbmpc.studies.minniti2019.door_trial import believed
from wbmpc.studies.minniti2019.grip import KEPT, UNSURE, GripEstimator
from wbmpc.studies.minniti2019.slip import SlipSettings
from wbmpc.studies.minniti2019.slip_figures import Press, metrics
from wbmpc.studies.minniti2019.touch_plant import TouchPlant

ROBOT = load_robot("rezero", contact="force")
HOME, TORQUE = ROBOT.base.numeric.equilibrium(ROBOT.home[ROBOT.state["arm"]])
HAND = ROBOT.pose(HOME)[0]


class Watched(TouchPlant):
    """Keeps where MuJoCo has tip and panel at every physics step, and what the sensor between end effector and tip reads."""

    def __init__(self, *args: Any, **more: Any) -> None:
        self.places: list[tuple[np.ndarray, ...]] = []
        super().__init__(*args, **more)

    def _add_step(self) -> None:
        super()._add_step()
        d = self.data
        tip, panel = (int(self.model.geom_bodyid[g]) for g in (self._tip, self._panel))
        depth = max((-c.dist for c in d.contact if {c.geom1, c.geom2} == {self._tip, self._panel}), default=0.0)
        sensor = d.site("hand_force").xmat.reshape(3, 3) @ d.sensordata[:3]
        self.places.append(
            tuple(
                np.array(v)
                for v in (d.xpos[tip], d.xmat[tip], d.xpos[panel], d.xmat[panel], self.normal, [depth], sensor)
            )
        )

    def slid(self) -> np.ndarray:
        """How far (n, 2) the two materials moved against each other at the point of contact in each step, along the panel and up."""
        out = []
        for now, then in zip(self.places, self.places[1:], strict=False):
            normal, point = now[4], now[0] + (TIP_RADIUS - 0.5 * now[5][0]) * now[4]
            moved = []
            for k in (0, 2):
                turn, turned = now[k + 1].reshape(3, 3), then[k + 1].reshape(3, 3)
                moved.append(then[k] + turned @ (turn.T @ (point - now[k])) - point)
            out.append([np.cross(normal, [0, 0, 1]) @ (moved[0] - moved[1]), (moved[0] - moved[1])[2]])
        return np.array(out)


@pytest.mark.parametrize("grip", [0.0, 0.8])
def test_sliding_is_that_of_material_points(grip: float) -> None:
    """A door swings into a tip that moves along it."""
    door = Door(
        (HAND[0] + 0.043, HAND[1] + 0.7), closed=-np.pi / 2 - 0.3, friction=0.0, closer=0.0, damping=0.0, grip=grip
    )
    p = Watched(ROBOT.description, door, HOME, TORQUE, BallPerturbation.none(actuator_time_constant=0.0))
    p.data.qpos[p._q], p.data.qvel[p._dof] = 0.3, -0.4
    p.data.qvel[[1, 5]] = 0.1, 0.3
    for _ in range(120):
        p.step(BallCommand(TORQUE))
    rows, truth = p.record(), p.slid()
    assert rows[:, 1].max() > 1.0 and np.abs(truth).sum(axis=0).min() > 1e-4
    touching = rows[:-1, 1] > 0.0
    for use in (touching, ~touching):  # MuJoCo moves bodies with the speeds that a step ends with
        assert rows[1:][use, 4:6].sum(axis=0) * p.timestep == pytest.approx(truth[use].sum(axis=0), abs=3e-5)


def test_the_robot_sees_material_points_slide() -> None:
    """Tip and panel turned and moved for a short time by SciPy's rotations; and a tip that rolls does not slide."""
    rng, geometry, h = np.random.default_rng(3), believed(HAND), 1e-7
    for _ in range(5):
        angle, rate = rng.uniform(0.0, 1.0), rng.normal()
        along, normal = geometry.directions(angle)
        place = geometry.place(angle, 0.6, 0.9)
        velocity, turn = rng.normal(size=3), rng.normal(size=3)
        point = place + TIP_RADIUS * normal
        tip = place + h * velocity + Rotation.from_rotvec(h * turn).apply(point - place)
        hinge = np.array([*geometry.hinge, 0.0])
        panel = hinge + Rotation.from_rotvec([0.0, 0.0, geometry.opening * h * rate]).apply(point - hinge)
        moved = (tip - panel) / h
        found = geometry.sliding((place, velocity, turn), angle, rate, HALF_THICKNESS)
        assert found == pytest.approx([along @ moved, moved[2]], abs=1e-5)
    rolls = -TIP_RADIUS * np.cross([0.0, 0.0, 1.5], geometry.directions(0.0)[1])
    motion = geometry.place(0.0, 0.6, 0.9), rolls, np.array([0.0, 0.0, 1.5])
    assert geometry.sliding(motion, 0.0, 0.0, HALF_THICKNESS) == pytest.approx(np.zeros(2), abs=1e-12)


@pytest.mark.parametrize("grip", [0.12, 0.3, 0.7])
def test_a_block_on_a_table_shows_its_grip(grip: float) -> None:
    """1 kg pressed with 10 N is pulled ever harder until it slides by Coulomb's law."""
    monitor, speed, h, slid = GripEstimator(0.09), 0.0, 0.0025, 0.0
    bounds = []
    for k in range(4000):
        pull = min(0.5 + 0.002 * k, 10.0 * grip + 0.3)
        friction = 10.0 * grip if speed > 0.0 or pull > 10.0 * grip else pull
        speed = max(speed + h * (pull - friction), 0.0)
        if monitor.sliding:
            break
        slid += h * speed
        monitor.update(h, 10.0, friction, [speed, 0.0])
        bounds.append(monitor.bound)
    assert monitor.slips == 1 and 0.0 < slid < 0.01
    assert max(bounds) == pytest.approx(max(KEPT * (grip - UNSURE), 0.09), abs=0.004)  # what it bore before
    assert monitor.bound == pytest.approx(min(KEPT * grip, bounds[-1]), abs=0.01) and monitor.bound < grip


def test_what_is_hardly_pressed_shows_nothing() -> None:
    monitor = GripEstimator(0.09)
    for _ in range(400):
        assert not monitor.update(0.0025, 1.0, 0.9, [1.0, 0.0])
    assert monitor.bound == 0.09 and monitor.slips == 0
    for _ in range(400):
        monitor.update(0.0025, 10.0, 4.0, [0.0, 0.0])
    assert monitor.bound == pytest.approx(KEPT * (0.4 - UNSURE))
    with pytest.raises(InputError, match="least"):
        GripEstimator(0.0)


def test_the_cone_has_the_coefficient_of_its_reference() -> None:
    """Forces of the pyramid's edge, by hand: the force of the world on the robot is against the push."""
    cone = residuals.FrictionCone(ROBOT, 0.5)
    u, w = ca.SX.sym("u", ROBOT.input.size), ca.SX.sym("w", 4)
    rows = ca.Function("rows", [u, w], [cone(SimpleNamespace(u=u, reference=w))])
    normal, inputs = np.array([0.6, 0.8, 0.0]), np.zeros(ROBOT.input.size)
    for friction in (0.09, 0.6):
        edge = friction * 10.0 / np.sqrt(2.0)
        inputs[ROBOT.input["force"]] = -(10.0 * normal + edge * np.array([-0.8, 0.6, 0.0]) + [0.0, 0.0, -0.5 * edge])
        found = np.array(rows(inputs, [*normal, friction])).ravel()
        assert found[0] == pytest.approx(9.5)
        assert sorted(found[1:]) == pytest.approx([0.0, 0.5 * edge, 1.5 * edge, 2.0 * edge], abs=1e-9)


def push(slide: float, force: float = 10.0, reason: str = "", bound: float = 0.18) -> Press:
    """A tip that touches at 1 s, pushes with ``force`` when 10 N are wanted from 0.2 s later on, and slides for 0.1 s."""
    t = np.arange(0.0, 3.0, 0.001)
    rows = np.zeros((t.size, 6))
    rows[:, 0] = t
    since = t - 1.0
    rows[:, 1] = np.where(since >= 0.0, np.maximum(force * np.clip(since / 0.2, 0.0, 1.0), 0.01), 0.0)
    rows[(since > 0.5) & (since <= 0.6), 4] = 10.0 * slide
    rows[(since > 0.6) & (since <= 0.65), 4] = -10.0 * slide
    rows[(since < 0.0) | (since > 1.5), 5] = 1.0  # before the touch and after the push
    return Press(0.2, 10.0, 0.2, 2.5, rows, np.array([0.09, bound]), Ending(reason))


def test_figures_of_a_push_on_paper() -> None:
    good = push(0.0008)
    assert good.figures()["slide_max"] == pytest.approx(0.0008, rel=0.02)
    assert good.figures()["force_error_ratio"] == pytest.approx(0.0, abs=2e-3)
    found = metrics([good, push(0.0003, 9.0)], [push(0.02, 5.0, bound=0.35)])
    assert found["slide_max"].value == pytest.approx(0.0008, rel=0.02)
    assert found["force_error_ratio"].value == pytest.approx(0.1, rel=0.03)
    assert found["grip_bound_ratio"].value == pytest.approx(0.9)
    assert found["slide_max_plain"].value == pytest.approx(0.02, rel=0.02)
    lost = push(0.0)
    lost.steps[2000:2100, 1] = 0.0
    assert lost.figures()["time_without_contact"] == pytest.approx(0.1)
    assert lost.figures()["force_error_ratio"] == pytest.approx(np.sqrt(0.1 / 1.4), rel=0.01)
    assert np.isinf(push(0.0, reason="the robot fell").figures()["slide_max"])


@thorough
def test_a_push_is_judged_by_what_mujoco_has(monkeypatch: pytest.MonkeyPatch) -> None:
    """Slide from places of the bodies, force from the sensor behind the tip, whose inertia is small."""
    plants: list[Watched] = []

    class Kept(Watched):
        def __init__(self, *args: Any, **more: Any) -> None:
            super().__init__(*args, **more)
            plants.append(self)

    monkeypatch.setattr(pressing, "TouchPlant", Kept)
    settings = SlipSettings(grips=(0.1,), compare=False, surface="door", timeout=7.0)
    result = REGISTRY["slip"].run(settings, 0, None)
    assert result.completed, result.reason
    rows, slid = plants[0].record(), plants[0].slid()
    first = int(np.flatnonzero(rows[:, 1] > 0.0)[0])
    end = int(np.flatnonzero(rows[:, 1] > 8.0)[-1])
    gone = np.linalg.norm(np.cumsum(slid[first:end], axis=0), axis=1)
    assert result.metrics["slide_max"].value == pytest.approx(gone.max(), rel=0.05, abs=1e-4)
    sensed = np.array(
        [p[6] @ p[4] for p in plants[0].places]
    )  # what the end effector does to the tip; its weight is across
    pushing = slice(first + 400, end)
    assert np.sqrt(np.mean((sensed[pushing] - rows[pushing, 1]) ** 2)) < 0.3
    assert without_units(result.log) == set()
    assert result.log.array("steps_grip_0.1")[:, 0].max() == pytest.approx(rows[:, 1].max(), rel=0.05)
