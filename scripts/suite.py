"""Runs the tests as `make test` does: side by side, then those by the wall clock, then once more and alone what failed.

    python scripts/suite.py [--workers 2] [--ignore PATH]... [ARGUMENTS OF PYTEST]

A test that fails beside others and passes alone does not fail the run: its name is printed. Whatever else goes wrong does: a test that
fails twice, a module that cannot be collected, a process of tests that dies, an error of pytest itself.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

PASSED, FAILED, INTERRUPTED, NOTHING_SELECTED = 0, 1, 2, 5
#: `.ci/run` looks for these lines.
AGAIN = "--- once more, alone"
ALONE = "failed beside other tests, passed alone: "

Run = Callable[[Sequence[str]], int]


def pytest(arguments: Sequence[str]) -> int:
    """Exit status of pytest in a process of its own."""
    return subprocess.run([sys.executable, "-m", "pytest", *arguments]).returncode


def by_the_clock(folder: Path) -> list[str]:
    """Files with tests that need the wall clock."""
    return [str(f) for f in sorted(folder.rglob("test_*.py")) if "mark.wallclock" in f.read_text()]


def suite(workers: int, arguments: Sequence[str], cache: Path, run: Run = pytest, ignored: Sequence[str] = ()) -> int:
    """Exit status of the whole; ``cache`` is an empty directory, in which pytest remembers what failed; of ``ignored`` files those
    tests run alone that need the wall clock."""
    remember = ["-o", f"cache_dir={cache}"]
    # each process would rewrite all assertions to explain those that fail: variables do, and what fails is run once more
    terse = ["--assert", "plain", "--showlocals"]
    # "worksteal" leaves the tests of a module with one process, so that what they share is made once
    beside = [*terse, "-n", str(workers), "--dist", "worksteal", "-m", "not wallclock"]
    beside += [f"--ignore={path}" for path in ignored]
    status = [run([*remember, *beside, *arguments])]
    # other tests would take the time of these
    if late := arguments or by_the_clock(Path("tests")):
        status.append(run([*remember, "-m", "wallclock", *late]))
    wrong = [s for s in status if s not in (PASSED, NOTHING_SELECTED)]
    if not wrong:
        return max(status) if min(status) == NOTHING_SELECTED else PASSED
    if any(s != FAILED for s in wrong):
        return max(wrong)
    record = cache / "v/cache/lastfailed"
    names = sorted(json.loads(record.read_text()))
    print(f"{AGAIN}: {len(names)} of the tests", flush=True)
    again = run([*remember, "--last-failed", "--last-failed-no-failures", "none", *arguments])
    left = json.loads(record.read_text()) if record.exists() else {}
    for name in names:
        if again in (PASSED, FAILED) and name not in left:
            print(f"!!! {ALONE}{name}", flush=True)
    return again


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    parser.add_argument("--workers", type=int, default=2, help="test processes")
    parser.add_argument("--ignore", action="append", default=[], help="a path whose tests have been run")
    known, arguments = parser.parse_known_args()
    with tempfile.TemporaryDirectory() as cache, suppress(KeyboardInterrupt):
        return suite(known.workers, arguments, Path(cache), ignored=known.ignore)
    return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
