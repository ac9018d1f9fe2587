"""General experiments: any robot, with and without physics. Truth: the robot's own kinematics, a path's geometry, MuJoCo's bodies."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml

import wbmpc as wb
from effort import some, thorough
from planar_driving import write_robot
from wbmpc import lie
from wbmpc.cli import main
from wbmpc.configuration import configure
from wbmpc.default_problem import EVADING, default_problem, keep_clear
from wbmpc.errors import InputError
from wbmpc.obstacles.geometry import robot_geometry
from wbmpc.obstacles.pairs import distances, self_pairs
from wbmpc.registry import REGISTRY, load
from wbmpc.simulation.model_plant import ModelPlant
from wbmpc.tasks import goals
from wbmpc.tasks.arm_reach import reached_share
from wbmpc.tasks.following import Task
from wbmpc.tasks.path_settings import Circle, Curve, Line, Poses, Sine, Table, carried_base, timed
from wbmpc.tasks.settings import TaskSettings

WHEELS = [((0.0, 0.2), (0.0, 1.0, 0.0)), ((0.0, -0.2), (0.0, 1.0, 0.0))]


@pytest.fixture(scope="module")
def driving(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot of two wheels and two arm joints."""
    return write_robot(tmp_path_factory.mktemp("driving"), WHEELS, {"type": "differential"})


@pytest.fixture(scope="module")
def standing(driving: Path) -> Path:
    """The same whose base stands."""
    text = driving.read_text().replace("type: differential", "type: fixed").replace("  wheels:\n  - w0\n  - w1\n", "")
    text = text.replace("    w0: 12.0\n    w1: 12.0\n", "") + "fixed_joints: {w0: 0, w1: 0}\n"
    path = driving.with_name("standing.yaml")
    path.write_text(text)
    return path


def run(name: str, robot: Path, *assignments: str, plant: str = "kinematic") -> wb.RunResult:
    experiment = load(name)
    settings = configure(experiment.config_type, [f"robot={robot}", f"plant={plant}", *assignments], name)
    result = experiment.run(settings, 0, None)
    assert result.completed, result.reason
    return result


POSITION_ONLY = "settle_time=0.2"


def test_a_base_that_drives_carries_the_tip_along_a_line(driving: Path) -> None:
    """Two joints of an arm and a differential base reach every position."""
    result = run("end-effector-track", driving, POSITION_ONLY, "path.length=0.3", "path.ramp=0.5")
    m = result.metrics
    assert m["end_effector_error_mean"].value < 2e-4 and m["end_effector_error_max"].value < 1e-3
    assert m["base_path_length"].value == pytest.approx(0.3, abs=0.15)
    reference = result.log.array("end_effector_reference")
    assert np.linalg.norm(reference[-1] - reference[0]) == pytest.approx(0.3)
    assert m["limit_violation_max"].value < 1e-6
    assert not {"contacts_unwanted", "clearance_min"} & m.keys()  # nothing looks for contacts without physics


def test_progress_goes_as_fast_as_the_wheels_and_ends(driving: Path) -> None:
    """Asked for 3 m/s, wheels of 0.1 m at 12 rad/s: 1 m/s along a line, which is the planner's limit of the base."""
    more = ("path.length=1.5", "path.speed=3", "path.ramp=1", "reference=progress", "reference.time_limit=2.6")
    result = run("end-effector-track", driving, POSITION_ONLY, *more)
    m, base = result.metrics, result.log.array("base")
    speed = np.diff(base[:, 0]) / np.diff(result.log.times("base"))
    assert 0.9 < speed.max() < 1.3 and m["limit_violation_max"].value < 1e-6
    assert 1.5 / speed.max() < m["path_time"].value < 2.4
    assert m["contour_error_max_world"].value < 0.01 and m["end_effector_error_max"].value < 0.03
    tool, end = result.log.array("end_effector"), result.log.array("end_effector_reference")[-1]
    assert np.linalg.norm(tool[-1] - end) < 5e-3 and end[0] - tool[0, 0] == pytest.approx(1.5, abs=5e-3)


