"""Builds the source distribution and, of that, the wheel; checks what is in them and runs tests of the unpacked source.

Call it with the Python of an environment that has the test dependencies: ``.venv/bin/python .ci/package.py``.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
#: What is run, in seconds: tests that ask what is installed, or where this is, or git, which the unpacked source is not in. All others
#: are those of the commit, where they run anyhow: its files are the same (:func:`check_source`).
TESTS = (
    "tests/test_public_api.py::test_the_public_names_and_signatures_are_those_of_the_file",
    "tests/test_documents.py",
    "tests/test_settings_listed.py",
    "tests/test_experiments.py",
    "tests/test_figures.py",
    "tests/test_gallery_page.py",
    "tests/benchmark/test_obstacle_peers.py",
    "tests/ros2/test_settings.py",
)
#: What a wheel consists of, at its top.
PARTS = {"wbmpc", "wbmpc-{version}.dist-info"}
NEEDED = (
    "wbmpc/py.typed",
    "wbmpc/robots/data/rezero.yaml",
    "wbmpc/robots/data/rezero.xml",
    "wbmpc/studies/__init__.py",
)
FOREIGN = ("tests", "benchmarks", "docs", "examples")


def run(*command: object, **options: object) -> None:
    """A command that must succeed."""
    subprocess.run([str(c) for c in command], check=True, **options)  # type: ignore[call-overload]


def build(folder: Path) -> tuple[Path, Path]:
    """Source distribution and wheel of the last commit, made by `build`."""
    archive, checkout = folder / "commit.tar", folder / "checkout"
    run("git", "-C", ROOT, "archive", "--output", archive, "HEAD")
    with tarfile.open(archive) as tar:
        tar.extractall(checkout, filter="data")
    environment = folder / "environment"
    run(sys.executable, "-m", "venv", "--without-pip", environment)
    pip = (sys.executable, "-m", "pip", "--python", environment / "bin/python", "--disable-pip-version-check")
    run(*pip, "install", "--quiet", "build", "setuptools>=77")
    run(
        environment / "bin/python", "-m", "build", "--no-isolation", "--outdir", folder / "dist", checkout,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    return next((folder / "dist").glob("*.tar.gz")), next((folder / "dist").glob("*.whl"))


def check_wheel(names: list[str], version: str) -> list[str]:
    """What is wrong with the files of a wheel."""
    tops = {name.split("/")[0] for name in names} - {p.format(version=version) for p in PARTS}
    folders = {part for name in names for part in name.split("/")[:-1]}
    return [
        *(f"wheel: '{top}' does not belong in it" for top in sorted(tops)),
        *(f"wheel: '{name}' is missing" for name in NEEDED if name not in names),
        *(f"wheel: it has a folder '{name}'" for name in FOREIGN if name in folders),
    ]


def check_source(unpacked: Path, commit: Path) -> list[str]:
    """What of the last commit, an archive, is not in the source distribution, or is something else there."""
    wrong = []
    with tarfile.open(commit) as tar:
        for member in (m for m in tar if m.isfile()):
            copy, content = unpacked / member.name, tar.extractfile(member)
            if not copy.is_file():
                wrong.append(f"source distribution: '{member.name}' is missing")
            elif content is None or copy.read_bytes() != content.read():
                wrong.append(f"source distribution: '{member.name}' is not that of the commit")
    return wrong


def test_source(unpacked: Path) -> None:
    """Some tests are run, of the unpacked source and nothing else."""
    environment = {**os.environ, "PYTHONPATH": str(unpacked / "src"), "OPENBLAS_NUM_THREADS": "1"}
    # what fails is explained where it fails at the commit
    pytest = (sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "--assert", "plain")
    run(*pytest, *TESTS, cwd=unpacked, env=environment)


def main() -> int:
    """0 if all is well."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        source, wheel = build(folder)
        version = wheel.name.split("-")[1]
        with tarfile.open(source) as tar:
            tar.extractall(folder / "unpacked", filter="data")
        unpacked = next((folder / "unpacked").iterdir())
        wrong = check_source(unpacked, folder / "commit.tar")
        with zipfile.ZipFile(wheel) as archive:
            wrong += check_wheel(archive.namelist(), version)
        for line in wrong:
            print(line, file=sys.stderr)
        if not wrong:
            test_source(unpacked)
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
