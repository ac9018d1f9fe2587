"""Radii of wheels that a URDF draws as meshes. Truth: the discs that trimesh makes and writes here."""

from __future__ import annotations

from pathlib import Path

import pytest
import trimesh
import yaml
from urdf_parts import ARM, CASTER, RADIUS, joint, link, model, new

from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.robots.doctor import examine_robot

#: Writers of the same disc, by the file's ending and, of STL, whether it is text.
FORMATS = {"binary.stl": "stl", "text.stl": "stl_ascii", "disc.obj": "obj"}


def wheels(folder: Path, name: str, form: str, radius: float) -> str:
    """Two wheels about y, drawn by a disc about z in millimeters whose middle is 5 mm above the file's origin."""
    disc = trimesh.creation.cylinder(1e3 * radius, 40.0, sections=64)
    disc.apply_translation([0.0, 0.0, 5.0])
    data = disc.export(file_type=form)
    (folder / name).write_bytes(data if isinstance(data, bytes) else data.encode())
    shape = (
        f'<visual><origin xyz="0 -0.005 0" rpy="-1.5707963267948966 0 0"/><geometry><mesh filename="{name}" scale="0.001 0.001 0.001"/>'
        "</geometry></visual>"
    )
    limit = '<limit velocity="10" effort="5"/>'
    return "".join(
        link(side, shape) + joint(f"{side}_joint", "hull", side, (0, y, RADIUS), "0 1 0", kind="continuous", more=limit)
        for side, y in (("left", 0.25), ("right", -0.25))
    )


@pytest.mark.parametrize(("name", "form"), FORMATS.items())
def test_a_new_robot_has_the_radius_of_its_meshes(name: str, form: str, tmp_path: Path) -> None:
    out = new(model(tmp_path, wheels(tmp_path, name, form, 0.093) + CASTER + ARM))
    assert "wheel_radius" not in yaml.safe_load(out.read_text())["base"]
    assert load_robot(out).base.geometry.radius == pytest.approx(0.093, rel=1e-3)


@pytest.mark.parametrize(("sections", "round_too", "found"), [(8, False, 0.093), (4, True, 0.08), (4, False, RADIUS)])
def test_a_box_that_stands_for_a_wheel_is_not_its_radius(
    sections: int, round_too: bool, found: float, tmp_path: Path
) -> None:
    """Prisms of eight and of four sides as collision meshes of 0.093 m, and what is drawn: a disc of 0.08 m, or nothing."""
    text = wheels(tmp_path, "prism.stl", "stl", 0.08)
    if not round_too:
        text = text.replace("<visual>", "<!--").replace("</visual>", "-->")
    prism = trimesh.creation.cylinder(93.0, 40.0, sections=sections)
    (tmp_path / "collision.stl").write_bytes(prism.export(file_type="stl"))
    mesh = '<geometry><mesh filename="collision.stl" scale="0.001 0.001 0.001"/></geometry>'
    collision = f'<collision><origin rpy="-1.5707963267948966 0 0"/>{mesh}</collision></link>'
    for side in ("left", "right"):
        start = text.index(f'<link name="{side}"')
        end = text.index("</link>", start)
        text = text[:end] + collision + text[end + len("</link>") :]
    out = new(model(tmp_path, text + CASTER + ARM))
    assert load_robot(out).base.geometry.radius == pytest.approx(found, rel=1e-3)


def test_a_radius_that_contradicts_the_mesh_is_found(tmp_path: Path) -> None:
    out = new(model(tmp_path, wheels(tmp_path, "binary.stl", "stl", RADIUS) + CASTER + ARM))
    data = yaml.safe_load(out.read_text())
    for given, found in ((1.04 * RADIUS, False), (1.1 * RADIUS, True), (0.9 * RADIUS, True)):
        data["base"]["wheel_radius"] = given
        out.write_text(yaml.safe_dump(data))
        words = [f.message for f in examine_robot(str(out)).findings if f.severity == "error"]
        assert any("has a radius of 0.1 m" in text for text in words) == found, words
        if found:
            with pytest.raises(InputError, match=r"'base\.wheel_radius'.*'left_joint'.*has a radius of 0\.1 m"):
                load_robot(out)
        else:
            load_robot(out)


@pytest.mark.parametrize(
    "content", [b"", b"solid nothing\nendsolid", b"v 1 2\nv nan 0 0\n", b"\0" * 80 + b"\xff\xff\xff\xff", None]
)
@pytest.mark.parametrize("name", ["disc.stl", "disc.obj", "disc.dae"])
def test_a_mesh_that_cannot_be_read_says_nothing(content: bytes | None, name: str, tmp_path: Path) -> None:
    """No file either: the radius is what the wheel's height says, and any other is taken."""
    path = model(tmp_path, wheels(tmp_path, "disc.obj", "obj", RADIUS).replace("disc.obj", name) + CASTER + ARM)
    (tmp_path / "disc.obj").unlink()
    if content is not None:
        (tmp_path / name).write_bytes(content)
    out = new(path)
    data = yaml.safe_load(out.read_text())
    assert data["base"]["wheel_radius"] == pytest.approx(RADIUS)
    data["base"]["wheel_radius"] = 0.15
    out.write_text(yaml.safe_dump(data))
    assert load_robot(out).base.geometry.radius == 0.15
