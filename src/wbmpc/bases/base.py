"""What a base type is: the protocols that generic code asks, and nothing else.

:class:`Base` is the symbolic side, inside a :class:`wbmpc.model.robot.RobotModel`. :class:`BaseType` is the plug-in: how a robot
file's ``base`` section is read, and what estimates, controls and simulates such a base. A plug-in derives from it and defines
``Description``, ``model`` and what else its base has; a part that it leaves out raises :class:`wbmpc.errors.InputError` naming
the part and the base types that offer it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn, Protocol

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from wbmpc.arrays import Array
from wbmpc.constants import GRAVITY
from wbmpc.errors import InputError

if TYPE_CHECKING:
    import casadi as ca
    import mujoco

    from wbmpc.bases.calibrator import Calibrator
    from wbmpc.bases.footprint import Footprint
    from wbmpc.control.protocols import Controller, RobotController
    from wbmpc.model.joints import Limits
    from wbmpc.model.kinematics import Chain, FramePose
    from wbmpc.model.robot import RobotModel
    from wbmpc.model.tree import Tree
    from wbmpc.mpc.mpc import MPC
    from wbmpc.obstacles.world import Obstacles
    from wbmpc.ocp import Constraint, Mode, Reference
    from wbmpc.robots.description import LimitsDescription, RobotDescription
    from wbmpc.robots.findings import Finding
    from wbmpc.robots.mechanism import Mechanism
    from wbmpc.robots.wheel_search import Wheel
    from wbmpc.settings import StabilitySettings
    from wbmpc.types import Edit, SimulatedRobot, Timing

#: The group of a base's wheels, or of what drives it in their place, in commands and measurements: whether or not the model's state has it.
WHEELS = "wheel"


#: What is known of a base's wheels: arrays by name, which only its base type reads.
Calibration = Mapping[str, Array]


class Section(BaseModel):
    """A mapping of a robot file: its keys are the fields, unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)


class InertialDescription(Section):
    """The inertial unit's range: ``rate`` [rad/s] and ``acceleration`` [m/s²] that it can measure about and along each axis. Left
    out: those of the ADIS16448's data sheet, 1000 degrees/s and 18 g."""

    rate: float = Field(np.deg2rad(1000.0), ge=0.1, le=1e4)
    acceleration: float = Field(18.0 * GRAVITY, ge=10, le=1e5)


@dataclass(frozen=True)
class Radius:
    """A radius ``value`` [m] that a robot file gives under ``key``, of a part ``what`` called ``name``: the wheel of a joint, or
    (``sphere``) a body that is a ball."""

    key: str
    value: float
    what: str
    name: str
    sphere: bool = False


@dataclass(frozen=True)
class Question:
    """What a base type cannot see in a file: ``key`` of its section, the ``text`` that asks, and the ``answer`` that it assumes."""

    key: str
    text: str
    answer: Any


@dataclass(frozen=True)
class Proposal:
    """How a base type would describe a robot model that has no robot file yet.

    ``section``: keys of its ``base`` section, without ``type`` and ``body``; ``fit``: from 0 (hardly) to 1 (nothing else is possible);
    ``reason``: what it saw, for a user; ``joints``: those that the section names; ``held``: others of the base, which stand still;
    ``speed`` [rad/s] of joints for which the file has none, and ``acceleration`` [rad/s²], by joint; ``questions``: what only the user
    knows.
    """

    section: Mapping[str, Any]
    fit: float
    reason: str
    joints: tuple[str, ...] = ()
    held: tuple[str, ...] = ()
    speed: Mapping[str, float] = field(default_factory=dict)
    acceleration: Mapping[str, float] = field(default_factory=dict)
    questions: tuple[Question, ...] = ()


