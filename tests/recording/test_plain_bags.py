"""Recordings of `ros2 bag record`, which wbmpc has not made. Truth: written by rosbags."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from wbmpc.cli import main
from wbmpc.errors import InputError
from wbmpc.recording.reader import read_recording
from wbmpc.view.replay import Film

STORE: Any = get_typestore(Stores.ROS2_JAZZY)
START, COUNT = 1_700_000_000, 20


def bag(
    path: Path, storage: StoragePlugin = StoragePlugin.MCAP, topics: tuple[str, ...] = ("/cmd_vel", "/rosout")
) -> Path:
    """A directory as `ros2 bag record` leaves it: speeds, and log lines, of a type that is not known to wbmpc."""
    types = STORE.types
    vector = lambda x: types["geometry_msgs/msg/Vector3"](x=x, y=0.0, z=0.0)
    stamp = types["builtin_interfaces/msg/Time"](sec=START, nanosec=0)
    line = types["rcl_interfaces/msg/Log"](stamp=stamp, level=20, name="n", msg="m", file="f", function="g", line=1)
    with Writer(path, version=9, storage_plugin=storage) as writer:
        for topic in topics:
            said = lambda k, topic=topic: (
                line
                if topic == "/rosout"
                else types["geometry_msgs/msg/Twist"](linear=vector(0.1 * k), angular=vector(0.0))
            )
            to = writer.add_connection(topic, said(0).__msgtype__, typestore=STORE)
            for k in range(COUNT):
                writer.write(to, 10**9 * START + 10**8 * k, STORE.serialize_cdr(said(k), said(k).__msgtype__))
    return path


def test_its_directory_is_a_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = read_recording(bag(tmp_path / "drive"))
    assert found.title == "drive" and found.unknown == {"/rosout": "rcl_interfaces/Log"}
    assert found.table("/cmd_vel").columns["linear.x"] == pytest.approx(0.1 * np.arange(COUNT))
    assert main(["log", "info", str(tmp_path / "drive")]) == 0
    said = capsys.readouterr().out
    assert "not recorded by wbmpc" in said and "seed" not in said
    assert "not read, for their types are not known here: /rosout (rcl_interfaces/Log)" in said


def test_what_a_replay_of_it_lacks_is_said(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"drive_?\S*\.mcap: cannot be drawn: it has no scene .* and no frames \(/tf\); "
    ):
        Film(read_recording(bag(tmp_path / "drive")))


def test_one_in_another_storage_says_so(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a bag in SQLite; 'ros2 bag convert' makes"):
        read_recording(bag(tmp_path / "drive", StoragePlugin.SQLITE3))


def test_one_without_a_topic_that_is_known_names_what_it_has(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["log", "info", str(bag(tmp_path / "drive", topics=("/rosout",)))]) == 0
    assert "not known here: /rosout (rcl_interfaces/Log)" in capsys.readouterr().out


def test_of_several_files_one_is_asked_for(tmp_path: Path) -> None:
    directory = bag(tmp_path / "drive")
    (directory / "drive_1.mcap").write_bytes(next(directory.glob("*.mcap")).read_bytes())
    with pytest.raises(InputError, match=r"holds 2 recordings; give one of them: .*\.mcap, .*\.mcap"):
        read_recording(directory)


def test_two_are_compared_and_json_alone_writes_no_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    runs = [str(bag(tmp_path / name)) for name in ("one", "two")]
    assert main(["compare", *runs, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["page"] is None and not list(tmp_path.glob("*.html"))
    assert main(["compare", *runs, "--json", "--out", "page.html"]) == 0
    assert json.loads(capsys.readouterr().out)["page"] == "page.html" and Path("page.html").is_file()
