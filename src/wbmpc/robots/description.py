"""What a robot's YAML says, checked; and its URDF or MJCF as one MuJoCo specification."""

from __future__ import annotations

import logging
import re
from os.path import isfile
from pathlib import Path
from typing import Annotated, Any, Self

import mujoco
import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    SerializeAsAny,
    ValidationError,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from wbmpc.bases import available_base_types, base_type, base_type_in_use
from wbmpc.bases.base import BaseDescription, Section
from wbmpc.errors import InputError, unknown_name
from wbmpc.input_file import expanded
from wbmpc.robots.actuation import Drive
from wbmpc.robots.checks import check_joints, check_tool, compiled
from wbmpc.robots.collision import CollisionDescription, check_frames
from wbmpc.robots.couplings import Coupled, check_couplings, couple, limits_of_leaders
from wbmpc.robots.description_faults import first_fault, keys, reject_truths
from wbmpc.robots.fixed_joints import fix_joint
from wbmpc.robots.inertia import replace_inertias
from wbmpc.robots.mechanism import Mechanism, read_mechanism
from wbmpc.robots.model_checks import AT_LOAD, Subject, examine
from wbmpc.robots.model_file import ModelFile, file_of, parse
from wbmpc.robots.model_import import keep_mechanics, reject_couplings, widen
from wbmpc.robots.read_once import once, remembers
from wbmpc.robots.wheel_geometry import check_radii
from wbmpc.yaml_file import load_yaml

_LOG = logging.getLogger(__name__)
DATA = Path(__file__).parent / "data"
#: Characters of a robot's name, which is part of names of files and nodes.
LONGEST_NAME = 64
#: Keys of ``limits`` that are of joints, whatever the base.
JOINT_LIMITS = ("velocity", "actuator_velocity", "acceleration", "effort", "position")