class BaseDescription(Section):
    """The ``base`` section of a robot file: what all base types have. A base type adds its own keys in a subclass.

    ``body``: the file's body that carries the arm.
    """

    #: Whether the base moves: then ``body`` is a body of the file, not its world.
    moves: ClassVar[bool] = True
    #: Whether the planner's equations have masses and inertias: then a link whose inertia cannot be is an error, else it is replaced.
    uses_inertia: ClassVar[bool] = True
    #: Whether it describes wheels beside their steering axes, and steering axes that point down.
    describes_offsets: ClassVar[bool] = False
    #: Whether a driver of its own takes the base's speeds and says how far it went: nothing else moves its wheels.
    takes_twist: ClassVar[bool] = False
    #: The key of the section that names joints; "" where none does. Error messages say it.
    joint_key: ClassVar[str] = ""
    #: What views call groups of joints whose loads they show: "legs", "steering", "wheels".
    captions: ClassVar[Mapping[str, str]] = {}
    #: Keys of other base types that do not apply to this one, and why: the error of a file that has them.
    not_applicable: ClassVar[Mapping[str, str]] = {}
    #: Keys of the file's ``limits`` that this base reads, beside those of joints.
    limit_keys: ClassVar[tuple[str, ...]] = ()

    type: str
    body: str

    def joint_groups(self) -> dict[str, list[str]]:
        """Names of the file's joints that belong to the base, by group of the model's state."""
        return {}

    def joints(self) -> list[str]:
        """All names of the file's joints that belong to the base: those of the groups, then those of the wheels that are in none."""
        grouped = [name for names in self.joint_groups().values() for name in names]
        return [*grouped, *(name for name in self.wheel_joints() if name not in grouped)]

    def wheel_joints(self) -> list[str]:
        """Joints with drives whose angles are no part of the model's state."""
        return []

    def steering_joints(self) -> list[str]:
        """Joints that steer wheels; their drives may be faster than what plans use (key ``limits.actuator_velocity``)."""
        return []

    def parts(self) -> dict[str, str]:
        """Bodies beside ``body``, by the key that names them, whose joints are moved by the base's own equations. They turn about
        the origin of ``body``."""
        return {}

    @property
    def ground(self) -> float:
        """Height [m] of the floor in the model's world: negative where the world's origin is above it."""
        return 0.0

    def radii(self) -> list[Radius]:
        """Radii that the section gives, which the shapes of the robot's model must have too."""
        return []

    def torque_limits(self, limits: LimitsDescription) -> tuple[float, ...]:
        """Limits [N m] of drives that are commanded by torque, in the order in which they come first in the simulated robot."""
        return ()

    def frames(self) -> dict[str, tuple[str, ...]]:
        """Frames of the file (bodies or sites) that the section names, by key."""
        return {}

    def check_limits(self, limits: LimitsDescription) -> None:
        """Raise ``ValueError`` with the key path where the file's limits do not fit this base."""


