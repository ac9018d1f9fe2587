"""Legs and brakes from the bus. Truth: Table I's configurations, MuJoCo's legs and brakes, hand-written CDR of a service."""

from __future__ import annotations

import struct
import threading
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from needs import MISSING, needs_dds, private, wait_until

from wbmpc.bases.swerve.brake_control import BrakeControl
from wbmpc.bases.swerve.ros import SwerveRosAdapter
from wbmpc.bases.swerve.ros_leg_control import LegControl
from wbmpc.bases.swerve.ros_legs import Legs
from wbmpc.bases.swerve.ros_settings import SwerveRosSettings
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.ros2.bus import DEFAULT
from wbmpc.ros2.hold_ups import HoldUps
from wbmpc.ros2.network import Network
from wbmpc.ros2.publishers import rejections
from wbmpc.stability import configuration_positions
from wbmpc.types import Observation

pytestmark = needs_dds
if not MISSING:
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.idl import types as idl_types
    from cyclonedds.pub import DataWriter
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from simulated import Simulated

    from wbmpc.bases.swerve.ros_legs import SET_LEGS
    from wbmpc.ros2.cdr_types import message_class
    from wbmpc.ros2.messages import request, response, types

ROBOT = load_robot("swerve-ur10")
DOMAIN = 49
NETWORK = Network.of({**private(), "ROS_DOMAIN_ID": str(DOMAIN)})
LEGS = ROBOT.state.groups["leg"]


@pytest.fixture(scope="module")
def robot() -> Iterator[Any]:
    s = Simulated(ROBOT, NETWORK)
    s.ready()
    yield s
    s.close()


def angles(s: Any) -> np.ndarray:
    """The true ones [rad]."""
    joints = s.truth().joints
    return np.array([joints[n] for n in LEGS])


def ask(s: Any, values: dict[str, Any]) -> Any:
    """Call the service while the node goes on."""
    answers: list[Any] = []
    call = lambda: answers.append(s.other.call("/set_legs", SET_LEGS, values, 60.0))
    thread = threading.Thread(target=call)
    thread.start()
    assert s.until(lambda: answers)
    thread.join()
    return answers[0]


def closed(s: Any) -> bool:
    return bool(np.all(s.sim.plant.brakes.engaged == 1.0))


def test_single_legs_brakes_and_a_configuration_by_name(robot: Any) -> None:
    """By topic a leg, which arrives, and a brake; by service the configuration A, to which the legs are on their way."""
    s, home = robot, ROBOT.home[ROBOT.state["leg"]]
    s.send("/legs", "sensor_msgs/msg/JointState", {"name": ["leg_RF"], "position": [-0.65]})
    assert s.until(lambda: s.sim.plant.brakes.engaged[1] == 0.0), s.control.state
    assert np.array_equal(s.sim.plant.brakes.engaged[[0, 2, 3]], [1.0, 1.0, 1.0])
    target = np.where(np.array(LEGS) == "leg_RF", -0.65, home)
    assert s.until(lambda: np.abs(angles(s) - target).max() < 0.02 and closed(s)), (angles(s), s.control.state)
    s.send("/brakes", "std_msgs/msg/Float64MultiArray", {"data": [0.0, 0.0, 1.0, 0.0]})
    assert s.until(lambda: s.sim.plant.brakes.engaged[2] == 0.0)
    np.testing.assert_array_equal(s.sim.plant.brakes.engaged, [1.0, 1.0, 0.0, 1.0])
    s.send("/brakes", "std_msgs/msg/Float64MultiArray", {"data": [0.0] * 4})
    assert s.until(lambda: closed(s))
    answer = ask(s, {"configuration": "A"})
    assert answer.success and answer.message.startswith("leg_LF to -0.498 rad, leg_RF to 0.498")
    assert s.until(
        lambda: np.array_equal(s.control.base_commands.commands.angles, configuration_positions(ROBOT, "A"))
    ), s.control.base_commands.commands.angles
    previous, way = angles(s), configuration_positions(ROBOT, "A") - angles(s)
    assert s.until(lambda: np.all((angles(s) - previous) * np.sign(way) > 0.02)), angles(s)


def test_legs_that_hold_nothing_are_not_let_go(robot: Any, caplog: pytest.LogCaptureFixture) -> None:
    """All brakes open in H: nothing would hold the base sideways. In X they may, and in H on the way to other angles."""
    legs, free, nowhere = robot.control.base_commands.commands, np.ones(4), np.full(4, np.nan)
    legs.stop()
    brakes = BrakeControl(ROBOT)
    legs._put(nowhere, free)
    assert not legs.apply(brakes, 1.0, np.zeros(4)) and not brakes.commanded(2.0).any()
    assert "a command for the legs is rejected: brakes: with these legs" in caplog.text
    legs._put(configuration_positions(ROBOT, "X"), free)
    assert legs.apply(brakes, 1.0, np.zeros(4)) and brakes.commanded(2.0).all()
    legs.stop()


