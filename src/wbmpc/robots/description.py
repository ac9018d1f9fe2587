"""What a robot's YAML says, checked; and its URDF or MJCF as one MuJoCo specification."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, Self
from xml.etree import ElementTree

import mujoco
import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from wbmpc.errors import InputError, unknown_name
from wbmpc.robots.checks import check_ball, check_joints, check_tool, compiled, refuse_truths
from wbmpc.robots.file_limits import check_size
from wbmpc.robots.lock import lock
from wbmpc.robots.mechanics import keep_mechanics, refuse_couplings, widen
from wbmpc.robots.wheel_geometry import check_radii
from wbmpc.yaml_file import load_yaml

DATA = Path(__file__).parent / "data"
#: Omni wheels nearer to each other than about so many radians turn the ball about two axes only.
LEAST_SPREAD = 0.05


def _moves(value: float) -> float:
    if value < 1e-6:
        raise ValueError("input should be 1e-06 or more")
    return value


#: A limit of a machine, in SI units: what is smaller is a standstill, what is larger no limit.
_Limit = Annotated[float, Field(gt=0, le=1e6), AfterValidator(_moves)]
_Place = Annotated[float, Field(ge=-1e6, le=1e6)]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class ModuleDescription(_Model):
    """One swerve module: names of its joints; ``hinge`` is left out when the legs are fixed (all of a base, or none)."""

    hinge: str | None = None
    steer: str
    wheel: str


class SwerveBaseDescription(_Model):
    """A base on steered and driven wheels. ``wheel_radius`` [m]. ``orientation``: SE(2) state or a quaternion."""

    type: Literal["swerve"]
    body: str
    orientation: Literal["yaw", "quaternion"] = "yaw"
    wheel_radius: float = Field(gt=0)
    modules: tuple[ModuleDescription, ...] = Field(min_length=2)


class OmniWheelsDescription(_Model):
    """Omni wheels on the ball: radius [m], zenith angle and azimuths [rad] of their contacts."""

    radius: float = Field(gt=0)
    zenith: float = Field(gt=0, lt=np.pi / 2)
    azimuths: tuple[float, ...] = Field(min_length=3)

    @field_validator("azimuths")
    @classmethod
    def _every_way(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        around = np.stack([np.cos(value), np.sin(value), np.ones(len(value))])  # the axes' directions at 45 degrees
        if np.linalg.svd(around, compute_uv=False)[-1] < LEAST_SPREAD:
            raise ValueError("the wheels cannot turn the ball about every axis: three different azimuths are needed")
        return value


class InertialDescription(_Model):
    """The inertial unit's range: ``rate`` [rad/s] and ``acceleration`` [m/s²] that it can measure about and along each axis. Left
    out: those of the ADIS16448's data sheet, 1000 degrees/s and 18 g."""

    rate: float = Field(np.deg2rad(1000.0), gt=0)
    acceleration: float = Field(18.0 * 9.81, gt=0)


class BallBaseDescription(_Model):
    """A base that balances on a ball: the body ``ball`` hangs on ``body`` by a ball joint, in the same frame.

    ``contact``: what the world does to the robot as an input: a force, or a wrench (force and moment), at each frame of
    ``contact_frame`` (a name or several; the arm's tool when left out); "none": a force at the tool as a parameter.
    ``payload``: whether a mass at the tool [kg] is a parameter (``payload``).
    """

    type: Literal["ball"]
    body: str
    ball: str
    ball_radius: float = Field(gt=0)
    wheels: OmniWheelsDescription
    imu: InertialDescription = InertialDescription()
    contact: Literal["none", "force", "wrench"] = "none"
    contact_frame: tuple[str, ...] = ()
    payload: bool = False

    @field_validator("contact_frame", mode="before")
    @classmethod
    def _several(cls, value: Any) -> Any:
        return (value,) if isinstance(value, str) else value

    @model_validator(mode="after")
    def _contacts(self) -> Self:
        if self.contact_frame and self.contact == "none":
            raise ValueError("contact_frame needs contact: force or contact: wrench")
        if len(set(self.contact_frame)) < len(self.contact_frame):
            raise ValueError(f"contact_frame: every frame once, got {', '.join(self.contact_frame)}")
        return self


class FixedBaseDescription(_Model):
    """A base that does not move."""

    type: Literal["fixed"]
    body: str


class ArmDescription(_Model):
    """The arm's joints from base to hand, and the name of the hand's frame (site or body)."""

    joints: tuple[str, ...] = Field(min_length=1)
    tool: str


