"""The base type ``wheels``. Truth: MuJoCo's velocities of the wheels' bodies, rolling tires, the geometry of files written here."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml

import wbmpc as wb
from planar_driving import Constant, ideal_plant
from wbmpc import lie
from wbmpc.bases.planar_motion.messages import PlanarCommand, PlanarMeasurement
from wbmpc.bases.wheels.control import WheelsController, WheelsOdometry
from wbmpc.default_problem import default_mpc
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.robots import load_spec
from wbmpc.simulation.any_perturbation import AnyPerturbation
from wbmpc.tasks.following import PathTaskSettings
from wbmpc.tasks.track import EXPERIMENT

HEIGHT, RADIUS = 0.15, 0.08
#: A wheel: (x, y) [m] of its axis, sign of the steering axis (0: none), offset (x, y) [m] of the wheel, further keys.
Wheel = tuple[tuple[float, float], int, tuple[float, float], dict[str, Any]]
FRONT: Wheel = ((0.4, 0.0), 1, (0.0, 0.0), {})
REAR: list[Wheel] = [
    ((-0.2, 0.25), 0, (0.0, 0.0), {"driven": False}),
    ((-0.2, -0.25), 0, (0.0, 0.0), {"driven": False}),
]
CASTERS: list[Wheel] = [((x, y), 1, (-0.03, 0.0), {}) for x in (0.25, -0.25) for y in (0.2, -0.2)]
BESIDE: list[Wheel] = [((0.0, 0.25), -1, (0.0, 0.04), {}), ((0.0, -0.25), -1, (0.0, -0.04), {})]
CAR: list[Wheel] = [
    ((0.4, y), 1, (0.0, 0.0), {"driven": False}) for y in (0.25, -0.25)
] + [((-0.2, y), 0, (0.0, 0.0), {}) for y in (0.25, -0.25)]  # fmt: skip
KINDS = {"tricycle": [FRONT, *REAR], "casters": CASTERS, "beside": BESIDE, "car": CAR}


def write(folder: Path, wheels: list[Wheel], axis: str = "0 0", **base: Any) -> Path:
    """A YAML and an MJCF with an arm of two joints."""
    bodies, records, speeds = "", [], {"pan": 2.0, "lift": 2.0}
    for i, ((x, y), sign, (ox, oy), keys) in enumerate(wheels):
        inertial = '<inertial pos="0 0 0" mass="1" diaginertia="0.003 0.003 0.003"/>'
        tire = f'<joint name="w{i}" axis="0 1 0"/><geom type="cylinder" size="{RADIUS} 0.02" euler="{np.pi / 2} 0 0"/>'
        at = f"{x} {y} {RADIUS - HEIGHT}"
        if sign:
            steer = f'<joint name="s{i}" axis="{axis} {sign}"/>'
            bodies += f'<body name="fork{i}" pos="{at}">{inertial}{steer}<body name="disc{i}" pos="{ox} {oy} 0">{inertial}{tire}</body></body>'
        else:
            bodies += f'<body name="disc{i}" pos="{at}">{inertial}{tire}</body>'
        speeds |= {f"w{i}": 12.0, **({f"s{i}": 5.0} if sign else {})}
        records.append({"joint": f"w{i}", **({"steer": f"s{i}"} if sign else {}), **keys})
    (folder / "robot.xml").write_text(f"""<mujoco><compiler angle="radian" autolimits="true"/><worldbody>
      <body name="chassis" pos="0 0 {HEIGHT}"><inertial pos="0 0 0.05" mass="25" diaginertia="0.8 0.8 1.2"/>{bodies}
      <body name="shoulder" pos="0 0 0.1"><inertial pos="0 0 0.05" mass="2" diaginertia="0.01 0.01 0.01"/>
      <joint name="pan" axis="0 0 1" range="-3 3"/>
      <body name="upper" pos="0 0 0.2"><inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.01 0.01"/><joint name="lift" axis="0 1 0" range="-2 2"/>
      <site name="tip" pos="0.3 0 0"/></body></body></body></worldbody></mujoco>""")
    description = {
        "name": "mixed", "model": "robot.xml", "base": {"type": "wheels", "body": "chassis", "wheels": records, **base},
        "arm": {"joints": ["pan", "lift"], "tool": "tip"}, "home": {"lift": 0.3},
        "limits": {"velocity": speeds, "effort": {"pan": 100.0, "lift": 100.0}},
    }  # fmt: skip
    (folder / "robot.yaml").write_text(yaml.safe_dump(description))
    return folder / "robot.yaml"


@pytest.mark.parametrize("kind", KINDS)
def test_rows_are_velocities_of_the_wheels(kind: str, tmp_path: Path) -> None:
    """At random steering angles and rates: along and across of each wheel's center, by MuJoCo."""
    robot = wb.load_robot(write(tmp_path, KINDS[kind]))
    spec = load_spec(robot.description)
    spec.body("chassis").add_freejoint(name="root")
    model = spec.compile()
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    for _ in range(5):
        twist = rng.uniform(-1.0, 1.0, 3)
        steering = robot.state.groups.get("steer", ())
        angles, rates = rng.uniform(-2.0, 2.0, (2, len(steering)))
        data.qvel[:] = [twist[0], twist[1], 0.0, 0.0, 0.0, twist[2], *np.zeros(model.nv - 6)]
        for name, angle, rate in zip(steering, angles, rates, strict=True):
            data.joint(name).qpos[0], data.joint(name).qvel[0] = angle, rate
        mujoco.mj_forward(model, data)
        for contact, wheel in zip(robot.base.wheel_contacts, robot.description.base.wheels, strict=True):
            joint, velocity = model.joint(wheel.joint), np.zeros(6)
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, int(joint.bodyid[0]), velocity, 0)
            along = np.cross(data.xaxis[joint.id], [0.0, 0.0, 1.0])
            aside = np.cross([0.0, 0.0, 1.0], along)
            rows = np.array(contact.rows(angles, len(steering)))
            np.testing.assert_allclose(
                rows @ [*twist, *rates], [along @ velocity[3:], aside @ velocity[3:]], atol=1e-12
            )


