"""Recordings that reach their size, and disks that are full. Truth: the messages that were written; limits of the system."""

from __future__ import annotations

import json
import re
import resource
import struct
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard

from command_line import shell
from wbmpc.cli import main
from wbmpc.cli.directories import size_of
from wbmpc.errors import InputError
from wbmpc.recording.reader import read_recording
from wbmpc.recording.recorder import Recorder
from wbmpc.recording.records import MAGIC, records
from wbmpc.recording.writer import McapFile
from wbmpc.simulation.film import SceneModel
from wbmpc.simulation.scene import Scene

RNG = np.random.default_rng(3)


def test_a_recording_rotates_and_both_parts_stand_by_themselves(tmp_path: Path) -> None:
    path, limit = tmp_path / "run.mcap", 1_000_000
    file = McapFile(path, limit)
    file.metadata("run", {"experiment": "toy"})
    file.attach("scene.json", {"robot": "b"})
    file.put("/mode", "std_msgs/String", 0.0, {"data": "walks"}, latched=True)
    rows = RNG.normal(size=(4000, 100))
    for k, row in enumerate(rows):
        layout = {"dim": [], "data_offset": 0}
        file.put("/x", "std_msgs/Float64MultiArray", 0.01 * k, {"layout": layout, "data": row})
    file.close()
    parts = [read_recording(tmp_path / "run-1.mcap"), read_recording(path)]
    assert {f.name for f in tmp_path.iterdir()} == {"run.mcap", "run-1.mcap"}
    assert 0.5 * limit < sum(f.stat().st_size for f in tmp_path.iterdir()) < 1.4 * limit
    for part in parts:
        assert part.complete and not part.damage and part.metadata["run"] == {"experiment": "toy"}
        assert part.attachment("scene.json") == {"robot": "b"} and part["/mode"].last() == {"data": "walks"}
    times = np.concatenate([part["/x"].times for part in parts])
    np.testing.assert_allclose(times, 0.01 * np.arange(4000 - times.size, 4000), atol=1e-9)
    newest = [m["data"] for part in parts for _, m in part["/x"].messages()]
    np.testing.assert_array_equal(newest, rows[-len(newest) :])


def test_a_scene_larger_than_the_limit_leaves_room_for_messages(tmp_path: Path) -> None:
    """Every file begins with it: without room for more each message would begin a new one."""
    path, limit = tmp_path / "run.mcap", 1_000_000
    file = McapFile(path, limit)
    file.attach("scene.json", {"v": RNG.random(100_000).tolist()})
    rows = RNG.normal(size=(2000, 100))
    for k, row in enumerate(rows):
        file.put("/x", "std_msgs/Float64MultiArray", 0.01 * k, {"layout": {"dim": [], "data_offset": 0}, "data": row})
    file.close()
    parts = [read_recording(tmp_path / "run-1.mcap"), read_recording(path)]
    assert len(parts[0]["/x"].times) * 800 > 0.2 * limit  # a message has 800 bytes
    newest = [m["data"] for part in parts for _, m in part["/x"].messages()]
    np.testing.assert_array_equal(newest, rows[-len(newest) :])


def test_a_limit_is_a_size() -> None:
    assert size_of("--record-limit", "1.5GB") == 1_500_000_000
    for text in ("much", "5", "10B", "-1MB", "nanGB", "\u0663MB", "1e3MB", "0.999MB"):
        with pytest.raises(InputError, match=rf"--record-limit: '{text}'"):
            size_of("--record-limit", text)


def test_a_full_disk_is_named_and_the_figures_are_elsewhere(tmp_path: Path) -> None:
    """The system lets no file grow beyond 20 kB: log.npz does not fit, metrics.json does, and goes elsewhere."""
    done = _run("run", "fake", "--out", "out", folder=tmp_path, largest=20_000)
    assert done.returncode == 1 and "Traceback" not in done.stderr
    found = re.search(
        r"out/log\.npz: cannot be written \(File too large\); the figures of the run are in (\S+)", done.stderr
    )
    assert found is not None, done.stderr
    assert json.loads(Path(found[1]).read_text())["metrics"]["path_length"]["value"] == 20.53
    Path(found[1]).unlink()
    Path(found[1]).parent.rmdir()


def test_where_nothing_can_be_written_the_message_has_the_figures(tmp_path: Path) -> None:
    done = _run("run", "fake", "--out", "out", folder=tmp_path, largest=100)
    assert done.returncode == 1 and '"path_length": 20.53' in done.stderr and "Traceback" not in done.stderr


