"""Cached machine code runs: it counts only where nobody but the user can have put it. Truth: what the file system says of
owners and modes, and a sentinel as the entry's content."""

from __future__ import annotations

import logging
import os
import stat
from collections.abc import Callable
from pathlib import Path

import pytest

from toys import LinearQuadratic
from wbmpc.benchmark.program import compiled_library, compiler, library_folder
from wbmpc.kernel import build_kernel, cache
from wbmpc.kernel.library import Library
from wbmpc.ocp import Transcription

CODE = b"machine code of somebody"
SOMEBODY = 12345

needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")


@pytest.fixture(autouse=True)
def warn_again() -> None:
    cache._warn.cache_clear()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache with the entry "key"."""
    monkeypatch.setenv("WBMPC_CACHE_DIR", str(tmp_path / "above" / "cache"))
    cache.save("key", CODE, {"nx": 1})
    return tmp_path / "above" / "cache"


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


@pytest.mark.parametrize("umask", [0o000, 0o002, 0o022, 0o077])
def test_what_is_made_is_the_users_alone_whatever_the_umask(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, umask: int
) -> None:
    monkeypatch.setenv("WBMPC_CACHE_DIR", str(tmp_path / "missing" / "cache"))
    previous = os.umask(umask)
    try:
        cache.save("key", CODE, {})
        below = cache.trusted_folder("below")
    finally:
        os.umask(previous)
    made = tmp_path / "missing" / "cache"
    assert mode(made.parent) == mode(made) == mode(below) == 0o700
    assert mode(made / "key.bin") == 0o600
    assert cache.load("key") == (CODE, {})


@pytest.mark.parametrize("given", [0o700, 0o755, 0o750, 0o555])
def test_a_directory_that_others_may_only_read_is_used(folder: Path, given: int) -> None:
    folder.chmod(given)
    (folder / "key.bin").chmod(0o644)
    assert cache.load("key") == (CODE, {"nx": 1})


def foreign_link(folder: Path) -> None:
    folder.rename(folder.with_name("moved"))
    folder.symlink_to(folder.with_name("moved"))
    os.chown(folder, SOMEBODY, SOMEBODY, follow_symlinks=False)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda folder: folder.chmod(0o775), "0775"),
        (lambda folder: folder.chmod(0o1777), "1777"),
        (lambda folder: folder.chmod(0o702), "0702"),
        pytest.param(lambda folder: os.chown(folder, SOMEBODY, -1), str(SOMEBODY), marks=needs_root),
        pytest.param(foreign_link, str(SOMEBODY), marks=needs_root),
    ],
)
def test_a_directory_that_others_can_change_is_neither_read_nor_written(
    folder: Path, spoil: Callable[[Path], None], reason: str, caplog: pytest.LogCaptureFixture
) -> None:
    spoil(folder)
    previous = sorted(p.name for p in folder.iterdir())
    assert cache.load("key") is None
    cache.save("other", CODE, {})
    assert cache.load("other") is None
    assert sorted(p.name for p in folder.iterdir()) == previous
    assert len(caplog.records) == 1  # once
    assert str(folder) in caplog.text and reason in caplog.text and "compiled in memory" in caplog.text


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda above: above.chmod(0o777), "0777"),
        (lambda above: above.chmod(0o770), "0770"),
        pytest.param(lambda above: os.chown(above, SOMEBODY, -1), str(SOMEBODY), marks=needs_root),
        pytest.param(
            lambda above: (os.chown(above, SOMEBODY, -1), above.chmod(0o1777)), str(SOMEBODY), marks=needs_root
        ),
    ],
)
@pytest.mark.parametrize("levels", [1, 2])
def test_a_directory_that_others_can_replace_is_neither_read_nor_written(
    folder: Path, spoil: Callable[[Path], None], reason: str, levels: int, caplog: pytest.LogCaptureFixture
) -> None:
    """Who may write to a directory above may rename the cache and put another in its place."""
    spoil(folder.parents[levels - 1])
    previous = sorted(p.name for p in folder.iterdir())
    assert cache.load("key") is None
    cache.save("other", CODE, {})
    with pytest.raises(cache.UntrustedCache):
        cache.trusted_folder("below")
    assert sorted(p.name for p in folder.iterdir()) == previous
    assert len(caplog.records) == 1  # once
    assert str(folder.parents[levels - 1]) in caplog.text and reason in caplog.text


def test_a_directory_below_one_with_the_sticky_bit_is_used(folder: Path) -> None:
    """As below /tmp: others may add to it, and not rename what is there."""
    folder.parent.chmod(0o1777)
    assert cache.load("key") == (CODE, {"nx": 1})


def test_a_link_leads_to_where_others_can_replace_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    """It counts where a directory is."""
    (tmp_path / "way").symlink_to(folder.parent)
    monkeypatch.setenv("WBMPC_CACHE_DIR", str(tmp_path / "way" / "cache"))
    assert cache.load("key") == (CODE, {"nx": 1}) and cache.trusted_folder("below") == folder / "below"
    folder.parent.chmod(0o777)
    assert cache.load("key") is None


@pytest.mark.parametrize(
    "spoil",
    [
        lambda open_to_all: open_to_all.chmod(0o777),
        pytest.param(lambda own: (own.chmod(0o1777), os.lchown(own / "way", SOMEBODY, -1)), marks=needs_root),
    ],
)
def test_a_link_that_others_can_replace_is_no_way_to_a_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: Path, spoil: Callable[[Path], None]
) -> None:
    """It counts by which way it is reached, too: the link may lead elsewhere when the file is opened."""
    (tmp_path / "between").mkdir()
    (tmp_path / "between" / "way").symlink_to(folder.parent)
    monkeypatch.setenv("WBMPC_CACHE_DIR", str(tmp_path / "between" / "way" / "cache"))
    assert cache.load("key") == (CODE, {"nx": 1})
    spoil(tmp_path / "between")
    previous = sorted(folder.iterdir())
    assert cache.load("key") is None
    cache.save("other", CODE, {})
    assert sorted(folder.iterdir()) == previous


@pytest.mark.parametrize(
    "spoil",
    [
        lambda between: between.chmod(0o777),
        lambda between: between.chmod(0o770),
        pytest.param(lambda between: os.chown(between, SOMEBODY, -1), marks=needs_root),
        pytest.param(
            lambda between: (between.chmod(0o1777), os.lchown(between / "on", SOMEBODY, -1)), marks=needs_root
        ),
    ],
)
@pytest.mark.parametrize("relative", [False, True])
def test_every_link_of_several_is_on_the_way(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: Path, spoil: Callable[[Path], None], relative: bool
) -> None:
    """way -> between/on -> the cache's directory: "between" is neither in the path as it is written nor in the one without links."""
    between = tmp_path / "between"
    between.mkdir()
    (between / "on").symlink_to(Path("../above") if relative else folder.parent)
    (tmp_path / "way").symlink_to(Path("between/../between/on") if relative else between / "on")
    monkeypatch.setenv("WBMPC_CACHE_DIR", str(tmp_path / "way" / "cache"))
    assert cache.load("key") == (CODE, {"nx": 1}) and cache.trusted_folder("below") == folder / "below"
    spoil(between)
    assert cache.load("key") is None
    cache.save("other", CODE, {})
    with pytest.raises(cache.UntrustedCache, match=str(between)):
        cache.trusted_folder("other")
    assert sorted(p.name for p in folder.iterdir()) == ["below", "key.bin"]