def test_rates_of_rollers_are_those_of_a_mecanum_base(tmp_path: Path) -> None:
    """Truth: the textbook's (vx ∓ vy ∓ (lx + ly) w) / r."""
    at = [(0.3, 0.2), (0.3, -0.2), (-0.3, 0.2), (-0.3, -0.2)]
    signs = [-1.0, 1.0, 1.0, -1.0]
    wheels: list[Wheel] = [(p, 0, (0.0, 0.0), {"rollers": 45.0 * s}) for p, s in zip(at, signs, strict=True)]
    base = wb.load_robot(write(tmp_path, wheels)).base
    roll, side = base.matrices(np.zeros(0))
    expected = [[1.0, s, -np.sign(y) * 0.5] for (_, y), s in zip(at, signs, strict=True)]
    np.testing.assert_allclose(roll * RADIUS, expected, atol=1e-12)
    assert side.size == 0 and base.state.keys() == {"base", "arm"}


@pytest.mark.parametrize("kind", ["casters", "tricycle"])
def test_odometry_finds_the_way_that_wheels_rolled(kind: str, tmp_path: Path) -> None:
    """Wheels on paper: steering and wheel angles integrated in steps of 1 ms along a motion without slip."""
    base = wb.load_robot(write(tmp_path, KINDS[kind])).base
    odometry, h = WheelsOdometry(base, np.zeros(3)), 1e-3
    steer, wheel, pose = np.full(base.steering, 0.3), np.zeros(sum(c.driven for c in base.wheel_contacts)), np.zeros(3)
    for k in range(1000):
        _roll, side = base.matrices(steer)
        if kind == "casters":  # any twist; casters follow
            twist = np.array([0.3, 0.2 * np.sin(2e-3 * k), 0.4])
            rate = -np.linalg.solve(side[:, 3:], side[:, :3] @ twist)
        else:  # the steered wheel decides
            rate = np.array([0.2 * np.cos(3e-3 * k)])
            speeds = np.linalg.svd(base.by_input(side)[:1, :2])[2][-1]
            twist = base.twist @ (0.3 * speeds / speeds[0])
        if k % 5 == 0:
            odometry.turn(k * h, wheel, steer, None)
        pose = lie.se2_step(pose, twist * h)
        middle = base.matrices(steer + 0.5 * h * rate)[0]
        wheel, steer = wheel + h * (middle @ [*twist, *rate]), steer + h * rate
    found = odometry.turn(1.0, wheel, steer, None)
    np.testing.assert_allclose(found, pose, atol=2e-3)
    assert np.linalg.norm(pose[:2]) > 0.2
    assert np.linalg.eigvalsh(odometry.covariance).min() > 0.0


