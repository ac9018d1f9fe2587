"""`swerve-wipe`. Truth: Hooke's law of the tip's spring and MuJoCo's kinematics of recorded positions, least squares, statics, series on
paper."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

from toys import robot
from wbmpc.errors import RunAborted
from wbmpc.log import Log
from wbmpc.studies.force_tip import TIP, TIP_MASS, TIP_RADIUS
from wbmpc.studies.pankert2022 import wipe as study
from wbmpc.studies.pankert2022.wipe import EXPERIMENT, SwerveWipeSettings
from wbmpc.studies.pankert2022.wipe_control import BEGIN, INTEGRAL, RISE, STAND, TOUCHES, WALL, Order, WallLine, Wipe
from wbmpc.studies.pankert2022.wipe_figures import metrics
from wbmpc.studies.pankert2022.wipe_plant import Wall, WipePlant

ROBOT = robot("swerve-ur10")
ORDER = Order(15.0, 3.0, 0.2, 0.02, 5000.0, TIP_RADIUS, TIP_MASS)


class Kept(WipePlant):
    """Keeps all positions at every physics step: what else is known of a step follows from them."""

    def __init__(self, *args: Any, **more: Any) -> None:
        self.positions: list[np.ndarray] = []
        super().__init__(*args, **more)
        self.positions.clear()

    def _see(self) -> None:
        super()._see()
        self.positions.append(self.data.qpos.copy())


@pytest.fixture(scope="module")
def short():  # type: ignore[no-untyped-def]
    """A short way on a wall that is 13 and 12 mm off, rough and with a spring that is 20 % softer than the robot believes."""
    plants: list[Kept] = []

    def plant(*args: Any, **more: Any) -> Kept:
        plants.append(Kept(*args, **more))
        return plants[-1]

    wall, spring = Wall((BEGIN, BEGIN + 0.4), (WALL + 0.013, WALL + 0.012), 0.7), 4000.0
    patch = pytest.MonkeyPatch()
    patch.setattr(study, "WipePlant", plant)
    patch.setattr(SwerveWipeSettings, "draw", lambda self, seed: (wall, spring))
    settings = SwerveWipeSettings(length=0.4, touch_speed=0.04, settle_time=0.5, calibration="none")
    result = EXPERIMENT.run(settings, 0)
    patch.undo()
    return result, plants[0], wall, spring


def test_the_force_is_that_of_the_spring(short) -> None:  # type: ignore[no-untyped-def]
    result, plant, _, spring = short
    assert result.completed, result.reason
    place = plant.model.joint(TIP).qposadr[0]
    squeezed = -np.array(plant.positions)[:, place]
    steps = np.array(plant.steps)
    use = slice(np.flatnonzero(steps[:, 1] > 14.0)[0], np.flatnonzero(steps[:, 1] > 14.0)[-1])
    np.testing.assert_allclose(steps[use, 1].mean(), spring * squeezed[use].mean(), rtol=4e-3)
    # the headline figure by Hooke's law, over the time in which the end effector moves and some before it
    t = steps[:, 0] - 0.5
    begin = t[np.flatnonzero(steps[:, 1] > 0.0)[0]] + RISE + 0.1
    judged = (t >= begin + 0.03) & (t <= begin - 0.1 + STAND + 0.4 / 0.2 + 1.0)
    by_hooke = np.sqrt(np.mean((spring * squeezed[judged] / 15.0 - 1.0) ** 2))
    m = {name: metric.value for name, metric in result.metrics.items()}
    assert m["force_error_ratio"] == pytest.approx(by_hooke, abs=0.004)
    assert 0.0 < m["force_error_ratio"] < 0.1 and m["time_without_contact"] == 0.0 and m["contacts_unwanted"] == 0.0
    assert m["force_max"] == pytest.approx(spring * squeezed.max(), rel=0.1)
    assert m["friction_error"] < 0.1 and TOUCHES < m["touch_peak"] < 15.0


def test_the_path_is_that_of_recorded_positions(short) -> None:  # type: ignore[no-untyped-def]
    """MuJoCo's kinematics on other data; the wall is where its surface touches the tip."""
    result, plant, wall, _ = short
    log, data = result.log, mujoco.MjData(plant.model)
    t, reference = log.times("hand"), log.array("hand_reference")
    errors, gaps = [], []
    for k in np.flatnonzero(log.array("force_normal") > 14.0):
        step = round((t[k] + 0.5) / plant.timestep) - 1
        data.qpos[:] = plant.positions[step]
        mujoco.mj_kinematics(plant.model, data)
        place = data.site(ROBOT.description.arm.tool).xpos
        np.testing.assert_allclose(log.array("hand")[k][:2], place[:2], atol=2e-4)
        if reference[k, 0] > BEGIN + 0.01:
            errors.append(log.array("hand")[k, 0] - reference[k, 0])
        tip = data.geom(TIP).xpos
        gaps.append((tip[:2] - [wall.along[0], wall.across[0]]) @ wall.normal[:2] + TIP_RADIUS)
    assert np.abs(gaps).max() < 1e-3  # contacts are soft
    rms = float(np.sqrt(np.mean(np.square(errors))))
    assert result.metrics["path_error_rms_world_along"].value == pytest.approx(rms, abs=3e-4)


def test_the_wall_is_a_line_of_its_places() -> None:
    rng, line = np.random.default_rng(1), WallLine()
    along = np.linspace(0.0, 1.0, 400)
    places = 0.74 + 0.012 * along + 1e-4 * rng.normal(size=400)
    line.begin(along[0], places[0])
    for x, y in zip(along[1:], places[1:], strict=True):
        line.update(0.02, x, y)
    slope, offset = np.polyfit(along, places, 1)
    assert line.at(np.array([1.0, 1.2])) == pytest.approx([offset + slope, offset + 1.2 * slope], abs=6e-4)
    assert line.slope == pytest.approx(slope, abs=3e-3)


