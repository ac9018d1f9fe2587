"""What the controller's node publishes and takes beside goals. Truth: MuJoCo's robot, its wheel loads, the stability library."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from needs import MISSING, needs_dds, private

from effort import thorough
from wbmpc import lie
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.ros2.bus import LATCHED
from wbmpc.ros2.network import Network
from wbmpc.ros2.opening import open_node
from wbmpc.runtime.clock import WallClock
from wbmpc.stability import assess

pytestmark = needs_dds
if not MISSING:
    from simulated import Simulated

    from wbmpc.bases.swerve.ros_settings import SwerveRosSettings
    from wbmpc.ros2.convert import seconds
    from wbmpc.ros2.inertial_readings import InertialReadings
    from wbmpc.ros2.joints import Inertial
    from wbmpc.ros2.publishers import LINE_STRIP, SPHERE
    from wbmpc.ros2.settings import settings_of
    from wbmpc.ros2.sim import SimNode

ROBOT, BALL = load_robot("swerve-ur10"), load_robot("rezero")
NETWORK = Network.of({**private(), "ROS_DOMAIN_ID": "50"})
ARM = ROBOT.input.groups["arm"]


@pytest.fixture
def watcher() -> Iterator[Any]:
    """A node that hears both sides: none hears what it publishes itself."""
    node = open_node("watcher", "dds", NETWORK)
    yield node
    node.close()


@pytest.fixture
def made() -> Iterator[Callable[..., Any]]:
    opened: list[Any] = []

    def make(robot: Any = ROBOT, **settings: Any) -> Any:
        opened.append(Simulated(robot, NETWORK, **settings))
        return opened[-1]

    yield make
    for s in opened:
        s.close()


@pytest.mark.wallclock
def test_stamps_of_real_time_are_the_physics_whenever_messages_go_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whole periods between stamps, though the process sleeps now and then; what is later than 120 ms is let go, once."""
    node = open_node("robot", "dds", NETWORK)
    with pytest.raises(InputError, match=r"factor: .*simulated time"):
        SimNode(node, ROBOT, SwerveRosSettings(), factor=2.0)
    sim = SimNode(node, ROBOT, SwerveRosSettings())
    stamps: list[float] = []

    def publish(message: Any) -> None:
        stamps.append(seconds(SimpleNamespace(**message["header"]["stamp"])))
        time.sleep({20: 0.01, 40: 0.1, 60: 0.2}.get(len(stamps), 0.0))

    monkeypatch.setattr(sim, "_joints", SimpleNamespace(publish=publish))
    begin = time.time()
    sim.spin(lambda: len(stamps) >= 100)
    gaps = np.diff(stamps)
    let_go = gaps > 0.004
    np.testing.assert_allclose(gaps[~let_go], 0.0025, atol=1e-6)
    assert sim.behind == let_go.sum() >= 1 and gaps[58:61].max() > 0.1
    assert abs(stamps[0] - begin) < 0.1 and abs(stamps[-1] - time.time()) < 0.1
    node.close()


