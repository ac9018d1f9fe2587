"""Tasks among obstacles. Truth: distances of MuJoCo's shapes at the poses that the run recorded, and closed forms."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import mujoco
import numpy as np
import pytest

import wbmpc as wb
from clearing import TrueDistance, write_arm
from planar_driving import write_robot
from test_tasks import WHEELS, run
from wbmpc.configuration import configure
from wbmpc.errors import InputError
from wbmpc.obstacles.scene import SceneObstacle
from wbmpc.obstacles.shapes import Box, Capsule, HalfSpace, Sphere
from wbmpc.ocp.symbols import Symbols
from wbmpc.registry import load
from wbmpc.simulation.obstacles import SimulatedObstacles, load_scene
from wbmpc.tasks.obstacles import (
    ENTRY,
    PERSON,
    Clutter,
    Corridor,
    Extent,
    Moving,
    clutter_scene,
    corridor_scene,
    moving_scene,
    passing,
)  # fmt: skip
from wbmpc.tasks.rooms import RoomSettings, draw_room
from wbmpc.tasks.scene import WINDOW, stays

BOX = "{box: {half: [0.05, 0.05, 1]}, position: [PLACE], KEYS}"


def test_who_comes_back_to_where_it_was_has_not_stayed() -> None:
    """Truth: an evasion of half a meter and back, and a drift, in closed form."""
    times = np.arange(0.0, WINDOW + 0.3, 0.02)
    out_and_back = 0.5 * np.sin(2.0 * np.pi * times / WINDOW) ** 2
    drift = 0.02 * times
    along = lambda y: [(t, np.array([1.0, v, 0.5])) for t, v in zip(times.tolist(), y.tolist(), strict=True)]
    assert abs(np.interp(times[-1] - WINDOW, times, out_and_back) - out_and_back[-1]) < 0.01
    assert not stays(along(out_and_back))
    assert stays(along(drift)) and not stays(along(drift)[:50])


@pytest.fixture(scope="module")
def driving(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_robot(tmp_path_factory.mktemp("driving"), WHEELS, {"type": "differential"})


def scene(folder: Path, place: str, keys: str = "appears: 0") -> Path:
    path = folder / "scene.yaml"
    path.write_text(f"obstacles:\n  box: {BOX.replace('PLACE', place).replace('KEYS', keys)}\n")
    return path


def test_a_robot_keeps_its_margin_to_a_box_in_its_world(driving: Path, tmp_path: Path) -> None:
    """The left wheel would pass the box at 10 mm."""
    robot, path = wb.load_robot(driving), scene(tmp_path, "0.35, 0.28, 0")
    more = (f"obstacles={path}", "settle_time=0.1", "path.length=0.5", "path.ramp=0.3", "path.speed=0.5")
    m, margin = run("end-effector-track", driving, *more, "mpc.rate=25").metrics, robot.description.collision.margin
    assert margin - 0.01 < m["obstacle_clearance_min"].value < margin + 0.05
    assert m["obstacle_contacts"].value == 0.0 and m["time_stuck"].value == 0.0


def test_progress_waits_for_a_wall_that_passes(driving: Path, tmp_path: Path) -> None:
    """The wall is in the way of the chassis from 0.2 to 3 s; without it the path takes 1.55 s."""
    path = tmp_path / "scene.yaml"
    wall = "box: {half: [0.05, 0.5, 1]}, position: [0.45, -0.8, 0], velocity: [0, 0.5, 0]"
    path.write_text(f"obstacles:\n  wall: {{{wall}, appears: 0}}\n")
    more = (f"obstacles={path}", "settle_time=0.1", "path.length=0.5", "path.ramp=0.3", "path.speed=0.4", "mpc.rate=25")
    result = run("end-effector-track", driving, *more, "reference=progress", "reference.time_limit=4.2")
    m, margin = result.metrics, wb.load_robot(driving).description.collision.margin
    assert 2.5 < m["path_time"].value < 4.1
    assert m["obstacle_clearance_min"].value > margin - 0.01
    assert m["obstacle_contacts"].value == 0.0 and m["braking_plans"].value == 0.0
    # it slows down instead of leaving its path or its reference
    assert m["contour_error_max_world"].value < 0.01 and m["end_effector_error_max_world"].value < 0.03


def test_a_robot_that_is_stuck_says_so(tmp_path: Path) -> None:
    """An arm on a foot, and a wall across its way that reaches beyond it: it stands before the wall, and the run ends then."""
    arm, path = write_arm(tmp_path), tmp_path / "scene.yaml"
    robot = wb.load_robot(arm)
    tip = robot.pose(robot.home)[0]
    place = [float(tip[0]) + 0.15, 0.0, 0.0]
    path.write_text(f"obstacles:\n  wall: {{box: {{half: [0.05, 3, 3]}}, position: {place}}}\n")
    more = [
        f"robot={arm}",
        "plant=kinematic",
        f"obstacles={path}",
        "settle_time=0.1",
        "path.length=0.3",
        "mpc.rate=20",
    ]
    experiment = load("obstacles-static")
    settings = configure(
        experiment.config_type, [*more, "path.ramp=0.3", "path.speed=0.3", "reference.patience=10"], "x"
    )
    result = experiment.run(settings, 0, None)
    assert result.outcome == "stuck" and re.search(r"stuck .* m from its goal", result.reason)
    m, tool = result.metrics, result.log.array("end_effector")
    assert m["obstacle_clearance_min"].value > 0.0 and (tool[:, 0] < tip[0] + 0.1).all()
    assert m["passed"].value == 0.0
    assert m["goal_missed"].value == pytest.approx(np.linalg.norm(tool[-1] - tip - [0.3, 0, 0]), abs=0.02)
    # the reference is at the wall after 0.5 s, stands after another 0.5 s, and waits are reported after WINDOW
    assert result.log.times("end_effector")[-1] < 0.1 + 0.3 + 1.0 + 2.0


def ball_and_floor(around: SimulatedObstacles) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A ball of 0.1 m that falls upwards without gravity, among simulated obstacles."""
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, 0]
    body = spec.worldbody.add_body(name="ball", pos=[0, 0, 1.0])
    body.add_freejoint()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.1, 0, 0], contype=4, conaffinity=8)
    around.edit(spec)
    model = spec.compile()
    around.bind(model)
    return model, mujoco.MjData(model)


