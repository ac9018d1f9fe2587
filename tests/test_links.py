"""Links in a directory for files whose names are the command's: what they lead to stays. Truth: the file system."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace

import pytest

import wbmpc as wb
from clearing import write_arm
from command_line import call
from fake_experiment import FAKE, FakeSettings
from wbmpc.output_file import write_text
from wbmpc.recording.writer import McapFile
from wbmpc.report import RUN_FILES, write_run
from wbmpc.reproduce import _clip
from wbmpc.tasks.simulation import _directory

pytestmark = pytest.mark.usefixtures("empty_directory")


@pytest.fixture(params=["there", "missing"])
def precious(request: pytest.FixtureRequest) -> Path:
    """Where links lead: a file of the user's, or nothing yet."""
    Path("out").mkdir()
    path = Path("precious")
    if request.param == "there":
        path.write_text("mine")
    return path


def is_untouched(path: Path, before: bool) -> bool:
    return path.read_text() == "mine" if before else not path.exists()


@pytest.mark.parametrize("name", ["controller.o", "README.md", "expected.txt"])
def test_an_export_writes_no_file_that_a_link_leads_to(
    name: str, precious: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = precious.exists()
    Path("problem.py").write_text("def make_mpc():\n    raise AssertionError('links are seen first')\n")
    (Path("out") / name).symlink_to("../precious")
    arguments = ["export", "problem.py", "--out", "out", *(["--check"] if name == "expected.txt" else [])]
    for more in ([], ["--force"]):
        assert call(*arguments, *more) == 2
        assert f"--out: 'out/{name}' is a link" in capsys.readouterr().err
    assert is_untouched(precious, before)


def test_tables_of_a_recording_are_not_written_where_a_link_leads(
    precious: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = precious.exists()
    recorded("run.mcap")
    Path("out/mode.csv").symlink_to("../precious")
    assert call("log", "export", "run.mcap", "/mode", "--out", "out", "--force") == 2
    assert "--out: 'out/mode.csv' is a link" in capsys.readouterr().err
    assert is_untouched(precious, before)


def recorded(path: str) -> None:
    recording = McapFile(Path(path))
    recording.put("/mode", "std_msgs/String", 0.0, {"data": "H"})
    recording.close()


#: Commands whose file has a name of their own, and that name.
DEFAULTS = {
    "plots.html": ("log", "plot", "run.mcap"), "foxglove.json": ("log", "layout", "run.mcap"), "export": ("log", "export", "run.mcap", "/mode"),
    "compare.html": ("compare", "run.mcap", "run.mcap"), "arm.yaml": ("new", "arm.xml", "--yes"),
}  # fmt: skip


@pytest.mark.parametrize("name", DEFAULTS)
def test_names_that_the_user_has_not_given_do_not_lead_elsewhere(
    name: str, precious: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A run that somebody else has packed may hold links; what --out names is the user's own choice."""
    before = precious.exists()
    recorded("run.mcap")
    write_arm(Path())
    Path("arm.yaml").unlink()
    if name == "export":
        Path("elsewhere").mkdir()
    Path(name).symlink_to("elsewhere" if name == "export" else "precious")
    assert call(*DEFAULTS[name], "--force") == 2
    assert f"--out: '{name}' is a link" in capsys.readouterr().err
    assert is_untouched(precious, before) and (name != "export" or not list(Path("elsewhere").iterdir()))
    assert Path(name).is_symlink()
    if name == "compare.html":
        assert call(*DEFAULTS[name], "--force", "--out", name) == 0
        assert Path(name).is_symlink() and len(precious.read_text()) > len("mine")


def test_the_calibration_of_a_run_is_not_written_where_a_link_leads(
    precious: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor where one is put while it is found."""
    before, module = precious.exists(), "wbmpc.cli.calibration"
    link = lambda: Path("calibration.yaml").symlink_to("precious")
    save = lambda path, follow: write_text(path, "found", follow)
    found = SimpleNamespace(save=save, table=dict, lines=list)
    calibrator = SimpleNamespace(find=lambda *_, **__: link() or found)
    monkeypatch.setattr(f"{module}._channels", lambda path: ({}, path))
    monkeypatch.setattr(f"{module}._calibrator_of", lambda *_: calibrator)
    Path("log.npz").touch()
    for _ in range(2):
        assert call("calibrate", "log.npz", "--force") == 2
        assert "--out: 'calibration.yaml' is a link" in capsys.readouterr().err
        assert is_untouched(precious, before)
    Path("calibration.yaml").unlink()
    calibrator.find = lambda *_, **__: found
    monkeypatch.setattr(f"{module}.reject_links", lambda *_: link())  # in the moment after
    assert call("calibrate", "log.npz", "--force") == 0
    assert is_untouched(precious, before) and Path("calibration.yaml").read_text() == "found"


@pytest.mark.parametrize("name", ["metrics.json", "log.npz", "report.html"])
def test_a_link_that_is_put_where_a_run_writes_later_is_replaced(
    name: str, precious: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While the run goes on: the directory was free of it when it was chosen."""
    before, file = precious.exists(), Path("out") / name
    result = FAKE.run(FakeSettings(), 7)
    file.symlink_to("../precious")
    write_run(result, Path("out"))
    assert is_untouched(precious, before) and not file.is_symlink() and file.stat().st_size > 1000


def test_a_clip_of_an_experiment_is_not_drawn_where_a_link_leads(
    precious: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, job = precious.exists(), SimpleNamespace(name="task", done=True, directory=Path(), mark=Path("out"))
    Path("out/task").mkdir()
    Path("out/task/clip.mp4").symlink_to("../../precious")
    monkeypatch.setattr("wbmpc.recording.reader.read_recording", lambda path: path)
    monkeypatch.setattr("wbmpc.view.replay.Film", lambda recording: recording)
    monkeypatch.setattr("wbmpc.view.render.render", lambda film, path, *_: path.write_text("film"))
    assert "<video" in _clip([job], "task", Path("out"), True)  # type: ignore[list-item]
    assert is_untouched(precious, before) and Path("out/task/clip.mp4").read_text() == "film"


def test_a_link_to_what_is_no_file_is_replaced_too(precious: Path) -> None:
    """A pipe would wait for its reader, a directory would have the file in it."""
    os.mkfifo("pipe")
    for name in ("pipe", "out"):
        Path("link").symlink_to(name)
        write_text(Path("link"), "new", follow=False)
        assert not Path("link").is_symlink() and Path("link").read_text() == "new"
        Path("link").unlink()
    assert not list(Path("out").iterdir()) and Path("pipe").is_fifo()


def test_a_recording_is_not_written_where_a_link_leads(precious: Path) -> None:
    before = precious.exists()
    Path("run.mcap").symlink_to("precious")
    with pytest.raises(OSError, match="symbolic link"):
        McapFile(Path("run.mcap"))
    assert is_untouched(precious, before)


@pytest.mark.parametrize("name", [*RUN_FILES, "weights.yaml"])
def test_a_run_beside_a_link_has_a_directory_of_its_own(name: str, precious: Path) -> None:
    """Also by the name of the file that only a run with a view writes, at its end."""
    before = precious.exists()
    (Path("out") / name).symlink_to("../precious")
    assert call("run", "fake", "--out", "out", "--quiet") == 0
    assert [p.name for p in Path("out").iterdir()] == [name] and Path("out-2/metrics.json").is_file()
    assert is_untouched(precious, before)


@pytest.mark.parametrize("name", RUN_FILES)
def test_a_simulation_does_not_go_where_a_link_is(name: str, precious: Path) -> None:
    (Path("out") / name).symlink_to("../precious")
    with pytest.raises(wb.InputError, match="has a run already"):
        _directory("out")
