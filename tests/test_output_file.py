"""Files that are written whole or not at all. Truth: what is in the folder after the system let no file grow on."""

from __future__ import annotations

import json
import os
import resource
import shutil
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from fake_experiment import FAKE, FakeSettings
from wbmpc.errors import NotWritten
from wbmpc.log import Log
from wbmpc.output_file import whole_file, write_text
from wbmpc.recording.export import export
from wbmpc.recording.reader import read_recording
from wbmpc.recording.writer import McapFile
from wbmpc.report import write_run

RNG = np.random.default_rng(1)


@contextmanager
def full_disk(size: int) -> Iterator[None]:
    """No file gets more bytes, in this process and what it starts."""
    previous = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, previous[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, previous)


def save_log(path: Path) -> None:
    log = Log()
    for k in range(200):
        log.add("x", 0.01 * k, RNG.normal(size=20))
    log.save(path)


def save_table(path: Path) -> None:
    with full_disk(resource.RLIM_INFINITY):
        file = McapFile(path.parents[1] / "run.mcap")
        for k in range(300):
            message = {"layout": {"dim": [], "data_offset": 0}, "data": RNG.normal(size=20)}
            file.put("/x", "std_msgs/Float64MultiArray", 0.01 * k, message)
        file.close()
    export(read_recording(path.parents[1] / "run.mcap"), path.suffix[1:], path.parent)


def draw(path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg")
    from wbmpc.view.render import _WRITERS

    with whole_file(path) as partial:
        _WRITERS[path.suffix](partial, (RNG.integers(0, 256, (64, 64, 3), np.uint8) for _ in range(30)), [50] * 30)


WRITERS: dict[str, Callable[[Path], None]] = {
    "page.html": lambda path: write_text(path, "x" * 100_000),
    "log.npz": save_log, "x.csv": save_table, "run.npz": save_table, "a.png": draw, "a.gif": draw, "a.webp": draw, "a.mp4": draw,
}  # fmt: skip


# of a pipe that the library of films leaves open
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("size", [0, 6000])
def test_a_full_disk_leaves_nothing_and_names_the_file(name: str, size: int, tmp_path: Path) -> None:
    path = tmp_path / "out" / name
    path.parent.mkdir()
    with full_disk(size), pytest.raises(NotWritten, match=rf"^{path}: cannot be written \("):
        WRITERS[name](path)
    assert not list(path.parent.iterdir())


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("name", WRITERS)
def test_what_is_there_stays_until_the_new_file_is_whole(name: str, tmp_path: Path) -> None:
    path = tmp_path / "out" / name
    path.parent.mkdir()
    path.write_bytes(b"of yesterday")
    path.chmod(0o640)
    with full_disk(1000), pytest.raises(NotWritten):
        WRITERS[name](path)
    assert path.read_bytes() == b"of yesterday" and os.listdir(path.parent) == [name]
    WRITERS[name](path)
    assert path.stat().st_size > 1000 and os.listdir(path.parent) == [name]
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


@pytest.mark.parametrize("stands", ["file", "link to nowhere", "pipe"])
def test_figures_of_a_run_are_kept_if_something_else_is_in_the_place_of_its_directory(
    stands: str, tmp_path: Path
) -> None:
    """It was put there while the run went on. Truth: the figure that was given."""
    out = tmp_path / "out"
    if stands == "file":
        out.write_text("something else")
    elif stands == "pipe":
        os.mkfifo(out)
    else:
        out.symlink_to(tmp_path / "nowhere")
    result = FAKE.run(FakeSettings(), 7)
    with pytest.raises(NotWritten, match=rf"^{out}: cannot be made .*; the figures of the run are in ") as error:
        write_run(result, out)
    kept = Path(str(error.value).rpartition(" are in ")[2])
    assert json.loads(kept.read_text())["metrics"]["path_length"]["value"] == 20.53
    shutil.rmtree(kept.parent)


def test_an_interrupt_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), whole_file(tmp_path / "a.txt") as partial:
        partial.write_text("half of it")
        raise KeyboardInterrupt
    assert not list(tmp_path.iterdir())


def test_devices_are_written_and_links_stay(tmp_path: Path) -> None:
    write_text(Path("/dev/null"), "x")
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)
    with pytest.raises(NotWritten, match=r"^/dev/full: cannot be written \(No space left on device\)"):
        write_text(Path("/dev/full"), "x")
    (tmp_path / "below").mkdir()
    (tmp_path / "link").symlink_to("below/page.html")
    write_text(tmp_path / "link", "x")
    assert (tmp_path / "link").is_symlink() and (tmp_path / "below" / "page.html").read_text() == "x"


def test_a_pipe_has_no_reader_to_wait_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "page.html")
    with pytest.raises(NotWritten, match=r"page.html: cannot be written \(is a pipe\)"):
        write_text(tmp_path / "page.html", "x")


def test_nobody_knows_where_a_file_is_written_first(tmp_path: Path) -> None:
    """Another user could put a link there, and have what it leads to replaced. Truth: two names, which a process alone would have the same of."""
    with whole_file(tmp_path / "a.html") as first, whole_file(tmp_path / "a.html") as second:
        assert first != second and {first.parent, second.parent} == {tmp_path}
        assert first.suffix == second.suffix == ".html"
        first.write_text("first")
        second.write_text("second")
    assert os.listdir(tmp_path) == ["a.html"] and (tmp_path / "a.html").read_text() == "first"


@pytest.mark.parametrize("letter", ["a", "é", "あ", "\U0001f916", "\udcff"])
def test_names_are_as_long_as_the_file_system_takes(letter: str, tmp_path: Path) -> None:
    """It counts bytes. Truth: the longest name of such letters that the system itself takes."""
    size = len(os.fsencode(letter))
    path = tmp_path / (letter * ((255 - 5) // size) + ".html")
    write_text(path, "whole")
    assert [*tmp_path.iterdir()] == [path] and path.read_text() == "whole"
