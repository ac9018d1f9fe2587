"""Recordings that reach their size, and disks that are full. Truth: the messages that were written; limits of the system."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from command_line import shell
from wbmpc.cli import main
from wbmpc.cli.directories import size_of
from wbmpc.errors import InputError
from wbmpc.recording.reader import read_recording
from wbmpc.recording.writer import McapFile

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
    for gone, where in ((False, "is in run-1.mcap"), (True, "was overwritten")):
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
