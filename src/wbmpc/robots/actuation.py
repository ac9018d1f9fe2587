"""What a robot's file says of its joints' drives: largest speeds and efforts, and whether a joint has a drive at all."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import mujoco

from wbmpc.checks import parse_number
from wbmpc.robots.model_file import ModelFile

#: What is smaller is a standstill, what is larger no limit [rad/s, m/s, N m or N].
SMALLEST, LARGEST = 1e-6, 1e6


@dataclass(frozen=True)
class Drive:
    """``velocity`` [rad/s or m/s] and ``effort`` [N m or N] of a joint, None where the file has none; ``mimics``: the joint that it follows,
    at ``ratio`` times its value and ``offset`` [rad or m]; ``driven``: whether a transmission or an actuator names it; ``no_range``: it
    needs a range in a URDF, and has none or an empty one; ``no_effort``: the file names an effort that limits nothing (0, or a range of
    forces on one side of 0)."""

    velocity: float | None = None
    effort: float | None = None
    mimics: str | None = None
    driven: bool = False
    ratio: float = 1.0
    offset: float = 0.0
    no_range: bool = False
    no_effort: bool = False


def read_drives(file: ModelFile, spec: mujoco.MjSpec) -> dict[str, Drive]:
    """By joint. ``spec``: the file as :func:`wbmpc.robots.model_file.parse` gives it, with its actuators."""
    return _of_urdf(file) if file.root is not None else _of_spec(spec)


# ---------------------------------------------------------------------- URDF
def _of_urdf(file: ModelFile) -> dict[str, Drive]:
    assert file.root is not None
    driven = {j.get("name") for t in file.root.iter("transmission") for j in t.iter("joint")}
    driven |= {
        j.get("name")
        for t in file.root.iter("ros2_control")
        for j in t.iter("joint")
        if j.find("command_interface") is not None
    }
    found = {}
    for joint in file.root.findall("joint"):
        name, limit, mimic = joint.get("name", ""), joint.find("limit"), joint.find("mimic")
        attributes = {} if limit is None else limit.attrib
        low, high = (number(attributes.get(k, "0")) for k in ("lower", "upper"))
        found[name] = Drive(
            _bound(number(attributes.get("velocity"))), _bound(number(attributes.get("effort"))),
            None if mimic is None else mimic.get("joint", ""), name in driven, *_following(mimic),
            joint.get("type") in ("revolute", "prismatic") and not (low is not None and high is not None and low < high),
            (effort := number(attributes.get("effort"))) is not None and effort < SMALLEST,
        )  # fmt: skip
    return found


def _following(mimic: Any) -> tuple[float, float]:
    """Ratio and offset of a joint that follows another."""
    if mimic is None:
        return 1.0, 0.0
    ratio, offset = number(mimic.get("multiplier", "1")), number(mimic.get("offset", "0"))
    return (1.0 if ratio is None else ratio), offset or 0.0


def number(text: str | None) -> float | None:
    """A number of an attribute; None where there is none."""
    try:
        value = parse_number(text or "")
    except ValueError:
        return None
    return None if math.isnan(value) else value


def _bound(value: float | None) -> float | None:
    return value if value is not None and SMALLEST <= value <= LARGEST else None


# ---------------------------------------------------------------------- MJCF
def _of_spec(spec: mujoco.MjSpec) -> dict[str, Drive]:
    found: dict[str, Drive] = {}
    for joint in spec.joints:
        forces = tuple(map(float, joint.actfrcrange))
        found[joint.name] = Drive(
            effort=_bound(_half(forces, joint.actfrclimited)), no_effort=_one_sided(forces, joint.actfrclimited)
        )
    for actuator in spec.actuators:
        if actuator.target in found and actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT:
            found[actuator.target] = _with(found[actuator.target], actuator)
    for name, other, ratio, offset in _followers(spec):
        if name in found:
            found[name] = replace(found[name], mimics=other, ratio=ratio, offset=offset)
    return found


def _with(drive: Drive, actuator: mujoco.MjsActuator) -> Drive:
    """What an actuator adds: the range of its force, or of its control where that is a force or a speed."""
    gear, gain = abs(float(actuator.gear[0])), float(actuator.gainprm[0])
    force, control = (
        _half(tuple(actuator.forcerange), actuator.forcelimited),
        _half(tuple(actuator.ctrlrange), actuator.ctrllimited),
    )
    bias, velocity = tuple(map(float, actuator.biasprm[:3])), drive.velocity
    constant = actuator.gaintype == mujoco.mjtGain.mjGAIN_FIXED
    is_force = constant and actuator.biastype == mujoco.mjtBias.mjBIAS_NONE
    if force is None and control is not None and is_force:
        force = control * abs(gain)
    if control is not None and constant and bias[:2] == (0.0, 0.0) and bias[2] == -gain != 0.0 and gear > 0.0:
        velocity = _bound(control / gear)
    effort = drive.effort if force is None else drive.effort or _bound(force * gear)
    none = drive.no_effort or _one_sided(tuple(actuator.forcerange), actuator.forcelimited)
    none = none or (is_force and _one_sided(tuple(actuator.ctrlrange), actuator.ctrllimited))
    return replace(drive, velocity=velocity, effort=effort, driven=True, no_effort=none and effort is None)


def _half(bounds: tuple[float, ...], limited: int) -> float | None:
    """The largest value that a range allows both ways; None where it does not hold (0: off, 1: on, 2: by whether it is given)."""
    low, high = map(float, bounds)
    return min(-low, high) if int(limited) and low < 0.0 < high else None


def _one_sided(bounds: tuple[float, ...], limited: int) -> bool:
    """Whether a range that holds does not reach beyond 0 both ways."""
    low, high = map(float, bounds)
    return bool(int(limited)) and low < high and not low < 0.0 < high


def _followers(spec: mujoco.MjSpec) -> Iterator[tuple[str, str, float, float]]:
    for equality in spec.equalities:
        if equality.type == mujoco.mjtEq.mjEQ_JOINT and equality.active and equality.name2:
            yield equality.name1, equality.name2, float(equality.data[1]), float(equality.data[0])
