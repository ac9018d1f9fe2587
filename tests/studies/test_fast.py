"""The parts of `swerve-fast`. Truth: hand-made series of loads and positions; the names of the models that plans are made with."""

from __future__ import annotations

import numpy as np
import pytest

import wbmpc as wb
from wbmpc.configuration import configure
from wbmpc.errors import InputError
from wbmpc.model.wheels import wheel_velocities
from wbmpc.registry import load
from wbmpc.studies.pankert2022.fast import SwerveFastSettings, WheelWatch
from wbmpc.studies.pankert2022.fast_courses import PILLAR, SHIFT, SCurve, Slalom, path_error, time_to_goal
from wbmpc.tasks.obstacles import Extent
from wbmpc.tasks.settings import TaskMpcSettings
from wbmpc.tasks.tip_over import reaching
from wbmpc.types import Truth

#: Of two tests with one problem: it is compiled once.
SLIPPERY = ["course=s-curve", "stability.friction=0.2"]


def test_the_time_to_the_goal_ends_where_the_end_effector_stays() -> None:
    times = 0.1 * np.arange(20)
    positions = np.zeros((20, 3))
    positions[:, 1] = np.clip(times, 0.0, 1.0)
    positions[14, 2] = 0.011  # it leaves once more
    goal = np.array([0.0, 1.0, 0.0])
    assert time_to_goal(times, positions, goal, 0.5, 0.01) == pytest.approx(1.0)
    positions[-1, 0] = 0.02
    assert np.isnan(time_to_goal(times, positions, goal, 0.5, 0.01))


def test_the_way_is_straight_and_ends_at_the_goal() -> None:
    start, goal = np.array([1.0, 0.0, 0.5]), np.array([1.0, 2.0, 0.5])
    assert path_error(np.array([[1.0, 0.3, 0.5], [1.0, 1.9, 0.5]]), start, goal) == pytest.approx(0.0, abs=1e-12)
    assert path_error(np.array([[1.03, 1.0, 0.54]]), start, goal) == pytest.approx(0.05)
    assert path_error(np.array([[1.0, 2.2, 0.5], [1.1, 0.5, 0.5]]), start, goal) == pytest.approx(0.2)


def test_the_s_curve_heads_along_itself_and_begins_straight() -> None:
    """Truth: finite differences of its points."""
    course = SCurve(length=3.0, width=0.5)
    poses = course.curve()
    x, y, heading = poses.T
    assert (
        (x[0], x[-1]) == (0.0, 3.0)
        and y[[0, -1]] == pytest.approx([0.0, 0.0])
        and y.max() == pytest.approx(0.5, abs=1e-4)
    )
    middle = np.arctan2(np.diff(y), np.diff(x))
    assert 0.5 * (heading[1:] + heading[:-1]) == pytest.approx(middle, abs=1e-4)
    curvature = np.diff(heading) / np.hypot(np.diff(x), np.diff(y))
    assert np.abs(curvature[[0, -1]]).max() < 0.04 * np.abs(curvature).max()
    assert np.abs(np.diff(curvature)).max() < 0.08 * np.abs(curvature).max()  # it changes steadily


def test_a_base_on_its_path_is_off_by_its_heading_alone() -> None:
    """Truth: poses of the path itself, turned by 0.2 rad on the second half."""
    course, log, robot = SCurve(), wb.Log(), wb.load_robot("swerve-ur10")
    for k, pose in enumerate(course.curve()):
        log.add("base", 0.01 * k, pose + [0.0, 0.0, 0.2 * (k > 200)])
    found = course.metrics(log, 0.0, robot)
    assert found["heading_error_max"].value == pytest.approx(0.2, abs=0.01)
    assert found["path_error_max"].value < 1e-4
    assert course.metrics(log, 0.0, robot)["time_to_goal"].value == pytest.approx(3.99 - 0.03, abs=0.02)


@pytest.mark.parametrize("seed", [0, 7])
def test_pillars_of_the_slalom_are_in_the_way_of_a_straight_base_and_beside_the_path(seed: int) -> None:
    """Truth: what the robot's own shapes take up at home."""
    robot, course = wb.load_robot("swerve-ur10"), Slalom()
    pillars, e = course.scene(robot, seed), Extent(robot, "slalom")
    poses = course.curve()
    assert [p.name for p in pillars] == ["pillar0", "pillar1", "pillar2"]
    for k, pillar in enumerate(pillars):
        x, y, z = pillar.place["position"]
        reach = e.base_high[1] if y > 0.0 else -e.base_low[1]
        assert (y > 0.0) == (k % 2 == 1)  # right and left in turn
        assert abs(y) - PILLAR == pytest.approx(reach - course.overlap, abs=SHIFT)
        aside = np.interp(x, poses[:, 0], poses[:, 1])
        assert (
            abs(y - aside) - PILLAR > reach - SHIFT
        )  # nothing of it is deeper in the path's way than it was moved for the seed
        assert z == pytest.approx(e.ground) and z + pillar.shape.b[2] < e.top  # the arm passes above
    again = [p.place["position"].tolist() for p in course.scene(robot, seed)]
    assert again == [p.place["position"].tolist() for p in pillars]


