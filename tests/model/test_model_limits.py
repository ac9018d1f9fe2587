"""Models that would take long: found by their text, or on trial in a process that ends.

Truth: expat, which knows what is a comment, and what a process is after a signal.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

from wbmpc.errors import InputError
from wbmpc.robots import limited_process, model_file
from wbmpc.robots.file_limits import check_size
from wbmpc.robots.model_file import parse, read_model
from wbmpc.robots.xml_text import without_comments

MANY = '<replicate count="100000"><body><geom size="0.1"/></body></replicate>'
ARM = """<mujoco>{top}<worldbody><body name="b"><geom size="0.1"/>
<body name="t" pos="0 0 1"><joint name="j" range="-60 60"/><geom size="0.1"/></body></body>{world}</worldbody></mujoco>"""


@pytest.mark.parametrize(
    "world",
    [
        f'<![CDATA[<!--]]>{MANY}<![CDATA[-->]]>',
        f'<site name="<!--"/>{MANY}<site name="-->"/>',
        f'<site name="a\'<!--"/>{MANY}<site name="\'-->"/>',
        f'<?a <!-- ?>{MANY}<?a --> ?>',
        f'<!-- <![CDATA[ -->{MANY}<!-- ]]> -->',
        f'<!-- " -->{MANY}<!-- " -->',
    ],
)  # fmt: skip
@pytest.mark.parametrize("name", ["arm.xml", "arm.urdf"])
def test_nothing_hides_elements_from_the_limits(name: str, world: str, tmp_path: Path) -> None:
    """An attribute, text or instruction that has the marks of a comment; MuJoCo would build what is between them."""
    (tmp_path / name).write_text(ARM.format(top="", world=world))
    with pytest.raises(InputError, match=r"more than 5000 elements|not well-formed"):
        check_size(tmp_path / name)


@pytest.mark.parametrize(
    "text",
    [
        "<a><!-- x --><b c='1'/><!----></a>", "<a b='>'><!-- ' -->t</a>", "<a><![CDATA[ <!-- x --> ]]>t<!-- ]]> --></a>",
        "<?xml version='1.0'?><!-- <a> --><a b=\"<!-- '>&gt;\"/>".replace("<!-- '", "&lt;!-- '"), "<a>-->></a>",
    ],
)  # fmt: skip
def test_what_is_left_without_comments_is_what_expat_reads(text: str) -> None:
    plain = without_comments(text.encode())
    assert b"<!--" not in plain.replace(b"<![CDATA[ <!-- x --> ]]>", b"")
    assert ElementTree.tostring(ElementTree.fromstring(plain)) == ElementTree.tostring(ElementTree.fromstring(text))


@pytest.mark.parametrize(
    ("top", "says"),
    [
        (f'\n<asset><mesh name="m" vertex="{"1 2 3 " * 33_334}"/></asset>', "line 2: <mesh>: 'vertex' has 100002 words; at most 100000"),
        ('<asset>' + f'<mesh vertex="{"1 2 3 " * 33_333}"/>' * 4 + '</asset>', "<mesh>: more than 300000 words of attributes"),
        ('<asset><mesh file="large.obj"/></asset>', "<mesh>: 'file': .*large.obj' has 5000001 bytes; at most 5000000 are read"),
        ('<asset><mesh file="meshes/large.obj"/></asset><compiler meshdir="."/>', "<mesh>: 'file': .*large.obj' has 5000001 bytes"),
        ('<include file="."/>', "line 1: <include>: 'file': .* is a directory; a file is needed"),
        ('<asset><mesh file="meshes"/></asset>', "<mesh>: 'file': .*meshes' is a directory"),
    ],
    ids=range(6),
)  # fmt: skip
def test_meshes_that_take_long_are_an_error_by_their_size(
    top: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """MuJoCo computes hull and volume of each. Truth: the numbers that are written here."""
    (tmp_path / "meshes").mkdir()
    (tmp_path / "large.obj").write_bytes(b"#" * 5_000_001)
    (tmp_path / "arm.xml").write_text(ARM.format(top=top, world=""))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=rf"arm\.xml: .*{says}"):
        parse(read_model(tmp_path / "arm.xml"))


def test_warnings_of_mujoco_are_logged_and_leave_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Truth: MuJoCo's own way with a warning, which writes MUJOCO_LOG.TXT beside the user."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.xml").write_text(ARM.format(top="", world=""))
    parse(read_model(tmp_path / "arm.xml"))
    with pytest.raises(ValueError, match="Empty file"):
        mujoco.MjSpec.from_string('<mujoco><include file="."/></mujoco>')
    assert [p.name for p in tmp_path.iterdir()] == ["arm.xml"]
    assert "MuJoCo: " in caplog.text
    order = {"text": '<mujoco><include file="."/></mujoco>'}
    limited_process.run_limited(order)
    assert [p.name for p in tmp_path.iterdir()] == ["arm.xml"]


def test_comments_that_do_not_end_take_no_time(tmp_path: Path) -> None:
    """A search for the end of each would be quadratic in them."""
    (tmp_path / "arm.xml").write_bytes(b"<a>" + b"<!--" * 2_000_000)
    began = time.process_time()
    with pytest.raises(InputError, match="more than 100000 tags"):
        check_size(tmp_path / "arm.xml")
    assert time.process_time() - began < 10.0


@pytest.mark.parametrize("encoding", ["cp037", "utf-7", "utf-16", "nowhere"])
def test_an_encoding_of_other_tags_is_an_error(encoding: str, tmp_path: Path) -> None:
    """MuJoCo reads bytes; expat would read other elements of the same file."""
    (tmp_path / "a.xml").write_text(f'<?xml version="1.0" encoding="{encoding}"?>' + ARM.format(top="", world=""))
    with pytest.raises(InputError, match=r"UTF-8 is needed|cannot be read"):
        check_size(tmp_path / "a.xml")


# ---------------------------------------------------------------------- trials
def slow_model(folder: Path, points: int) -> Path:
    """All points of a ball are corners of its hull, which MuJoCo's compiler looks for."""
    corners = np.random.default_rng(0).normal(size=(points, 3, 3)).astype(np.float32)
    corners /= np.linalg.norm(corners, axis=2, keepdims=True)
    faces = np.zeros(points, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    faces["corners"] = corners
    (folder / "ball.stl").write_bytes(bytes(80) + np.uint32(points).tobytes() + faces.tobytes())
    mesh, shape = '<asset><mesh name="m" file="ball.stl"/></asset>', '<geom type="mesh" mesh="m"/>'
    (folder / "ball.xml").write_text(ARM.format(top=mesh, world=shape))
    return folder / "ball.xml"


def test_a_model_that_compiles_slowly_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limited_process, "PROCESSOR", 0.0)
    with pytest.raises(InputError, match=r"ball\.xml: MuJoCo does not compile it within 0 s of the processor; smaller"):
        parse(read_model(slow_model(tmp_path, 90_000)))


