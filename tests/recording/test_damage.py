"""Recordings that were damaged or cut. Truth: the messages that were written, and the file as it was before."""

from __future__ import annotations

import json
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from wbmpc.cli import main
from wbmpc.errors import InputError
from wbmpc.recording import recorder, writer
from wbmpc.recording.reader import KINDS, Recording, read_recording
from wbmpc.recording.records import MAGIC
from wbmpc.recording.writer import McapFile, stamp

RNG = np.random.default_rng(6)
POSES = RNG.normal(size=(60, 7))
quick = settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small recording in many chunks."""
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    with patch.object(writer, "CHUNK", 700):
        file = McapFile(path)
    file.metadata("run", {"experiment": "toy", "seed": 7, "started": "then", "settings": json.dumps({"a": 1})})
    file.attach("scene", {"bodies": list(range(40))})
    for k, pose in enumerate(POSES):
        header = {"stamp": stamp(0.01 * k), "frame_id": "odom"}
        file.put("/ground_truth/end_effector", "geometry_msgs/PoseStamped", 0.01 * k, {"header": header, "pose": pose})
        joints = {"header": header, "name": ["a", "b"], "position": pose[:2], "velocity": [], "effort": []}
        file.put("/joint_states", "sensor_msgs/JointState", 0.01 * k, joints)
        file.put("/mode", "std_msgs/String", 0.01 * k, {"data": f"mode {k}"})
    file.metadata("result", {"completed": "true"})
    file.close()
    return path


def contents(recording: Recording) -> tuple[object, ...]:
    topics = {name: (t.kind, t.times, t.data) for name, t in recording.topics.items()}
    return topics, recording.metadata, recording.attachments, recording.complete


def read_all(path: Path) -> Recording | None:
    """The recording with all its numbers decoded; None if it, or a topic of it, is rejected with a message."""
    try:
        found = read_recording(path)
        for topic in found.topics:
            found.table(topic)
    except InputError as error:
        assert str(error).strip()
        return None
    return found


@quick
@given(st.data())
def test_changed_bytes_never_pass_unnoticed(whole: Path, tmp_path: Path, data: st.DataObject) -> None:
    """What is read is what was written, or damage or a missing end is reported, or the file is rejected: never another error."""
    original = whole.read_bytes()
    changed = bytearray(original)
    for _ in range(data.draw(st.integers(1, 4))):
        changed[data.draw(st.integers(0, len(changed) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path / "changed.mcap"
    path.write_bytes(changed)
    found = read_all(path)
    if found is not None and found.complete and not found.damage:
        assert contents(found) == contents(read_recording(whole))


@quick
@given(st.integers(0, 100_000))
def test_of_a_cut_file_the_beginning_is_read(whole: Path, tmp_path: Path, at: int) -> None:
    original = whole.read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(original[: at % len(original)])
    found, all_of_it = read_all(path), read_recording(whole)
    if found is not None:
        assert not found.damage and not found.complete
        for name, topic in found.topics.items():
            assert topic.data == all_of_it[name].data[: len(topic.data)]


@quick
@given(st.binary(max_size=300))
def test_what_follows_the_first_bytes_may_be_anything(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "any.mcap"
    path.write_bytes(MAGIC + data)
    found = read_all(path)
    assert found is None or not found.complete


def _damaged(whole: Path, path: Path, old: bytes, new: bytes) -> None:
    original = whole.read_bytes()
    assert len(old) == len(new) and old in original
    path.write_bytes(original.replace(old, new, 1))


def test_only_the_damaged_chunk_is_lost(whole: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Even the first one, which names the topics: the file's end names them once more."""
    original = whole.read_bytes()
    chunk = original.index(b"zstd") + 60
    path = tmp_path / "run.mcap"
    path.write_bytes(original[:chunk] + bytes([original[chunk] ^ 1]) + original[chunk + 1 :])
    found, all_of_it = read_recording(path), read_recording(whole)
    assert found.complete and len(found.damage) == 2  # the chunk's own checksum, and the whole file's
    assert set(found.topics) == set(all_of_it.topics)
    assert len(found["/ground_truth/end_effector"].data) < len(all_of_it["/ground_truth/end_effector"].data)
    for name, topic in found.topics.items():
        lost = len(all_of_it[name].data) - len(topic.data)
        assert lost < 20 and topic.data == all_of_it[name].data[lost:]
    assert "is damaged, and read without what is not whole: the record at byte" in caplog.text


