"""Robot files, and the URDF and MJCF that they name."""

from __future__ import annotations

import random
import re
from pathlib import Path
from typing import Any

import yaml

from fuzzing.case import INVALID, NEVER, OPEN, VALID, Case, flipped, soup
from wbmpc.robots.description import DATA


def robots(rng: random.Random, folder: Path) -> Case:
    """Robot files: a built-in one that was changed."""
    name = rng.choice(("swerve-ur10", "swerve-fixed-ur10", "rezero", "swerve-mabi"))
    text = (DATA / f"{name}.yaml").read_text()
    data = yaml.safe_load(text)
    data["model"] = str(DATA / data["model"])
    place, key = rng.choice(
        [(data, k) for k in data] + [(data[s], k) for s in ("base", "arm", "limits") for k in data[s]]
    )
    kind, expected = (
        rng.choice(
            (
                "as it is",
                "radius",
                "never",
                "twice",
                "missing",
                "unknown",
                "soup",
                "number",
                "truth",
                "limit",
                "tool",
                "name",
                "long",
                "bytes",
            )
        ),
        INVALID,
    )
    out = ""
    if kind == "as it is":
        expected = VALID
    elif kind == "radius":
        radius = "ball_radius" if "ball_radius" in data["base"] else "wheel_radius"
        factor = rng.choice((0.97, 1.03, 0.5, 0.9, 1.1, 50.0, 1e9))
        data["base"][radius] *= factor
        expected = VALID if abs(factor - 1.0) < 0.05 else INVALID
    elif kind == "unknown":
        place[f"{key}_{rng.randint(0, 9)}"] = 1
        # joints' tables take any name, and say which they do not know
    elif kind == "missing":
        key = rng.choice(("name", "model", "base", "arm"))
        del data[key]
    elif kind == "number":
        place[key], expected = rng.uniform(-1, 1) * 10.0 ** rng.randint(-300, 300), OPEN
    elif kind == "truth":
        place[key] = rng.choice((True, False, [True], {"a": False}))
    elif kind == "limit":
        joint, value = (
            data["arm"]["joints"][0],
            rng.choice((1e300, 0.0, -1.0, 1e-300, "1e300", float("nan"), float("inf"), 10**40)),
        )
        table = rng.choice(("velocity", "acceleration", "effort"))
        data["limits"].setdefault(table, {})[joint] = value
    elif kind == "tool":  # of the base, which the arm does not move
        data["arm"]["tool"] = data["base"]["body"]
    elif kind == "name":
        data["name"] = rng.choice(
            ("", " ", "a/b", "..", "../x", "a\nb", "\x1b[31m", "\u202e", "a" * 5000, "-x", None, 5, "a b")
        )
        expected = OPEN
    elif kind == "long":
        place[key] = rng.choice(([0.1] * 9000, "x" * 250_000, [[0.1]] * 5000))
    elif kind == "bytes":
        return _encoded(rng, name, data, folder)
    if kind in ("never", "soup", "twice"):
        line = f"{rng.choice(list(data))}: "
        more = {"never": rng.choice(NEVER), "soup": soup(rng), "twice": "1"}[kind]
        body = {k: v for k, v in data.items() if kind == "twice" or f"{k}: " != line}
        out, expected = yaml.safe_dump(body) + f"{line}{more}\n", OPEN if kind == "soup" else INVALID
    path = folder / "robot.yaml"
    path.write_text(out or yaml.safe_dump(data, sort_keys=False), "utf-8", "surrogatepass")
    return Case(f"{name}: {kind}: {key}", expected, call=lambda: _load_robot(path))


def _encoded(rng: random.Random, name: str, data: dict[str, Any], folder: Path) -> Case:
    """The same text in other bytes."""
    text, path = yaml.safe_dump(data, sort_keys=False), folder / "robot.yaml"
    kind = rng.choice(("lines of Windows", "byte order mark", "NUL", "UTF-16", "Latin-1", "tabs"))
    expected = VALID if kind in ("lines of Windows", "byte order mark") else INVALID
    path.write_bytes(
        {
            "lines of Windows": text.replace("\n", "\r\n").encode(), "byte order mark": text.encode("utf-8-sig"),
            "NUL": text.encode() + bytes(3), "UTF-16": text.encode("utf-16"), "tabs": text.replace("  ", "\t").encode(),
            "Latin-1": f"# \u00e9\n{text}".encode("latin-1"),
        }[kind]
    )  # fmt: skip
    return Case(f"{name}: {kind}", expected, call=lambda: _load_robot(path))


def _load_robot(path: Path) -> None:
    from wbmpc.model.robot import load_robot

    load_robot(path)


_ARM = """<mujoco model="arm">{top}
 <worldbody><body name="b"><geom size="0.1"/>
  <body name="t" pos="0 0 {far}"><joint name="j" axis="0 0 1" range="-60 60"/>
  <geom type="box" size="{size} 0.1 0.1"/>{inside}</body>
 </body>{world}</worldbody>{end}</mujoco>"""
