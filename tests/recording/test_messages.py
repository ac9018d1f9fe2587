"""CDR bytes and definitions of messages. Truth: rosbags, an independent implementation with ROS 2's own definitions."""

from __future__ import annotations

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from wbmpc.errors import InputError
from wbmpc.recording.messages import DEFINITIONS, decode, encode, fields, full_name, numbers, schema
from wbmpc.recording.template import Template

STORE = get_typestore(Stores.ROS2_JAZZY)


def random_message(kind: str, rng: np.random.Generator):  # type: ignore[no-untyped-def]
    if numbers(kind):
        return rng.normal(size=len(numbers(kind)))
    out = {}
    for field in fields(kind):
        count = int(rng.integers(0, 4)) if field.array == 0 else (field.array or 1)
        if field.kind == "float64":
            values = rng.normal(size=count)
        elif field.kind == "string":
            values = ["é" * int(rng.integers(0, 6)) for _ in range(count)]
        elif field.kind in ("int32", "uint32"):
            values = [int(v) for v in rng.integers(0, 2**31, count)]
        else:
            values = [random_message(field.kind, rng) for _ in range(count)]
        out[field.name] = values if field.array is not None else values[0]
    return out


def leaves(value):  # type: ignore[no-untyped-def]
    """All numbers and texts, in order, of our messages and of rosbags'."""
    if hasattr(value, "__msgtype__"):
        for name in value.__dataclass_fields__:
            if name != "__msgtype__":
                yield from leaves(getattr(value, name))
    elif isinstance(value, dict):
        for one in value.values():
            yield from leaves(one)
    elif isinstance(value, (list, np.ndarray)):
        for one in value:
            yield from leaves(one)
    else:
        yield value


@pytest.mark.parametrize("kind", DEFINITIONS)
@pytest.mark.parametrize("seed", range(5))
def test_bytes_are_those_of_rosbags(kind: str, seed: int) -> None:
    message = random_message(kind, np.random.default_rng(seed))
    data = encode(kind, message)
    theirs = STORE.deserialize_cdr(data, full_name(kind))
    assert list(leaves(theirs)) == list(leaves(message))
    assert bytes(STORE.serialize_cdr(theirs, full_name(kind))) == data
    assert list(leaves(decode(kind, data))) == list(leaves(message))


@pytest.mark.parametrize("kind", DEFINITIONS)
def test_schemas_are_ros_definitions(kind: str) -> None:
    parsed = get_types_from_msg(schema(kind), full_name(kind))
    for name, definition in parsed.items():
        assert definition[1] == STORE.fielddefs[name][1]


def test_wrong_messages_are_named() -> None:
    with pytest.raises(InputError, match=r"geometry_msgs/PoseStamped.header is missing"):
        encode("geometry_msgs/PoseStamped", {"pose": np.zeros(7)})
    with pytest.raises(InputError, match=r"geometry_msgs/Pose needs 7 numbers, got 6"):
        encode("geometry_msgs/Pose", np.zeros(6))
    with pytest.raises(InputError, match="unknown message type 'geometry_msgs/Pse'"):
        fields("geometry_msgs/Pse")
    with pytest.raises(InputError, match="little-endian"):
        decode("std_msgs/String", b"\x00\x00\x00\x00")


@pytest.mark.parametrize("kind", DEFINITIONS)
@pytest.mark.parametrize("seed", range(5))
def test_a_template_gives_the_bytes_of_the_message(kind: str, seed: int) -> None:
    """Made of one message, filled with times and numbers of others of the same names and lengths."""
    message = random_message(kind, np.random.default_rng(seed))
    template, times, numbers, expected = Template(kind, message), [], [], []
    for k in range(3):
        found: list[float] = []
        other = _like(message, np.random.default_rng(100 + seed + k))
        expected.append(encode(kind, _timed(kind, other, 7 + k, 123456789, found)))
        times.append((7 + k) * 1_000_000_000 + 123456789)
        numbers.append(found)
    filled = [template.fill(time, np.array(row)) for time, row in zip(times, numbers, strict=True)]
    assert filled == expected
    assert template.size == len(numbers[0])


def test_a_template_with_other_numbers_than_it_has_is_rejected() -> None:
    template = Template("geometry_msgs/Pose", np.zeros(7))
    with pytest.raises(InputError, match="geometry_msgs/Pose needs 7 numbers, got 6"):
        template.fill(0, np.zeros(6))


def _like(value, rng: np.random.Generator):  # type: ignore[no-untyped-def]
    """The same message with other float64."""
    if isinstance(value, np.ndarray):
        return rng.normal(size=value.shape)
    if isinstance(value, dict):
        return {k: _like(v, rng) for k, v in value.items()}
    if isinstance(value, list):
        return [_like(v, rng) for v in value]
    return float(rng.normal()) if isinstance(value, float) else value


def _timed(kind: str, value, sec: int, nanosec: int, found: list[float]):  # type: ignore[no-untyped-def]
    """With all stamps at one time; ``found`` gets all float64 in order."""
    if kind == "builtin_interfaces/Time":
        return {"sec": sec, "nanosec": nanosec}
    if kind == "float64" or (kind in DEFINITIONS and numbers(kind)):
        found += np.ravel(value).tolist()
    elif isinstance(value, dict):
        out = {}
        for field in fields(kind):
            inside = value[field.name]
            several = field.array is not None and field.kind != "float64"
            out[field.name] = (
                [_timed(field.kind, v, sec, nanosec, found) for v in inside]
                if several
                else _timed(field.kind, inside, sec, nanosec, found)
            )
        return out
    return value