def test_a_changed_attachment_or_setting_is_seen(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    _damaged(whole, path, b'{"bodies": [0', b'{"bodies": [1')
    assert "scene" not in read_recording(path).attachments
    _damaged(whole, path, b"then", b"that")
    assert read_recording(path).damage


def test_every_command_says_a_message(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With a damaged recording, and with files that are none."""
    monkeypatch.chdir(tmp_path)
    _damaged(whole, Path("run.mcap"), b"zstd", b"zsXd")
    assert main(["log", "info", "run.mcap", "--json"]) == 0
    said = capsys.readouterr()
    assert len(json.loads(said.out)["damage"]) == 2 and "run.mcap is damaged" in said.err
    assert main(["log", "info", "run.mcap"]) == 0
    assert "killed" not in capsys.readouterr().out
    assert main(["log", "export", "run.mcap"]) == main(["log", "plot", "run.mcap"]) == 0
    assert main(["compare", ".", "run.mcap"]) == 0
    capsys.readouterr()
    for command in (["replay", "run.mcap", "--html", "a.html"], ["render", "run.mcap", "--png", "a.png"]):
        assert main(command) == 2
        assert "its scene was not written by wbmpc" in capsys.readouterr().err
    for content, why in (
        (b"", "is not a recording (MCAP): it is empty"),
        (MAGIC, "nothing can be read of this recording: it holds nothing yet"),
        (b"hello", "is not a recording (MCAP): it does not begin like one"),
    ):
        Path("bad.mcap").write_bytes(content)
        for command in (["log", "info"], ["log", "plot"], ["replay"], ["render", "--png", "a.png"]):
            assert main([*command, "bad.mcap"]) == 2
            assert capsys.readouterr().err == f"wbmpc: bad.mcap: {why}\n"


def test_log_without_a_command_shows_its_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["log"]) == 0
    said = capsys.readouterr()
    assert "Usage" in said.out and said.err == ""


def test_topics_that_are_read_by_name_are_recorded() -> None:
    """A name that no recorder writes would check nothing. Truth: where the recorder writes it."""
    source = Path(recorder.__file__).read_text()
    for name in KINDS:
        assert f'"{name}' in source, name


def test_a_message_that_is_none_of_its_type_names_file_and_topic(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    file = McapFile(path)
    file.put_bytes("/ground_truth/end_effector", "geometry_msgs/PoseStamped", 0.0, b"\0\1\0\0\xff\xff\xff\x7f")
    file.close()
    with pytest.raises(
        InputError, match=rf"^{path}: /ground_truth/end_effector: 8 bytes are no geometry_msgs/PoseStamped: "
    ):
        read_recording(path).table("/ground_truth/end_effector")


def test_joints_without_their_numbers_name_file_and_topic(tmp_path: Path) -> None:
    """It was a traceback of zip."""
    path, header = tmp_path / "run.mcap", {"stamp": stamp(0.0), "frame_id": "map"}
    file = McapFile(path)
    joints = {"header": header, "name": ["a", "b"], "position": np.zeros(2), "velocity": np.zeros(1), "effort": []}
    file.put("/joint_states", "sensor_msgs/JointState", 0.0, joints)
    file.close()
    with pytest.raises(InputError, match=rf"^{path}: /joint_states: a message has not as many numbers as names"):
        read_recording(path).table("/joint_states")


def test_an_end_of_zeros_is_not_followed(whole: Path, tmp_path: Path) -> None:
    """A power cut leaves them. Each nine zeros are a record: a gigabyte of them took minutes, and five times its size in memory."""
    path, data = tmp_path / "run.mcap", whole.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    before = contents(read_recording(path))
    path.write_bytes(data[: len(data) // 2] + bytes(1_000_000))
    found = read_recording(path)
    assert contents(found) == before and len(found.damage) < 2000
    assert found.damage[-1].startswith("nothing is read from byte ")


def test_the_true_odometry_of_a_recorded_bus_is_read(tmp_path: Path) -> None:
    """`wbmpc ros2 sim` publishes it beside the end effector's pose, which pages read by name."""
    path = tmp_path / "run.mcap"
    file = McapFile(path)
    stamp = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "world"}
    pose = {"position": {"x": 1.0, "y": 0.0, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    none = {"x": 0.0, "y": 0.0, "z": 0.0}
    odometry = {
        "header": stamp, "child_frame_id": "base_link", "pose": {"pose": pose, "covariance": np.zeros(36)},
        "twist": {"twist": {"linear": none, "angular": none}, "covariance": np.zeros(36)},
    }  # fmt: skip
    file.put("/ground_truth/odom", "nav_msgs/Odometry", 0.0, odometry)
    file.put("/ground_truth/end_effector", "geometry_msgs/PoseStamped", 0.0, {"header": stamp, "pose": pose})
    file.close()
    found = read_recording(path)
    assert set(found.topics) == {"/ground_truth/odom", "/ground_truth/end_effector"} and not found.damage


@pytest.mark.parametrize("name", KINDS)
def test_a_topic_of_another_type_is_left_out(tmp_path: Path, name: str) -> None:
    """Pages and films read these topics by name. One of another type, or of two, was a traceback of whatever its messages lack."""
    path, topic = tmp_path / "run.mcap", name + "x" * name.endswith("/")
    file = McapFile(path)
    for t in (0.0, 0.5):
        file.put("/x", "std_msgs/Float64", t, [t])
        file.put(topic, "std_msgs/Float64MultiArray", t, {"layout": {"dim": [], "data_offset": 0}, "data": np.ones(3)})
    file.close()
    found = read_recording(path)
    assert set(found.topics) == {"/x"} and found.complete
    assert found.damage == [f"{topic} is left out: its type is std_msgs/Float64MultiArray, {KINDS[name]} is needed"]
    assert main(["log", "plot", str(path)]) == 0