def _run(*arguments: str, folder: Path, largest: int = 0):  # type: ignore[no-untyped-def]
    limit = f"resource.setrlimit(resource.RLIMIT_FSIZE, ({largest}, {largest}))" if largest else "pass"
    code = (
        f"import os, resource, sys; os.chdir({str(folder)!r}); {limit}; sys.dont_write_bytecode = True\n"
        "from fake_experiment import REGISTRY; from wbmpc.cli import main; sys.exit(main(None, REGISTRY))"
    )
    return shell(*arguments, code=code)


def _bytes_left(file: McapFile, count: int) -> None:
    """From now on the system lets files of this process grow by so much."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (file._file.tell() + count, _UNLIMITED))


_UNLIMITED = resource.getrlimit(resource.RLIMIT_FSIZE)[1]


@pytest.mark.parametrize("left", [0, 1, 40, 300])
def test_a_disk_that_is_full_at_the_end_of_a_file_ends_the_recording_alone(
    left: int, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """When it rotates, or when the run ends: what closes it after the failure raised an error of Python's, which ended the run."""
    recorder = Recorder(tmp_path / "run.mcap", {})
    recorder.file = McapFile(tmp_path / "run.mcap", 1_000_000)
    for k, row in enumerate(RNG.normal(size=(300, 100))):
        recorder.file.put(
            "/x", "std_msgs/Float64MultiArray", 0.01 * k, {"layout": {"dim": [], "data_offset": 0}, "data": row}
        )
    try:
        _bytes_left(recorder.file, left)
        with recorder._noted():
            recorder.file._rotate(3.0)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (_UNLIMITED, _UNLIMITED))
    assert "cannot be written (File too large)" in recorder.failure and recorder.file is None
    recorder.close({"completed": "true"})
    times = np.array(read_recording(tmp_path / "run.mcap")["/x"].times)
    np.testing.assert_allclose(times, 0.01 * np.arange(times.size), atol=1e-9)  # whole chunks of 128 kB
    assert times.size >= 150


@pytest.mark.parametrize(
    ("then", "why"), [("new = 1", "another file took its place"), ("", "No such file or directory")]
)
@pytest.mark.parametrize("rotates", [False, True])
def test_a_recording_that_is_not_there_at_the_end_is_reported(
    then: str, why: str, rotates: bool, tmp_path: Path
) -> None:
    """What is written goes to a file without a name then: the run would end as if it had its recording."""
    path = tmp_path / "run.mcap"
    recorder = Recorder(path, {})
    recorder.file = McapFile(path, 1_000_000)
    path.unlink()
    if then:
        path.write_text(then)
    with recorder._noted():
        if rotates:
            recorder.file._rotate(1.0)
    recorder.close({"completed": "true"})
    assert f"{path}: cannot be written ({why})" in recorder.failure
    assert [f.read_text() for f in tmp_path.iterdir()] == [then] * bool(then)


def test_a_part_says_that_it_is_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Which times it holds, and where those before are: a part does not look like a whole run that long."""
    path = tmp_path / "run.mcap"
    file = McapFile(path, 1_000_000)
    for k, row in enumerate(RNG.normal(size=(3000, 100))):
        file.put("/x", "std_msgs/Float64MultiArray", 0.01 * k, {"layout": {"dim": [], "data_offset": 0}, "data": row})
    file.close()
    older, newest = read_recording(tmp_path / "run-1.mcap"), read_recording(path)
    assert older.end + 0.01 == pytest.approx(newest.start) and newest.end == pytest.approx(29.99)
    said = f"the run is longer than its --record-limit: what was before {newest.start:.2f} s"
    for gone, where in ((False, "is in run-1.mcap, or was overwritten"), (True, "was overwritten")):
        if gone:
            older.path.unlink()
        assert main(["log", "info", str(path)]) == 0
        lines = capsys.readouterr().out.splitlines()
        assert f"{newest.start:.2f} to 29.99 s" in lines[0] and lines[1] == f"{said} {where}"
    assert "was overwritten" in older.earlier


def test_a_run_that_fits_is_no_part(tmp_path: Path) -> None:
    file = McapFile(tmp_path / "run.mcap", 1_000_000)
    file.put("/x", "std_msgs/Float64", 0.0, [1.0])
    file.close()
    assert read_recording(tmp_path).earlier == ""


def _record(kind: int, body: bytes) -> bytes:
    """As the MCAP specification has it: kind, length, content."""
    return struct.pack("<BQ", kind, len(body)) + body


def _chunk(data: bytes, size: int | None = None, compression: bytes = b"zstd") -> bytes:
    packed = zstandard.compress(data) if compression == b"zstd" else lz4.frame.compress(data)
    head = struct.pack("<QQQII", 0, 1, len(data) if size is None else size, 0, len(compression))
    return _record(6, head + compression + struct.pack("<Q", len(packed)) + packed)


_PRIVATE, _MESSAGE = _record(0x80, b""), _record(5, struct.pack("<HIQQ", 1, 0, 0, 0) + bytes(12))


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        (_chunk(bytes(8_000_000)) * 2000, "more records"),
        (_chunk(_record(0x80, bytes(8_000_000))) * 2000, "unpacked, which no recording of"),
        (_chunk(_PRIVATE * 900_000) * 200, "more records"),
        (_chunk(_MESSAGE * 200_000) * 20, "more records"),
        (_PRIVATE * 3_000_000, "records, which no recording of"),
    ],
)
def test_what_becomes_far_larger_than_its_file_is_an_error(rows: bytes, says: str, tmp_path: Path) -> None:
    """Each took a reader from half a minute to many, and gigabytes. The test's time limit would end it."""
    path = tmp_path / "run.mcap"
    path.write_bytes(MAGIC + rows)
    with pytest.raises(InputError, match=says) as caught:
        read_recording(path)
    assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.parametrize("compression", [b"zstd", b"lz4"])
