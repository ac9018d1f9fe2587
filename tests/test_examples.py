"""What readers copy runs: the examples and the README's program. Truth: exit status and the figures they print."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from effort import thorough

ROOT = Path(__file__).parents[1]


def run_python(arguments: list[str]) -> str:
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(ROOT / "src")}
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, env=environment, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


def figure(text: str, pattern: str) -> float:
    found = re.search(pattern, text)
    assert found is not None, text
    return float(found.group(1))


@pytest.mark.parametrize("name", sorted(p.name for p in (ROOT / "examples").rglob("*.py")))
def test_examples_are_short(name: str) -> None:
    (path,) = (ROOT / "examples").rglob(name)
    assert len(path.read_text().splitlines()) <= 80


def test_first_example_tracks() -> None:
    assert figure(run_python(["examples/01_arm_on_swerve.py"]), r"mean ([\d.]+) mm") < 1.0


def test_second_example_stands_and_arrives() -> None:
    text = run_python(["examples/02_ball_robot.py"])
    assert "stood" in text
    assert figure(text, r"last second: ([\d.]+) mm") < 10.0


def test_third_example_runs_in_real_time_and_arrives() -> None:
    """Loosely: a busy machine misses ticks, and the load still arrives."""
    text = run_python(["examples/03_your_own_in_real_time.py"])
    assert "shut down after 4." in text
    assert figure(text, r"load at ([\d.]+) m") == pytest.approx(2.0, abs=0.15)
    assert figure(text, r"(\d+) failed") == 0


@thorough
@pytest.mark.skipif(shutil.which("c++") is None, reason="no C++ compiler (c++)")
def test_a_loop_in_cpp_is_the_loop_in_python() -> None:
    text = run_python(["examples/cpp_loop/compare.py"])
    assert figure(text, r"difference to Python: (\S+)") == 0.0
    assert figure(text, r"at ([\d.]+) m") == pytest.approx(2.0, abs=0.05)


def test_fourth_example_keeps_clear_and_arrives() -> None:
    text = run_python(["examples/04_obstacles.py"])
    assert figure(text, r"clearance (-?\d+) mm, margin") >= 40.0
    assert figure(text, r"end effector ([\d.]+) mm") < 50.0


def test_program_of_the_readme() -> None:
    program = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert program is not None
    speed = figure(run_python(["-c", program.group(1)]), r"\[ *([\d.]+)")
    assert 0.05 < speed < 0.3  # the reference moves at 0.2 m/s, the arm takes a part of it