@thorough
def test_a_swerve_base_follows_a_path_at_its_own_speed() -> None:
    """Asked for more than the base's limit, along a line to the side: wheels turn first."""
    more = (
        "path.length=1",
        "path.speed=2",
        "path.ramp=1",
        "path.direction=1.5708",
        "reference=progress",
        "reference.time_limit=6",
    )
    m = run("end-effector-track", Path("swerve-ur10"), POSITION_ONLY, *more).metrics
    assert 0.6 < m["path_time"].value < 4.0 and m["contour_error_max_world"].value < 0.01


@pytest.mark.parametrize(
    ("robot", "path"),
    some([(robot, path) for robot in ("panda", "ur5") for path in ("line", "circle", "sine")], [0, 1, 5]),
)
def test_a_path_that_nobody_sized_is_one_that_an_arm_alone_can_follow(robot: str, path: str) -> None:
    """Truth: the tool's distance from the reference, and states within the ranges."""
    m = run("end-effector-track", Path(robot), POSITION_ONLY, f"path={path}").metrics
    assert m["end_effector_error_max"].value < 1e-3 and m["limit_violation_max"].value < 1e-6
    assert m["path_time"].value < 60.0


def test_a_path_out_of_an_arms_reach_is_announced(caplog: pytest.LogCaptureFixture) -> None:
    """1 m straight ahead: more than what is left of an arm of 0.9 m."""
    settings = configure(load("end-effector-track").config_type, ["robot=panda", "path.length=1"], "end-effector-track")
    Task(settings)
    said = re.search(
        r"path: the arm of 'panda' can follow (0\.\d+) m of its 1 m; give a shorter 'path.length'", caplog.text
    )
    assert said and 0.1 < float(said[1]) < 0.4


def test_an_arm_reaches_as_far_as_its_links(standing: Path) -> None:
    """Truth: the farthest of random postures at the height of the path."""
    robot = wb.load_robot(standing)
    position, turn = robot.pose(robot.home)
    states = np.tile(robot.home, (400, 1))
    states[:, robot.state["arm"]] = np.random.default_rng(1).uniform(
        robot.limits.state_lower, robot.limits.state_upper, (400, 2)
    )
    at = robot.poses(states)[:, :3]
    shoulder_reach = np.ptp(at[:, 0]) / 2.0
    far = np.linspace(position, position + [2.0 * shoulder_reach, 0.0, 0.0], 101)
    turns = np.tile(turn, (101, 1))
    share = reached_share(robot, far, turns)
    edge = at[np.abs(at[:, 2] - position[2]) < 0.05, 0].max()
    assert position[0] + share * 2.0 * shoulder_reach == pytest.approx(edge, abs=0.06)
    assert reached_share(robot, np.tile(position, (5, 1)), turns[:5]) == 1.0


def test_a_robot_whose_base_stands_holds_in_mujoco(standing: Path) -> None:
    m = run("hold", standing, POSITION_ONLY, "duration=0.3", plant="mujoco").metrics
    assert m["end_effector_error_max_world"].value < 0.01 and "base_path_length" not in m
    assert {"contacts_unwanted", "clearance_min"} <= m.keys()


def test_the_simulated_arm_moves_as_its_model(standing: Path) -> None:
    """Without perturbation MuJoCo's tip is where the model's kinematics have it."""
    from wbmpc.bases import base_type
    from wbmpc.control.direct import InputCommand
    from wbmpc.simulation.any_perturbation import AnyPerturbation

    robot = wb.load_robot(standing)
    plant = base_type("fixed").plant(robot, AnyPerturbation.none(), 0)
    plant.step(InputCommand(np.array([0.5, -0.3]), np.zeros(1)), 400)
    plant.step(InputCommand(np.zeros(2), np.zeros(1)), 200)
    truth = plant.truth()
    # 0.2 s at these speeds: the servos' first-order lag delays, and does not lose
    np.testing.assert_allclose(truth.state - robot.home, [0.1, -0.06], atol=2e-3)
    np.testing.assert_allclose(truth.tool, robot.pose(truth.state)[0], atol=1e-9)
    np.testing.assert_allclose(plant.measure().state, truth.state, atol=1e-12)