def test_a_chunk_that_is_larger_than_it_says_is_damaged(compression: bytes) -> None:
    damage: list[str] = []
    bomb = _chunk(_MESSAGE + bytes(50_000_000), len(_MESSAGE), compression)
    assert not list(records(MAGIC + bomb, damage)) and len(damage) == 1
    fine: list[str] = []
    assert len(list(records(MAGIC + _chunk(_MESSAGE * 3, None, compression), fine))) == 3 and not fine


def test_a_topic_with_other_names_in_every_message_is_no_table(tmp_path: Path) -> None:
    """Every name is a column: a file of some kilobytes would fill the memory. One message alone may have as many."""
    file, many = McapFile(tmp_path / "run.mcap"), 12_000
    for k in range(1200):
        joints = [f"j{k}_{i}" for i in range(many // 1200)]
        message = {
            "header": {"stamp": {"sec": k, "nanosec": 0}, "frame_id": ""},
            "name": joints,
            "position": np.zeros(len(joints)),
        }
        file.put("/joint_states", "sensor_msgs/JointState", float(k), {**message, "velocity": [], "effort": []})
    file.close()
    recording = read_recording(tmp_path)
    with pytest.raises(InputError, match=r"/joint_states: is no table: its 1200 messages have 12000 different names"):
        recording.table("/joint_states")
    topic = recording["/joint_states"]
    topic.times, topic.data = topic.times[:3], topic.data[:3]
    assert len(recording.table("/joint_states").columns) == 30


def test_a_message_with_a_million_numbers_is_no_table(tmp_path: Path) -> None:
    """A file of some kilobytes unpacks to it; to write that as a table took minutes."""
    file, poses = McapFile(tmp_path / "run.mcap"), [{"pose": np.zeros(7)}] * 5_000
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "map"}
    file.put("/plan", "nav_msgs/Path", 0.0, {"header": header, "poses": [{"header": header, **p} for p in poses]})
    file.close()
    assert (tmp_path / "run.mcap").stat().st_size < 20_000
    with pytest.raises(InputError, match=r"/plan: is no table: it has more than 25000 columns"):
        read_recording(tmp_path).table("/plan")


def test_a_scene_of_a_recording_is_one_that_can_be_drawn() -> None:
    body, shape = {"name": "a", "parent": "world", "moves": True}, {
        "body": "a", "kind": "sphere", "size": [1, 1, 1], "pose": [0] * 7, "color": [1] * 4, "vertices": [], "faces": [],
    }  # fmt: skip
    assert Scene.of_plain({"robot": "a", "bodies": [body], "shapes": [shape]}).robot == "a"
    for bodies, shapes in ((20_000, 1), (1, 20_000)):
        with pytest.raises(TypeError, match=f"{bodies} bodies and {shapes} shapes; at most 2000 and 5000 are drawn"):
            Scene.of_plain({"robot": "a", "bodies": [body] * bodies, "shapes": [shape] * shapes})


@pytest.mark.parametrize(("kind", "size"), [("mesh", [1, 1, 1]), ("sphere", [0, 0, 0])])
def test_a_shape_that_nothing_draws_is_bad_input(kind: str, size: list[float]) -> None:
    shape = {
        "body": "a",
        "kind": kind,
        "size": size,
        "pose": [0, 0, 0, 1, 0, 0, 0],
        "color": [1] * 4,
        "vertices": [],
        "faces": [],
    }
    scene = Scene.of_plain(
        {"robot": "a", "bodies": [{"name": "a", "parent": "world", "moves": True}], "shapes": [shape]}
    )
    with pytest.raises(InputError, match="a recorded scene cannot be drawn"):
        SceneModel(scene)