@pytest.mark.parametrize("slow", [1.2, 4.0])
def test_time_that_is_left_out_is_a_gap_for_who_integrates_the_gyro(
    slow: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A machine on which a period of physics takes ``slow`` periods. Truth: the base turns evenly over the periods that are simulated;
    what the gyro says between stamps adds up to that at most."""
    node = open_node("robot", "dds", NETWORK)
    sim = SimNode(node, ROBOT, SwerveRosSettings())
    wall = [1e3]
    clock = lambda: wall[0]
    sleep = lambda seconds: wall.__setitem__(0, wall[0] + seconds)
    monkeypatch.setattr(
        "wbmpc.ros2.sim.time", SimpleNamespace(perf_counter=clock, monotonic=clock, time=clock, sleep=sleep)
    )
    monkeypatch.setattr(sim, "_advance", lambda: sleep(slow * sim.period) or sim.plant.step(sim._command(), sim.steps))
    stamps: list[float] = []
    publish = lambda message: stamps.append(seconds(SimpleNamespace(**message["header"]["stamp"])))
    monkeypatch.setattr(sim, "_imu", SimpleNamespace(publish=publish))
    sim.spin(lambda: len(stamps) >= 800)
    node.close()
    readings, rate, turned, counted = InertialReadings(WallClock(), 0.1), 0.5, 0.0, 0
    for before, stamp in pairwise(stamps):
        readings.put(stamp, Inertial(np.array([0.0, 0.0, rate]), np.zeros(3)))
        read = readings.averaged(stamp)
        assert read is not None
        if read.turning is not None:
            turned, counted = turned + read.turning[2] * (stamp - before), counted + 1
    assert sim.behind >= 3 and counted > 700
    assert turned == pytest.approx(counted * sim.period * rate, rel=1e-3)


@pytest.mark.parametrize("robot", [ROBOT, BALL], ids=["swerve", "ball"])
def test_the_true_odometrys_twist_is_the_derivative_of_its_pose(robot: Any) -> None:
    """Of a swerve base that drives and of a ball robot that falls: differences of what the same messages say."""
    node = open_node("robot", "dds", NETWORK)
    sim = SimNode(node, robot, settings_of(robot)(), 3)
    reported: list[Any] = []
    sim._odom = SimpleNamespace(publish=reported.append)  # type: ignore[assignment]
    groups = sim.side.rest()
    groups["wheel"][:] = [-8.0, 8.0, -8.0, 8.0] if robot is ROBOT else [0.5, -0.25, -0.3]
    for _ in range(60):
        sim.plant.step(sim.side.command(groups), sim.steps)
        sim._publish_truth(sim.now())
    node.close()
    array = lambda v, names: np.array([v[n] for n in names])
    rotation = lambda m: lie.quaternion_to_rotation(array(m["pose"]["pose"]["orientation"], lie.PARTS))
    place = lambda m: array(m["pose"]["pose"]["position"], "xyz")
    previous, now, after = reported[-3:]
    turned = rotation(previous).T @ rotation(after)
    rate = np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]) / 2.0
    h, twist = 2.0 * sim.period, now["twist"]["twist"]
    speed = (place(after) - place(previous)) / h
    # what is reported of the height is that of a flat floor: not its derivative
    np.testing.assert_allclose((rotation(now) @ array(twist["linear"], "xyz"))[:2], speed[:2], atol=0.01)
    np.testing.assert_allclose(array(twist["angular"], "xyz")[2], rate[2] / h, atol=0.02)
    assert np.abs(speed).max() > 0.02


def test_the_arm_by_trajectories_and_what_is_reported(made: Callable[..., Any], watcher: Any) -> None:
    """The end effector reaches its goal over a joint_trajectory_controller; footprint, odometry, description and sensors' frames."""
    controllers = {g: {"topic": f"/{g}/commands", "joints": ROBOT.input.groups[g]} for g in ("wheel", "steer")} | {
        "arm": {"topic": "/arm/joint_trajectory", "joints": ARM, "takes": "trajectory"}
    }
    s = made(controllers=controllers, rates={"plan": 20.0})
    got: dict[str, Any] = {}
    kinds = {
        "/footprint": "visualization_msgs/msg/MarkerArray", "/odom": "nav_msgs/msg/Odometry",
        "/contact/wheel_LF": "geometry_msgs/msg/WrenchStamped", "/arm/joint_trajectory": "trajectory_msgs/msg/JointTrajectory",
    }  # fmt: skip
    for topic, kind in kinds.items():
        watcher.subscribe(topic, kind, lambda m, t=topic: got.__setitem__(t, m))
    for topic, kind in {"/robot_description": "std_msgs/msg/String", "/tf_static": "tf2_msgs/msg/TFMessage"}.items():
        watcher.subscribe(topic, kind, lambda m, t=topic: got.__setitem__(t, m), LATCHED)
    s.ready()
    goal = ROBOT.pose(ROBOT.home)[0] + [0.1, 0.0, 0.05]
    s.end_effector(dx=0.1, dz=0.05)
    away = lambda: float(np.linalg.norm(s.truth().tool - goal))
    assert s.until(lambda: s.control.running and away() < 0.01), (away(), s.control.state)
    assert list(got["/arm/joint_trajectory"].joint_names) == list(ARM)
    times = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in got["/arm/joint_trajectory"].points]
    assert times[0] > 0.0 and times[-2] < 0.5 and np.all(np.diff(times) > 0.0)
    assert not np.any(got["/arm/joint_trajectory"].points[-1].velocities)
    # how it stands: corners and zero-moment point of the stability library at home; loads of MuJoCo's wheels
    markers = {(m.ns, m.id): m for m in got["/footprint"].markers}
    support, zmp = markers["support", 0], markers["zmp", 0]
    assert (support.type, zmp.type, zmp.color.g > zmp.color.r) == (LINE_STRIP, SPHERE, True)
    corners = np.array([[p.x, p.y] for p in support.points])
    stance, base = assess(ROBOT, "X").stance, s.truth().pose
    assert all(np.linalg.norm(corners - base[:2] - foot, axis=1).min() < 0.05 for foot in stance.feet)
    at = np.array([zmp.pose.position.x, zmp.pose.position.y])
    assert np.linalg.norm(at - base[:2] - stance.zmp) < 0.1  # the arm has moved by 0.1 m
    assert ("predicted", 4) in markers
    loads = got["/contact/wheel_LF"].wrench.force
    assert 0.1 < loads.z / (9.81 * stance.mass) < 0.5
    assert got["/robot_description"].data.startswith('<?xml version="1.0"?>\n<robot name="swerve-ur10"')
    assert got["/tf_static"].transforms[0].child_frame_id == "imu"
    covariance = np.array(got["/odom"].pose.covariance).reshape(6, 6)
    planar = covariance[np.ix_([0, 1, 5], [0, 1, 5])]
    assert np.linalg.eigvalsh(planar).min() >= 0.0 and 0.0 < np.sqrt(planar[0, 0]) < 0.05
    assert covariance[2, 2] == covariance[3, 3] == 1e6


