"""`wbmpc stability`: what it prints, draws and rejects. Truth: Table I of Pankert et al. 2022, statics of a push."""

from __future__ import annotations

import json
import math
from pathlib import Path
from xml.etree import ElementTree

import pytest

from toys import robot
from wbmpc.cli import main
from wbmpc.registry import REGISTRY
from wbmpc.stability import assess, slope_gravity

SWERVE = robot("swerve-ur10")


def reported(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict:
    assert main(["stability", *arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_json_has_the_papers_areas(capsys: pytest.CaptureFixture[str]) -> None:
    for name, areas in {"H": (1.16, 0.29), "X": (1.81, 0.45), "a": (1.17, 0.76)}.items():
        data = reported(capsys, "swerve-ur10", "--configuration", name)
        assert (round(data["support_polygon_area"], 2), round(data["double_support_area"], 2)) == areas
        assert data["stays_upright"] and len(data["triangle_margins"]) == 4 and len(data["regions"]) == 4
        assert data["zero_moment_point"] == pytest.approx(data["center_of_mass"][:2])


def test_a_push_and_a_slope_move_the_zero_moment_point_by_their_moments(capsys: pytest.CaptureFixture[str]) -> None:
    rest = reported(capsys, "swerve-ur10")
    pushed = reported(capsys, "swerve-ur10", "--wrench", "50,0,0")
    moved = pushed["zero_moment_point"][0] - rest["zero_moment_point"][0]
    assert moved == pytest.approx(50.0 * 0.80 / (9.81 * rest["mass"]), rel=0.01)  # the end effector is 0.80 m high
    sloped = reported(capsys, "swerve-ur10", "--slope", "0.1")
    moved = sloped["zero_moment_point"][0] - rest["zero_moment_point"][0]
    assert moved == pytest.approx(-0.10033 * rest["center_of_mass"][2], rel=1e-3)  # tan 0.1, downhill
    assert not reported(capsys, "swerve-ur10", "--wrench", "0,2000,0")["stays_upright"]
    assert reported(capsys, "swerve-ur10", "--wrench", "0,0,2000")["zero_moment_point"] is None


def test_how_rough_the_ground_has_to_be(capsys: pytest.CaptureFixture[str]) -> None:
    """On a slope its tangent; a push at the end effector also turns the robot. It may slide and not tip over."""
    steep = assess(SWERVE, "X", gravity=slope_gravity(0.9)).summary()
    assert steep["stays_upright"] and steep["friction_needed"] == pytest.approx(math.tan(0.9))
    pushed = assess(SWERVE, "X", wrench=(400.0, 0.0, 0.0, 0.0, 0.0, 0.0)).summary()
    assert pushed["friction_needed"] > 1.2 * 400.0 / (9.81 * pushed["mass"])
    for none in ((0.0, 0.0, 2000.0), (0.0, 2000.0, 0.0)):
        assert assess(SWERVE, wrench=(*none, 0.0, 0.0, 0.0)).summary()["friction_needed"] is None
    assert main(["stability", "swerve-ur10", "--slope", "0.9"]) == 0
    assert "friction needed not to slide 1.26" in capsys.readouterr().out
    assert main(["stability", "swerve-ur10", "--wrench", "0,2000,0"]) == 0
    assert "friction needed not to slide –" in capsys.readouterr().out


def test_text_and_drawing(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    plot = tmp_path / "a.svg"
    assert main(["stability", "swerve-ur10", "--configuration", "0.1,-0.1,0.2,-0.2", "--plot", str(plot)]) == 0
    out = capsys.readouterr().out
    assert "support polygon" in out and "given leg angles" in out and str(plot) in out
    root = ElementTree.parse(plot).getroot()
    shapes = [e.tag.split("}")[1] for e in root]
    assert shapes.count("polygon") >= 6 and shapes.count("circle") == 2
    assert "wheel_LF" in plot.read_text()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nobody"], "unknown robot"),
        (["rezero"], "stands on 3 feet or more"),
        (["swerve-ur10", "--configuration", "Z"], "unknown configuration"),
        (["swerve-ur10", "--configuration", "1,2"], "4 angles"),
        (["swerve-ur10", "--wrench", "1,2"], "3 or 6"),
        (["swerve-ur10", "--arm", "1,2"], "--arm: 6"),
        (["swerve-ur10", "--arm", "100,0,0,0,0,0"], "shoulder_pan_joint at 100 rad is outside its limits"),
        (["swerve-ur10", "--configuration", "nan,0,0,0"], "finite, one per leg, got 'nan,0,0,0'"),
        (["swerve-ur10", "--slope", "2"], "--slope"),
        (["swerve-ur10", "--wrench", "1e300,0,0"], "wrench: numbers of 1e+09 at most"),
        (["swerve-ur10", "--plot", "a.bmp"], ".svg"),
        (["swerve-fixed-ur10", "--configuration", "H"], "fixed"),
    ],
)
def test_bad_input_is_one_message(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stability", *arguments]) == 2
    err = capsys.readouterr().err
    assert words in err and err.count("\n") == 1


def test_the_experiment_reaches_the_table() -> None:
    experiment = REGISTRY["swerve-stability"]
    result = experiment.run(experiment.config_type(), 0, None)
    names = {f"{kind}_{c}" for kind in ("support_polygon_area", "double_support_area") for c in "HXA"}
    assert set(result.metrics) == names and all(m.met for m in result.metrics.values())
    assert [p.title for p in result.plots] == ["Configuration H", "Configuration X", "Configuration A"]