def test_a_short_slalom_touches_nothing_and_lifts_no_wheel() -> None:
    experiment = load("swerve-fast")
    course = [
        "course=slalom",
        "course.pillars=1",
        "course.first=2.0",
        "course.length=4.0",
        "after=4",
        "plant.calibration=none",
    ]
    found = experiment.run(configure(experiment.config_type, course, "swerve-fast"), 1)
    values = {name: metric.value for name, metric in found.metrics.items()}
    assert found.outcome == "completed"
    assert values["obstacle_clearance_min"] > 0.02 and values["contacts_unwanted"] == 0.0
    assert values["time_unloaded"] < 0.05 and values["time_to_goal"] < 4.0


def test_the_s_curve_is_driven_with_faster_wheels() -> None:
    robot = wb.load_robot("swerve-ur10")
    faster = SCurve(drives=3.0).equipped(robot)
    for group, times in (("base", 3.0), ("wheel", 3.0), ("steer", 1.0), ("arm", 1.0)):
        part = robot.input[group]
        assert faster.limits.input_upper[part] == pytest.approx(times * robot.limits.input_upper[part])


def test_a_base_at_rest_sees_the_whole_of_a_sharp_curve_at_once() -> None:
    """A guess with wheels that are too fast made plans of a few centimeters for many solves. Truth: rigid-body speeds of the wheels; a base
    whose wheels turn at most at their limit goes more than half of the way of two seconds."""
    settings = configure(SwerveFastSettings, [*SLIPPERY, "course.length=2.4"], "swerve-fast")
    course = settings.course
    robot = reaching(course.equipped(wb.load_robot("swerve-ur10")), np.pi / 2, "H", 0.0)
    robot, mpc = settings.weighted.prepare(False, robot, "base")
    mpc.reset(robot.home)
    mpc.update(wb.Observation(0.0, robot.home))
    course.order(0.02, robot, mpc)
    twists = mpc.guess._inner.preview(0.02 + np.linspace(0.0, 2.0, 200), robot.home[robot.state["base"]])
    geometry, leg = robot.base.geometry, robot.home[robot.state["leg"]]
    fastest = max(np.linalg.norm(wheel_velocities(geometry, leg, twist), axis=1).max() for twist in twists)
    assert 0.9 * course.drives < fastest < 1.1 * course.drives  # of 1 m/s
    mpc.update(wb.Observation(0.02, robot.home))
    assert mpc.path.progress(2.02) > 0.5 * 0.01 * np.linalg.norm(twists[:, :2], axis=1).sum() > 0.5


def test_weights_are_factors_on_those_of_the_course() -> None:
    settings = configure(SwerveFastSettings, ["course=s-curve", "weights={contour: 0.5, state: 2.0}"], "swerve-fast")
    assert settings.weighted.weights == {**SCurve.WEIGHTS, "contour": 0.5 * SCurve.WEIGHTS["contour"], "state": 2.0}


def truth(load: float, slip: float, tilt: float) -> Truth:
    at, turn = np.zeros(3), np.eye(3)
    return Truth(
        0.0, at, at, turn, at, turn, tilt, at, {}, slip=np.array([0.0, slip]), wheel_force=np.array([300.0, load])
    )


def test_wheels_are_watched_from_the_order_on() -> None:
    watch = WheelWatch(1.0)
    for k in range(40):  # until 1 s whatever; then in the air from 2.0 to 2.5 s
        early, off = k < 10, 20 <= k < 25
        watch.see(0.1 * k, truth(0.0 if early or off else 200.0, 0.3 if early else 0.01 * (k == 30), 0.001 * k))
    found = watch.metrics()
    assert found["time_unloaded"].value == pytest.approx(0.5, abs=0.03)
    assert found["wheel_slip_max"].value == pytest.approx(0.01)
    assert found["tilt_max"].value == pytest.approx(0.039)


def test_the_experiment_has_both_models() -> None:
    found = load("swerve-fast")
    assert configure(found.config_type, [], "swerve-fast").upright.payload == 10.0
    assert configure(found.config_type, ["stability=nothing"], "swerve-fast").upright is None
    assert SwerveFastSettings().mpc == TaskMpcSettings(horizon=2.0)
    with pytest.raises(InputError, match=r"swerve-fast: --set plant\.kind='kinematic'"):
        configure(found.config_type, ["plant=kinematic"], "swerve-fast")


def test_an_arm_that_is_a_counterweight_keeps_off_the_floor() -> None:
    """Plans that trust little friction swing the load down to the floor, which ended the run. Truth: MuJoCo's contacts."""
    experiment = load("swerve-fast")
    changes = [*SLIPPERY, "plant.friction=0.4", "plant.calibration=none", "after=3"]
    result = experiment.run(configure(experiment.config_type, changes, "swerve-fast"), 1)
    assert result.outcome == "completed" and result.metrics["contacts_unwanted"].value == 0.0
    assert result.metrics["path_error_max"].value < 0.03 and result.metrics["wheel_slip_max"].value < 0.1
