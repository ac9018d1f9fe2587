"""What a base type is: the protocols that generic code asks, and nothing else.

:class:`Base` is the symbolic side, inside a :class:`wbmpc.model.robot.RobotModel`. :class:`BaseType` is the plug-in: how a robot
file's ``base`` section is read, and what estimates, controls and simulates such a base. Every part but ``Description`` and
``model`` is optional in the sense that it may raise :class:`wbmpc.errors.InputError` saying what the base type does not offer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

if TYPE_CHECKING:
    import casadi as ca
    import mujoco

    from wbmpc.model.joints import Limits
    from wbmpc.model.kinematics import Chain, FramePose
    from wbmpc.model.robot import RobotModel
    from wbmpc.model.tree import Tree
    from wbmpc.model.wheels import ModuleGeometry
    from wbmpc.mpc.mpc import MPC
    from wbmpc.ocp import Constraint
    from wbmpc.robots.description import LimitsDescription, RobotDescription
    from wbmpc.simulation.lockstep import Timing
    from wbmpc.simulation.perturbation import Perturbation

Array = NDArray[np.float64]


class Section(BaseModel):
    """A mapping of a robot file: its keys are the fields, unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class InertialDescription(Section):
    """The inertial unit's range: ``rate`` [rad/s] and ``acceleration`` [m/s²] that it can measure about and along each axis. Left
    out: those of the ADIS16448's data sheet, 1000 degrees/s and 18 g."""

    rate: float = Field(np.deg2rad(1000.0), gt=0)
    acceleration: float = Field(18.0 * 9.81, gt=0)


class BaseDescription(Section):
    """The ``base`` section of a robot file: what all base types have. A base type adds its own keys in a subclass.

    ``body``: the file's body that carries the arm.
    """

    #: The key of the section that names joints; "" where none does. Error messages say it.
    joint_key: ClassVar[str] = ""
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
        """The same names in the order of the file's section."""
        return [name for names in self.joint_groups().values() for name in names]

    def parts(self) -> dict[str, str]:
        """Bodies beside ``body``, by the key that names them, whose joints are moved by the base's own equations."""
        return {}

    def frames(self) -> dict[str, tuple[str, ...]]:
        """Frames of the file (bodies or sites) that the section names, by key."""
        return {}

    def check_limits(self, limits: LimitsDescription) -> None:
        """Raise ``ValueError`` with the key path where the file's limits do not fit this base."""


class Footprint(Protocol):
    """Where a base stands on the ground: ``size`` points, in the axes of its body. ``modules``: its legs, where the points are
    those of steered wheels."""

    size: int
    modules: ModuleGeometry | None

    def positions(self, x: Array) -> Array:
        """Feet (n, 2) [m] in the axes of the body at a state (nx)."""

    def expressions(self, x: ca.SX) -> list[ca.SX]:
        """The same (2 each) as symbols of the state."""


class Base(Protocol):
    """The symbolic side of a base in a robot model: names of its state and input, kinematics, dynamics, limits and home.

    ``state``, ``input``, ``parameters``, ``mode``: names by group, of state x (nx), input u (nu), parameters w that hold over the
    horizon and mode values m per node. ``unit_quaternions``: where quaternions begin in x. ``mode_bounds``: lowest and highest
    value of groups of ``mode``. ``brakes``: groups of ``mode`` that are brakes (1 open, 0 closed), and the input group each holds.
    ``ground`` [m]: height of the floor in the model's world (negative where the world's origin is
    above it). ``body_height`` [m]: of the body's frame above the floor at home. ``balances``: the robot falls when it is stopped.
    ``wheels``: how many wheels :meth:`rolling` has rows of; 0 where no constraint makes them roll. ``footprint``: None where the
    base does not stand on feet of its own. An optional ``jacobian(x, u, w, m)`` gives ẋ and its Jacobian (nx, nx + nu) where
    there is a shorter way than to differentiate ``derivative``.
    """

    tree: Tree
    state: dict[str, list[str]]
    input: dict[str, list[str]]
    parameters: dict[str, list[str]]
    mode: dict[str, list[str]]
    mode_bounds: dict[str, tuple[float, float]]
    unit_quaternions: tuple[int, ...]
    brakes: dict[str, str]
    ground: float
    body_height: float
    balances: bool
    wheels: int
    footprint: Footprint | None

    def chain(self, x: ca.SX) -> Chain:
        """The tree of links at a state."""

    def root(self, x: ca.SX) -> FramePose:
        """Pose of the body's frame in the model's world."""

    def motion(self, x: ca.SX, u: ca.SX) -> tuple[dict[int, ca.SX], ca.SX, ca.SX]:
        """Rates of the tree's joints by link, linear and angular velocity of its root in the root's axes."""

    def derivative(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        """ẋ (nx)."""

    def rolling(self, x: ca.SX, u: ca.SX, m: ca.SX) -> ca.SX:
        """Rolling (wheels) and side-slip (wheels) velocities [m/s] of the contacts, zero where wheels roll."""

    def constraints(self, robot: RobotModel) -> list[Constraint]:
        """What every problem on this base needs: rolling wheels, closed brakes."""

    def limits(self, description: RobotDescription) -> Limits:
        """Bounds of state and input."""

    def home(self, robot: RobotModel) -> Array:
        """State (nx) with the joints of the description's home."""


@dataclass(frozen=True)
class System:
    """A simulated robot with its controller and MPC, ready to run: ``plant``, ``controller``, ``mpc`` and their ``timing``."""

    plant: Any
    controller: Any
    mpc: MPC
    timing: Timing


class BaseType(Protocol):
    """A plug-in. Its instances hold nothing."""

    Description: type[BaseDescription]

    def check(self, description: RobotDescription, model: mujoco.MjModel) -> None:
        """Raise :class:`InputError` for a robot file whose mechanics this base type does not describe."""

    def model(self, description: RobotDescription, spec: mujoco.MjSpec) -> Base:
        """The symbolic base of a described robot."""

    def plant(self, robot: RobotModel, perturbation: Perturbation | None, seed: int) -> Any:
        """The simulated robot at home, perturbed against the model."""

    def system(self, robot: RobotModel, seed: int) -> System:
        """Plant, controller and MPC with default settings: what views and first runs start from."""

    def ros(self, robot: RobotModel, settings: Any, period: float) -> Any:
        """The adapter of this base type on a ROS 2 bus (:class:`wbmpc.ros2.base_adapter.BaseAdapter`)."""
