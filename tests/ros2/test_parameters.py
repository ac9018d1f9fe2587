"""Parameters and log lines on the bus. Truth: the definitions of rcl_interfaces, the problem rebuilt with other weights."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from needs import MISSING, needs_dds, wait_until

from wbmpc.bases.swerve.defaults import SwerveCost, swerve_problem
from wbmpc.errors import InputError
from wbmpc.ros2.bus import Qos
from wbmpc.ros2.parameters import Parameter, Parameters

pytestmark = needs_dds
if not MISSING:
    from standin import NETWORK, ROBOT, Pair, drive

    from wbmpc.bases.swerve.ros_settings import SwerveRosSettings
    from wbmpc.ros2.control import ControlNode
    from wbmpc.ros2.opening import open_node
    from wbmpc.ros2.settings import RosSettings
    from wbmpc.ros2.tuning import Tuning


HAND = "cost.end_effector.weight"


def ask(p: Pair, service: str, kind: str, **values: Any) -> Any:
    """An answer of the controller's node, which gives it in its own thread: this one."""
    answers: list[Any] = []
    given = f"/wbmpc/{service}", f"rcl_interfaces/srv/{kind}", values
    asks = threading.Thread(target=lambda: answers.append(p.standin.node.call(*given, timeout=30.0)), daemon=True)
    asks.start()
    assert wait_until(lambda: p.control.step() or not asks.is_alive())
    return answers[0]


def number(name: str, value: float) -> dict[str, Any]:
    """A Parameter message."""
    return {"name": name, "value": {"type": 3, "double_value": value}}


def test_the_node_lists_gets_and_describes_its_parameters(pair: Callable[..., Any]) -> None:
    p = pair(rates={"odom": 30.0})
    names = ["rates.odom", "frames.base", "use_sim_time", HAND, "no.such"]
    values = ask(p, "get_parameters", "GetParameters", names=names).values
    assert [v.type for v in values] == [3, 4, 1, 3, 0]
    assert (values[0].double_value, values[1].string_value, values[2].bool_value) == (30.0, "base_link", True)
    assert list(ask(p, "get_parameter_types", "GetParameterTypes", names=names).types) == [3, 4, 1, 3, 0]
    listed = ask(p, "list_parameters", "ListParameters", prefixes=["rates", "cost"], depth=1).result
    assert "rates.control" in listed.names and "cost.terminal" in listed.names
    assert HAND not in listed.names and "frames.base" not in listed.names  # two parts below; not below at all
    assert HAND in ask(p, "list_parameters", "ListParameters").result.names
    rate, weight = ask(p, "describe_parameters", "DescribeParameters", names=["rates.odom", HAND]).descriptors
    assert (rate.read_only, weight.read_only) == (True, False)
    assert (weight.floating_point_range[0].from_value, len(rate.floating_point_range)) == (0.0, 0)