def _robot_name(value: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", value) or len(value) > LONGEST_NAME:
        raise ValueError(
            f"a name of letters, digits, - and _ is needed, which begins with a letter or digit and has at most {LONGEST_NAME} characters"
        )
    return value


#: A limit of a machine, in SI units: what is smaller is a standstill, what is larger no limit.
_Limit = Annotated[float, Field(gt=0, ge=1e-6, le=1e6)]
_Place = Annotated[float, Field(ge=-1e6, le=1e6)]


class ArmDescription(Section):
    """The arm's joints from base to end effector, and the name of the end effector's frame (site or body)."""

    joints: tuple[str, ...] = Field(min_length=1)
    tool: str


class LimitsDescription(Section):
    """Limits by joint: velocity [rad/s], acceleration [rad/s²], effort [N m], position [rad] (overrides the file's range).

    ``actuator_velocity`` [rad/s]: what a steering drive may do beyond ``velocity``, which is the planner's, to catch up with the plan.
    ``base``: largest speed along each axis [m/s] and about the vertical [rad/s]; ``wheel_effort`` [N m]: omni wheels (needed);
    ``wheel_velocity`` [rad/s]: up to which they give it, in the simulated robot; ``spin_effort`` [N m]: what they may do about the
    vertical before the robot spins on the floor.
    """

    velocity: dict[str, _Limit] = Field(default={})
    actuator_velocity: dict[str, _Limit] = Field(default={})
    acceleration: dict[str, _Limit] = Field(default={})
    effort: dict[str, _Limit] = Field(default={})
    position: dict[str, tuple[_Place, _Place]] = Field(default={})
    base_linear: _Limit = 1.0
    base_angular: _Limit = 1.0
    wheel_effort: _Limit = np.inf
    wheel_velocity: _Limit = np.inf
    spin_effort: _Limit = np.inf

    @model_validator(mode="after")
    def _reserve(self) -> Self:
        for name, rate in self.actuator_velocity.items():
            if rate < self.velocity.get(name, np.inf):
                raise ValueError(f"actuator_velocity: '{name}' needs a velocity, and no less than that")
        return self

    @field_validator("position")
    @classmethod
    def _in_order(cls, value: dict[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        for name, (low, high) in value.items():
            if not low < high:
                raise ValueError(f"'{name}' needs lower < upper")
        return value


def _base_section(value: Any) -> Any:
    """The section as its base type reads it. Errors keep the keys of the section in their path."""
    if isinstance(value, BaseDescription) or not isinstance(value, dict):
        return value
    name = value.get("type")
    if name not in available_base_types():
        raise PydanticCustomError("base_type", "valid: {valid}", {"valid": ", ".join(available_base_types())})
    return base_type_in_use(name).Description.model_validate(value)


class RobotDescription(Section):
    """A robot: where its file is, what moves it, its arm, home and limits. Units SI and radians.

    ``arms``: several of them by name, in place of ``arm``: the first one's tool is the robot's end effector, and all their joints are its
    ``arm``. ``torso``: joints that carry the arms, before theirs.
    ``fixed_joints``: joints that are held, and where [rad or m]. Every joint of the file below the base's body is either named by
    ``arm`` or ``base`` or held: fingers of a gripper (mimic joints too), a wrist that is not used, casters. ``packages``: folders of
    the ROS packages that the model names (``package://``), ``xacro_arguments``: of its macros. What ``limits`` does not say of a
    joint's velocity, effort and position, the model does. ``couple``: joints that follow joints of the arm, as the stages of a telescope:
    of each the joint that leads it, or a mapping with ``joint``, ``ratio`` and ``offset``. ``collision``: shapes, and the distances that they keep.
    ``source``: the file, for messages.
    """

    name: Annotated[str, AfterValidator(_robot_name)]
    model: Path
    base: Annotated[SerializeAsAny[BaseDescription], BeforeValidator(_base_section)]
    arm: ArmDescription
    arms: dict[str, ArmDescription] = Field(default={})
    torso: tuple[str, ...] = ()
    packages: dict[str, Path] = Field(default={})
    xacro_arguments: dict[str, str] = Field(default={})
    fixed_joints: dict[str, _Place] = Field(default={})
    couple: dict[str, Coupled] = Field(default={})
    home: dict[str, _Place] = Field(default={})
    limits: LimitsDescription = LimitsDescription()
    collision: CollisionDescription = CollisionDescription()
    source: str = Field(default="", exclude=True)

    @model_validator(mode="before")
    @classmethod
    def _one_arm_of_all(cls, data: Any) -> Any:
        """``arm`` as everything that moves end effectors: the torso, and the joints of all arms."""
        if not isinstance(data, dict) or not (data.get("arms") or data.get("torso")):
            return data
        arms = data.get("arms") or {"arm": data.get("arm")}
        if data.get("arms") and data.get("arm") is not None:
            raise ValueError("arms: with several arms there is no key 'arm'")
        if not isinstance(arms, dict) or not all(
            isinstance(a, dict) and isinstance(a.get("joints"), list) for a in arms.values()
        ):
            return data  # the fields say what is wrong
        joints = [*(data.get("torso") or ()), *(n for a in arms.values() for n in a["joints"])]
        return {**data, "arm": {"joints": joints, "tool": next(iter(arms.values())).get("tool")}}

    @model_validator(mode="after")
    def _every_joint_once(self) -> Self:
        names = self.joints()
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise ValueError(f"{self.joint_keys(' and ')}: every joint once, got '{twice[0]}' twice")
        return self

    @model_validator(mode="after")
    def _coupled_joints_follow(self) -> Self:
        check_couplings(self)
        return self

    @model_validator(mode="after")
    def _limits_fit_the_base(self) -> Self:
        valid = [*JOINT_LIMITS, *self.base.limit_keys]
        for key in type(self.limits).model_fields:
            if key in self.limits.model_fields_set and key not in valid:
                raise ValueError(
                    f"key 'limits.{key}': a base of type {self.base.type} does not read it; valid: {', '.join(valid)}"
                )
        self.base.check_limits(self.limits)
        return self

    def joints(self) -> list[str]:
        """Names of all joints that the description uses."""
        return [*self.arm.joints, *self.base.joints()]

    def tools(self) -> dict[str, str]:
        """Frames of the end effectors by arm; of one arm under "arm"."""
        return {name: arm.tool for name, arm in self.arms.items()} or {"arm": self.arm.tool}

    def joint_keys(self, between: str) -> str:
        """The keys of the file that name joints."""
        return f"arm.joints{between}base.{self.base.joint_key}" if self.base.joint_key else "arm.joints"


def available_robots() -> list[str]:
    """Names of the built-in robots."""
    return sorted(p.stem for p in DATA.glob("*.yaml"))


def load_description(name_or_path: str | Path, **base: Any) -> RobotDescription:
    """A built-in robot by name, or a YAML file. ``base`` replaces keys of its base section.

    Raises :class:`InputError` naming file and key.
    """
    if not isinstance(name_or_path, str | Path):
        raise InputError(f"robot: a name or a path to a .yaml file is needed, got {name_or_path!r}")
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        if str(name_or_path) not in available_robots():
            raise unknown_name("robot", str(name_or_path), [*available_robots(), "a path to a .yaml file"])
        path = DATA / f"{name_or_path}.yaml"
    if not isfile(path):
        raise InputError(f"{path}: there is no such file")
    data = load_yaml(path)
    if not isinstance(data, dict):
        raise InputError(f"{path}: a mapping of keys is needed")
    strange = [key for key in data if not isinstance(key, str)]
    if strange:
        raise unknown_name("key", str(strange[0]), keys(RobotDescription, ""), where=str(path))
    reject_truths(data, path, data, RobotDescription)
    if isinstance(data.get("base"), dict):
        data["base"] = {**data["base"], **base}
    try:
        description = RobotDescription(**data)
    except ValidationError as error:
        raise InputError(f"{path}: {first_fault(error, data, RobotDescription)}") from error
    packages = {
        name: path.parent / _expanded(folder, path, "packages") for name, folder in description.packages.items()
    }
    model = path.parent / _expanded(description.model, path, "model")
    description = description.model_copy(update={"model": model, "packages": packages, "source": str(path)})
    spec = load_spec(description)
    _check_names(description, spec)
    mechanism = read_mechanism(file_of(description))
    description = _with_limits_of_the_model(description, mechanism.drives)
    if description.couple:
        description = description.model_copy(update={"limits": limits_of_leaders(description, spec)})
    _examine(description, mechanism)
    model = compiled(spec, description.model)
    check_joints(description, model)
    check_tool(description, model)
    base_type(description.base.type).check(description, model)
    check_radii(description, model)
    return description


def _with_limits_of_the_model(description: RobotDescription, drives: dict[str, Drive]) -> RobotDescription:
    """The description with the speeds and efforts that its model has for joints which ``limits`` does not name."""
    named = [*description.joints(), *description.couple]
    limits, found = description.limits, {n: drives[n] for n in named if n in drives}
    velocity = {n: d.velocity for n, d in found.items() if d.velocity is not None and n not in limits.velocity}
    effort = {n: d.effort for n, d in found.items() if d.effort is not None and n not in limits.effort}
    if not velocity and not effort:
        return description
    update = {"velocity": {**limits.velocity, **velocity}, "effort": {**limits.effort, **effort}}
    return description.model_copy(update={"limits": limits.model_copy(update=update)})


def _examine(description: RobotDescription, mechanism: Mechanism) -> None:
    """Raise :class:`InputError` for the first error that checks of the model find, and log their warnings."""
    findings = examine(Subject(mechanism, description), AT_LOAD)
    for finding in sorted(findings, key=lambda f: f.severity != "error"):
        if finding.severity == "error":
            raise InputError(f"{description.model}: {finding.message}")
        if finding.severity == "warning":
            _LOG.warning("%s: %s", description.model, finding.message)


def _expanded(path: Path, file: Path, key: str) -> Path:
    try:
        return expanded(path)
    except InputError as error:
        raise InputError(f"{file}: {key}: {error}") from error


def _check_names(description: RobotDescription, spec: mujoco.MjSpec) -> None:
    joints = [j.name for j in spec.joints]
    limits = description.limits
    used = {
        "arm.joints": list(description.arm.joints), f"base.{description.base.joint_key}": description.base.joints(),
        "home": list(description.home), "limits.velocity": list(limits.velocity),
        "limits.actuator_velocity": list(limits.actuator_velocity), "limits.acceleration": list(limits.acceleration),
        "limits.effort": list(limits.effort), "limits.position": list(limits.position),
    }  # fmt: skip
    for key, names in used.items():
        for name in names:
            if name not in joints:
                raise unknown_name(f"joint (key '{key}')", name, joints, where=description.source)
    frames = [s.name for s in spec.sites] + [b.name for b in spec.bodies]
    of_base = {n: f"base.{key}" for key, names in description.base.frames().items() for n in names}
    of_arms = {arm.tool: f"arms.{name}.tool" for name, arm in description.arms.items()}
    for name, key in {**of_base, description.arm.tool: "arm.tool", **of_arms}.items():
        if name not in frames:
            raise unknown_name(f"frame (key '{key}')", name, frames, where=description.source)
    steering = description.base.steering_joints()
    for name in limits.actuator_velocity:
        if name not in steering:
            raise unknown_name(
                "steering joint (key 'limits.actuator_velocity')", name, steering, where=description.source
            )
    check_frames(description.collision, spec, description.source)
    bodies = [b.name for b in spec.bodies]
    for key, body in {"body": description.base.body, **description.base.parts()}.items():
        if body not in bodies:
            raise unknown_name(f"body (key 'base.{key}')", body, bodies, where=description.source)


def load_spec(description: RobotDescription | str | Path, *, meshes: bool = False) -> mujoco.MjSpec:
    """The file of a robot (its ``description``, or what :func:`load_description` takes) as an editable MuJoCo specification of its mechanics,
    without its locked joints.

    ``meshes``: with the meshes of a URDF that exist, for display.
    """
    if not isinstance(description, RobotDescription):
        description = load_description(description)
    if meshes or not remembers():
        return _mechanics(description, meshes)
    own = description.model_dump(include={"model", "packages", "xacro_arguments", "fixed_joints", "couple", "source"})
    base = description.base
    key = repr((own, description.joints(), description.limits.position, base.uses_inertia, base.body, base.parts()))
    return once(("mechanics", key), lambda: _mechanics(description, meshes)).copy()


def _mechanics(description: RobotDescription, meshes: bool) -> mujoco.MjSpec:
    file = file_of(description)
    spec = _parse(description, file, meshes)
    if meshes and file.root is not None and spec.meshes and (fault := _fault(spec)):
        _LOG.warning("%s: its meshes are not shown: %s", description.model, fault)
        spec = _parse(description, file, meshes=False)
    keep_mechanics(spec, description.base.body, description.model)
    reject_couplings(spec, description)
    widen(spec, description.limits.position, description.model)
    for name, angle in description.fixed_joints.items():
        fix_joint(spec, name, angle, description.source)
    couple(spec, description.couple, description.source)
    return spec


def _parse(description: RobotDescription, file: ModelFile, meshes: bool) -> mujoco.MjSpec:
    spec = parse(file, meshes=meshes)
    if not description.base.uses_inertia:
        replace_inertias(spec, balance=True)  # else MuJoCo names the body
    return spec


def _fault(spec: mujoco.MjSpec) -> str | None:
    """Why a specification does not compile."""
    try:
        spec.compile()
    except ValueError as error:
        return " ".join(str(error).split())
    return None