@pytest.mark.parametrize("angles", [(0.0, 0.0), (0.0, 3.14), (3.14, 3.14)])
def test_people_from_all_sides_meet_the_robot_and_do_not_appear_in_it(
    driving: Path, angles: tuple[float, float]
) -> None:
    """Truth: motions at constant velocities, of people and of a robot that nothing delays; the axle is in the middle of its box."""
    robot, settings = wb.load_robot(driving), Moving(robot=str(driving), angles=angles, people=6)
    e = Extent(robot, "x")
    half = float(np.linalg.norm(np.maximum(e.high[:2] - e.base[:2], e.base[:2] - e.low[:2])))
    for seed in range(10):
        for k, one in enumerate(moving_scene(settings, robot, seed)):
            velocity = np.array(one.place["velocity"])
            along = (k + 0.5) / 6 * settings.path.length
            meet = passing(settings, along)
            base = lambda t, at=along, then=meet: e.base[:2] + [at - settings.path.speed * (then - t), 0.0]
            turned = abs(np.arctan2(velocity[1], velocity[0]))
            assert angles[0] - 1e-9 <= turned <= angles[1] + 1e-9
            start = np.array(one.place["position"])[:2] - base(one.appears)
            assert np.linalg.norm(start) > half + PERSON[0] - 1e-9
            relative = velocity[:2] - [settings.path.speed, 0.0]
            if np.linalg.norm(relative) > 1e-6:  # a straight way relative to the robot leads through its middle
                assert abs(np.cross(relative, start)) / np.linalg.norm(relative) < 1e-6