def test_goals_that_can_be_reached_are_reached(standing: Path) -> None:
    m = run("goals", standing, "count=1", "time_per_goal=2", POSITION_ONLY).metrics
    assert m["goals_reached"].value == 1.0 and m["goal_error_max"].value < 0.005


def test_a_base_drives_as_it_is_ordered(driving: Path) -> None:
    orders = "orders=[[1.5, 0.2, 0, 0.3], [1.1, 0, 0, 0]]"
    result = run("cmd-vel", driving, orders, POSITION_ONLY)
    assert result.metrics["base_error_mean"].value < 2e-3
    # an arc of radius v / w; what speeds lack while they rise, they have while they fall
    radius, angle = 0.2 / 0.3, 0.3 * 1.5
    arc = [radius * np.sin(angle), radius * (1.0 - np.cos(angle)), angle]
    np.testing.assert_allclose(result.log.array("base")[-1], arc, atol=3e-3)


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("cmd-vel", "orders=[[2, 0, 0.1, 0]]", "no speed to the left; valid: v, wz"),
        ("cmd-vel", "orders=[[0.5, 0.1, 0, 0]]", "must last longer than 1 s"),
        ("hold", "weights={end_efector: 2}", "unknown cost.*end_efector.*did you mean 'end_effector'"),
        ("hold", "plant.mass=0.1", "nothing uses it without plant=mujoco"),
        ("end-effector-track", "path={kind: poses, poses: [[1, 2]]}", "section"),
    ],
)
def test_bad_settings_name_the_key(driving: Path, name: str, change: str, words: str) -> None:
    with pytest.raises(wb.InputError, match=words):
        run(name, driving, change)


def test_a_base_that_stands_does_not_drive(standing: Path) -> None:
    with pytest.raises(wb.InputError, match=r"the state of robot 'own' has no pose of a base"):
        run("cmd-vel", standing)


# ---------------------------------------------------------------------- paths
START, TURN = np.array([0.4, 0.1, 0.8]), np.array([1.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("path", "end", "length"),
    [
        (Line(length=2.0, direction=np.pi / 2), [0.4, 2.1, 0.8], 2.0),
        (Circle(length=3.0, laps=0.5), [0.4, 0.1 + 6.0 / np.pi, 0.8], 3.0),
        (Circle(length=3.0, vertical=True), [0.4, 0.1, 0.8], 3.0),
        (Sine(length=2.0, amplitude=0.0, lift=0.0), [2.4, 0.1, 0.8], 2.0),
        (Poses(poses=((0.5, 0.0, 0.0), (0.5, 0.5, 0.0))), [0.9, 0.6, 0.8], 1.0),
    ],
)
def test_paths_are_as_long_as_they_say(driving: Path, path: Any, end: list[float], length: float) -> None:
    curve = path.curve(wb.load_robot(driving), START, TURN)
    np.testing.assert_allclose(curve.points[0], START, atol=1e-12)
    np.testing.assert_allclose(curve.points[-1], end, atol=1e-9)
    assert np.linalg.norm(np.diff(curve.points, axis=0), axis=1).sum() == pytest.approx(length, rel=1e-3)
    reference, stop = timed(curve, 0.25, 1.0, 0.5)
    assert stop == pytest.approx(0.5 + length / 0.25 + 1.0, rel=1e-3)
    speed = np.linalg.norm(np.diff(reference.values[:, :3], axis=0), axis=1) / np.diff(reference.times)
    assert speed.max() == pytest.approx(0.25, rel=0.02) and speed[0] == 0.0 and speed[-1] < 0.01


def test_a_table_of_poses_turns_on_its_way(driving: Path, tmp_path: Path) -> None:
    file, half = tmp_path / "way.csv", np.sqrt(0.5)
    file.write_text(f"x,y,z,qw,qx,qy,qz\n0.5,0,0,1,0,0,0\n1,0,0,{half},0,0,{half}\n")
    curve = Table(file=file).curve(wb.load_robot(driving), START, TURN)
    np.testing.assert_allclose(curve.points[-1], START + [1.0, 0.0, 0.0])
    angles = [lie.rotation_to_euler_zyx(lie.quaternion_to_rotation(q))[0] for q in curve.turns]
    # level over the first half, then a quarter turn
    assert angles[len(angles) // 2] == pytest.approx(0.0, abs=1e-3) and angles[-1] == pytest.approx(np.pi / 2)
    for text, words in (
        ("a,b\n", "line 1: columns"),
        ("x,y,z\n1,2\n", "line 2: 3 finite numbers"),
        ("x,y,z\n1,2,nan\n", "line 2"),
        ("x,y,z\n1,2,1001\n", "line 2: 3 finite numbers from -1000 to 1000"),
        ("x,y,z\n1,2,1_0\n", "line 2: 3 finite numbers"),
        ("x,y,z\n900,0,0\n0,0,0\n", "the path is 1800 m long; at most 1000 m"),
        ("x,y,z\n" + "1,0,0\n" * 1001, "line 1002: at most 1000 poses"),
    ):
        file.write_text(text)
        with pytest.raises(wb.InputError, match=words):
            Table(file=file).curve(wb.load_robot(driving), START, TURN)


def test_a_path_that_takes_hours_is_an_error() -> None:
    """Its reference would fill the memory."""
    curve = Curve(np.array([[0.0, 0.0, 0.0], [1000.0, 0.0, 0.0]]), np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)))
    with pytest.raises(wb.InputError, match=r"path\.speed: 1000 m with 0.001 m/s take 1e\+06 s; at most 7200 s"):
        timed(curve, 1e-3, 1.0, 0.0)