def test_steered_tires_roll_in_the_plan(tmp_path: Path) -> None:
    """In the closed loop without physics: the tip follows a line aside, and no tire slips."""
    settings = PathTaskSettings.model_validate(
        {"robot": str(write(tmp_path, CASTERS)), "plant": "kinematic", "settle_time": 0.2,
         "path": {"kind": "line", "length": 0.3, "direction": 0.1, "ramp": 1.0}}
    )  # fmt: skip
    result = EXPERIMENT.run(settings, 0, None)
    assert result.completed and result.metrics["end_effector_error_mean"].value < 1e-3
    robot = wb.load_robot(tmp_path / "robot.yaml")
    states, inputs = result.log.array("state"), result.log.array("input")
    slip = [
        robot.base.matrices(x[robot.state["steer"]])[1] @ u[:7] * RADIUS for x, u in zip(states, inputs, strict=True)
    ]
    assert np.abs(slip).max() < 2e-3


def test_rates_of_steered_wheels_hold_however_far_the_goal_is(tmp_path: Path) -> None:
    """The robot goes to a goal that appears 3.6 m away, without physics. Truth: MuJoCo's velocities of the wheels' centers in the plan's
    motion, over the radius, against the file's 12 rad/s."""
    robot = wb.load_robot(write(tmp_path, BESIDE, casters=[[0.3, 0.0], [-0.3, 0.0]]))
    mpc = default_mpc(robot)
    position, orientation = robot.pose(robot.home)
    mpc.reference["end_effector"] = wb.Reference.poses([0.0], [position + [3.0, 2.0, 0.0]], orientation)
    model = load_spec(robot.description).compile()
    data, x, fastest = mujoco.MjData(model), robot.home, 0.0
    steer = robot.state.groups["steer"]
    for k in range(100):
        u = mpc.update(wb.Observation(t=0.02 * k, x=x)).feedforward(0.02 * k + 0.01)
        for name, angle, rate in zip(steer, x[robot.state["steer"]], u[robot.input["steer"]], strict=True):
            data.joint(name).qpos[0], data.joint(name).qvel[0] = angle, rate
        mujoco.mj_forward(model, data)
        for wheel in robot.description.base.wheels:
            joint, jacobian = model.joint(wheel.joint), np.zeros((3, model.nv))
            mujoco.mj_jacBodyCom(model, data, jacobian, None, int(joint.bodyid[0]))
            at = data.xpos[int(joint.bodyid[0])]
            velocity = jacobian @ data.qvel + [u[0] - u[2] * at[1], u[1] + u[2] * at[0], 0.0]
            along = np.cross(data.xaxis[joint.id], [0.0, 0.0, 1.0])
            fastest = max(fastest, abs(float(along @ velocity)) / RADIUS)
        x = mpc.simulate(x, u, 0.02)
    assert 9.0 < fastest < 12.0 * 1.02


