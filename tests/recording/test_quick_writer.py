"""Messages that are packed in one piece. Truth: the bytes that the MCAP library's own writer makes."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from wbmpc.errors import InputError
from wbmpc.recording.messages import encode
from wbmpc.recording.quick_writer import QuickWriter
from wbmpc.recording.template import Template, Topics
from wbmpc.recording.writer import stamp

POSE = "geometry_msgs/PoseStamped"
TEMPLATE = Template(POSE, {"header": {"stamp": stamp(0.0), "frame_id": "map"}, "pose": np.zeros(7)})

ALONE = Topics([("/pose", POSE, TEMPLATE)])


def written(kind: type[Writer]) -> bytes:
    """A file of three channels with several chunks, messages of all sizes and times that go back."""
    rng, out = np.random.default_rng(0), BytesIO()
    writer = kind(out, chunk_size=2000, compression=CompressionType.ZSTD, enable_data_crcs=True)
    writer.start(profile="ros2", library="test")
    schema = writer.register_schema(name="a/msg/B", encoding="ros2msg", data=b"float64 x")
    channels = [writer.register_channel(f"/topic{i}", "cdr", schema) for i in range(3)]
    for k in range(200):
        at = 1_000_000 * (k if k % 17 else k // 2) + 7
        writer.add_message(channels[k % 3], at, rng.bytes(int(rng.integers(0, 150))), at + k, sequence=k)
        numbers = rng.normal(size=7)
        pose = {"header": {"stamp": stamp(1e-9 * at), "frame_id": "map"}, "pose": numbers}
        if isinstance(writer, QuickWriter):
            writer.add_row([channels[k % 2]], at, ALONE, ALONE.row([numbers]))
            numbers[:] = 0.0  # what was given may change afterwards
        else:
            writer.add_message(channels[k % 2], at, encode(POSE, pose), at)
        if k == 90:
            writer.add_metadata("note", {"k": "90"})
    writer.finish()
    return out.getvalue()


def test_the_file_is_the_librarys() -> None:
    assert written(QuickWriter) == written(Writer)


def test_it_takes_the_short_way() -> None:
    """The library still has what is used of it; else recordings take as long as they did."""
    assert QuickWriter(BytesIO())._quick


def test_without_what_it_uses_it_is_the_librarys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "wbmpc.recording.quick_writer._PARTS", ("_Writer__chunk_builder", "_Writer__statistics", "none")
    )
    assert not QuickWriter(BytesIO())._quick
    assert written(QuickWriter) == written(Writer)


def together(kind: type[Writer]) -> bytes:
    """A file of one chunk: other messages, and rows of three that are written together, the second without a stamp."""
    rng, out, number = np.random.default_rng(0), BytesIO(), "std_msgs/Float64"
    writer = kind(out, chunk_size=10**6, compression=CompressionType.ZSTD, enable_data_crcs=True)
    writer.start(profile="ros2", library="test")
    schema = writer.register_schema(name="a/msg/B", encoding="ros2msg", data=b"float64 x")
    channels = [writer.register_channel(f"/topic{i}", "cdr", schema) for i in range(3)]
    topics = Topics([("/a", POSE, TEMPLATE), ("/b", number, Template(number, [0.0])), ("/c", POSE, TEMPLATE)])
    for k in range(30):
        at, (first, one, last) = 10**9 * k + 7, (rng.normal(size=n) for n in (7, 1, 7))
        if k % 7 == 0:
            writer.add_message(channels[2], at, rng.bytes(k), at)
        if isinstance(writer, QuickWriter):
            writer.add_row(channels, at, topics, topics.row([first, one, last]))
            continue
        poses = [{"header": {"stamp": stamp(1e-9 * at), "frame_id": "map"}, "pose": pose} for pose in (first, last)]
        for channel, data in zip(
            channels, (encode(POSE, poses[0]), encode(number, one), encode(POSE, poses[1])), strict=True
        ):
            writer.add_message(channel, at, data, at)
    writer.finish()
    return out.getvalue()


def test_messages_that_are_written_together_are_the_librarys() -> None:
    assert together(QuickWriter) == together(Writer)


def test_a_row_with_too_few_numbers_is_rejected() -> None:
    topics = Topics([("/a", POSE, TEMPLATE), ("/b", POSE, TEMPLATE)])
    with pytest.raises(InputError, match=r"\[7, 7\].*\[8, 6\]"):
        topics.row([np.zeros(8), np.zeros(6)])