def test_the_base_goes_along_beside_its_tip(driving: Path) -> None:
    robot = wb.load_robot(driving)
    x = robot.home.copy()
    x[robot.state["base"]] = [0.7, -0.4, 1.1]
    poses = np.vstack([np.concatenate(robot.pose(robot.home)), np.concatenate(robot.pose(x))])
    np.testing.assert_allclose(carried_base(robot, poses)[1], [0.7, -0.4, 1.1], atol=1e-9)


# ---------------------------------------------------------------------- the model as a plant
@pytest.mark.parametrize("name", ["differential-ur10", "swerve-ur10", "rezero"])
def test_pictures_of_the_model_are_its_kinematics(name: str) -> None:
    """Of every kind of base: MuJoCo's tool is where the symbolic model has it."""
    robot = wb.load_robot(name)

    class Problem:  # what the plant asks of an MPC when nothing is stepped
        dynamics = robot.dynamics()

    rng = np.random.default_rng(1)
    x = robot.home + 0.1 * rng.uniform(-1.0, 1.0, robot.state.size)
    plant = ModelPlant(robot, Problem, x)  # type: ignore[arg-type]
    frames, truth = plant.world.frames(height=0.0), plant.truth()
    lift = np.array([0.0, 0.0, -robot.base.ground])
    np.testing.assert_allclose(frames["tool"] - lift, truth.tool, atol=1e-9)
    np.testing.assert_allclose(frames["tool_rotation"], truth.tool_rotation, atol=1e-9)
    np.testing.assert_allclose(frames["tool_in_base"], truth.tool_in_base, atol=1e-9)


def test_a_base_that_is_fixed_to_another_body_is_simulated(driving: Path, tmp_path: Path) -> None:
    """As ``base_footprint`` and ``base_link`` of many robots. Truth: the tip is where the model has it."""
    model = (driving.parent / "robot.xml").read_text()
    inner = model.replace(
        '<body name="chassis" pos="0 0 0.15">',
        '<body name="foot" pos="0.3 0 0"><body name="chassis" pos="0.1 0.2 0.15" euler="0 0 0.4">',
    )
    (tmp_path / "robot.xml").write_text(
        inner.replace("    </body>\n  </worldbody>", "    </body></body>\n  </worldbody>")
    )
    (tmp_path / "robot.yaml").write_text(driving.read_text())
    robot = wb.load_robot(tmp_path / "robot.yaml")
    plant = wb.base_type("differential").plant(robot, wb.SimulationSettings().plant.none(), 0)
    truth = plant.truth()
    np.testing.assert_allclose(truth.pose, 0.0, atol=1e-3)
    np.testing.assert_allclose(truth.tool, robot.pose(truth.state)[0], atol=2e-3)


