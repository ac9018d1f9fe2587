"""Links in a directory for files whose names are the command's: what they lead to stays. Truth: the file system."""

from __future__ import annotations

from pathlib import Path

import pytest

import wbmpc as wb
from command_line import call
from wbmpc.recording.writer import McapFile
from wbmpc.report import RUN_FILES
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
    recording = McapFile(Path("run.mcap"))
    recording.put("/mode", "std_msgs/String", 0.0, {"data": "H"})
    recording.close()
    Path("out/mode.csv").symlink_to("../precious")
    assert call("log", "export", "run.mcap", "/mode", "--out", "out", "--force") == 2
    assert "--out: 'out/mode.csv' is a link" in capsys.readouterr().err
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
