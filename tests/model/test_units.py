"""Units of states and inputs. Truth: MuJoCo's joint types of the robots' files; the derivative of a quantity has its unit per second."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import wbmpc as wb
from wbmpc.compare import Run, load, overlay
from wbmpc.errors import InputError
from wbmpc.log import Log
from wbmpc.model.augment import DriveLag, FrequencyShaping, InputFilter, InputRate, WithPath
from wbmpc.model.layout import Layout
from wbmpc.plots.notebook import trajectories
from wbmpc.robots import load_spec
from wbmpc.run_files import read_log

#: Of every base type one robot, among them legs and lifts that slide.
ROBOTS = ("fetch", "mecanum-ur10", "panda", "rezero", "tidybot", "swerve-ur10", "telescope-ur10")
LENGTHS, ANGLES, FREE = ("x", "y", "z"), ("yaw", "pitch", "roll"), ("qw", "qx", "qy", "qz")


@pytest.mark.parametrize("name", ROBOTS)
def test_every_component_has_its_unit(name: str) -> None:
    robot = wb.load_robot(name)
    model = load_spec(robot.description).compile()
    slides = {model.joint(i).name for i in range(model.njnt) if model.jnt_type[i] == mujoco.mjtJoint.mjJNT_SLIDE}
    known = dict.fromkeys(LENGTHS, "m") | dict.fromkeys(ANGLES, "rad") | dict.fromkeys(FREE, "1")
    for group, names in robot.state.groups.items():
        position = [known[n] if group.startswith("base") else "m" if n in slides else "rad" for n in names]
        expected = [f"{unit}/s" for unit in position] if group.endswith("_velocity") else position
        assert list(robot.state.unit_groups[group]) == expected
    second = "base_velocity" in robot.state  # forces and torques move it, else speeds
    for group, names in robot.input.groups.items():
        for joint, unit in zip(names, robot.input.unit_groups[group], strict=True):
            linear = joint in slides or joint in ("v", "vx", "vy")
            assert unit == (("N" if linear else "N m") if second else ("m/s" if linear else "rad/s"))


def test_the_wrench_of_the_world_has_units() -> None:
    robot = wb.load_robot("rezero", contact="wrench")
    assert robot.input.unit_groups["force"] == ("N",) * 3 and robot.input.unit_groups["moment"] == ("N m",) * 3


def test_wrappers_keep_and_add_units() -> None:
    inner = wb.load_robot("fetch").dynamics()
    rate = InputRate(inner, ["arm"])
    assert rate.state.unit_groups["arm_input"] == inner.input.unit_groups["arm"]
    assert rate.input.unit_groups["arm_rate"] == tuple(f"{unit[:-2]}/s²" for unit in inner.input.unit_groups["arm"])
    assert rate.input.unit_groups["base"] == inner.input.unit_groups["base"]
    lag = DriveLag(inner, {"base": 0.1})
    assert lag.state.unit_groups["base_actual"] == lag.input.unit_groups["base"] == ("m/s", "rad/s")
    shaped = FrequencyShaping(inner, {"base": InputFilter(1.0, 5.0)})
    assert shaped.input.unit_groups["base_shaped"] == ("m/s", "rad/s") and set(
        shaped.state.unit_groups["base_filter"]
    ) == {""}
    assert WithPath(inner).state.units[-2:] == ("m", "m/s") and WithPath(inner).input.units[-1] == "m/s²"


def test_what_declares_no_units_has_none_and_wrong_ones_are_rejected() -> None:
    groups = {"x": ["p", "v"]}
    assert Layout(groups).units == ("", "") and wb.Ode(groups, {"u": ["a"]}, lambda x, u: x).input.units == ("",)
    system = wb.Ode(groups, {"u": ["a"]}, lambda x, u: x, state_units={"x": ["m", "m/s"]}, input_units={"u": "m/s²"})
    assert system.state.units == ("m", "m/s") and system.input.units == ("m/s²",)
    with pytest.raises(InputError, match=r"group 'x'.*2 entries"):
        Layout(groups, {"x": ["m"]})
    with pytest.raises(InputError, match="unknown group 'y'"):
        Layout(groups, {"y": "m"})


def test_a_plot_has_one_unit() -> None:
    system = wb.Ode({"x": ["p", "v"]}, {"u": ["a"]}, lambda x, u: x, state_units={"x": ["m", "m/s"]})
    t, x, u = np.arange(3.0), np.arange(6.0).reshape(3, 2), np.array([[1.0], [2.0]])
    drawn = {
        plot.y_label: [(line.name, list(line.y)) for line in plot.series] for plot in trajectories(t, x, u, system)
    }
    assert drawn == {
        "state [m]": [("x.p", [0, 2, 4])],
        "state [m/s]": [("x.v", [1, 3, 5])],
        "input": [("u.a", [1, 1, 2, 2])],
    }


def logged(folder: Path, units: tuple[str, ...]) -> Run:
    log = Log()
    log.label("state", ("lift", "elbow", "wrist"), units)
    for t in range(3):
        log.add("state", t, [t, 2 * t, 3 * t])
    folder.mkdir()
    log.save(folder / "log.npz")
    (folder / "metrics.json").write_text('{"metrics": {}}')
    return load(folder)


def test_units_go_through_the_log_into_comparisons(tmp_path: Path) -> None:
    units = ("m", "rad", "rad")
    runs = [logged(tmp_path / name, units) for name in "ab"]
    assert read_log(tmp_path / "a/log.npz")["state.units"].tolist() == list(units)
    plots = overlay(runs, ["a", "b"])
    assert [(p.y_label, [s.signal for s in p.series]) for p in plots] == [
        ("state [m]", ["lift"] * 2), ("state [°]", ["elbow", "wrist"] * 2)
    ]  # fmt: skip
    bare = [logged(tmp_path / name, ()) for name in "cd"]
    assert [p.y_label for p in overlay(bare, ["c", "d"])] == ["state"]