def test_a_base_on_a_joint_cannot_be_simulated() -> None:
    from wbmpc.simulation.world import free_body

    bodies = "<body name='foot'><body name='hull'><joint name='lift' type='slide'/></body></body>"
    spec = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    with pytest.raises(
        wb.InputError, match=r"robot\.yaml: key 'base\.body': body 'hull' hangs on 'foot' by joint 'lift'"
    ):
        free_body(spec, "hull", "robot.yaml")


def test_a_rate_that_is_no_part_of_200_hz_has_a_faster_controller(standing: Path) -> None:
    """80 Hz: every fifth tick of 400 Hz."""
    from wbmpc.tasks.loop import make_system

    robot, mpc = TaskSettings(robot=str(standing), mpc={"rate": 80}).prepare()  # type: ignore[arg-type]
    timing = make_system(robot, mpc, wb.SimulationSettings(plant="kinematic"), 0).timing
    assert timing.period == pytest.approx(1 / 400) and timing.mpc_every == 5 and timing.delay == 4


# ---------------------------------------------------------------------- closed loops of users
def own_mpc(robot: wb.RobotModel) -> wb.MPC:
    """Costs of a user."""
    ocp = wb.OptimalControlProblem(robot.dynamics(), horizon=1.0, intervals=20, first_interval=0.02)
    ocp.add(wb.Cost("end_effector", wb.residuals.FramePose(robot, robot.tool), [1000.0] * 3 + [0.0] * 3))
    ocp.add(wb.Cost("speed", wb.residuals.Input(robot), 0.1))
    mpc = wb.MPC(ocp, rate=50.0)
    position, turn = robot.pose(robot.home)
    mpc.reference["end_effector"] = wb.Reference.poses([0.0], [position], turn)
    return mpc


def test_simulate_runs_and_writes_what_a_run_has(driving: Path, tmp_path: Path) -> None:
    robot = wb.load_robot(driving)
    out = tmp_path / "mine"
    result = wb.simulate(robot, own_mpc(robot), 0.2, seed=3, name="mine", out=out, settle_time=0)
    assert result.completed and result.metrics["end_effector_error_max_world"].value < 0.01
    assert json.loads((out / "metrics.json").read_text())["experiment"] == "mine"
    assert wb.read_recording(out / "run.mcap").complete
    with pytest.raises(wb.InputError, match="has a run already"):
        wb.simulate(robot, own_mpc(robot), 0.2, out=out)
    with pytest.raises(wb.InputError, match=r"simulate: plant.kind='paper'"):
        wb.simulate(robot, own_mpc(robot), 0.2, plant="paper")


@pytest.mark.parametrize("physics", ["kinematic", "mujoco"])
def test_an_mpc_of_another_robot_is_an_error(physics: str, driving: Path, standing: Path, tmp_path: Path) -> None:
    """One without the base, and one with the same joints whose arm is mounted 0.1 m higher."""
    mpc = own_mpc(wb.load_robot(driving))
    with pytest.raises(wb.InputError, match=r"'mpc': .* its state 'base' is \(\), the robot's is \(x, y, yaw\)"):
        wb.simulate(wb.load_robot(driving), own_mpc(wb.load_robot(standing)), 0.1, plant=physics)
    raised = write_robot(tmp_path, WHEELS, {"type": "differential"})
    model = raised.with_name("robot.xml")
    model.write_text(model.read_text().replace('name="shoulder" pos="0 0 0.1"', 'name="shoulder" pos="0 0 0.2"'))
    with pytest.raises(wb.InputError, match=r"the end effector of its model is elsewhere, by 0\.1 m at home"):
        wb.simulate(wb.load_robot(raised), mpc, 0.1, plant=physics)


@thorough
def test_the_same_seed_gives_the_same_run(driving: Path) -> None:
    robot = wb.load_robot(driving)
    one, other = (wb.simulate(robot, own_mpc(robot), 0.3, seed=5) for _ in range(2))
    np.testing.assert_array_equal(one.log.array("base"), other.log.array("base"))


