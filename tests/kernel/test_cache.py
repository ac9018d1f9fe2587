"""The cache of compiled code. Truth: the file system, and the code that runs."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from effort import thorough
from toys import LinearQuadratic
from wbmpc.errors import InputError
from wbmpc.kernel import build_kernel, cache
from wbmpc.model.ode import Ode
from wbmpc.ocp import (
    Constraint,
    Cost,
    OptimalControlProblem,
    Quadratic,
    RelaxedBarrier,
    SmoothL1,
    Transcription,
    residuals,
    sets,
)
from wbmpc.solver import SQP, Solver


def transcription(seed: int = 0) -> Transcription:
    return Transcription(LinearQuadratic(3, 2, 1, seed=seed).problem())


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("WBMPC_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


def solve(use_cache: bool = True) -> np.ndarray:
    lq = LinearQuadratic(3, 2, 1)
    solver = Solver(lq.problem(), SQP(iterations=20), use_cache=use_cache)
    return solver.solve(lq.x0).u


def test_second_build_comes_from_the_cache(folder: Path) -> None:
    assert not build_kernel(transcription()).from_cache
    assert build_kernel(transcription()).from_cache
    assert not build_kernel(transcription(), use_cache=False).from_cache
    assert not build_kernel(transcription(seed=1)).from_cache
    assert len(list(folder.iterdir())) == 2  # nothing half-written stays behind
    np.testing.assert_array_equal(solve(), solve(use_cache=False))


@pytest.mark.parametrize("damage", ["truncated", "flipped", "empty", "short", "text"])
def test_damaged_files_are_built_again(folder: Path, damage: str, caplog: pytest.LogCaptureFixture) -> None:
    build_kernel(transcription())
    (file,) = folder.glob("*.bin")
    good = file.read_bytes()
    flipped = bytearray(good)
    flipped[len(good) // 2] ^= 1
    bad = {"truncated": good[:-100], "flipped": bytes(flipped), "empty": b"", "short": good[:20], "text": b"x" * 500}
    file.write_bytes(bad[damage])
    assert not build_kernel(transcription()).from_cache
    assert "is damaged or of another problem: it is built again" in caplog.text and str(file) in caplog.text
    assert file.read_bytes()[:32] == good[:32]
    assert build_kernel(transcription()).from_cache


def test_an_entry_larger_than_the_memory_is_built_again(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    """As a file system leaves one that lost its length; nothing of it is on the disk."""
    build_kernel(transcription())
    (file,) = folder.glob("*.bin")
    size = file.stat().st_size
    os.truncate(file, 2**43)
    assert not build_kernel(transcription()).from_cache
    assert "is damaged or of another problem: it is built again" in caplog.text
    assert file.stat().st_size == size and build_kernel(transcription()).from_cache


def test_a_whole_entry_under_another_name_is_built_again(folder: Path) -> None:
    built = build_kernel(transcription())
    (file,) = folder.glob("*.bin")
    code, description = cache.load(file.stem)  # type: ignore[misc]
    cache.save("of-another-problem", code[::-1], description)
    file.write_bytes((folder / "of-another-problem.bin").read_bytes())
    assert cache.load(file.stem) is None  # before it is run
    assert not built.from_cache and not build_kernel(transcription()).from_cache
    assert cache.load(file.stem) == (code, description)


@pytest.mark.parametrize(
    "text",
    [b"", b"{", b"[1]", b"null", b'"sizes"', b"\xff\xfe", b"NaN", b'{"sizes": {"nx": ' + b"[" * 100_000],
    ids=range(8),
)
def test_an_entry_that_describes_nothing_is_built_again(
    folder: Path, text: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    """Its hash is right: who wrote it was wrong."""
    build_kernel(transcription())
    (file,) = folder.glob("*.bin")
    good = cache.load(file.stem)
    for length in (len(text), 2**63):
        body = length.to_bytes(8, "little") + text + b"code"
        file.write_bytes(cache._digest(file.stem, body) + body)
        caplog.clear()
        assert cache.load(file.stem) is None and f"{file} is damaged" in caplog.text
        assert not build_kernel(transcription()).from_cache
        assert cache.load(file.stem) == good


@pytest.mark.parametrize("nx", ["3", None, 3.0, -3, [3]])
def test_an_entry_whose_sizes_are_none_is_built_again(
    folder: Path, nx: object, caplog: pytest.LogCaptureFixture
) -> None:
    build_kernel(transcription())
    (file,) = folder.glob("*.bin")
    code, good = cache.load(file.stem)  # type: ignore[misc]
    cache.save(file.stem, code, {**good, "sizes": {**good["sizes"], "nx": nx}})
    assert not build_kernel(transcription()).from_cache and f"{file} is damaged" in caplog.text
    assert cache.load(file.stem) == (code, good)


@pytest.mark.parametrize("description", [{}, {"nx": 3}, {"target": "other cpu", "sizes": {}}, {"sizes": {"nx": 1}}])
def test_an_entry_of_another_format_or_machine_is_built_again(folder: Path, description: dict) -> None:
    build_kernel(transcription())
    (file,) = folder.glob("*.bin")
    code, good = cache.load(file.stem)  # type: ignore[misc]
    cache.save(file.stem, b"not machine code", description)
    assert not build_kernel(transcription()).from_cache
    assert cache.load(file.stem) == (code, good)
    assert build_kernel(transcription()).from_cache


RACE = """
from toys import LinearQuadratic
from wbmpc.kernel import build_kernel
from wbmpc.ocp import Transcription
build_kernel(Transcription(LinearQuadratic(3, 2, 1).problem()))
"""


def test_two_processes_that_start_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    paths = os.pathsep.join([str(Path(__file__).parents[1]), *sys.path])
    environment = {**os.environ, "WBMPC_CACHE_DIR": str(tmp_path / "new"), "PYTHONPATH": paths}
    command = [sys.executable, "-W", "error", "-c", RACE]
    both = [
        subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    done = [p.communicate(timeout=120) for p in both]
    assert all(p.returncode == 0 for p in both), done
    assert len(list((tmp_path / "new").iterdir())) == 1  # nothing half-written
    monkeypatch.setenv("WBMPC_CACHE_DIR", str(tmp_path / "new"))
    assert build_kernel(transcription()).from_cache


def test_a_leftover_temporary_file_does_no_harm(folder: Path) -> None:
    folder.mkdir(parents=True)
    (folder / "tmpabc").write_bytes(b"half")
    assert not build_kernel(transcription()).from_cache
    assert build_kernel(transcription()).from_cache


def test_concurrent_writers_leave_a_valid_entry(folder: Path) -> None:
    for code in (b"one" * 100, b"two" * 100):
        cache.save("key", code, {"nx": 1})
    assert cache.load("key") == (b"two" * 100, {"nx": 1})
    assert cache.load("other") is None


@pytest.mark.parametrize("thing", ["folder", "pipe", "dangling link", "locked"])
def test_what_is_no_file_is_bypassed_and_nothing_piles_up(folder: Path, thing: str) -> None:
    build_kernel(transcription())
    (file,) = folder.glob("*.bin")
    file.unlink()
    {
        "folder": file.mkdir,
        "pipe": lambda: os.mkfifo(file),
        "dangling link": lambda: file.symlink_to("/nonexistent/place"),
        "locked": lambda: file.touch(0),
    }[thing]()
    for again in (False, thing != "folder"):  # a folder in its place cannot be replaced
        assert build_kernel(transcription()).from_cache == again
    assert list(folder.iterdir()) == [file]


def test_a_full_disk_is_reported_once_and_leaves_nothing(tmp_path: Path) -> None:
    code = """
