"""`make test`: what fails beside other tests and passes alone is named, what else goes wrong fails the run.

Truth: pytest's documented exit statuses, and folders of tests of which it is known what each does.
"""

import importlib.util
import json
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
_spec = importlib.util.spec_from_file_location("suite", ROOT / "scripts" / "suite.py")
assert _spec is not None and _spec.loader is not None
suite = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(suite)

#: Fails, or does something else, in the first process that runs it.
FLAKY = """
import os
from pathlib import Path
def test_flaky():
    here = Path(__file__).with_suffix(".seen")
    seen = here.exists()
    here.touch()
    assert seen
def test_fine(): pass
def test_wrong(): assert 0
"""


def whole(folder: Path, tests: str) -> tuple[int, str, str]:
    """Exit status and output of the script with a file of tests, and the line with which CI closes."""
    ours = (ROOT / "tests" / "conftest.py").read_text()
    hooks = ours[ours.index("DIED = ") : ours.index("@pytest.fixture")]
    (folder / "conftest.py").write_text(f"from typing import Any\nimport pytest\n{hooks}")
    (folder / "test_some.py").write_text(tests)
    done = subprocess.run(
        [sys.executable, ROOT / "scripts" / "suite.py", "--workers", "1"],
        capture_output=True, text=True, cwd=folder,
        env={**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_PLUGINS": "xdist.plugin", "PYTEST_ADDOPTS": ""},
    )  # fmt: skip
    awk = re.search(r"^awk ('.*?') \"\$log\"$", (ROOT / ".ci" / "run").read_text(), re.S | re.M)
    assert awk is not None
    closing = subprocess.run(["sh", "-c", f"awk {awk[1]}"], input=done.stdout, capture_output=True, text=True).stdout
    return done.returncode, done.stdout + done.stderr, closing


def test_what_passes_alone_is_named_and_what_fails_again_fails_the_run(tmp_path: Path) -> None:
    status, out, closing = whole(tmp_path, FLAKY)
    assert status == 1, out
    assert "!!! failed beside other tests, passed alone: test_some.py::test_flaky\n" in out
    assert closing == "2 passed, 1 failed; FAILED BESIDE OTHER TESTS, passed alone: test_some.py::test_flaky\n"


def test_a_process_that_dies_fails_the_run(tmp_path: Path) -> None:
    status, out, closing = whole(tmp_path, FLAKY.replace("assert seen", "seen or os._exit(3)"))
    assert status == 3 and suite.AGAIN not in out, out
    assert closing == "1 passed, 2 failed\n"


@pytest.mark.parametrize(
    ("statuses", "failed", "expected", "calls"),
    [
        ([0, 0], [], 0, 2),
        ([0, 5], [], 0, 2),
        ([5, 0], [], 0, 2),
        ([5, 5], [], 5, 2),
        ([1, 0, 0], ["a"], 0, 3),
        ([0, 1, 0], ["a"], 0, 3),
        ([1, 1, 1], ["a"], 1, 3),
        ([1, 5, 5], ["a"], 5, 3),  # the test is not found again
        ([1, 5, 2], ["a"], 2, 3),
        ([2, 0], ["test_that_cannot_be_imported.py"], 2, 2),
        ([3, 1], ["a"], 3, 2),
        ([1, -11], ["a"], 1, 2),
        ([4, 4], [], 4, 2),
    ],
)
def test_exit_status(tmp_path: Path, statuses: list[int], failed: list[str], expected: int, calls: int) -> None:
    left = list(statuses)

    def run(arguments: Sequence[str]) -> int:
        record = tmp_path / "v" / "cache" / "lastfailed"
        record.parent.mkdir(parents=True, exist_ok=True)
        record.write_text(json.dumps(dict.fromkeys(failed, True)))
        return left.pop(0)

    assert suite.suite(2, ["tests"], tmp_path, run) == expected
    assert len(statuses) - len(left) == calls


def test_what_has_been_run_is_left_out_but_for_tests_by_the_wall_clock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_a.py").write_text("@pytest.mark.wallclock")
    (tmp_path / "tests" / "test_b.py").write_text("")
    called: list[Sequence[str]] = []
    suite.suite(2, [], tmp_path, lambda arguments: called.append(arguments) or 0, ["tests/test_a.py"])
    assert "--ignore=tests/test_a.py" in called[0]
    assert called[1][-3:] == ["-m", "wallclock", str(Path("tests", "test_a.py"))]