def test_the_order_over_time() -> None:
    wipe = Wipe(ROBOT, ORDER)
    t = np.arange(0.0, 40.0, 0.01)
    assert not wipe.force(t).any() and not wipe.way(t).any() and wipe.end_effector(t)[:, 1].max() > WALL + 0.02
    speed = np.diff(wipe.end_effector(t)[t > wipe.search][:, 1]) / 0.01
    assert speed.max() == pytest.approx(0.02)
    wipe.touched = 8.0
    force, way = wipe.force(t), wipe.way(t)
    assert force[t < 8.0].max() == 0.0 and force[(t > 8.0 + RISE) & (t < wipe.released)] == pytest.approx(15.0)
    assert force[t > wipe.released].max() == 0.0
    assert way[-1] == pytest.approx(3.0) and (np.diff(way) / 0.01).max() == pytest.approx(0.2)
    assert way[t < 8.0 + RISE + STAND].max() == 0.0 and way[t > wipe.ended].min() == pytest.approx(3.0)


def press(wipe: Wipe, t: float, y: float, push: float) -> None:
    """An end effector with its axis along y whose tip's front is at ``y`` [m]; the sensor carries the tip, too."""
    state = ROBOT.home.copy()
    place, _ = ROBOT.pose(state)
    state[ROBOT.state["base"].start + 1] += y - TIP_RADIUS - place[1]
    wipe.update(t, state, np.array([0.0, TIP_MASS * 9.81, push]))


def test_the_reference_is_beyond_the_wall_by_what_the_spring_gives() -> None:
    wipe = Wipe(ROBOT, ORDER)
    press(wipe, wipe.search + 1.0, WALL - 0.007, 5.0)  # 5 N are 1 mm of the spring
    assert wipe.touched == wipe.search + 1.0 and wipe.line.at(np.array([BEGIN]))[0] == pytest.approx(
        WALL - 0.008, abs=1e-4
    )
    later = np.array([wipe.began + 0.1])
    assert wipe.end_effector(later)[0, 1] == pytest.approx(WALL - 0.008 - TIP_RADIUS + 0.003, abs=1e-4)
    with pytest.raises(RunAborted, match="presses with"):
        press(wipe, wipe.began, WALL, 70.0)
    with pytest.raises(RunAborted, match="no wall"):
        press(Wipe(ROBOT, ORDER), wipe.search + 1.0, WALL + 0.06, 0.0)


def test_what_is_left_of_the_error_is_integrated() -> None:
    """1 N too little for a second, and no friction: the sensor's other axes carry the tip alone."""
    wipe = Wipe(ROBOT, ORDER)
    press(wipe, wipe.search + 1.0, WALL, 5.0)
    press(wipe, wipe.began, WALL, 15.0)
    before = wipe.extra
    for k in range(50):
        press(wipe, wipe.began + 0.02 * (k + 1), WALL, 14.0)
    assert wipe.extra - before == pytest.approx(INTEGRAL * 1.0, abs=0.01)
    assert wipe.coefficient == pytest.approx(0.0, abs=2e-3)


def test_what_is_drawn_is_within_its_bounds() -> None:
    drawn = [SwerveWipeSettings().draw(seed) for seed in range(200)]
    across, grips = np.array([w.across for w, _ in drawn]) - WALL, np.array([w.grip for w, _ in drawn])
    assert 0.019 < np.abs(across).max() <= 0.02 and abs(np.corrcoef(across.T)[0, 1]) < 0.2
    assert grips.min() == pytest.approx(0.2, abs=0.02) and grips.max() == pytest.approx(0.8, abs=0.02)
    with pytest.raises(ValueError, match="lower"):
        SwerveWipeSettings(grip=(0.8, 0.2))


def test_figures_of_a_wipe_on_paper() -> None:
    """1 mm up and 2 mm along; 10 % too much force, none for a second."""
    wipe, log = Wipe(ROBOT, ORDER), Log()
    wipe.touched = 8.0
    t = np.arange(0.0, wipe.done, 0.001)
    push = np.where(t >= 8.0, 16.5, 0.0)
    for now in t[::10]:
        target = wipe.end_effector(np.array([now]))[0]
        for name, error in (
            ("hand", [0.002, 0.3, 0.001]),
            ("hand_odometry", [0.0, 0.3, 0.003]),
            ("hand_reference", [0, 0, 0]),
        ):
            log.add(name, now, target + error)
        log.add("base", now, np.zeros(3))
        log.add("coefficient", now, 0.45)
    found = metrics(log, wipe, np.stack([t, push, 0.0 * t], axis=1), 0.5)
    assert found["force_error_ratio"].value == pytest.approx(0.1)
    assert found["path_error_rms_world"].value == pytest.approx(np.sqrt(5.0) * 1e-3)
    assert found["path_error_rms_world_along"].value == pytest.approx(0.002)
    assert found["path_error_rms"].value == pytest.approx(0.003) and found["friction_error"].value == pytest.approx(
        0.05
    )
    push[(t > 12.0) & (t <= 13.0)] = 0.0
    found = metrics(log, wipe, np.stack([t, push, 0.0 * t], axis=1), 0.5)
    judged = wipe.ended - wipe.began - 0.1
    assert found["time_without_contact"].value == pytest.approx(1.0, abs=2e-3)
    expected = np.sqrt((1.0 + 0.01 * (judged - 1.0)) / judged)
    assert found["force_error_ratio"].value == pytest.approx(expected, rel=1e-3)