def test_directories_that_can_be_searched_alone_are_a_way(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As homes of others are; and from a directory as the system has it, ".." behind a link included."""
    folder.parent.chmod(0o311)
    assert cache.load("key") == (CODE, {"nx": 1})
    folder.parent.chmod(0o711)
    (tmp_path / "link").symlink_to(folder)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("WBMPC_CACHE_DIR", "link/../cache")
    assert cache.load("key") == (CODE, {"nx": 1})
    monkeypatch.setenv("WBMPC_CACHE_DIR", str(tmp_path / "loop" / "cache"))
    (tmp_path / "loop").symlink_to("loop")
    cache.save("other", CODE, {})  # a warning
    assert cache.load("other") is None


def test_nothing_is_made_where_others_can_replace_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    monkeypatch.setenv("WBMPC_CACHE_DIR", str(tmp_path / "open" / "more" / "cache"))
    cache.save("key", CODE, {})
    assert not list((tmp_path / "open").iterdir())


def linked(file: Path) -> None:
    file.rename(file.with_name("elsewhere"))
    file.symlink_to(file.with_name("elsewhere"))


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda file: file.chmod(0o620), "0620"),
        (lambda file: file.chmod(0o606), "0606"),
        (linked, "is a link"),
        pytest.param(lambda file: os.chown(file, SOMEBODY, -1), str(SOMEBODY), marks=needs_root),
    ],
)
def test_an_entry_that_others_can_have_written_is_replaced_by_an_own_one(
    folder: Path, spoil: Callable[[Path], None], reason: str, caplog: pytest.LogCaptureFixture
) -> None:
    spoil(folder / "key.bin")
    assert cache.load("key") is None and cache.load("key") is None
    assert len(caplog.records) == 1 and str(folder / "key.bin") in caplog.text and reason in caplog.text
    cache.save("key", CODE[::-1], {})
    assert cache.load("key") == (CODE[::-1], {})
    found = (folder / "key.bin").lstat()
    assert stat.S_ISREG(found.st_mode) and found.st_uid == os.geteuid() and stat.S_IMODE(found.st_mode) == 0o600
    if reason == "is a link":  # nothing was written through it
        assert CODE in (folder / "elsewhere").read_bytes()


def test_an_own_link_to_an_own_directory_is_followed(folder: Path) -> None:
    """Caches are moved to larger disks that way."""
    folder.rename(folder.with_name("moved"))
    folder.symlink_to(folder.with_name("moved"))
    assert cache.load("key") == (CODE, {"nx": 1})


def test_kernels_and_translated_functions_are_compiled_in_memory(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    problem = Transcription(LinearQuadratic(2, 1, 1).problem())

    def driver() -> Library:
        library = Library("owner", packages=("kernel",))
        library.compiled(_twice)
        return library

    assert not build_kernel(problem).from_cache and build_kernel(problem).from_cache
    assert driver().functions[0](2.0) == 4.0
    entries = {p: p.read_bytes() for p in folder.iterdir()}
    assert len(entries) == 4  # machine code and optimized bitcode of each
    folder.chmod(0o777)
    for _ in range(2):
        assert not build_kernel(problem).from_cache
        assert driver().functions[0](3.0) == 6.0
    assert {p: p.read_bytes() for p in folder.iterdir()} == entries
    assert len([r for r in caplog.records if r.levelno == logging.WARNING]) == 1


def _twice(x: float) -> float:
    return 2.0 * x


def test_libraries_of_the_c_compiler_are_kept_in_a_safe_place_only(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    assert library_folder() == folder / "peers" and mode(folder / "peers") == 0o700
    (folder / "peers").chmod(0o777)
    assert folder not in library_folder().parents and mode(library_folder()) == 0o700
    assert library_folder() == library_folder() and str(folder / "peers") in caplog.text


@pytest.mark.skipif(compiler() is None, reason="no C compiler")
def test_a_library_that_others_can_have_written_is_made_again(folder: Path) -> None:
    made = compiled_library({})
    assert isinstance(made, Path)
    good = made.read_bytes()
    made.write_bytes(b"of somebody")
    assert compiled_library({}) == made and made.read_bytes() == b"of somebody"  # trusted, as the user's own
    made.chmod(0o777)
    assert compiled_library({}) == made and made.read_bytes()[:4] == good[:4] == b"\x7fELF"