def test_a_weight_is_in_force_from_the_next_solve_on_and_is_reported(pair: Callable[..., Any]) -> None:
    p = pair()
    reported: list[Any] = []
    kind = "rcl_interfaces/msg/ParameterEvent"
    p.standin.node.subscribe("/parameter_events", kind, reported.append, Qos(depth=100))
    drive(p)
    solver = p.control.adapter.mpc.solver
    previous = solver.constants.copy()
    results = ask(
        p, "set_parameters", "SetParameters", parameters=[number(HAND, 500.0), number("cost.state.yaw", 7.0)]
    ).results
    assert [(r.successful, r.reason) for r in results] == [(True, ""), (True, "")]
    assert p.until(lambda: np.any(solver.constants != previous))
    target = SwerveCost()
    target = target.model_copy(
        update={
            "end_effector": target.end_effector.model_copy(update={"weight": 500.0}),
            "state": target.state.model_copy(update={"yaw": 7.0}),
        }
    )
    fresh = swerve_problem(ROBOT, p.settings.mpc, target, accelerations=True)
    for cost in fresh.costs:
        for place, weight in (("path", cost.weight), ("terminal", cost.terminal_weight)):
            if f"{place}.{cost.name}" in solver.problem.constant.slices:
                assert weight is not None
                part = solver.constants[solver.problem.constant.slices[f"{place}.{cost.name}"]]
                np.testing.assert_allclose(part, cost.expand(weight), rtol=1e-15)
    assert ask(p, "get_parameters", "GetParameters", names=[HAND]).values[0].double_value == 500.0
    assert wait_until(
        lambda: any(c.name == HAND and c.value.double_value == 500.0 for m in reported for c in m.changed_parameters)
    )
    assert p.control.running


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (number("rates.odom", 10.0), "read-only"),
        (number("cost.end_effector.wait", 10.0), "did you mean 'cost.end_effector.weight'"),
        (number(HAND, -1.0), "valid: 0 to"),
        (
            number(HAND, 1e9),
            f"valid: 0 to {1e3 * SwerveCost().end_effector.weight:g}",
        ),  # far from the file's: a ball robot fell
        (number(HAND, np.nan), "a finite number is needed"),
        ({"name": HAND, "value": {"type": 4, "string_value": "much"}}, "float is needed, got str"),
        (
            {"name": HAND, "value": {"type": 8, "double_array_value": [1.0, 2.0]}},
            "float is needed, got an array of doubles",
        ),
        ({"name": HAND, "value": {"type": 9, "string_array_value": ["1"]}}, "float is needed, got an array of strings"),
        ({"name": HAND, "value": {"type": 77}}, "float is needed, got the unknown type 77"),
        ({"name": HAND, "value": {"type": 0}}, "float is needed, got nothing (a parameter cannot be deleted)"),
        ({"name": HAND, "value": {"type": 8, "double_array_value": [1.0]}}, "float is needed"),
    ],
)
def test_what_cannot_be_set_says_why_and_of_an_atomic_request_nothing_is(
    pair: Callable[..., Any], given: dict[str, Any], says: str
) -> None:
    p = pair()
    good = number("cost.state.yaw", 9.0)
    result = ask(p, "set_parameters_atomically", "SetParametersAtomically", parameters=[good, given]).result
    assert not result.successful and says in result.reason
    assert ask(p, "get_parameters", "GetParameters", names=["cost.state.yaw"]).values[0].double_value == 5.0
    first, second = ask(p, "set_parameters", "SetParameters", parameters=[good, given]).results
    assert first.successful and says in second.reason


def test_requests_for_more_than_a_node_has_are_answered(
    pair: Callable[..., Any], caplog: pytest.LogCaptureFixture
) -> None:
    """Too many names, too many bytes: no values, or a reason where rcl_interfaces has a field for it. Nothing is set."""
    p = pair()
    for text, count, says in (
        ("x", 1000, "a request for 1000 parameters at once"),
        ("x" * 1_200_000, 1, "bytes is too large; valid: at most 65536"),
    ):
        assert not ask(p, "get_parameters", "GetParameters", names=[text] * count).values
        assert says in caplog.text
        wanted = [number(text, 1.0)] * count
        (only,) = ask(p, "set_parameters", "SetParameters", parameters=wanted).results
        result = ask(p, "set_parameters_atomically", "SetParametersAtomically", parameters=wanted).result
        assert not only.successful and not result.successful
        assert says in only.reason and says in result.reason
    assert len(ask(p, "get_parameters", "GetParameters", names=[HAND] * 100).values) == 100


def test_setting_a_weight_costs_the_bus_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """However many are set: the problem is rebuilt once, in the node's own thread, with what was set last."""
    made: list[Any] = []
    adapter = SimpleNamespace(
        robot=ROBOT, problem=lambda cost: made.append(cost) or SimpleNamespace(costs=[]),
        pending=SimpleNamespace(reweigh=lambda weights: None),
    )  # fmt: skip
    tuning = Tuning(adapter, SwerveRosSettings())  # type: ignore[arg-type]
    for k in range(100):
        tuning.parameters.set({HAND: float(k)})
    assert not made
    tuning.update()
    tuning.update()
    assert [cost.end_effector.weight for cost in made] == [99.0]


def test_a_change_that_is_not_taken_leaves_the_old_value() -> None:
    def change(values: dict[str, Any]) -> None:
        raise InputError("not now")

    parameters = Parameters([Parameter("a", 1.0, read_only=False)], change)
    with pytest.raises(InputError, match="not now"):
        parameters.set({"a": 2})
    assert parameters.known["a"].value == 1.0


def rosout_handlers() -> set[logging.Handler]:
    return {h for h in logging.getLogger("wbmpc").handlers if type(h).__name__ == "Rosout"}


def test_log_lines_are_on_rosout_for_late_joiners_too(pair: Callable[..., Any]) -> None:
    others = rosout_handlers()  # of nodes that other fixtures of this process keep
    p = pair()
    assert len(rosout_handlers() - others) == 1
    p.ready()  # there is a time
    logging.getLogger("wbmpc").warning("%s is near", "the wall")
    p.run(0.1)
    lines: list[Any] = []
    p.standin.node.subscribe("/rosout", "rcl_interfaces/msg/Log", lines.append, Qos(latched=True, depth=100))
    assert wait_until(lambda: any(m.msg == "the wall is near" for m in lines))
    (line,) = [m for m in lines if m.msg == "the wall is near"]
    assert (line.level, line.name, line.function) == (30, "wbmpc", "test_log_lines_are_on_rosout_for_late_joiners_too")
    assert line.file.endswith("test_parameters.py") and line.stamp.sec > 0
    p.control.close()
    lines.clear()
    logging.getLogger("wbmpc").warning("after the end")
    assert rosout_handlers() <= others