@pytest.mark.parametrize("kind", ["beside", "casters"])
def test_wheels_roll_as_their_steering_turns(kind: str, tmp_path: Path) -> None:
    """Steering that is behind its plan is ordered to catch up, and wheels beside it roll along, where they are: else each holds the
    other back. Truth: MuJoCo's velocity of each tire's lowest point, along its heading, at the measured angles and ordered rates."""
    robot = wb.load_robot(write(tmp_path, KINDS[kind]))
    names = robot.state.groups["steer"]
    n, driven = len(names), len(robot.description.base.wheel_joints())
    angles, u = np.linspace(0.2, 0.6, n), np.array([0.02, 0.01, 0.1, *np.linspace(-0.2, 0.3, n), 0.0, 0.0])
    controller, plans = WheelsController(robot, np.zeros(3), 0.0025, lag=0.02), PolicyQueue()
    plans.add(0.0, Constant(u))  # type: ignore[arg-type]
    for k in range(100):
        controller.measure(PlanarMeasurement(0.0025 * k, np.zeros(driven), robot.home[-2:], steer=angles))
        command = controller.command(0.0025 * k, plans)
    # 0.25 s of the plan's rates, of which the drives still owe 20 ms, are missing
    np.testing.assert_allclose(command.steer, u[3:-2] * (1.0 + 10.0 * 0.23), rtol=0.05)
    spec = load_spec(robot.description)
    spec.body("chassis").add_freejoint(name="root")
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[2] = HEIGHT
    data.qvel[:6] = [u[0], u[1], 0.0, 0.0, 0.0, u[2]]
    for name, angle, rate in zip(names, angles, command.steer, strict=True):
        data.joint(name).qpos[0], data.joint(name).qvel[0] = angle, rate
    for name, rate in zip(robot.description.base.wheel_joints(), command.wheel, strict=True):
        data.joint(name).qvel[0] = rate
    mujoco.mj_forward(model, data)
    for wheel in robot.description.base.wheels:
        joint, velocity, jacobian = model.joint(wheel.joint), np.zeros(3), np.zeros((3, model.nv))
        along, body = np.cross(data.xaxis[joint.id], [0.0, 0.0, 1.0]), int(joint.bodyid[0])
        mujoco.mj_jac(model, data, jacobian, None, data.xpos[body] - [0.0, 0.0, RADIUS], body)
        velocity = jacobian @ data.qvel
        assert abs(along @ velocity) < 0.002, (wheel.joint, along @ velocity)


def test_a_plan_goes_on_from_where_steering_is_that_is_held(tmp_path: Path) -> None:
    """A wheel that does not turn although commands come: for 0.9 s the plan turns it by 1 rad/s. The state that plans begin with is 0.3 rad from
    the encoder's at most, the file's truth of the joint; without a limit it would be 0.9 rad."""
    robot = wb.load_robot(write(tmp_path, CASTERS))
    n = len(robot.state.groups["steer"])
    controller, plans = WheelsController(robot, np.zeros(3), 0.0025, lag=0.02), PolicyQueue()
    plans.add(0.0, Constant(np.array([0.1, 0.0, 0.0, *np.ones(n), 0.0, 0.0])))  # type: ignore[arg-type]
    held = np.full(n, 0.4)
    for k in range(360):
        controller.measure(PlanarMeasurement(0.0025 * k, np.zeros(n), robot.home[-2:], steer=held))
        controller.command(0.0025 * k, plans)
    off = controller.state()[robot.state["steer"]] - held
    assert np.abs(off).max() < 0.33 and off.min() > 0.2


