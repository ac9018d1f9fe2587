"""One YAML file for everything that a robot's bus may call differently: topics, frames, joints, rates."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal, cast

import numpy as np
from pydantic import Field, ValidationError, field_validator

from wbmpc.bases import base_type
from wbmpc.bases.base import WHEELS
from wbmpc.configuration import describe, keys, keys_of
from wbmpc.errors import InputError, unknown_name
from wbmpc.model.robot import RobotModel
from wbmpc.robots.frames import MAP
from wbmpc.ros2.bus import LONGEST_NODE_NAME, full_name, name_fault
from wbmpc.ros2.obstacle_settings import ObstacleSettings
from wbmpc.settings import ACTUATOR_TIME_CONSTANT, MpcSettings, Settings
from wbmpc.yaml_file import load_yaml

#: What ros2_control's controllers take: numbers for all joints, or a trajectory_msgs/JointTrajectory.
NUMBERS, TRAJECTORY = "std_msgs/msg/Float64MultiArray", "trajectory_msgs/msg/JointTrajectory"
TYPES = {"numbers": NUMBERS, "trajectory": TRAJECTORY, "twist": "geometry_msgs/msg/TwistStamped"}
#: Types of obstacles, by the keys of their topics.
OBSTACLE_TYPES = {
    "detections": "vision_msgs/msg/Detection3DArray", "occupancy_grid": "nav_msgs/msg/OccupancyGrid", "points": "sensor_msgs/msg/PointCloud2",
}  # fmt: skip
#: How long [s of the wall] simulated time may stand: in lockstep, and without a publisher, or else.
LOCKSTEP_PATIENCE, GONE = 30.0, 1.0
#: Topics of ROS whose names and types are fixed: nothing else may be there.
FIXED = {
    "/tf": "tf2_msgs/msg/TFMessage", "/tf_static": "tf2_msgs/msg/TFMessage", "/clock": "rosgraph_msgs/msg/Clock",
    "/robot_description": "std_msgs/msg/String", "/rosout": "rcl_interfaces/msg/Log",
    "/parameter_events": "rcl_interfaces/msg/ParameterEvent", "/ros_discovery_info": "rmw_dds_common/msg/ParticipantEntitiesInfo",
}  # fmt: skip


def _not_empty(name: str) -> str:
    if not name.strip("/ "):
        raise ValueError("a name is needed")
    return name


def _topic(name: str) -> str:
    fault = name_fault(name)
    if fault:
        raise ValueError(f"a topic's name {fault}")
    return name


class Topics(Settings):
    """Where messages come from and go to; a remapping is another name here. An empty name switches a topic off.

    ``pose``: another localization's pose of the base in the world frame; it corrects the odometry. ``wrench``: what the end effector is to exert.
    ``base_odom``: how far a base that takes speeds went, as its driver says.
    ``detections``, ``occupancy_grid``, ``points``: obstacles, which plans keep clear of; needed once they are named.
    """

    #: Types of goals and commands, by the keys of their topics; and keys of services. A base type adds its own in a subclass.
    requests: ClassVar[Mapping[str, str]] = {
        "goal_pose": "geometry_msgs/msg/PoseStamped", "end_effector_goal": "geometry_msgs/msg/PoseStamped",
        "base_path": "nav_msgs/msg/Path", "end_effector_path": "nav_msgs/msg/Path", "wrench": "geometry_msgs/msg/WrenchStamped",
    }  # fmt: skip
    services: ClassVar[tuple[str, ...]] = ()

    joint_states: str = "/joint_states"
    imu: str = "/imu"
    base_odom: str = "/base_controller/odom"
    pose: str = ""
    detections: str = ""
    occupancy_grid: str = ""
    points: str = ""
    goal_pose: str = "/goal_pose"
    end_effector_goal: str = "/end_effector_goal"
    base_path: str = "/base_path"
    end_effector_path: str = "/end_effector_path"
    cmd_vel: str = "/cmd_vel"
    wrench: str = "/wrench"
    odom: str = "/odom"
    end_effector_pose: str = "/end_effector_pose"
    plan: str = "/plan"
    end_effector_plan: str = "/end_effector_plan"
    footprint: str = "/footprint"
    diagnostics: str = "/diagnostics"

    @field_validator("*")
    @classmethod
    def _valid(cls, name: str) -> str:
        return name and _topic(name)

    @field_validator("joint_states", "base_odom")
    @classmethod
    def _needed(cls, name: str) -> str:
        if not name:
            raise ValueError("cannot be switched off")
        return name


class Frames(Settings):
    """Names of frames (REP 105): ``world`` is fixed where the robot started, ``base`` moves with it."""

    world: str = "odom"
    base: str = "base_link"

    @field_validator("world", "base")
    @classmethod
    def _named(cls, name: str) -> str:
        if not re.fullmatch(r"[^\s/]\S{0,199}", _not_empty(name)):
            raise ValueError("a frame's name begins with no /, has no spaces and at most 200 characters")
        return name


class Rates(Settings):
    """Rates [Hz] of the controller and of what it publishes about itself."""

    control: float = Field(400.0, ge=1, le=2000)
    odom: float = Field(50.0, ge=0.01, le=1000)
    plan: float = Field(2.0, ge=0.01, le=100)
    diagnostics: float = Field(1.0, ge=0.01, le=100)
    trajectory: float = Field(20.0, ge=0.01, le=200)


class Speeds(Settings):
    """How fast goals without times are approached: base [m/s], [rad/s], end effector [m/s]."""

    base: float = Field(0.4, ge=1e-3, le=20)
    turn: float = Field(0.4, ge=1e-3, le=20)
    end_effector: float = Field(0.2, ge=1e-3, le=20)


class VelocityLimits(Settings):
    """The largest speed that ``cmd_vel`` may ask for [m/s along x and y, rad/s]; left out, what the robot can (where
    these are no inputs: ``speeds``)."""

    base: float | None = Field(None, ge=1e-3, le=20)
    turn: float | None = Field(None, ge=1e-3, le=20)


class WrenchLimits(Settings):
    """The most that the end effector of a balancing robot may be asked to exert: force [N], moment [N m]. Its plan leans on the world's
    answer, and where there is none it has to stand all the same: an unanswered push of 20 N makes it fall."""

    force: float = Field(10.0, ge=1e-3, le=200)
    moment: float = Field(2.0, ge=1e-3, le=20)


class Goals(Settings):
    """How far from the robot goals and paths may be [m], over the floor: of the base, and of the end effector from where it is."""

    base: float = Field(100.0, ge=1e-3, le=10_000)
    end_effector: float = Field(100.0, ge=1e-3, le=10_000)


class Safety(Settings):
    """Times [s]: ``watchdog``: largest age of joint states; ``policy``: of a policy without a successor; ``ramp`` of a stop; ``cmd_vel``: a
    speed holds this long; ``clock``: with simulated time, largest wall time in which it stands (left out: as long as the watchdog, of a
    slower simulator's time, at most 1 s; in lockstep 30 s, for a busy machine takes its time, or 1 s when no publisher is left).
    ``jump`` [m, rad]: how far a pose of another localization may be off from what the robot's own motion says, beyond three deviations."""

    watchdog: float = Field(0.1, ge=1e-3, le=1)
    policy: float = Field(0.5, ge=1e-3, le=10)
    ramp: float = Field(0.2, ge=0, le=2)
    cmd_vel: float = Field(0.5, ge=1e-3, le=5)
    clock: float | None = Field(None, ge=1e-3, le=600)
    jump: float = Field(0.1, ge=1e-3, le=10)


class Controller(Settings):
    """A controller of ros2_control: ``topic`` of its commands, our ``joints`` in its order.

    ``takes``: ``numbers`` (Float64MultiArray: speeds, or efforts where the robot's drives take these) or ``trajectory`` (JointTrajectory), or
    ``twist`` (TwistStamped) of a base that takes speeds, whose "joints" are these (base/NAME).
    """

    topic: str
    joints: tuple[str, ...]
    takes: Literal["numbers", "trajectory", "twist"] = "numbers"

    @field_validator("topic")
    @classmethod
    def _named(cls, name: str) -> str:
        return _topic(_not_empty(name))

    @property
    def type(self) -> str:
        """Of its messages."""
        return TYPES[self.takes]


class RosSettings(Settings):
    """What every base type's settings have; subclasses (:meth:`wbmpc.bases.base.BaseType.ros_settings`) add a type's own, with its ``cost``.

    ``joints``: our name of a joint to the bus's; ``ignore``: joints of the bus that are not ours. ``controllers``: left out, one for each
    of :func:`drive_groups` on ``GROUP_controller/commands``; brakes (1 open, 0 closed) go out in the order of their joints. ``use_sim_time``: time is
    what ``/clock`` says. ``lockstep``: so it does, and a solve takes the modeled ``mpc.computation_delay`` of that time, however fast the
    machine is. ``actuator_time_constant`` [s] of the drives; ``state_age`` [s]: by the wall clock, how old joint states are when they come,
    and ``wrench`` (robots that balance).
    """

    node: str = "wbmpc"
    use_sim_time: bool = False
    lockstep: bool = False
    topics: Topics = Topics()
    frames: Frames = Frames()
    rates: Rates = Rates()
    speeds: Speeds = Speeds()
    cmd_vel: VelocityLimits = VelocityLimits()
    goals: Goals = Goals()
    wrench: WrenchLimits | None = None
    safety: Safety = Safety()
    obstacles: ObstacleSettings = ObstacleSettings()
    joints: dict[str, str] = Field({})
    ignore: tuple[str, ...] = ()
    controllers: dict[str, Controller] = Field({})
    mpc: MpcSettings = MpcSettings()
    cost: Settings = Settings()
    actuator_time_constant: float = Field(ACTUATOR_TIME_CONSTANT, ge=0, le=0.5)
    state_age: float = Field(0.005, ge=0, le=0.05)

    @field_validator("node")
    @classmethod
    def _node(cls, name: str) -> str:
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
            raise ValueError("a name of letters, digits and _ is needed")
        if len(name) > LONGEST_NODE_NAME:
            raise ValueError(f"a node's name has at most {LONGEST_NODE_NAME} characters")
        return name

    @property
    def sees_obstacles(self) -> bool:
        """Whether obstacles come from the bus."""
        return any(getattr(self.topics, key) for key in OBSTACLE_TYPES)

    def bus_name(self, joint: str) -> str:
        """What a joint of ours is called on the bus."""
        return self.joints.get(joint, joint)

    @property
    def patience(self) -> float:
        """How long [s of the wall] simulated time, or the answers to it, may stay away: see ``safety.clock``."""
        return self.safety.clock or (LOCKSTEP_PATIENCE if self.lockstep else GONE)

    @property
    def held_up(self) -> float:
        """How late [s] a tick may begin: by the watchdog; in lockstep 1 s: a simulator waits from the first commands on that it hears."""
        return max(self.safety.watchdog, self.lockstep * GONE)

    def silence(self, speed: float) -> float:
        """How long [s of the wall] ``/clock`` may stand while the robot moves, if its time has passed ``speed`` times as fast as
        the wall's: joint states have stopped then too, and would be older than the watchdog allows. In lockstep: ``patience``."""
        limited = self.lockstep or self.safety.clock is not None
        return self.patience if limited else min(self.safety.watchdog / min(max(speed, 1e-3), 1.0), GONE)

    def fastest(self, robot: RobotModel) -> np.ndarray:
        """The largest speed (3) that may be asked for [m/s, m/s, rad/s]."""
        speeds, limits = self.speeds, self.cmd_vel
        target = np.array([limits.base, limits.base, limits.turn], float)  # None: not a number
        if "base" in robot.input:
            upper = dict(zip(robot.input.groups["base"], robot.limits.input_upper[robot.input["base"]], strict=True))
            ahead = upper.get("vx", upper.get("v", np.inf))
            return np.fmin(target, [ahead, upper.get("vy", ahead), upper["wz"]])
        return np.where(np.isnan(target), [speeds.base, speeds.base, speeds.turn], target)

    def joint_speeds(self, robot: RobotModel, group: str) -> np.ndarray:
        """Speed limits [rad/s] of the joints of a group of the model, beyond which joint states cannot be true."""
        if group not in robot.input:
            return np.array([robot.description.limits.velocity.get(n, np.inf) for n in joint_groups(robot)[group]])
        return robot.limits.input_upper[robot.input[group]]

    def command_topics(self, robot: RobotModel) -> dict[str, Controller]:
        """Controllers by name, checked: every drive of the robot once. Raises :class:`InputError` naming the joint."""
        drives = drive_groups(robot)
        brakes = [n for g in robot.base.brakes for n in drives.get(g, ())]
        twist = drives[WHEELS] if robot.description.base.takes_twist else []
        if not self.controllers:
            found = {
                f"{g}_controller": Controller(topic=f"/{g}_controller/commands", joints=tuple(drives[g]))
                for g in drives
                if drives[g] and not (twist and g == WHEELS)
            }
            base = Controller(topic="/base_controller/cmd_vel", joints=tuple(twist), takes="twist")
            return {"base_controller": base, **found} if twist else found
        known = [n for names in drives.values() for n in names]
        seen: dict[str, str] = {}
        for name, controller in self.controllers.items():
            for joint in controller.joints:
                where = f"key 'controllers.{name}.joints'"
                if joint not in known:
                    raise unknown_name("joint", joint, known, where=where)
                if (controller.takes == "twist") != (joint in twist):
                    valid = f"{', '.join(twist)} with 'takes: twist'" if twist else "numbers, trajectory"
                    raise InputError(f"{where}: '{joint}' is not commanded by '{controller.takes}'; valid: {valid}")
                if controller.takes == "trajectory" and joint not in drives["arm"]:
                    raise InputError(
                        f"{where}: '{joint}' cannot be led by a trajectory; valid: {', '.join(drives['arm'])}"
                    )
                if joint in seen:
                    raise InputError(f"{where}: joint '{joint}' is commanded by '{seen[joint]}' too")
                seen[joint] = name
        left = [n for n in known if n not in seen and n not in brakes]
        if left:
            raise InputError(f"key 'controllers': no controller commands joint '{left[0]}'")
        return self.controllers


def settings_of(robot: RobotModel) -> type[RosSettings]:
    """The settings for a robot's base type. Raises :class:`InputError` where that has no controller for ROS 2."""
    description = robot.description
    return cast(type[RosSettings], base_type(description.base.type).ros_settings(description))


def joint_groups(robot: RobotModel) -> dict[str, tuple[str, ...]]:
    """Our names of the joints in /joint_states by group: all that have an encoder."""
    base, state = robot.description.base, robot.state.groups
    wheels = state.get(WHEELS) or robot.input.groups.get(WHEELS) or tuple(base.wheel_joints())
    return {g: state[g] for g in base.joint_groups()} | {WHEELS: wheels, "arm": state["arm"]}


def drive_groups(robot: RobotModel) -> dict[str, list[str]]:
    """Our names of the drives by group: wheels, whatever else the model's input moves but the base as a whole and joints that brakes
    hold, and the brakes, GROUP/JOINT; the speeds of a base that takes them are base/NAME, as wheels."""
    base, inputs = robot.description.base, dict(robot.input.groups)
    brakes = {g: [f"{g}/{n}" for n in inputs.pop(held, ())] for g, held in robot.base.brakes.items()}
    speeds = [f"base/{n}" for n in inputs.pop("base", ())]
    wheels = inputs.pop(WHEELS, ()) or (speeds if base.takes_twist else base.wheel_joints())
    return {WHEELS: list(wheels), **{g: list(names) for g, names in inputs.items()}, **brakes}


def load_settings(path: Path | None, robot: RobotModel) -> RosSettings:
    """The settings of a YAML file, defaults without one. Raises :class:`InputError` naming file and key."""
    kind = settings_of(robot)
    if path is None:
        return kind()
    if path.is_dir():
        raise InputError(f"--config: '{path}' is a directory, a YAML file is needed")
    if not path.is_file():
        raise InputError(f"--config: there is no file '{path}'")
    data = load_yaml(path)
    data = {} if data is None else data
    if not isinstance(data, dict):
        raise InputError(f"{path}: a mapping of keys is needed; valid: {', '.join(kind.model_fields)}")
    try:
        settings = kind.model_validate(data)
        _check_joints(settings, robot)
        _check_topics(settings, settings.command_topics(robot))
    except ValidationError as error:
        unknown = [keys_of(f["loc"], kind) for f in error.errors(include_url=False) if f["type"] == "extra_forbidden"]
        if unknown:
            raise unknown_name("key", ".".join(map(str, unknown[0])), _siblings(kind, unknown[0]), str(path)) from error
        raise InputError(f"{path}: {describe(error, kind)}") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return settings


def _siblings(kind: type[RosSettings], place: tuple[Any, ...]) -> list[str]:
    """Valid keys beside a wrong one."""
    prefix = ".".join(map(str, place[:-1]))
    inside = [k for k in keys(kind) if k.startswith(f"{prefix}.")] if prefix else []
    return sorted({".".join(k.split(".")[: len(place)]) for k in inside}) or list(kind.model_fields)


def _check_topics(settings: RosSettings, controllers: dict[str, Controller]) -> None:
    """Nothing else is on a topic; the service's name is no topic."""
    if settings.frames.base in (settings.frames.world, MAP):
        raise InputError(f"key 'frames.base': a frame above it is called '{settings.frames.base}' too")
    seen: dict[str, str] = {}
    named = {
        f"topics.{k}": v for k, v in settings.topics.model_dump().items() if v and k not in settings.topics.services
    }
    named |= {f"controllers.{k}.topic": c.topic for k, c in controllers.items()}
    for key, name in named.items():
        topic = full_name(name)
        if topic in FIXED:
            raise InputError(f"key '{key}': '{name}' always carries {FIXED[topic]}; another name is needed")
        if topic in seen:
            raise InputError(f"key '{key}': '{name}' is the topic of '{seen[topic]}' already")
        seen[topic] = key


def _check_joints(settings: RosSettings, robot: RobotModel) -> None:
    known = [n for names in joint_groups(robot).values() for n in names]
    for name in settings.joints:
        if name not in known:
            raise unknown_name("joint (key 'joints')", name, known)
    on_bus = [settings.bus_name(n) for n in known]
    if "" in on_bus:
        raise InputError(f"key 'joints': '{known[on_bus.index('')]}' has no name on the bus")
    twice = sorted({n for n in on_bus if on_bus.count(n) > 1})
    if twice:
        raise InputError(f"key 'joints': two joints are called '{twice[0]}' on the bus")
    for ours, name in zip(known, on_bus, strict=True):
        if name in settings.ignore:
            who = "a joint of this robot" if name == ours else f"our joint '{ours}'"
            raise InputError(f"key 'ignore': '{name}' is {who}, which is needed")