def test_weights_are_factors_of_costs(driving: Path) -> None:
    _, mpc = TaskSettings(robot=str(driving), weights={"input": 3.0}).prepare()
    _, plain = TaskSettings(robot=str(driving)).prepare()
    where = plain.solver.problem.constant.slices
    key = next(k for k in where if "input" in k and "path" in k)
    before = plain.solver.constants[where[key]]
    assert before.max() > 0.0
    np.testing.assert_allclose(mpc.solver.constants[where[key]], 3.0 * before)


def test_a_part_of_a_cost_has_a_factor_of_its_own(driving: Path) -> None:
    """Truth: the weights of the problem itself, times both factors."""
    _, mpc = TaskSettings(robot=str(driving), weights={"end_effector": 2.0, "end_effector.orientation": 0.1}).prepare()
    _, plain = TaskSettings(robot=str(driving)).prepare()
    key = "path.end_effector"
    before, found = (m.solver.constants[m.solver.problem.constant.slices[key]] for m in (plain, mpc))
    np.testing.assert_allclose(found, before * [2.0, 2.0, 2.0, 0.2, 0.2, 0.2])
    with pytest.raises(InputError, match=r"part of the cost 'end_effector'.*turn"):
        TaskSettings(robot=str(driving), weights={"end_effector.turn": 2.0}).prepare()


# ---------------------------------------------------------------------- the command line
def test_every_setting_is_listed_with_what_it_means(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "end-effector-track", "--settings", "--json"]) == 0
    found = {row["key"]: row for row in json.loads(capsys.readouterr().out)["settings"]}
    assert found["path.speed"]["unit"] == "m/s" and found["path.speed"]["default"] == "`0.2`"
    assert "≥ 0.001" in found["path.speed"]["kind"] and "along the arc" in found["path.speed"]["help"]
    assert {"robot", "plant.kind", "mpc.horizon", "plant.mass", "path.kind", "path.file", "weights"} <= set(found)


def test_settings_come_from_a_file_and_the_line_after_it(driving: Path, tmp_path: Path) -> None:
    file = tmp_path / "settings.yaml"
    file.write_text(
        f"robot: {driving}\nplant: kinematic\nmpc: {{horizon: 2.0}}\npath.length: 0.7\nweights: {{input: 2}}\n"
    )
    kind = load("end-effector-track").config_type
    settings = configure(kind, ["path.length=0.9"], "x", file)
    assert settings.mpc.horizon == 2.0 and settings.path.length == 0.9 and settings.weights == {"input": 2.0}
    assert configure(kind, [], "x", file).path.length == 0.7
    for text, words in (
        ("mpc: {horison: 2}\n", r"settings.yaml: unknown key 'mpc.horison'"),
        ("[1]\n", "a mapping"),
        ("mpc: {horizon: -1}\n", "mpc.horizon=-1"),
    ):
        file.write_text(text)
        with pytest.raises(wb.InputError, match=words):
            configure(kind, [], "x", file)


def test_weights_of_sliders_are_a_settings_file(tmp_path: Path) -> None:
    from wbmpc.cli.running import write_weights

    assert write_weights({}, {"input": 2.0}, tmp_path) == {}
    files = write_weights({"end_effector": 0.1}, {"input": 2.0}, tmp_path)
    settings = configure(TaskSettings, [], "x", Path(files["weights"]))
    assert settings.weights == {"input": 2.0, "end_effector": 0.1}


@pytest.mark.parametrize("name", ["end-effector-track", "hold", "goals", "cmd-vel"])
def test_every_setting_says_what_it_means(name: str) -> None:
    """In a text of its own; what is a length, a time, an angle or a mass by its name has a unit."""
    from wbmpc.settings_table import rows

    found = list(rows(load(name).config_type))
    texts = [r.help for r in found if r.key.split(".")[-1] not in ("wheel_radius", "spring_damping")]
    assert len(set(texts)) >= len(texts) - 6  # "of bodies, relative" and the like
    dimensional = re.compile(r"time|delay|offset|noise|bias|walk|payload|length|speed|horizon|ramp|jitter")
    bare = re.compile(r"spread|effort_noise|estimate_")  # shares, and what is done or not
    assert [r.key for r in found if dimensional.search(r.key) and not bare.search(r.key) and not r.unit] == []