@pytest.mark.parametrize(("kind", "base"), [("tricycle", {}), ("beside", {"casters": [[0.3, 0.0], [-0.3, 0.0]]})])
def test_it_drives_ahead_in_mujoco(kind: str, base: dict[str, Any], tmp_path: Path) -> None:
    robot = wb.load_robot(write(tmp_path, KINDS[kind], **base))
    plant = wb.base_type("wheels").plant(robot, AnyPerturbation.none(), 0)
    driven = len(robot.description.base.wheel_joints())
    command = PlanarCommand(np.full(driven, 0.3 / RADIUS), np.zeros(2), np.zeros(robot.base.steering))
    plant.step(command, round(1.0 / plant.timestep))
    truth = plant.truth()
    assert truth.pose[0] == pytest.approx(0.3, rel=0.1) and np.abs(truth.pose[1:]).max() < 0.02
    assert truth.wheel_force.min() > 10.0 and truth.tilt < 0.02
    assert plant.measure().wheel == pytest.approx(np.full(driven, 0.3 / RADIUS), rel=0.1)


@pytest.mark.parametrize(
    ("wheels", "options", "words"),
    [
        ([REAR[0], ((0.1, -0.25), 0, (0.0, 0.0), {})], {}, "share one axle"),
        ([FRONT, ((0.4, 0.0), 1, (0.0, 0.0), {})], {}, "do not determine the motion"),
        ([((0.1, 0.2), 0, (0.0, 0.0), {"rollers": 0.0}), ((0.1, -0.2), 0, (0.0, 0.0), {"rollers": 0.0})], {}, "rank 2, 3 is needed|do not determine"),
        ([((0.1, 0.2), 0, (0.0, 0.0), {"rollers": 80.0}), REAR[0]], {}, r"base\.wheels\.0\.rollers"),
        ([FRONT, *REAR], {"axis": "0.2 0"}, "'s0' must turn about a vertical axis"),
        ([FRONT, *REAR], {"wheel_radius": 0.1}, r"0\.1 m, but the shape of the wheel 'w0'"),
    ],
)  # fmt: skip
def test_faults_name_the_wheel(wheels: list[Wheel], options: dict[str, Any], words: str, tmp_path: Path) -> None:
    with pytest.raises(wb.InputError, match=words):
        wb.load_robot(write(tmp_path, wheels, **options))


# ---------------------------------------------------------------------- a base whose wheels are not described
def planar(folder: Path, drive: str, center: float = 0.2) -> Path:
    """A tricycle of which nobody knows how it steers."""
    path = write(folder, [FRONT, *REAR])
    data = yaml.safe_load(path.read_text())
    data["base"] = {"type": "planar", "body": "chassis", "drive": drive, "center": center, "height": HEIGHT}
    data["fixed_joints"] = dict.fromkeys(["s0", "w0", "w1", "w2"], 0.0)
    data["limits"]["velocity"] = {"pan": 2.0, "lift": 2.0}
    path.write_text(yaml.safe_dump(data))
    return path


def test_a_base_that_takes_speeds_turns_about_its_center(tmp_path: Path) -> None:
    """What is at the center stays there in a turn. Truth: the velocity of a frame in the middle of the body, by hand."""
    robot = wb.load_robot(planar(tmp_path, "skid"))
    assert robot.input.groups["base"] == ("v", "wz") and robot.base.body_height == HEIGHT
    np.testing.assert_allclose(robot.base.twist @ [0.0, 1.0], [0.0, -0.2, 1.0])
    assert wb.load_robot(planar(tmp_path, "omni")).input.groups["base"] == ("vx", "vy", "wz")
    with pytest.raises(wb.InputError, match=r"key 'base\.drive'"):
        wb.load_robot(planar(tmp_path, "hover"))