class LimitsDescription(_Model):
    """Limits by joint: velocity [rad/s], acceleration [rad/s²], effort [N m], position [rad] (overrides the file's range).

    ``drive_velocity`` [rad/s]: what a steering drive may do beyond ``velocity``, which is the planner's, to catch up with the plan.
    ``base``: largest speed along each axis [m/s] and about the vertical [rad/s]; ``wheel_effort`` [N m]: omni wheels (needed);
    ``spin_effort`` [N m]: what they may do to a ball about the vertical before it spins on the floor.
    """

    velocity: dict[str, _Limit] = {}
    drive_velocity: dict[str, _Limit] = {}
    acceleration: dict[str, _Limit] = {}
    effort: dict[str, _Limit] = {}
    position: dict[str, tuple[_Place, _Place]] = {}
    base_linear: _Limit = 1.0
    base_angular: _Limit = 1.0
    wheel_effort: float = Field(default=np.inf, gt=0)
    spin_effort: float = Field(default=np.inf, gt=0)

    @model_validator(mode="after")
    def _reserve(self) -> Self:
        for name, rate in self.drive_velocity.items():
            if rate < self.velocity.get(name, np.inf):
                raise ValueError(f"drive_velocity: '{name}' needs a velocity, and no less than that")
        return self

    @field_validator("position")
    @classmethod
    def _in_order(cls, value: dict[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        for name, (low, high) in value.items():
            if not low < high:
                raise ValueError(f"'{name}' needs lower < upper")
        return value


class RobotDescription(_Model):
    """A robot: where its file is, what moves it, its arm, home and limits. Units SI and radians.

    ``lock``: joints that are held, and where [rad or m]. Every joint of the file below the base's body is either named by
    ``arm`` or ``base`` or held: fingers of a gripper (mimic joints too), a wrist that is not used, casters.
    """

    name: str
    model: Path
    base: Annotated[SwerveBaseDescription | BallBaseDescription | FixedBaseDescription, Field(discriminator="type")]
    arm: ArmDescription
    lock: dict[str, float] = {}
    home: dict[str, float] = {}
    limits: LimitsDescription = LimitsDescription()
    source: str = Field(default="", exclude=True)

    @model_validator(mode="after")
    def _every_joint_once(self) -> Self:
        names = self.joints()
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise ValueError(f"arm.joints and base.modules: every joint once, got '{twice[0]}' twice")
        return self

    @model_validator(mode="after")
    def _wheels_have_limits(self) -> Self:
        if isinstance(self.base, BallBaseDescription) and not np.isfinite(self.limits.wheel_effort):
            raise ValueError(
                "key 'limits.wheel_effort': a base of type ball needs the largest torque [N m] of its omni wheels"
            )
        return self

    def joints(self) -> list[str]:
        """Names of all joints that the description uses."""
        names = list(self.arm.joints)
        if isinstance(self.base, SwerveBaseDescription):
            names += [n for m in self.base.modules for n in (m.hinge, m.steer, m.wheel) if n]
        return names


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
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")
    data = load_yaml(path)
    if not isinstance(data, dict):
        raise InputError(f"{path}: a mapping of keys is needed")
    strange = [key for key in data if not isinstance(key, str)]
    if strange:
        raise unknown_name("key", str(strange[0]), _sibling_keys((strange[0],), ""), where=str(path))
    refuse_truths(data, path)
    if isinstance(data.get("base"), dict):
        data["base"] = {**data["base"], **base}
        _refuse_contact(data["base"], path)
    try:
        description = RobotDescription(**data)
    except ValidationError as error:
        raise InputError(f"{path}: {_first_fault(error)}") from error
    model = description.model if description.model.is_absolute() else path.parent / description.model
    description = description.model_copy(update={"model": model, "source": str(path)})
    spec = load_spec(description)
    _check_names(description, spec)
    model = compiled(spec, description.model)
    check_joints(description, model)
    check_tool(description, model)
    check_ball(description, model)
    check_radii(description, model)
    return description


def _refuse_contact(base: dict[str, Any], path: Path) -> None:
    """What the world pushes changes the motion of forces' robots only, not of those whose inputs are speeds."""
    kind = base.get("type")
    for key in ("contact", "contact_frame"):
        if kind in ("swerve", "fixed") and key in base:
            raise InputError(
                f"{path}: key 'base.{key}': the inputs of a {kind} base are speeds, so that a contact force or wrench has "
                "no effect on its motion; valid: with a base of type ball"
            )


def _first_fault(error: ValidationError) -> str:
    """The first fault of a validation in plain words, without web links, and how many more there are.

    A key that is not known comes before one that is missing: it is usually that key, mistyped.
    """
    faults = error.errors(include_url=False)
    fault = min(faults, key=lambda f: f["type"] != "extra_forbidden")
    path = [str(k) for k in fault["loc"] if k not in ("swerve", "ball", "fixed")] or ["?"]
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    key = ".".join(path)
    if fault["type"] == "extra_forbidden":
        return str(unknown_name("key", key, _sibling_keys(fault["loc"], ".".join(path[:-1])))) + more
    if not fault["loc"]:  # of keys together: the sentence names them
        return fault["msg"].removeprefix("Value error, ") + more
    if fault["type"].startswith("union_tag"):
        return f"key '{key}.type': valid: ball, fixed, swerve{more}"
    given = "" if fault["type"] == "missing" or isinstance(fault["input"], dict) else f", got {fault['input']!r}"
    text = fault["msg"].removeprefix("Value error, ")
    return f"key '{key}': {text[0].lower()}{text[1:]}{given}{more}"


def _sibling_keys(location: tuple[int | str, ...], prefix: str) -> list[str]:
    """The valid keys beside an unknown one, with the same dotted prefix."""
    bases: dict[str, type[BaseModel]] = {
        "swerve": SwerveBaseDescription,
        "ball": BallBaseDescription,
        "fixed": FixedBaseDescription,
    }
    inner: dict[str, type[BaseModel]] = {
        "modules": ModuleDescription,
        "wheels": OmniWheelsDescription,
        "imu": InertialDescription,
        "arm": ArmDescription,
        "limits": LimitsDescription,
    }
    model: type[BaseModel] = RobotDescription
    for part in location[:-1]:
        model = bases.get(str(part)) or inner.get(str(part)) or model
    names = [n for n in model.model_fields if n != "source"]
    return [f"{prefix}.{n}" if prefix else n for n in names]


def _check_names(description: RobotDescription, spec: mujoco.MjSpec) -> None:
    joints = [j.name for j in spec.joints]
    limits = description.limits
    used = {
        "arm.joints": list(description.arm.joints),
        "base.modules": description.joints()[len(description.arm.joints) :],
        "home": list(description.home),
        "limits.velocity": list(limits.velocity),
        "limits.drive_velocity": list(limits.drive_velocity),
        "limits.acceleration": list(limits.acceleration),
        "limits.effort": list(limits.effort),
        "limits.position": list(limits.position),
    }
    for key, names in used.items():
        for name in names:
            if name not in joints:
                raise unknown_name(f"joint (key '{key}')", name, joints, where=description.source)
    frames = [s.name for s in spec.sites] + [b.name for b in spec.bodies]
    contacts = {n: "base.contact_frame" for n in getattr(description.base, "contact_frame", ())}
    for name, key in {**contacts, description.arm.tool: "arm.tool"}.items():
        if name not in frames:
            raise unknown_name(f"frame (key '{key}')", name, frames, where=description.source)
    steering = [m.steer for m in getattr(description.base, "modules", ())]
    for name in limits.drive_velocity:
        if name not in steering:
            raise unknown_name("steering joint (key 'limits.drive_velocity')", name, steering, where=description.source)
    bodies = [b.name for b in spec.bodies]
    for key in ("body", "ball"):
        body = getattr(description.base, key, None)
        if body is not None and body not in bodies:
            raise unknown_name(f"body (key 'base.{key}')", body, bodies, where=description.source)


def load_spec(description: RobotDescription) -> mujoco.MjSpec:
    """The robot's file as an editable MuJoCo specification of its mechanics, with its locked joints removed."""
    path = description.model
    if not path.is_file():
        raise InputError(f"{description.source}: key 'model': there is no file {path}")
    check_size(path)
    try:
        spec = _urdf_spec(path) if path.suffix.lower() == ".urdf" else mujoco.MjSpec.from_file(str(path))
    except (ValueError, ElementTree.ParseError) as error:
        raise InputError(f"{path}: cannot be read: {' '.join(str(error).split())}") from error
    keep_mechanics(spec, description.base.body, path)
    refuse_couplings(spec, description)
    widen(spec, description.limits.position, path)
    for name, angle in description.lock.items():
        lock(spec, name, angle, description.source)
    return spec


def _urdf_spec(path: Path) -> mujoco.MjSpec:
    """URDF without its meshes (planning needs none), with all links kept."""
    root = ElementTree.parse(path).getroot()
    for link in root.iter("link"):
        for kind in ("visual", "collision"):
            for element in link.findall(kind):
                link.remove(element)
    compiler = {"strippath": "false", "balanceinertia": "true", "fusestatic": "false", "discardvisual": "false"}
    extension = root.find("mujoco")
    if extension is None:
        extension = ElementTree.SubElement(root, "mujoco")
    ElementTree.SubElement(extension, "compiler", compiler)
    return mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"))
