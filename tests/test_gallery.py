"""Public robots in small files of the package, and the command that runs them. Truth: figures that their makers publish; counts."""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path, PurePosixPath

import mujoco
import numpy as np
import pytest

from effort import some
from wbmpc.cli import main
from wbmpc.cli.study import built_in_studies
from wbmpc.errors import InputError, WbmpcError
from wbmpc.model.robot import load_robot
from wbmpc.robots import load_spec
from wbmpc.robots.doctor import examine_robot
from wbmpc.study.study import Study

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))

import gallery

HALF = np.pi / 2.0


class File(PurePosixPath):
    """A file of an installed distribution, as ``importlib.metadata`` has it."""

    def locate(self) -> Path:
        return Path(self)


@pytest.mark.parametrize(
    ("name", "joints", "tool"),
    [
        # the ready pose of Franka's own examples: O_T_EE of the hand
        ("panda", [0.0, -HALF / 2, 0.0, -3 * HALF / 2, 0.0, HALF, HALF / 2], (0.3069, 0.0, 0.4869)),
        # the data sheet's lengths: 0.425 + 0.39225, 0.10915 + 0.0823, 0.089159 - 0.09465
        ("ur5", [0.0] * 6, (0.81725, 0.19145, -0.00549)),
    ],
)
def test_end_effectors_of_arms_are_where_their_makers_have_them(
    name: str, joints: list[float], tool: tuple[float, ...]
) -> None:
    np.testing.assert_allclose(load_robot(name).pose(joints)[0], tool, atol=2e-4)


@pytest.mark.parametrize("name", gallery.OWN)
def test_the_doctor_finds_no_error_and_files_name_their_source(name: str) -> None:
    result = examine_robot(name)
    assert result.count("error") == 0, result.findings
    text = load_robot(name).description.model.read_text()
    assert "license" in text and "mesh" not in text


@pytest.mark.parametrize("name", some(gallery.OWN, [3]))
def test_a_robot_follows_a_path_and_reaches_a_goal_with_default_weights(name: str) -> None:
    row = gallery.examine(name, name, quick=True)
    assert row.failures == () and row.reached == 1.0 and row.at_goal < gallery.AT_GOAL
    assert len(row.errors) == 1 and row.errors[0] < gallery.MEAN


def test_a_robot_whose_package_is_not_installed_is_skipped(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(gallery.PACKAGED, "tiago", ("no-such-distribution", "tiago.urdf", ()))
    monkeypatch.setattr(sys, "argv", ["gallery.py", "--robots", "tiago"])
    assert gallery.main() == 0
    assert "| skipped: pip install no-such-distribution |" in capsys.readouterr().out


def test_the_study_has_robots_of_other_packages_too(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Truth: the number of runs, two experiments of each robot; a package that is missing is named."""
    monkeypatch.setattr(gallery, "packaged", lambda name, folder: Path(shutil.copy(own, folder / f"{name}.yaml")))
    own = tmp_path / "own.yaml"
    own.write_text("name: tiago")
    monkeypatch.setattr(sys, "argv", ["gallery.py", "--study", str(tmp_path / "all"), "--robots", "tiago", "fetch"])
    assert gallery.main() == 0
    study, alone = Study.load(tmp_path / "all" / "gallery.yaml"), Study.load(built_in_studies()["gallery"])
    assert study.planned == alone.planned + 2 * 10 and alone.planned == 2 * 10 * 7
    assert str(tmp_path / "all" / "tiago.yaml") in {c.changes["robot"] for c in study.combinations}
    monkeypatch.undo()
    monkeypatch.setitem(gallery.PACKAGED, "tiago", ("no-such-distribution", "tiago.urdf", ()))
    with pytest.raises(WbmpcError, match="tiago: pip install no-such-distribution"):
        gallery.write_study(["tiago"], tmp_path / "none")


def test_a_robot_that_does_not_load_is_a_failed_row_and_the_next_one_runs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """One whose model no command describes, and one whose file cannot be compiled in time. Truth: the messages, one row each."""
    bad = tmp_path / "broken.urdf"
    bad.write_text('<robot name="broken"><link name="a"/></robot>')
    monkeypatch.setitem(gallery.PACKAGED, "tiago", ("own", "broken.urdf", ()))
    monkeypatch.setattr(gallery, "files", lambda _: [File(bad)])

    def examine(name: str, *_: object) -> gallery.Row:
        if name == "ur5":
            raise InputError("ur5.xml: MuJoCo does not compile it within 20 s | or more")
        return gallery.Row(name, 7, (1e-5,), (), 1.0, 1e-3, 0.2)

    monkeypatch.setattr(gallery, "examine", examine)
    monkeypatch.setattr(sys, "argv", ["gallery.py", "--robots", "tiago", "ur5", "panda"])
    assert gallery.main() == 1
    rows = capsys.readouterr().out.splitlines()[2:]
    assert len(rows) == 3 and len({row.count("|") for row in rows}) == 1
    assert "failed: " in rows[0] and "no joint looks like an arm's" in rows[0]
    assert "failed: ur5.xml: MuJoCo does not compile it within 20 s / or more" in rows[1]
    assert rows[2].startswith("| panda | 7 | 0.010")


@pytest.mark.parametrize("name", ["panda", "panda-omni"])
def test_paths_are_as_long_as_they_are_to_be(name: str) -> None:
    """By sums over their points; those of an arm that stands are in its reach."""
    from wbmpc.tasks.following import PathTaskSettings

    robot = load_robot(name)
    position, quaternion = robot.pose(robot.home)
    for path in gallery.paths(robot, 5.0):
        points = (
            PathTaskSettings.model_validate({"robot": name, "path": path})
            .path.curve(robot, position, quaternion)
            .points
        )
        length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
        assert 4.99 < length < 6.0
        assert robot.description.base.moves or np.ptp(points, axis=0).max() < 0.6


def test_a_standing_arm_starts_well_above_the_floor(tmp_path: Path) -> None:
    """As `wbmpc new` has it. Truth: MuJoCo's heights of all that the arm lifts, which reaches 0.95 m; plans keep 30 mm to the floor."""
    model, out = load_robot("ur5").description.model, tmp_path / "mine.yaml"
    assert main(["new", str(model), "--yes", "--out", str(out)]) == 0
    for robot in (load_robot(str(out)), load_robot("ur5")):
        simulated = load_spec(robot.description).compile()
        data = mujoco.MjData(simulated)
        for name, angle in zip(robot.state.groups["arm"], robot.home, strict=True):
            data.joint(name).qpos = angle
        mujoco.mj_kinematics(simulated, data)
        lifted = ("forearm_link", "wrist_1_link", "wrist_2_link", "wrist_3_link")
        assert min(data.body(name).xpos[2] for name in lifted) > 0.2


def test_what_is_new_has_as_many_warnings_as_the_doctor_finds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A model without shapes."""
    bare, out = tmp_path / "bare.xml", tmp_path / "bare.yaml"
    bare.write_text(re.sub(r"<geom[^>]*/>", "", load_robot("ur5").description.model.read_text()))
    assert main(["new", str(bare), "--yes", "--out", str(out)]) == 0
    summary = capsys.readouterr().out
    assert main(["doctor", str(out)]) == 0
    said = capsys.readouterr().out
    assert (
        "has no shapes" in " ".join(said.split())
        and "0 errors, 1 warning," in said
        and "0 errors, 1 warnings" in summary
    )