def test_a_leg_on_its_way_stays_on_it_where_an_order_is_rejected(robot: Any) -> None:
    """Else its brake would remain open for good: nobody watches whether it arrives, or comes no nearer."""
    legs, brakes, at = robot.control.base_commands.commands, BrakeControl(ROBOT), np.zeros(4)
    legs.stop()
    legs._put(np.array([0.3, np.nan, np.nan, np.nan]), np.full(4, np.nan))
    assert legs.apply(brakes, 1.0, at)
    legs._command = np.full(4, np.nan), np.array([0.0, 1.0, 1.0, 1.0])  # legs have moved since it was taken
    brakes.set = lambda *given: (_ for _ in ()).throw(InputError("brakes: no"))  # type: ignore[method-assign]
    assert not legs.apply(brakes, 2.0, at)
    del brakes.set
    assert legs.angles[0] == 0.3 and legs.watch(brakes, 3.0, np.array([0.3, 0.0, 0.0, 0.0]))
    assert not brakes.commanded(4.0).any()
    legs.stop()


def test_a_leg_that_arrives_while_a_goal_is_planned_is_braked() -> None:
    """Its plan goes 0.08 rad farther, where it would end. By hand: legs that arrive, a plan that takes long. An order of that time waits; what the
    plan knows of the legs is of before."""
    bus = SimpleNamespace(subscribe=lambda *given, **keys: None, serve=lambda *given, **keys: None)
    brakes, home, followed = BrakeControl(ROBOT), ROBOT.home.copy(), list[Any]()
    adapter = SimpleNamespace(
        robot=ROBOT, settings=SwerveRosSettings(), brakes=brakes, legs=None, snapshot=lambda: (0.0, home),
        swing=lambda legs: None, references=lambda task, x: adapter.legs.copy(),
    )  # fmt: skip
    control = SimpleNamespace(
        node=bus, hold_ups=HoldUps(), request_queue=SimpleNamespace(running=None),
        clock=SimpleNamespace(now=lambda: now), running=True, stopping=False, active_task="",
        planning=SimpleNamespace(busy=False), set_task=lambda task, legs: followed.append(legs),
    )  # fmt: skip
    legs, now, at = LegControl(control, adapter), 1.0, home[ROBOT.state["leg"]]  # type: ignore[arg-type]
    target, order = at + [0.3, 0.0, 0.0, 0.0], np.full(4, np.nan)
    legs.commands._put(np.where(target == at, order, target), order)
    legs.update()
    assert brakes.commanded(2.0)[0] == 1.0 and followed.pop()[0] > target[0] + 0.07
    control.planning.busy, now = True, 2.0
    home[ROBOT.state["leg"]] = target
    legs.commands._put(np.where(target == at, order, target + 0.2), order)
    legs.update()
    assert brakes.commanded(3.0)[0] == 0.0 and followed.pop()[0] == target[0] and legs.commands.waiting
    legs.commands.drop()
    control.planning.busy, now = False, 3.0
    for _ in range(2):
        legs.update()
    assert [legs[0] for legs in followed] == [target[0]]


def test_a_leg_that_stops_short_ends_with_its_brake_closed(robot: Any) -> None:
    """0.768 of 0.785 rad, and 2 mrad more after 3 s: waited for 4 s from then on. The other leg goes on, slowly."""
    legs, brakes = robot.control.base_commands.commands, BrakeControl(ROBOT)
    legs.stop()
    legs._put(np.array([0.785, 0.4, np.nan, np.nan]), np.full(4, np.nan))
    at = lambda t: np.array([0.768 + 0.003 * (t >= 3.0), 0.02 * t, 0.0, 0.0])
    assert legs.apply(brakes, 0.0, at(0.0))
    times = np.arange(0.05, 8.0, 0.05)
    assert legs.aims[0] > 0.785 and legs.aims[1] > 0.4
    ended = [t for t in times if legs.watch(brakes, t, at(t))]
    assert len(ended) == 1 and ended[0] == pytest.approx(7.05, abs=0.051)
    np.testing.assert_array_equal(brakes.commanded(8.0), [0.0, 1.0, 0.0, 0.0])
    np.testing.assert_array_equal(legs.moving, [False, True, False, False])
    assert legs.angles[0] == 0.771 and legs.angles[1] == 0.4
    assert legs.aims[0] == legs.angles[0]
    says = "leg_LF stopped at 0.771 rad on its way to 0.785 rad: no nearer for 4 s, brakes closed"
    assert rejections(robot.control)["legs stopped short"] == says
    robot.said.clear()
    reported = lambda: [
        v.value for m in robot.said for s in m.status for v in s.values if v.key == "legs stopped short"
    ]
    assert robot.until(lambda: says in reported())
    legs._put(np.array([0.8, np.nan, np.nan, np.nan]), np.full(4, np.nan))
    legs.apply(brakes, 8.0, at(8.0))
    assert not legs.short
    legs.stop()