def test_plain_models_and_those_of_the_package_need_no_trial(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A start stays as fast as it is."""

    def no(*_: object) -> None:
        raise AssertionError("a process was started")

    monkeypatch.setattr(model_file, "run_limited", no)
    (tmp_path / "part.xml").write_text('<mujocoinclude><site name="s"/></mujocoinclude>')
    (tmp_path / "arm.xml").write_text(ARM.format(top="<!-- -- -->", world='<include file="part.xml"/>'))
    assert parse(read_model(tmp_path / "arm.xml")).site("s") is not None
    data = Path(model_file.__file__).with_name("data")
    for path in data.glob("*10.xml"):
        parse(read_model(path))
    (tmp_path / "part.xml").write_text('<mujocoinclude><replicate count="3"><site/></replicate></mujocoinclude>')
    with pytest.raises(AssertionError):
        parse(read_model(tmp_path / "arm.xml"))


def test_a_model_is_tried_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = list[object]()
    monkeypatch.setattr(model_file, "run_limited", lambda order: calls.append(order) or {})
    path = slow_model(tmp_path, 10)
    for _ in range(3):
        parse(read_model(path))
    assert len(calls) == 1
    slow_model(tmp_path, 11)
    parse(read_model(path))
    assert len(calls) == 2


@pytest.mark.parametrize(("number", "status"), [(signal.SIGTERM, 143), (signal.SIGKILL, -9)])
def test_signals_end_a_command_and_its_trial(number: signal.Signals, status: int, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "wbmpc", "doctor", str(slow_model(tmp_path, 90_000))]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    child = wait_for(lambda: compiling_child(process.pid))
    os.kill(process.pid, number)
    assert process.wait(timeout=20) == status
    wait_for(lambda: not Path(f"/proc/{child}/maps").exists() or not Path(f"/proc/{child}/maps").read_text())


def compiling_child(parent: int) -> str:
    """Number of the process that compiles a trial for another one; empty until it does."""
    for child in Path(f"/proc/{parent}/task/{parent}/children").read_text().split():
        with suppress(OSError):  # it has ended
            about = Path("/proc", child)
            if b"limited_program" in (about / "cmdline").read_bytes() and "mujoco" in (about / "maps").read_text():
                return child
    return ""


def wait_for(condition: Callable[[], Any]) -> Any:
    end = time.monotonic() + 30.0
    while not (found := condition()):
        assert time.monotonic() < end, "it does not come"
        time.sleep(0.02)
    return found


def test_more_joints_than_a_robot_has_are_an_error(tmp_path: Path) -> None:
    """Each costs time that grows with their number; joints of a URDF that do not move are none."""
    joints = "".join(f'<body name="c{i}"><joint name="q{i}"/><geom size="0.1"/></body>' for i in range(201))
    (tmp_path / "arm.xml").write_text(ARM.format(top="", world=joints))
    with pytest.raises(InputError, match="more than 200 joints"):
        check_size(tmp_path / "arm.xml")
    fixed = "".join(
        f'<link name="l{i}"/><joint name="q{i}" type="fixed"><parent link="b"/><child link="l{i}"/></joint>'
        for i in range(300)
    )
    (tmp_path / "arm.urdf").write_text(f'<robot name="a"><link name="b"/>{fixed}</robot>')
    check_size(tmp_path / "arm.urdf")


def test_pictures_and_fields_have_one_limit_together(tmp_path: Path) -> None:
    top = "".join(f'<texture name="t{i}" type="2d" builtin="flat" width="2000" height="2000"/>' for i in range(5))
    (tmp_path / "arm.xml").write_text(ARM.format(top=f"<asset>{top}</asset>", world=""))
    with pytest.raises(InputError, match="more than 16000000 pixels of pictures and points of fields"):
        check_size(tmp_path / "arm.xml")


def test_a_picture_is_counted_by_its_own_head(tmp_path: Path) -> None:
    """The XML says nothing of its size; a few kilobytes unpack to hundreds of megabytes."""
    head = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"
    model = tmp_path / "robot.xml"
    model.write_text('<mujoco><asset><texture name="t" type="2d" file="big.png"/></asset><worldbody/></mujoco>')
    (tmp_path / "big.png").write_bytes(head + (20_000).to_bytes(4, "big") + (10_000).to_bytes(4, "big"))
    with pytest.raises(InputError, match=r"big\.png: a picture of 20000 x 10000 pixels"):
        check_size(model)
    (tmp_path / "big.png").write_bytes(head + (200).to_bytes(4, "big") * 2)
    assert tmp_path / "big.png" in check_size(model)