def test_skid_steering_is_warned_of(tmp_path: Path) -> None:
    robot, plugin = wb.load_robot(planar(tmp_path, "tracks")), wb.base_type("planar")
    (finding,) = plugin.diagnose(robot.description, robot.base)
    assert finding.severity == "warning" and "slip sideways" in finding.text
    assert not plugin.diagnose(wb.load_robot(planar(tmp_path, "omni")).description, robot.base)
    settings = PathTaskSettings.model_validate(
        {
            "robot": str(planar(tmp_path, "tracks")),
            "plant": "kinematic",
            "settle_time": 0,
            "path": {"kind": "line", "length": 0.2, "ramp": 0.3},
        }
    )
    assert EXPERIMENT.run(settings, 0, None).metrics["end_effector_error_mean"].value < 1e-3


@pytest.mark.parametrize(
    ("drive", "speeds"),
    [("omni", (0.3, -0.2, 0.4)), ("differential", (0.3, 0.5)), ("skid", (0.0, 0.5)), ("omni", (0.0, 3.0, 0.0))],
)
def test_a_simulated_base_that_takes_speeds(drive: str, speeds: tuple[float, ...], tmp_path: Path) -> None:
    """It moves as it is ordered, once the drives' lag and the start of the body's motion are over; skidding turns lose 5 %, which its
    own count does not see; and it comes to rest as fast as friction allows."""
    robot = wb.load_robot(planar(tmp_path, drive))
    plant = ideal_plant(robot)
    start, ordered = plant.truth().pose, np.array(speeds)
    plant.step(PlanarCommand(ordered, np.zeros(2)), round(1.0 / plant.timestep))
    lost = np.ones(len(ordered)) - (0.05 * np.eye(len(ordered))[-1] if drive == "skid" else 0.0)
    begun = plant.truth().pose
    plant.step(PlanarCommand(ordered, np.zeros(2)), round(0.5 / plant.timestep))
    moved = lie.se2_log(begun, plant.truth().pose) / 0.5
    np.testing.assert_allclose(moved, robot.base.twist @ (ordered * lost), atol=0.01)
    if speeds[1] == 3.0:
        assert plant.measure().wheel[1] == pytest.approx(np.linalg.norm((plant.truth().pose - start)[:2]), abs=2e-3)
    if drive == "skid":
        assert plant.measure().wheel[1] == pytest.approx((plant.truth().pose[2] - start[2]) / 0.95, rel=1e-3)
    fast = float(np.linalg.norm(plant.world.frames(height=0.0)["pose"][:2] - begun[:2])) / 0.5
    before = plant.truth().pose
    plant.step(PlanarCommand(np.zeros(len(ordered)), np.zeros(2)), round(1.5 / plant.timestep))
    way = float(np.linalg.norm(plant.truth().pose[:2] - before[:2]))
    assert way >= 0.95 * fast**2 / (2.0 * 0.8 * 9.81) and plant.truth().tilt < 0.03  # friction is 0.8
    resting = plant.truth().pose
    plant.step(PlanarCommand(np.zeros(len(ordered)), np.zeros(2)), 100)
    np.testing.assert_allclose(plant.truth().pose, resting, atol=1e-4)


def test_a_base_that_takes_speeds_is_controlled_in_mujoco(tmp_path: Path) -> None:
    path = {"kind": "line", "length": 0.3, "ramp": 0.3, "direction": 1.57}
    settings = PathTaskSettings.model_validate(
        {"robot": str(planar(tmp_path, "omni")), "settle_time": 0.2, "path": path}
    )
    m = EXPERIMENT.run(settings, 0, None).metrics
    assert m["end_effector_error_mean_world"].value < 4e-3 and m["base_path_length"].value > 0.1


def test_a_wheel_that_another_axis_steers_is_an_error(tmp_path: Path) -> None:
    file = write(tmp_path, CASTERS)
    data = yaml.safe_load(file.read_text())
    data["base"]["wheels"][0]["steer"], data["base"]["wheels"][1]["steer"] = "s1", "s0"
    file.write_text(yaml.safe_dump(data))
    with pytest.raises(wb.InputError, match=r"key 'base\.wheels': joint 's1' does not move 'w0'"):
        wb.load_robot(file)