@pytest.mark.parametrize("name", sorted(REGISTRY))
def test_what_a_setting_means_is_not_what_others_mean(name: str) -> None:
    """Every setting has a text, and none goes on with another setting of its section."""
    from wbmpc.settings_table import rows

    found = list(rows(REGISTRY[name].config_type))
    assert [r.key for r in found if not r.help] == []
    for row in found:
        section, _, own = row.key.rpartition(".")
        others = [
            k for k in (r.key.rpartition(".")[2] for r in found if r.key.rpartition(".")[0] == section) if k != own
        ]
        mixed = [k for k in others if re.search(rf"\b{k}( \[[^\]]*\]|:)", row.help)]
        assert not mixed, (row.key, row.help)


def test_a_key_of_several_kinds_has_the_default_of_the_chosen_one() -> None:
    """Truth: the experiment's own settings. All but one of the kinds have a payload, 0 kg by themselves."""
    from wbmpc.settings_table import rows

    kind = load("tip-over").config_type
    found = {r.key: r.default for r in rows(kind)}
    assert found["stability.payload"] == f"`{kind().stability.payload}`" == "`10.0`"


def test_units_reach_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    """Brackets are no markup: [s] would strike the text through."""
    assert "x, y, z [m]" in _shown("end-effector-track", capsys)


def _shown(name: str, capsys: pytest.CaptureFixture[str]) -> str:
    assert main(["run", name, "--settings"]) == 0
    return " ".join(capsys.readouterr().out.split())


def test_goals_are_drawn_where_the_robot_does_not_touch_itself() -> None:
    """Truth: distances by the collider that samples pairs, which is other code than that of the rows."""
    robot = wb.load_robot("swerve-ur10")
    pairs = list(self_pairs(robot))
    settings = goals.GoalsSettings(robot="swerve-ur10", posture=0.5)
    states = np.concatenate([goals.random_states(robot, settings, seed) for seed in range(3)])
    assert distances(robot_geometry(robot), pairs, states, 0.05).min() >= robot.description.collision.self.margin - 1e-6


def test_pairs_come_near_faster_among_obstacles() -> None:
    """Who evades folds the arm faster, up to a share of its full speed; the pairs are those of the robot file either way."""
    robot = wb.load_robot("differential-ur10")
    alone, among = default_problem(robot), keep_clear(default_problem(robot), robot, wb.Obstacles())
    rows = [ocp.terms["self_clearance"].residual for ocp in (alone, among)]
    assert 0.0 < rows[1].approach == pytest.approx(EVADING * rows[0].approach)  # type: ignore[attr-defined]
    assert rows[0].pairs == rows[1].pairs == self_pairs(robot)  # type: ignore[attr-defined]


def test_goals_are_drawn_for_a_robot_without_shapes(tmp_path: Path) -> None:
    """As a URDF has it whose meshes are of a format that is not read. Truth: the ranges of the file."""
    description = wb.load_robot("ur5").description
    (tmp_path / "bare.xml").write_text(re.sub(r"<geom[^>]*/>", "", description.model.read_text()))
    data = yaml.safe_load(Path(description.source).read_text())
    del data["collision"]
    (tmp_path / "bare.yaml").write_text(yaml.safe_dump(data | {"model": "bare.xml"}))
    robot = wb.load_robot(tmp_path / "bare.yaml")
    states = goals.random_states(robot, goals.GoalsSettings(robot=str(tmp_path / "bare.yaml")), 0)
    assert states.shape == (4, 6) and (np.abs(states) <= 2.0 * np.pi).all()
    assert len({tuple(x) for x in states}) == 4


def test_goals_of_a_robot_whose_pairs_cannot_be_found_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """It has shapes, and goals that are drawn as if it had none may let it run into itself. Truth: the limit that is set here."""
    robot = wb.load_robot("rezero")
    monkeypatch.setattr("wbmpc.obstacles.pairs.MAX_SHAPES", 1)
    with pytest.raises(wb.InputError, match="shapes; at most 1 "):
        goals.random_states(robot, goals.GoalsSettings(robot="rezero"), 0)
