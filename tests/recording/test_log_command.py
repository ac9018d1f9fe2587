"""`wbmpc log`: what it prints and writes. Truth: the file as rosbags reads it, read back by csv, NumPy and pyarrow."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from wbmpc.cli import main
from wbmpc.recording.reader import read_recording
from wbmpc.recording.writer import McapFile, stamp

RNG = np.random.default_rng(4)
TIMES = np.arange(40) / 100
POSES, SPEEDS = RNG.normal(size=(40, 7)), RNG.normal(size=(40, 2))


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A directory with a small recording."""
    monkeypatch.chdir(tmp_path)
    file = McapFile(tmp_path / "run.mcap")
    file.metadata("run", {"experiment": "toy", "seed": 7, "started": "then"})
    for t, pose, speed in zip(TIMES, POSES, SPEEDS, strict=True):
        header = {"stamp": stamp(t), "frame_id": "odom"}
        file.put("/end_effector_pose", "geometry_msgs/PoseStamped", t, {"header": header, "pose": pose})
        file.put("/end_effector_reference", "geometry_msgs/PoseStamped", t, {"header": header, "pose": 0.0 * pose})
        joints = {"header": header, "name": ["a", "b"], "position": [], "velocity": speed, "effort": []}
        file.put("/joint_states", "sensor_msgs/JointState", t, joints)
        file.put("/mpc/solve_time", "std_msgs/Float64", t, [1e-3 * t])
        moved = {"header": header, "child_frame_id": "left", "transform": pose}
        file.put("/tf", "tf2_msgs/TFMessage", t, {"transforms": [moved]})
    file.put("/mode", "std_msgs/String", 0.0, {"data": "H"}, latched=True)
    file.metadata("joint_units", {"a": "rad", "b": "m"})
    file.metadata("result", {"completed": "false", "reason": "the robot fell"})
    file.close()
    return tmp_path