@thorough
def test_a_wrench_that_is_announced_moves_the_hand_less(made: Callable[..., Any]) -> None:
    """6 N at the tool, without the disturbance observer: with the reference the plan counts with the world's answer."""
    moved = []
    for announced in (False, True):
        s = made(BALL, estimate_disturbance=False, topics={"wrench": f"/wrench_{announced}"})
        s.ready()
        s.end_effector()
        assert s.until(lambda s=s: s.control.state.startswith("running:"))
        s.run(0.5)
        start = s.truth().tool.copy()
        wrench = {"header": {"frame_id": "odom"}, "wrench": {"force": {"z": 6.0}}}
        publisher = s.other.publisher(f"/wrench_{announced}", "geometry_msgs/msg/WrenchStamped")
        assert s.until(lambda p=publisher: p._writer.get_matched_subscriptions())
        with s._physics:
            s.sim.plant.push([0.0, 0.0, -6.0], body="arm_forearm_link", point=[0.0, 0.0, 0.30])
        sag = 0.0
        for _ in range(10):
            if announced:
                publisher.publish(wrench)
            s.run(0.1)
            sag = max(sag, float(abs(s.truth().tool[2] - start[2])))
        moved.append(sag)
        assert not s.why
        s.close()
    assert moved[1] < 0.5 * moved[0], moved


def test_a_wrench_in_a_wrong_frame_or_without_numbers_is_rejected(made: Callable[..., Any]) -> None:
    s = made(BALL)
    for head, wrench, says in (
        ("hand", {}, "the wrench is in the frame 'hand'; valid: odom"),
        ("odom", {"torque": {"x": float("nan")}}, "not finite"),
        ("odom", {"force": {"x": float("inf")}}, "not finite"),
        ("odom", {"force": {"x": 20.0}}, "a force of 20 N is too much; valid: 0 to 10 (key 'wrench.force')"),
        ("odom", {"torque": {"z": -3.0}}, "a moment of 3 N m is too much; valid: 0 to 2 (key 'wrench.moment')"),
    ):
        s.send("/wrench", "geometry_msgs/msg/WrenchStamped", {"header": {"frame_id": head}, "wrench": wrench})
        assert s.until(lambda t=says: t in s.control.request_queue.rejected), s.control.request_queue.rejected