class Base(Protocol):
    """The symbolic side of a base in a robot model: names of its state and input, kinematics, dynamics, limits and home.

    ``state``, ``input``, ``parameters``, ``mode``: names by group, of state x (nx), input u (nu), parameters w that hold over the
    horizon and mode values m per node. A state group "base", if there is one, begins with the base's pose: x, y, yaw, or position and
    quaternion (7). ``unit_quaternions``: where quaternions begin in x. ``mode_bounds``: lowest and highest
    value of groups of ``mode``. ``brakes``: groups of ``mode`` that are brakes (1 open, 0 closed), and the input group each holds.
    ``rolling_groups``: groups of the input that are speeds of wheels, which roll as the base moves; ``steering_groups``: those of joints that
    steer wheels. Both are empty where the input has none.
    ``ground`` [m]: height of the floor in the model's world (negative where the world's origin is
    above it). ``body_height`` [m]: of the body's frame above the floor at home. ``balances``: the robot falls when it is stopped.
    ``wheels``: number of wheels with rows in :meth:`rolling`; 0 if no constraint makes them roll. ``footprint``: None where the
    base does not stand on feet of its own. ``twist`` (3, m): twist of the body's frame (vx, vy, wz) per unit of the base's m speeds, the
    last of which is the turn. What only some bases have, as units of their state, is in :mod:`wbmpc.bases.optional`.
    """

    tree: Tree
    state: dict[str, list[str]]
    input: dict[str, list[str]]
    parameters: dict[str, list[str]]
    mode: dict[str, list[str]]
    mode_bounds: dict[str, tuple[float, float]]
    unit_quaternions: tuple[int, ...]
    brakes: dict[str, str]
    rolling_groups: tuple[str, ...]
    steering_groups: tuple[str, ...]
    ground: float
    body_height: float
    balances: bool
    wheels: int
    footprint: Footprint | None
    twist: Array

    def chain(self, x: ca.SX) -> Chain:
        """The tree of links at a state."""

    def root_pose(self, x: ca.SX) -> FramePose:
        """Pose of the body's frame in the model's world."""

    def velocities(self, x: ca.SX, u: ca.SX) -> tuple[dict[int, ca.SX], ca.SX, ca.SX]:
        """Rates of the tree's joints by link, linear and angular velocity of its root in the root's axes."""

    def derivative(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        """ẋ (nx)."""

    def rolling(self, x: ca.SX, u: ca.SX, m: ca.SX) -> ca.SX:
        """Rolling (wheels) and side-slip (wheels) velocities [m/s] of the contacts, zero where wheels roll."""

    def constraints(self, robot: RobotModel, *, hard: bool = True) -> list[Constraint]:
        """Constraints of every problem on this base: rolling wheels, closed brakes. Its own limits are ``hard``, or soft."""

    def limits(self, description: RobotDescription) -> Limits:
        """Bounds of state and input."""

    def home(self, robot: RobotModel) -> Array:
        """State (nx) with the joints of the description's home."""


@dataclass(frozen=True)
class System:
    """A simulated robot with its controller and MPC, ready to run: ``plant``, ``controller``, ``mpc`` and their ``timing``.

    A controller with an estimate of the base has ``base_pose()`` (7) too. Of references a view moves "end_effector" (poses of the end
    effector) and "state" (nx), where the MPC has them.
    """

    plant: SimulatedRobot
    controller: RobotController
    mpc: MPC
    timing: Timing

    @property
    def parts(self) -> tuple[SimulatedRobot, RobotController, MPC, Timing]:
        """In the order in which :func:`wbmpc.simulation.lockstep.run_lockstep` takes them."""
        return self.plant, self.controller, self.mpc, self.timing


class Reshaping(Protocol):
    """Adapts the shape of a base to the clearance ahead of it, and to what its arm holds (:meth:`BaseType.reshaping`). ``narrowest`` (nx): the
    robot at home in its narrowest shape; ``free``: the mode in which its shape may change; ``narrow``: whether its shape
    changes for what lies ahead."""

    narrowest: Array
    free: Mode
    narrow: bool

    def update(self, t: float, ahead: Reference | None = None) -> None:
        """Set references and modes of its MPC for updates from ``t`` [s] on, after the reference "state" is set. ``ahead``: that
        reference as it goes on if it does not have to wait for the robot; None: it never waits."""


class OnBus(Protocol):
    """A part of a plug-in that :mod:`wbmpc.ros2` works with, for its ``robot``."""

    robot: RobotModel


class BaseType(Protocol):
    """The plug-in of a base type. Its instances have no state."""

    Description: type[BaseDescription]
    #: What of its robots' measurements :meth:`calibrate` reads, beside the gyro.
    calibration_channels: ClassVar[tuple[str, ...]] = ()

    def check(self, description: RobotDescription, model: mujoco.MjModel) -> None:
        """Raise :class:`InputError` for a robot file whose mechanics this base type does not describe."""

    def propose(self, mechanism: Mechanism, wheels: Sequence[Wheel]) -> Proposal | None:
        """A proposal of the ``base`` section for a model with these driven ``wheels``; None if this base type does not fit."""
        return None

    def diagnose(self, description: RobotDescription, base: Base) -> list[Finding]:
        """Findings on a base that loads: what its user should know or fix."""
        return []

    def model(self, description: RobotDescription, spec: mujoco.MjSpec) -> Base:
        """The symbolic base of a described robot."""
        reject_missing_part(description, "model")

    def perturbation(self) -> type[BaseModel] | None:
        """The model of its plant's perturbation, a subclass of :class:`wbmpc.simulation.perturbation.Perturbation` with settings of its own;
        None: what the plants of all robots read."""
        return None

    def plant(self, robot: RobotModel, perturbation: Any, seed: int, edit: Edit | None = None) -> SimulatedRobot:
        """The simulated robot at home, whose ``perturbation`` against the model is of :meth:`perturbation` (None: its defaults)."""
        reject_missing_part(robot.description, "plant")

    def mpc(
        self, robot: RobotModel, obstacles: Obstacles | None = None, *, stability: StabilitySettings | None = None,
        progress: str | None = None, **changes: Any,
    ) -> MPC:  # fmt: skip
        """The MPC with default weights, whose goal is the robot's home, and which keeps clear of ``obstacles``; ``changes``: of its
        :class:`wbmpc.settings.MpcSettings`, by name. ``stability``: what keeps a robot with a footprint from tipping over.
        ``progress``: the frame that follows a path (``mpc.path``) at its own speed, in the
        place of an end effector that follows a clock (:func:`wbmpc.path_problem`). Its references "end_effector" (poses) and, where a view
        may move the base, "state" (nx) follow the robot's task."""
        reject_missing_part(robot.description, "mpc")

    def system(
        self, robot: RobotModel, seed: int, perturbation: Any = None, mpc: MPC | None = None,
        edit: Edit | None = None, calibration: Calibration | None = None,
    ) -> System:  # fmt: skip
        """Plant, controller and MPC: what views and general experiments start from. ``perturbation`` of the plant and ``mpc``: the default
        ones where they are left out; another MPC has the robot's own dynamics. ``edit`` adds to MuJoCo's scene; ``calibration``: what
        :meth:`calibrate` found."""
        reject_missing_part(robot.description, "system")

    def calibrate(self, robot: RobotModel, channels: Mapping[str, Array], source: str) -> Calibration:
        """What a log with global poses shows of the wheels, for :meth:`system`. ``channels``: those of ``calibration_channels`` and "gyro" as
        measured, "place" of rows (x, y, yaw, their standard deviations), each with its times (as "wheel.time"); ``source``: its name in errors.
        Raises :class:`InputError` for a log that does not show them."""
        reject_missing_part(robot.description, "calibrate")

    def reshaping(self, robot: RobotModel, mpc: MPC, controller: Controller) -> Reshaping | None:
        """What makes the base as wide or narrow as the obstacles of ``mpc`` (which may have none) allow where its reference leads, and its arm
        asks for; it commands what that needs through ``controller``. None for a base that has one shape."""
        return None

    def configurations(self, robot: RobotModel) -> Mapping[str, Array]:
        """Named configurations: positions (n) of the joints that brakes hold, in the order of the robot's state, within their limits or
        not; empty for a base that has none."""
        return {}

    def ros_settings(self, description: RobotDescription) -> type[BaseModel]:
        """The settings of this base type's controller on a ROS 2 bus, a subclass of :class:`wbmpc.ros2.settings.RosSettings`."""
        reject_missing_part(description, "ros_settings")

    def ros(self, robot: RobotModel, settings: Any, period: float) -> OnBus:
        """The adapter of this base type on a ROS 2 bus (:class:`wbmpc.ros2.base_adapter.BaseAdapter`) with settings of
        :meth:`ros_settings`; ``period`` [s] of the controller."""
        reject_missing_part(robot.description, "ros")

    def ros_plant(self, robot: RobotModel, perturbation: Any, seed: int) -> OnBus:
        """The simulated robot's side of a ROS 2 bus (:class:`wbmpc.ros2.plants.RosPlant`)."""
        reject_missing_part(robot.description, "ros_plant")

    def calibrator(self, robot: RobotModel) -> Calibrator:
        """Finds the calibration file from a log."""
        reject_missing_part(robot.description, "calibrator")


#: Names of the parts of a plug-in in error messages; a part that it does not define is inherited from :class:`BaseType`.
PARTS = {
    "check": "check of its mechanics", "propose": "proposal for a new robot", "reshaping": "change of shape", "diagnose": "diagnosis",
    "configurations": "named configurations of its legs",
    "model": "model", "plant": "simulated robot", "perturbation": "model of its perturbation",
    "mpc": "problem with default weights", "system": "simulated robot with a controller",
    "ros_settings": "controller for ROS 2", "ros": "controller for ROS 2", "ros_plant": "simulated robot for ROS 2",
    "calibrator": "calibration file of its wheels", "calibrate": "calibration of its wheels",
}  # fmt: skip


class MissingPart(InputError):
    """A plug-in does not define a part. :func:`wbmpc.bases.base_type` adds who does."""


def reject_missing_part(description: RobotDescription, part: str) -> NoReturn:
    """Raise :class:`MissingPart`: the robot's base type does not define a part of the plug-in."""
    raise MissingPart(
        f"'{description.name}' has a base of type '{description.base.type}', whose plug-in offers no {PARTS[part]} ('{part}')"
    )
