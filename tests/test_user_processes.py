"""What users' programs do to the process of a command. Truth: processes of their own, as the operating system has them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from command_line import shell

PROGRAM = """
import atexit, os
from wbmpc.result import Metric, RunResult
from fake_experiment import FAKE
from dataclasses import replace
IMPORT

def run(*arguments):
    RUN
    return FAKE.run(*arguments)

EXPERIMENT = replace(FAKE, name="mine", run=run)
"""


@pytest.mark.parametrize("where", ["IMPORT", "RUN"])
@pytest.mark.parametrize("child", ["None", "1 / 0", "os.fork()", "os._exit(0)"])
def test_a_program_that_forks_is_one_command(where: str, child: str, tmp_path: Path) -> None:
    """The child that comes back from the program does not go on: there is one object on the output, and no complaint."""
    source = PROGRAM.replace(where, f"os.fork() or {child}").replace("IMPORT", "").replace("RUN", "")
    (tmp_path / "mine.py").write_text(source)
    ran = shell("run", str(tmp_path / "mine.py"), "--out", str(tmp_path / "run"), "--json")
    assert ran.returncode == 0 and ran.stderr == ""
    assert json.loads(ran.stdout)["experiment"] == "fake"
    assert not (tmp_path / "run-2").exists()


@pytest.mark.parametrize(
    ("leaves", "status"),
    [("sys.exit()", 0), ("sys.exit(3)", 3), ("sys.exit(10**10 + 3)", 3), ("sys.exit('why')", 1), ("", 1)],
)
def test_a_child_has_its_own_status_and_output(leaves: str, status: int, tmp_path: Path) -> None:
    """Truth: what Python does with the arguments of ``sys.exit``, and the program's own parent, which waits for its child."""
    child = f"print('from the child'); {leaves}"
    waits = f"if (child := os.fork()) == 0:\n        {child}\n    else: status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])"
    source = PROGRAM.replace("IMPORT", "import sys").replace(
        "RUN", f"{waits}; print('status', status, file=sys.stderr)"
    )
    (tmp_path / "mine.py").write_text(source)
    ran = shell("run", str(tmp_path / "mine.py"), "--out", str(tmp_path / "run"))
    assert ran.returncode == 0 and f"status {status}\n" in ran.stderr, ran.stderr
    assert ran.stdout.count("from the child") == 1
    assert ran.stderr.count("why\n") == ("why" in leaves)


@pytest.mark.parametrize(
    "breaks",
    [
        "read, write = os.pipe(); os.close(read); sys.stdout = open(write, 'w'); print('from the child')",
        "sys.stdout = open(os.dup(1), 'w'); sys.stdout.close()",
        "sys.stdout = None",
    ],
)
def test_a_child_whose_output_cannot_be_written_ends(breaks: str, tmp_path: Path) -> None:
    """A pipe without its reader, a file that was closed, none at all: it does not go on with the command."""
    child = f"{breaks}; sys.exit(3)"
    waits = f"if (child := os.fork()) == 0:\n        {child}\n    else: status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])"
    source = PROGRAM.replace("IMPORT", "import sys").replace(
        "RUN", f"{waits}; print('status', status, file=sys.stderr)"
    )
    (tmp_path / "mine.py").write_text(source)
    ran = shell("run", str(tmp_path / "mine.py"), "--out", str(tmp_path / "run"), "--json")
    assert ran.returncode == 0 and ran.stderr == "status 3\n"
    assert json.loads(ran.stdout)["experiment"] == "fake" and not (tmp_path / "run-2").exists()


@pytest.mark.parametrize("status", [0, 2])
def test_what_a_program_does_at_the_end_of_the_process_is_not_its_status(status: int, tmp_path: Path) -> None:
    source = PROGRAM.replace("IMPORT", f"atexit.register(lambda: os._exit({0 if status else 5}))")
    (tmp_path / "mine.py").write_text(source.replace("RUN", "1 / 0" if status else ""))
    ran = shell("run", str(tmp_path / "mine.py"), "--out", str(tmp_path / "run"), "--quiet")
    assert ran.returncode == status, ran.stderr