def test_distances_and_contacts_are_those_of_the_world() -> None:
    wall = SceneObstacle("wall", wb.shapes.Box((0.1, 1, 1)), {"position": (1.0, 0, 0.7), "velocity": (-0.5, 0, 0)}, 1.0)
    around = SimulatedObstacles([wall], ground=-0.3)
    model, data = ball_and_floor(around)
    data.qvel[0] = 0.4
    distances = []
    for k in range(700):
        t = k * model.opt.timestep
        around.place(data, t)
        around.count_contacts(data, t)
        distances.append(around.distance(data) if k % 100 == 0 else np.nan)
        mujoco.mj_step(model, data)
    assert distances[400] == 1.0  # it has not appeared
    # 1.2 s: the ball is at 0.48, the wall's face at 0.9 - 0.1
    assert distances[600] == pytest.approx(0.8 - 0.48 - 0.1, abs=3e-3)
    assert around.contacts == 0
    for k in range(700, 900):
        around.place(data, k * model.opt.timestep)
        mujoco.mj_step(model, data)
        around.count_contacts(data, k * model.opt.timestep)
    assert around.contacts == 1 and around.contact_speed == pytest.approx(0.4, abs=0.05)
    assert around.caused == 1


def test_a_contact_with_a_ball_at_rest_is_not_its_doing() -> None:
    """The wall comes at 0.5 m/s, is there after 0.68 s, and pushes the ball ahead of it from then on."""
    wall = SceneObstacle("wall", wb.shapes.Box((0.1, 1, 1)), {"position": (0.54, 0, 0.7), "velocity": (-0.5, 0, 0)})
    around = SimulatedObstacles([wall], ground=-0.3)
    model, data = ball_and_floor(around)
    h = model.opt.timestep
    for k in range(round(1.2 / h)):
        around.place(data, k * h)
        mujoco.mj_step(model, data)
        data.qvel[0] = min(data.qvel[0], 0.0)
        around.count_contacts(data, k * h)
    assert around.contacts >= 1 and around.caused == 0 and around.contact_speed < 0.02
    assert around.pushed > 0.0