def test_info(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["log", "info", "."]) == 0
    out = capsys.readouterr().out
    assert "toy, seed 7, 0.00 to 0.39 s, started then" in out and "did not complete: the robot fell" in out
    row = next(line for line in out.splitlines() if "/joint_states" in line)
    assert row.split() == ["/joint_states", "sensor_msgs/JointState", "40", "100.0", "Hz"]
    assert main(["log", "info", "run.mcap", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    with AnyReader([run / "run.mcap"]) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
    assert {name: t["messages"] for name, t in data["topics"].items()} == counts
    assert data["complete"] is True and data["metadata"]["run"]["seed"] == "7"


def test_info_of_a_killed_run(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole = (run / "run.mcap").read_bytes()
    (run / "run.mcap").write_bytes(whole[:-400])
    assert main(["log", "info", "."]) == 0
    assert "it ends in the middle: the run was killed" in capsys.readouterr().out


def test_csv_has_every_digit(run: Path) -> None:
    assert main(["log", "export", ".", "--out", "tables"]) == 0
    with (run / "tables" / "end_effector_pose.csv").open() as file:
        rows = list(csv.DictReader(file))
    names = [*(f"position.{a}" for a in "xyz"), *(f"orientation.{a}" for a in "xyzw")]
    np.testing.assert_array_equal([[float(r[f"pose.{n}"]) for n in names] for r in rows], POSES)
    np.testing.assert_array_equal([float(r["time"]) for r in rows], TIMES)
    assert (run / "tables" / "mode.csv").read_text().split() == ["time,data", "0.0,H"]
    with (run / "tables" / "joint_states.csv").open() as file:
        assert next(csv.reader(file)) == ["time", "velocity.a", "velocity.b"]


def test_nothing_is_overwritten(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What the program names gets a number; what the user names is rejected, unless it is forced. Truth: the files' bytes."""
    for k in (1, 2):
        assert main(["log", "plot", "."]) == 0 and main(["log", "export", ".", "/mode"]) == 0, k
    assert sorted(p.name for p in run.iterdir()) == ["export", "export-2", "plots-2.html", "plots.html", "run.mcap"]
    capsys.readouterr()
    page, table = run / "page.html", run / "tables" / "mode.csv"
    commands = {
        page: ["log", "plot", ".", "--out", "page.html"],
        table: ["log", "export", ".", "/mode", "--out", "tables"],
    }
    for file, command in commands.items():
        assert main(command) == 0
        file.write_text("mine")
        capsys.readouterr()
        assert main(command) == 2 and file.read_text() == "mine"
        name = file.relative_to(run)
        said = f"wbmpc: --out: '{name}' is there already; give another name, or --force to replace it\n"
        assert capsys.readouterr().err == said
        assert main([*command, "--force"]) == 0 and file.read_text() != "mine"
    assert main(["log", "plot", ".", "--out", "nowhere/page.html"]) == 2
    assert "there is no directory 'nowhere'" in capsys.readouterr().err


def test_numpy(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["log", "export", ".", "/joint_states", "/tf", "--to", "npz", "--json"]) == 0
    (path,) = json.loads(capsys.readouterr().out)["files"]
    with np.load(path) as saved:
        assert len(saved.files) == 3 + 8
        np.testing.assert_array_equal(saved["joint_states/velocity.b"], SPEEDS[:, 1])
        np.testing.assert_array_equal(saved["tf/transforms.left.transform.rotation.w"], POSES[:, 6])


def test_parquet(run: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    assert main(["log", "export", ".", "/joint_states", "--to", "parquet", "--out", "p"]) == 0
    table = parquet.read_table(run / "p" / "joint_states.parquet")
    np.testing.assert_array_equal(table["velocity.a"].to_numpy(), SPEEDS[:, 0])
    np.testing.assert_array_equal(table["time"].to_numpy(), TIMES)


def test_parquet_without_pyarrow_is_one_message(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert main(["log", "export", ".", "--to", "parquet", "--out", "p"]) == 2
    assert capsys.readouterr().err.startswith("wbmpc: export: Parquet needs pyarrow: pip install 'wbmpc[parquet]'")
    assert not (run / "p").exists()


def test_plots(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["log", "plot", "."]) == 0
    page = (run / "plots.html").read_text()
    body = page[page.index("<body>") :]
    for title in ("End effector from above", "End effector error, estimated frame", "Joint speeds", "Solve times"):
        assert f"<h3>{title}" in body
    assert body.count("Plotly.newPlot") == 5  # joints that turn and joints that slide have axes of their own
    assert main(["log", "plot", ".", "/mpc/solve_time", "--out", "one.html"]) == 0
    assert (run / "one.html").read_text().count("<h3>") == 1


def test_speeds_of_joints_that_turn_are_read_in_degrees(run: Path) -> None:
    from wbmpc.recording.plots import of_topics, overview

    recording = read_recording(run)
    joints = [p for p in overview(recording) if p.title == "Joint speeds"]
    for plots in (joints, of_topics(recording, ["/joint_states"])):
        turning, sliding = plots
        assert (turning.y_label, sliding.y_label) == ("speed [°/s]", "speed [m/s]")
        np.testing.assert_allclose(turning.series[0].y, np.degrees(SPEEDS[:, 0]))
        np.testing.assert_array_equal(sliding.series[0].y, SPEEDS[:, 1])


def test_hand_error(run: Path) -> None:
    from wbmpc.recording.plots import end_effector_error

    times, error = end_effector_error(read_recording(run))  # type: ignore[misc]
    np.testing.assert_array_equal(times, TIMES)
    np.testing.assert_allclose(error, np.sqrt((POSES[:, :3] ** 2).sum(axis=1)))


BAD = {
    ("log", "info", "nowhere"): "nowhere: there is no such recording",
    ("log", "export", ".", "--to", "xls"): "unknown format 'xls'; valid: csv, npz, parquet",
    (
        "log",
        "export",
        ".",
        "/end_effector/pose",
    ): "unknown topic '/end_effector/pose' (did you mean '/end_effector_pose'?)",
    ("log", "plot", ".", "/mode"): "topic '/mode' holds no numbers to plot",
}


@pytest.mark.parametrize("arguments", BAD, ids=" ".join)
def test_bad_input_is_one_message(run: Path, arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(list(arguments)) == 2
    err = capsys.readouterr().err
    assert BAD[arguments] in err and err.count("\n") == 1


def test_a_directory_that_cannot_be_made_is_named_by_its_option(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["log", "export", ".", "--out", "/proc/x"]) == 2
    assert capsys.readouterr().err.startswith("wbmpc: --out: '/proc/x' cannot be made (")
