"""What users of the package hold: public names, their signatures, their types, and a program that uses nothing else."""

from __future__ import annotations

import ast
import difflib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import public_api
import user_base_type
import user_program
import wbmpc as wb
from wbmpc import bases

SOURCE = Path(wb.__file__)


def test_the_public_names_and_signatures_are_those_of_the_file() -> None:
    kept, found = public_api.FILE.read_text().splitlines(), public_api.listing().splitlines()
    changes = "\n".join(difflib.unified_diff(kept, found, "public_api.txt", "wbmpc", n=0, lineterm=""))
    assert not changes, f"the public API has changed; if that is meant: python tests/public_api.py\n{changes}"


def test_type_checkers_see_the_names_that_are_loaded_when_they_are_used() -> None:
    blocks = [n for n in ast.parse(SOURCE.read_text()).body if isinstance(n, ast.If) and isinstance(n.test, ast.Name)]
    seen = {
        (alias.asname, node.module)
        for block in blocks
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == set(wb._MODULES.items())
    assert (SOURCE.parent / "py.typed").is_file()


def test_a_program_solves_and_controls_with_public_names_alone() -> None:
    start = np.array([2.0, 0.0])
    solution = user_program.solve(start)
    assert solution.status is wb.Status.CONVERGED
    # truth: with |a| ≤ 1 m/s², 2 m from rest to rest take at least 2 √2 s, so the limit is active at the start
    np.testing.assert_allclose(solution.u[0], -1.0, atol=1e-4)
    assert np.linalg.norm(user_program.control(start, 100)) < 1e-3


def test_a_program_runs_a_robot_in_real_time_with_public_names_alone() -> None:
    # truth: the origin, where the model's costs are least
    assert np.linalg.norm(user_program.run(np.array([1.0, 0.0]), 6.0)) < 1e-2


def test_a_robot_takes_the_programs_problem() -> None:
    robot = wb.load_robot("differential-ur10")
    assert list(user_program.problem_of(robot).terms) == ["end_effector", "speed", "limits"]


def test_another_rate_of_the_default_mpc_leaves_its_horizon() -> None:
    robot = wb.load_robot("panda")
    usual, slower = wb.default_mpc(robot), user_program.slower(robot)
    assert (slower.rate, slower.ocp.horizon, slower.ocp.intervals) == (20.0, usual.ocp.horizon, usual.ocp.intervals)
    assert usual.rate != 20.0


def test_a_program_runs_and_records_an_experiment_of_its_own(tmp_path: Path) -> None:
    result, recording = user_program.recorded(tmp_path / "run.mcap")
    assert result.completed and result.reached("moved")
    assert recording.complete and recording.metadata["result"]["completed"] == "True"
    # truth: the settings' 0.1 s
    assert 0.08 <= recording.end - recording.start <= 0.1
    assert recording["/joint_states"].times


RAIL = """<mujoco><compiler angle="radian"/><worldbody><body name="beam"><inertial mass="5" pos="0 0 0" diaginertia="1 1 1"/>
  <body name="cart"><joint name="slide" type="slide" axis="1 0 0" range="-2 2"/>
    <inertial mass="2" pos="0 0 0" diaginertia="0.1 0.1 0.1"/>
    <body name="link"><joint name="elbow" type="hinge" axis="0 0 1" range="-3 3"/>
      <inertial mass="1" pos="0.2 0 0" diaginertia="0.1 0.1 0.1"/><site name="tip" pos="0.3 0 0"/></body></body></body></worldbody></mujoco>"""
ROBOT = """{name: rail, model: rail.xml, base: {type: rail, body: beam, axis: slide}, arm: {joints: [elbow], tool: tip},
  home: {elbow: 0.5}, limits: {velocity: {slide: 0.4, elbow: 1.0}}}"""


@pytest.fixture
def rail(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[wb.RobotModel]:
    """A robot of the user's base type."""
    monkeypatch.setitem(bases.TABLE, "rail", "user_base_type:RailBaseType")
    bases._locations.cache_clear()
    (tmp_path / "rail.xml").write_text(RAIL)
    (tmp_path / "rail.yaml").write_text(ROBOT)
    yield wb.load_robot(tmp_path / "rail.yaml")
    monkeypatch.undo()
    bases._locations.cache_clear()
    bases.base_type.cache_clear()


def test_a_base_type_of_public_names_loads_and_plans(rail: wb.RobotModel) -> None:
    # truth: by hand
    np.testing.assert_allclose(rail.pose([0.7, 0.5])[0], [0.7 + 0.3 * np.cos(0.5), 0.3 * np.sin(0.5), 0.0], atol=1e-12)
    np.testing.assert_allclose(rail.home, [0.0, 0.5])
    np.testing.assert_allclose(rail.limits.input_upper, [0.4, 1.0])


def test_a_base_type_of_public_names_is_simulated(rail: wb.RobotModel) -> None:
    system = wb.base_type("rail").system(rail, 0)
    position, orientation = rail.pose([0.3, 0.5])
    system.mpc.reference["end_effector"] = wb.Reference.poses([0.0], [position], orientation)
    system.mpc.reset(rail.home)
    ending = wb.run_lockstep(*system.parts, 4.0, lambda t, command, plans: None)
    # truth: MuJoCo's site; drives that follow speeds at once leave no error at rest
    assert not ending.reason
    np.testing.assert_allclose(system.plant.truth().tool[:2], position[:2], atol=5e-3)


def test_programs_pass_mypy_strict_without_a_configuration(tmp_path: Path) -> None:
    """As a user runs it, on the files alone: the types of the package have to be found and right."""
    files = [str(program.__file__) for program in (user_program, user_base_type)]
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--follow-imports=silent", "--config-file=", f"--cache-dir={tmp_path}", *files],
        cwd=tmp_path, env={**os.environ, "MYPYPATH": str(SOURCE.parents[1])}, capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("program", [user_program, user_base_type])
def test_programs_import_nothing_else_of_the_package(program: ModuleType) -> None:
    tree = ast.parse(Path(str(program.__file__)).read_text())
    names = {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
    names |= {str(n.module) for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
    assert {n for n in names if n.startswith("wbmpc")} == {"wbmpc"}


#: Dependencies of the command line, of reports, recordings and views.
EXTRA = ("plotly", "typer", "rich", "mcap", "viser", "trimesh", "imageio", "pyarrow", "cyclonedds", "rosbags")
PLANNING = f"""
import sys
import numpy as np
import wbmpc as wb
import user_program
user_program.problem_of(wb.load_robot("differential-ur10"))
user_program.solve(np.array([2.0, 0.0]))
print([name for name in {EXTRA} if name in sys.modules])
"""


def test_a_robot_and_a_solve_load_no_library_of_reports_or_the_command_line() -> None:
    paths = os.pathsep.join(str(p) for p in (SOURCE.parents[1], Path(__file__).parent))
    environment = {**os.environ, "PYTHONPATH": paths}
    done = subprocess.run(
        [sys.executable, "-c", PLANNING], env=environment, capture_output=True, text=True, timeout=300
    )
    assert (done.stdout, done.stderr) == ("[]\n", "")