def test_walls_and_capsules_without_length_stand_in_the_world() -> None:
    """They have no mass: robots' files have a largest one. Truth: MuJoCo's rays from 2 m above, half-space and bead where they were put."""
    shapes = {
        "wall": HalfSpace((0.0, 0.0, 1.0), -1.0),
        "bead": Capsule((1.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.1),
        "hill": Sphere(900.0),
    }
    place = {"hill": {"position": (0.0, 0.0, -2000.0)}}
    spec = mujoco.MjSpec()
    SimulatedObstacles([SceneObstacle(n, s, place.get(n, {})) for n, s in shapes.items()]).edit(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert not model.body_mass.any()
    down, hit = np.array([0.0, 0.0, -1.0]), np.zeros(1, np.int32)
    for x, z in ((1.0, 0.1), (3.0, -1.0)):
        ray = mujoco.mj_ray(model, data, np.array([x, 0.0, 2.0]), down, None, 1, -1, hit)
        assert abs(2.0 - ray - z) < 1e-9


@pytest.mark.parametrize("name", ["~", "true", "1.5", '"a\\nb"', '"a\\u202eb"'])
def test_names_of_obstacles_can_be_printed(name: str, tmp_path: Path) -> None:
    file = tmp_path / "scene.yaml"
    file.write_text("obstacles: {" + name + ": {sphere: {radius: 0.1}}}\n")
    with pytest.raises(wb.InputError, match=r"scene\.yaml"):
        load_scene(file)


def test_the_planner_sees_a_scene_from_where_it_believes_to_be() -> None:
    """The odometry is 0.2 m and a quarter turn wrong: so is the pillar's place, which keeps its distance to the robot."""
    pillar = SceneObstacle("pillar", wb.shapes.Sphere(0.1), {"position": (2.0, 0.0, 0.5), "velocity": (0.1, 0, 0)})
    world = wb.Obstacles()
    SimulatedObstacles([pillar]).show(world, 0.0, np.array([1.0, 0.0, 0.0]), np.array([1.2, 0.0, 0.5 * np.pi]))
    snapshot = world.snapshot(0.0)
    place, _ = snapshot.pose(snapshot.obstacles[0], np.array([0.0, 1.0]))
    np.testing.assert_allclose(place, [[1.2, 1.0, 0.5], [1.2, 1.1, 0.5]], atol=1e-12)


def test_only_simulated_scenes_have_what_appears(tmp_path: Path) -> None:
    path = scene(tmp_path, "1, 0, 0", "appears: 2.0")
    assert [o.appears for o in load_scene(path)] == [2.0]
    with pytest.raises(InputError, match="appears"):
        wb.Obstacles().load(path)
    with pytest.raises(InputError, match=r"scene.yaml.*box.*'appears'.*number"):
        load_scene(scene(tmp_path, "1, 0, 0", "appears: soon"))


def test_bases_on_wheels_know_how_fast_their_speeds_may_change() -> None:
    """Truth: a wheel turns by (v ± w b) / r."""
    robot = wb.load_robot("differential-ur10")
    base, radius, half = robot.description.base, 0.1, 0.29
    most = min(robot.description.limits.acceleration[n] for n in base.wheel_joints())
    np.testing.assert_allclose(robot.limits.input_rate[:2], [most * radius, most * radius / half])


def test_plans_among_obstacles_use_a_share_of_the_accelerations() -> None:
    robot = wb.load_robot("differential-ur10")
    rows = wb.residuals.AccelerationLimit(robot, ["base"], 0.5)
    x, u, p = ca.SX.sym("x", robot.state.size), ca.SX.sym("u", robot.input.size), ca.SX.sym("p", rows.reference)
    found = ca.Function("rows", [x, u, p], [rows(Symbols(x, u, ca.SX(0, 1), ca.SX(robot.mode.size, 1), p, x, u))])
    rate, last = robot.limits.input_rate[:2], np.array([0.2, -0.1])
    for sign, which in ((1.0, slice(0, 2)), (-1.0, slice(2, 4))):
        given = np.zeros(robot.input.size)
        given[:2] = last + sign * 0.5 * rate * 0.1  # what half of the acceleration reaches in 0.1 s
        h = np.array(found(robot.home, given, [*last, 0.1])).ravel()
        np.testing.assert_allclose(h[which], 0.0, atol=1e-12)


def test_a_robot_finds_a_box_by_its_sensors_alone(driving: Path, tmp_path: Path) -> None:
    """The left wheel would pass it at 10 mm. Plans keep what a grid may be wrong by, and what balls stick out, beyond their margin."""
    path = scene(tmp_path, "0.45, 0.28, 0")
    more = (f"obstacles={path}", "settle_time=0.1", "path.length=0.4", "path.ramp=0.3", "path.speed=0.5", "mpc.rate=25")
    small = ("perception.map.size=[3, 3, 1]", "perception.lidar.columns=180", "perception.camera.width=16")
    result = run("clutter", driving, *more, *small)
    m, margin = result.metrics, wb.load_robot(driving).description.collision.margin
    assert margin - 0.01 < m["obstacle_clearance_min"].value < margin + 0.2
    assert m["map_age_max"].value < 0.2 and result.log.array("occupied_cells").min() > 0


def test_a_robot_whose_camera_fails_is_stopped(driving: Path, tmp_path: Path) -> None:
    experiment = load("clutter")
    keys = [f"robot={driving}", "plant=kinematic", f"obstacles={scene(tmp_path, '9, 9, 0')}", "settle_time=0.1"]
    keys += ["path.length=1.0", "mpc.rate=25", "perception.map.size=[3, 3, 1]", "perception.lidar.columns=36"]
    settings = configure(experiment.config_type, [*keys, "perception.camera.fails=0.25"], "clutter")
    result = experiment.run(settings, 0, None)
    assert not result.completed and "'map' was seen" in result.reason
    assert 0.58 <= result.log.times("base")[-1] <= 0.62  # the scan of 0.2 s would have come at 0.25 s


@pytest.mark.parametrize("name", ["differential-ur10", "swerve-ur10"])
def test_clutter_is_in_the_way_of_the_base_alone(name: str) -> None:
    """Every other thing reaches 5 cm into its way, lower than the end effector; the rest stands 0.3 m and more beside the robot."""
    robot = wb.load_robot(name)
    e, places = Extent(robot, "clutter"), []
    assert e.low[1] <= e.base_low[1] < e.base_high[1] <= e.high[1]
    for seed in range(5):
        for k, one in enumerate(clutter_scene(Clutter(), robot, seed)):
            place, solid = np.array(one.place["position"]), one.shape.solid  # type: ignore[union-attr]
            left, right = (place + solid.position)[1] + np.array([-1, 1]) * solid.size[0]
            low, high = (e.base_low, e.base_high) if k % 2 == 0 else (e.low, e.high)
            gap = max(left - high[1], low[1] - right)
            assert gap == pytest.approx(-0.05) if k % 2 == 0 else gap >= 0.3
            top = 2.0 * (place + solid.position)[2] - e.ground  # they stand on the floor
            assert k % 2 == 1 or top < e.tool[2]
            places.append(place[0])
    assert min(places) > e.high[0] + 0.5


def corridor_world(settings: Corridor) -> tuple[Extent, Callable[[list[float], list[float]], float]]:
    """What the robot takes up, and MuJoCo's ray [m] among the corridor's walls from a place (3) in a direction (3)."""
    robot = wb.load_robot("differential-ur10")
    e = Extent(robot, "corridor")
    around, spec = SimulatedObstacles(corridor_scene(settings, robot, 0), ground=e.ground), mujoco.MjSpec()
    around.edit(spec)
    model = spec.compile()
    data, hit = mujoco.MjData(model), np.zeros(1, np.int32)
    mujoco.mj_forward(model, data)
    return e, lambda place, way: mujoco.mj_ray(model, data, np.array(place), np.array(way), None, 1, -1, hit)


def test_corridors_turn_off_and_end() -> None:
    """Truth: MuJoCo's rays from the middle of the entry, along the corridor's axes."""
    e, ray = corridor_world(Corridor(width=0.86, long=2.0, offset=0.05, angle=0.0873, closed=True))
    c, s = np.cos(0.0873), np.sin(0.0873)
    inside = [e.high[0] + ENTRY + 0.5 * c, e.base[1] + 0.05 + 0.5 * s, 0.5]
    for direction, distance in (([-s, c, 0.0], 0.43), ([s, -c, 0.0], 0.43), ([c, s, 0.0], 1.5)):
        assert ray(inside, direction) == pytest.approx(distance, abs=1e-6)
    assert len(corridor_scene(Corridor(), wb.load_robot("differential-ur10"), 0)) == 2


def test_a_chicane_leads_aside_after_a_gap() -> None:
    """Truth: MuJoCo's rays from the middles of both corridors and of the gap."""
    e, ray = corridor_world(Corridor(width=0.9, long=1.0, offset=0.0, chicane=-0.3))
    gap, entry = float(e.high[0] - e.low[0]), float(e.high[0]) + ENTRY
    for along, middle in ((0.5, 0.0), (1.0 + gap + 0.5, -0.3)):
        for side in (1.0, -1.0):
            assert ray([entry + along, e.base[1] + middle, 0.5], [0.0, side, 0.0]) == pytest.approx(0.45, abs=1e-6)
    between = [entry + 1.0 + 0.5 * gap, e.base[1], 0.5]
    assert ray(between, [0.0, 1.0, 0.0]) == ray(between, [0.0, -1.0, 0.0]) == -1.0  # nothing there


def test_rooms_have_a_route_that_keeps_clear() -> None:
    """Truth: MuJoCo's distances along the route, of the robot at home."""
    robot = wb.load_robot("differential-ur10")
    settings = RoomSettings(things=2, length=4.0)
    room = draw_room(settings, robot, 3)
    boxes = [o for o in room.scene if isinstance(o.shape, Box)]
    truth = TrueDistance(robot, [(mujoco.mjtGeom.mjGEOM_BOX, list(o.shape.solid.size)) for o in boxes])
    places = [np.array(o.place["position"]) for o in boxes]
    least = np.inf
    for a, b in zip(room.route[:-1], room.route[1:], strict=True):
        for pose in np.linspace(a, b, int(np.abs(b - a).max() / 0.03) + 2):
            x = robot.home.copy()
            x[robot.state["base"]] = pose
            least = min(least, truth(x, places))
    assert least > robot.description.collision.margin
    np.testing.assert_allclose(room.route[-1], room.goal, atol=1e-9)
    assert len(room.scene) >= 6 + 2