@pytest.mark.parametrize("again", [0.785, np.nan])
def test_orders_that_change_nothing_for_a_leg_do_not_keep_its_brake_open(robot: Any, again: float) -> None:
    """The same order, or another leg's, twice a second: the 4 s without a way are over all the same. A new angle restarts."""
    legs, brakes, at = robot.control.base_commands.commands, BrakeControl(ROBOT), np.array([0.768, 0.0, 0.0, 0.0])
    legs.stop()
    legs._put(np.array([0.785, np.nan, np.nan, np.nan]), np.full(4, np.nan))
    assert legs.apply(brakes, 0.0, at) and not legs.watch(brakes, 0.0, at)
    for k in range(1, 8):
        legs._put(np.array([again, 0.4 + 0.01 * k, np.nan, np.nan]), np.full(4, np.nan))
        assert legs.apply(brakes, 0.5 * k, at) and not legs.watch(brakes, 0.5 * k, at)
    assert legs.watch(brakes, 4.05, at) and legs.short.startswith("leg_LF stopped at 0.768 rad")
    np.testing.assert_array_equal(legs.moving, [False, True, False, False])
    legs._put(np.array([0.9, np.nan, np.nan, np.nan]), np.full(4, np.nan))
    assert legs.apply(brakes, 4.1, at) and not legs.watch(brakes, 4.1, at)
    legs._put(np.array([0.6, np.nan, np.nan, np.nan]), np.full(4, np.nan))
    assert legs.apply(brakes, 7.0, at) and not legs.watch(brakes, 7.0, at)
    assert not legs.watch(brakes, 10.9, at) or legs.moving[0]
    legs.stop()


def test_legs_with_little_left_to_go_arrive() -> None:
    """Wheels point ahead, legs are 0.05 rad from X: with drives that do exactly what is planned. A plan to the angles themselves
    leaves two legs 0.017 rad away for good."""
    adapter = SwerveRosAdapter(ROBOT, SwerveRosSettings(), 1.0 / 400.0)
    node: Any = SimpleNamespace(subscribe=lambda *given, **also: None, serve=lambda *given, **also: None)
    legs = Legs(node, ROBOT, adapter.settings, lambda: "", lambda: None)
    x, goal, part = ROBOT.home.copy(), configuration_positions(ROBOT, "X"), ROBOT.state["leg"]
    x[part] = goal - 0.05 * np.sign(goal)
    adapter.begin(x)
    task, t = adapter.planner.hold(x, 0.0), 0.0
    legs._put(goal, np.full(4, np.nan))
    assert adapter.brakes is not None and legs.apply(adapter.brakes, t, x[part])
    adapter.swing(goal)
    while legs.moving.any() and t < 4.0:
        adapter.legs = legs.aims
        adapter.follow(adapter.references(task, x))
        policy = adapter.mpc.update(Observation(t, x))
        t += adapter.mpc.period
        x = policy.state(t)
        legs.watch(adapter.brakes, t, x[part])
    assert not legs.moving.any() and not legs.short
    np.testing.assert_allclose(x[part], goal, rtol=0.0, atol=0.011)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"configuration": "Y"}, "unknown configuration 'Y'"),
        ({"leg": ["leg_LF"], "angle": [9.0]}, "leg_LF at 9 rad is outside its limits"),
        ({"leg": ["hip"], "angle": [0.0]}, "unknown leg 'hip'"),
        ({"leg": ["leg_LF"], "angle": [0.0, 1.0]}, "as many angles or brakes"),
        ({}, "a configuration, or different legs"),
        ({"configuration": "X", "leg": ["leg_LF"]}, "not both"),
    ],
)
def test_a_bad_command_is_answered_with_a_message(robot: Any, values: dict[str, Any], says: str) -> None:
    answer = ask(robot, values)
    assert not answer.success and says in answer.message