_URDF = """<robot name="arm"><link name="b"/><link name="t"><inertial><mass value="{size}"/><origin xyz="0 0 {far}"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>{world}
<joint name="j" type="revolute"><parent link="b"/><child link="t"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>{inside}</robot>"""
_BOMB = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
#: By name of a place in the template what makes the file too large, broken or senseless.
_HUGE: tuple[tuple[str, str], ...] = (
    ("world", '<replicate count="100000" offset="0 0 1"><body><geom size="1"/></body></replicate>'),
    ("inside", '<replicate count="999"><replicate count="999"><geom size="1"/></replicate></replicate>'),
    ("world", "<body>" * 5000 + "</body>" * 5000), ("world", "<body/>" * 3000), ("world", '<geom size="1"/>' * 4000),
    ("world", '<include file="arm.xml"/>'), ("inside", '<geom size="-1"/>'), ("world", "<body"), ("world",
    "<x y='1'/>"),
    ("top", '<asset><texture name="x" type="2d" builtin="flat" width="90000" height="90000"/></asset>'),
    ("top", '<asset><hfield name="h" nrow="90000" ncol="90000" size="1 1 1 1"/></asset>'),
    ("top", '<asset><mesh name="h" builtin="supersphere" params="9000 1 1"/></asset>'),
    ("end", '<custom><numeric name="n" size="2000000000"/></custom>'), ("top", '<size nuser_body="2000000000"/>'),
    ("inside", '<joint name="j" axis="1 0 0"/>'), ("inside", '<joint name="other" axis="1 0 0"/>'),
)  # fmt: skip
#: Bodies of an MJCF need no names; links of a URDF do.
_NAMELESS = '<body><geom size="0.1"/><body pos="0 0 1"><site/></body></body>'
#: Attributes of the templates that are no numbers, and those of limits, whose numbers may be infinite.
_TEXTS, _LIMITS = ("name", "model", "type", "link"), ("range", "lower", "upper", "velocity", "effort")
_ATTRIBUTE = re.compile(r'(\w+)="([^"]*)"')


def _one_number(rng: random.Random, text: str, word: str, within: bool) -> str:
    """With ``word`` for one of the numbers of an attribute; ``within``: not of a limit."""
    found = [a for a in _ATTRIBUTE.finditer(text) if a[1] not in _TEXTS and not (within and a[1] in _LIMITS)]
    chosen = rng.choice(found)
    words = chosen[2].split()
    words[rng.randrange(len(words))] = word
    return text[: chosen.start(2)] + " ".join(words) + text[chosen.end(2) :]


def _hide(rng: random.Random, text: str, urdf: bool) -> str:
    """With too many elements between what looks like the marks of a comment."""
    many = "".join(f'<link name="l{k}"/>' for k in range(6000)) if urdf else _HUGE[0][1]
    marks = rng.choice(
        (("<![CDATA[<!--]]>", "<![CDATA[-->]]>"), ('<site name="<!--"/>', '<site name="-->"/>'), ("<?a <!-- ?>", "<?a --> ?>"),
         ("<!-- <![CDATA[ -->", "<!-- ]]> -->"), ("<!-- ' -->", "<!-- ' -->"), ("<!---->", "<!---->"))
    )  # fmt: skip
    at = text.rindex("</robot>" if urdf else "</worldbody>")
    return text[:at] + many.join(marks) + text[at:]


def models(rng: random.Random, folder: Path) -> Case:
    """URDF and MJCF: a small arm that was changed."""
    urdf = rng.random() < 0.4
    parts = {"top": "", "far": "0.5", "size": "0.2", "inside": "", "world": "", "end": ""}
    kinds = (
        "as it is",
        "huge",
        "entities",
        "cut",
        "attribute",
        "bytes",
        "hidden",
        "not finite",
        "far",
        "nameless",
        "endless",
    )
    kind, expected = rng.choice(kinds), INVALID
    if kind == "as it is":
        parts["far"], parts["size"], expected = f"{rng.uniform(0.1, 2):.3f}", f"{rng.uniform(0.1, 2):.3f}", VALID
    elif kind == "huge" and not urdf:
        place, text = rng.choice(_HUGE)
        parts[place] = text
    elif kind == "huge":
        parts["world"] = "".join(f'<link name="l{k}"/>' for k in range(3000))
    elif kind == "attribute":
        parts[rng.choice(("far", "size"))], expected = (
            rng.choice(("nan", "inf", "1e400", "", "a", "0x1", "-1", "1 2", "1e-320")),
            OPEN,
        )
    elif kind == "nameless":
        parts["inside"], expected = "" if urdf else _NAMELESS * rng.randint(1, 3), VALID
    text = (_URDF if urdf else _ARM).format(**parts)
    if kind == "entities":
        text = _BOMB + text
    elif kind == "hidden":
        text = _hide(rng, text, urdf)
    elif kind in ("not finite", "far"):
        words = (
            ("nan", "-NaN", "nan(7)", "+nan")
            if kind == "not finite"
            else ("1e200", "-1e11", "inf", "-Infinity", "1e308")
        )
        text = _one_number(rng, text, rng.choice(words), within=kind == "far")
    elif kind == "endless":  # a range that no joint can leave is none
        end = rng.choice(("1e7", "1e16", "1e308", "inf"))
        text, expected = (
            text.replace('"-60 60"', f'"-{end} {end}"')
            .replace('"-1"', f'"-{end}"')
            .replace('upper="1"', f'upper="{end}"'),
            VALID,
        )
    data = text.encode()
    if kind == "cut":
        data = data[: rng.randint(0, len(data) - 8)]
    elif kind == "bytes":
        data, expected = flipped(rng, data), OPEN
    name = "arm.urdf" if urdf else "arm.xml"
    (folder / name).write_bytes(data)
    path = folder / "arm.yaml"
    path.write_text(f"name: arm\nmodel: {name}\nbase: {{type: fixed, body: b}}\narm: {{joints: [j], tool: t}}\n")
    return Case(f"{name}: {kind}: {text[:60]!r}", expected, call=lambda: _load_robot(path))