def sent(pair: Callable[..., Any], last: str, *records: logging.LogRecord) -> list[Any]:
    """The lines on /rosout when a node has handled these, the ``last`` one among them."""
    others, lines = rosout_handlers(), list[Any]()
    p = pair()
    p.ready()
    p.standin.node.subscribe("/rosout", "rcl_interfaces/msg/Log", lines.append, Qos(latched=True, depth=100))
    (handler,) = rosout_handlers() - others
    for record in records:
        handler.handle(record)
    p.run(0.1)
    assert wait_until(lambda: any(last in m.msg for m in lines))
    return lines


class Silent:
    """A user's fault whose message cannot be written."""

    def __str__(self) -> str:
        raise RuntimeError("no text")


def test_no_line_stops_who_logs_it_and_names_that_are_no_text_are_readable(pair: Callable[..., Any]) -> None:
    """Who logs may be the control thread. Truth: Python's own handlers raise nothing; a name with a byte that is not UTF-8."""
    given = (("%s slips", Silent()), ("%d", "7"), ("scene %s", os.fsdecode(b"caf\xe9")))
    records = [
        logging.LogRecord("wbmpc", logging.ERROR, "x.py", k, text, (part,), None)
        for k, (text, part) in enumerate(given)
    ]
    said = [m.msg for m in sent(pair, "scene", *records) if m.line < 3]
    assert said == ["%s slips (its text cannot be made)", "%d (its text cannot be made)", "scene caf\\udce9"]


def test_records_that_no_message_can_hold_are_sent_as_the_nearest_one(pair: Callable[..., Any]) -> None:
    """Of other libraries' loggers. Truth: the fields' ranges in rcl_interfaces/msg/Log, and XCDR, whose texts have no NUL."""
    records = [
        logging.LogRecord("wbmpc", level, "x.py", line, f"odd\0{k}", (), None, function)  # type: ignore[arg-type]
        for k, (level, line, function) in enumerate(((-5, -1, "a\0b"), (10**9, 2**40, "f\udce9"), (30.5, 7, None)))
    ]
    lines = sent(pair, "odd\\x002", *records)
    assert [(m.msg, m.level, m.line, m.function) for m in lines if m.msg.startswith("odd")] == [
        ("odd\\x000", 10, 0, "a\\x00b"), ("odd\\x001", 50, 2**32 - 1, "f\\udce9"), ("odd\\x002", 30, 7, ""),
    ]  # fmt: skip


def test_a_controller_that_cannot_be_made_leaves_no_handler_of_log_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    """What was logged until then is on /rosout, and Python's own shutdown of logging finds nothing to send."""
    node, listener = open_node("wbmpc", "dds", NETWORK), open_node("listener", "dds", NETWORK)
    lines: list[Any] = []
    listener.subscribe("/rosout", "rcl_interfaces/msg/Log", lines.append, Qos(latched=True, depth=100))

    def fails(*given: Any) -> None:
        logging.getLogger("wbmpc").warning("the last line")
        raise InputError("cannot be made")

    monkeypatch.setattr("wbmpc.ros2.control.base_type", fails)
    others = rosout_handlers()
    try:
        with pytest.raises(InputError, match="cannot be made"):
            ControlNode(node, ROBOT, RosSettings())
        assert rosout_handlers() <= others
        assert wait_until(lambda: any(m.msg == "the last line" for m in lines))
    finally:
        node.close()
        listener.close()


def test_every_input_is_an_endpoint_before_there_is_a_robot(pair: Callable[..., Any]) -> None:
    """Who publishes speeds with a node of its own finds a subscription at once."""
    p = pair()
    topics = p.settings.topics
    inputs = [getattr(topics, n) for n in ("joint_states", "imu", "goal_pose", "end_effector_goal", "base_path", "end_effector_path",
              "cmd_vel", "wrench", "legs", "brakes", "leg_configuration")]  # fmt: skip
    there = lambda t: [e.type for e in p.standin.node.subscribers(t) if not e.own]
    assert wait_until(lambda: all(there(t) for t in inputs))
    assert there("/cmd_vel") == ["geometry_msgs/msg/Twist"]
    assert p.control.runner is None