def test_an_command_that_would_leave_the_base_without_hold_is_answered_so(
    robot: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Legs parallel (H) and all brakes open: the answer is no, not a yes and a line in the log."""
    legs = robot.control.base_commands.commands
    monkeypatch.setattr(legs, "_now", lambda: (np.zeros(4), np.zeros(4)))
    legs.stop()
    answer = ask(robot, {"leg": list(LEGS), "brake_open": [True] * 4})
    assert not answer.success and "nothing would hold the base against sideways" in answer.message
    answer = ask(robot, {"leg": list(LEGS), "angle": [0.6] * 4})  # all parallel on the whole way
    assert (
        not answer.success
        and "nothing would hold the base against" in answer.message
        and "on the way" in answer.message
    )
    robot.said.clear()
    reported = lambda: [s.message for m in robot.said for s in m.status]
    assert robot.until(lambda: any("nothing would hold the base" in text for text in reported()))
    assert ask(robot, {"leg": list(LEGS), "brake_open": [False] * 4}).success


def test_a_bad_topic_is_reported(robot: Any, caplog: pytest.LogCaptureFixture) -> None:
    robot.send("/leg_configuration", "std_msgs/msg/String", {"data": "Z"})
    assert robot.until(lambda: "unknown configuration 'Z'" in robot.control.base_commands.commands.rejected)
    robot.send("/brakes", "std_msgs/msg/Float64MultiArray", {"data": [2.0]})
    assert robot.until(lambda: "4 numbers, 0 (closed) or 1 (open)" in robot.control.base_commands.commands.rejected)
    assert caplog.text.count("unknown configuration 'Z'") == 1
    robot.said.clear()
    reported = lambda: [v.value for m in robot.said for s in m.status for v in s.values if "legs" in v.key]
    assert robot.until(lambda: any("4 numbers" in text for text in reported()))


def test_a_flood_of_bad_orders_is_a_few_lines(robot: Any, caplog: pytest.LogCaptureFixture) -> None:
    """Each with another name, so that none is a repetition."""
    for k in range(200):
        robot.control.base_commands.commands._from_topic(
            "/flood", lambda m: robot.control.base_commands.commands._target("", [m], (), ()), f"leg{k}"
        )
    assert "unknown leg 'leg199'" in robot.control.base_commands.commands.rejected
    assert 1 <= sum("/flood: " in r.getMessage() for r in caplog.records) <= 5


def test_the_services_bytes_are_those_of_rmw_cyclonedds(robot: Any) -> None:
    """A client of another make: header of 16 bytes (client, number) before the request; the answer begins with the same."""
    s, t = robot, types("jazzy")
    listening = DomainParticipant(DOMAIN)
    head: dict[str, Any] = {"client": idl_types.uint64, "number": idl_types.int64}
    kinds = {side: message_class(t, side(SET_LEGS), head) for side in (request, response)}
    asks = Topic(listening, "rq/set_legsRequest", kinds[request])
    answers = Topic(listening, "rr/set_legsReply", kinds[response])
    assert kinds[request].__idl_typename__ == "wbmpc_msgs.srv.dds_.SetLegs_Request_"  # type: ignore[attr-defined]
    qos = s.other._qos(DEFAULT, request(SET_LEGS))
    writer, reader = DataWriter(listening, asks, qos=qos), DataReader(listening, answers, qos=qos)
    assert wait_until(lambda: writer.get_matched_subscriptions() and reader.get_matched_publications())
    body = (
        struct.pack("<Qq", 0x1122334455667788, 7)
        + struct.pack("<I", 2)
        + b"Q\0"
        + b"\0\0"
        + struct.pack("<III", 0, 0, 0)
    )
    writer.write(kinds[request](b"\x00\x01\x00\x00" + body))
    got: list[bytes] = []
    assert wait_until(lambda: got.extend(x.data for x in reader.take(N=9)) or got)
    assert got[0][4:20] == struct.pack("<Qq", 0x1122334455667788, 7) and got[0][20] == 0  # not done: there is no Q
    length = struct.unpack_from("<I", got[0], 24)[0]
    assert b"unknown configuration 'Q'" in got[0][28 : 28 + length]


@pytest.mark.parametrize(
    ("topic", "kind", "message"),
    [
        ("/legs", "sensor_msgs/msg/JointState", {"name": ["leg_LF"], "position": [np.nan]}),
        ("/leg_configuration", "std_msgs/msg/String", {"data": "nan,nan,nan,nan"}),
    ],
)
def test_an_angle_that_is_no_number_starts_nobody(
    pair: Callable[..., Any], topic: str, kind: str, message: dict[str, Any]
) -> None:
    p = pair()
    p.ready()
    p.send(topic, kind, message)
    assert p.until(lambda: "finite" in p.control.base_commands.commands.rejected), (
        p.control.base_commands.commands.rejected
    )
    p.run(0.05)
    assert p.control.runner is None