import resource, signal
from wbmpc.kernel import cache
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
for key in ("one", "two"):
    cache.save(key, b"code" * 1000, {})
assert cache.load("one") is None
"""
    environment = {**os.environ, "WBMPC_CACHE_DIR": str(tmp_path / "new"), "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], env=environment, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("cannot be kept in") == 1 and str(tmp_path / "new") in done.stderr
    assert list((tmp_path / "new").iterdir()) == []


def test_directory_names(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("WBMPC_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache.cache_directory() == tmp_path / "wbmpc"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("WBMPC_CACHE_DIR", "~/elsewhere")
    assert cache.cache_directory() == tmp_path / "elsewhere"
    monkeypatch.setenv("WBMPC_CACHE_DIR", "~no-such-user-at-all/cache")
    with pytest.raises(InputError, match="no-such-user-at-all"):
        cache.cache_directory()
    monkeypatch.delenv("WBMPC_CACHE_DIR")
    assert cache.cache_directory() == Path.home() / ".cache" / "wbmpc"


def test_a_user_without_a_home_has_a_cache_among_temporary_files(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("WBMPC_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)

    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", homeless)
    assert cache.cache_directory() == Path(tempfile.gettempdir()) / f"wbmpc-{os.geteuid()}"


@dataclass(frozen=True)
class Stiff(Quadratic):
    """½ r² with another Gauss-Newton curvature."""

    factor: float = 2.0

    def curvature(self, r: ca.SX) -> ca.SX:
        return self.factor * ca.SX.ones(r.shape)


def test_norms_belong_to_the_key(folder: Path) -> None:
    """Gauss-Newton curvature is not in the values; norms of the same value and other curvature share no entry."""
    lq = LinearQuadratic(3, 2, 0)

    def problem(norm: object, mu: float) -> OptimalControlProblem:
        ocp = lq.problem()
        residual = ocp.terms["path"].residual
        ocp.add(Cost("more", residual, 1.0, norm=norm))
        ocp.add(Constraint("soft", residual, sets.NonNegative(), penalty=RelaxedBarrier(mu, 0.1)))
        return ocp

    norms = (SmoothL1(1.0), SmoothL1(2.0), Quadratic(), Stiff(), Stiff(3.0))
    for norm, mu in (*((n, 0.1) for n in norms), (SmoothL1(1.0), 0.2)):
        assert not build_kernel(Transcription(problem(norm, mu))).from_cache
        assert build_kernel(Transcription(problem(norm, mu))).from_cache


def test_the_integrator_belongs_to_the_key(folder: Path) -> None:
    """It is not in the values either, but decides which entries a step's derivative has: a chain of twelve integrators ends in other
    columns by four stages than by two."""

    def gains(integrator: str, use_cache: bool) -> np.ndarray:
        chain = Ode({"x": [str(i) for i in range(12)]}, {"u": ["0"]}, lambda x, u: ca.vertcat(x[1:], u))
        ocp = OptimalControlProblem(chain, 6.0, 6, integrator=integrator)
        ocp.add(Cost("all", residuals.Expression(13, lambda s: ca.vertcat(s.x - 0.3, s.u)), 1.0))
        solver = Solver(ocp, SQP(iterations=1, compute_kkt=False), use_cache=use_cache)
        solver.iterate(np.zeros(12))
        return solver.ws.k.copy()

    for integrator in ("rk2", "rk4"):
        np.testing.assert_array_equal(gains(integrator, True), gains(integrator, False))


SCRIPT = """
from toys import LinearQuadratic
from wbmpc.kernel import build_kernel
from wbmpc.ocp import Transcription
kernel = build_kernel(Transcription(LinearQuadratic(2, 1, 0).problem()))
assert not kernel.from_cache and kernel.addresses.all()
print("built")
"""


@pytest.mark.parametrize("place", ["file", pytest.param("missing_parent_is_file", marks=thorough)])
def test_unwritable_directory_still_works(tmp_path: Path, place: str) -> None:
    """A folder that cannot be made (root may write everywhere, so a file stands in the way)."""
    (tmp_path / "file").write_text("not a folder")
    given = tmp_path / "file" if place == "file" else tmp_path / "file" / "below"
    paths = os.pathsep.join([str(Path(__file__).parents[1]), *sys.path])
    environment = {**os.environ, "WBMPC_CACHE_DIR": str(given), "PYTHONPATH": paths}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", SCRIPT], env=environment, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout == "built\n" and done.stderr.count("cannot be kept in") == 1
    assert (tmp_path / "file").read_text() == "not a folder"
