"""What a base type is: the protocols that generic code asks, and nothing else.

:class:`Base` is the symbolic side, inside a :class:`wbmpc.model.robot.RobotModel`. :class:`BaseType` is the plug-in: how a robot
file's ``base`` section is read, and what estimates, controls and simulates such a base. Every part but ``Description`` and
``model`` is optional in the sense that it may raise :class:`wbmpc.errors.InputError` saying what the base type does not offer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import casadi as ca
    import mujoco
    from pydantic import BaseModel

    from wbmpc.model.kinematics import Chain
    from wbmpc.model.robot import Limits, RobotModel
    from wbmpc.model.tree import Tree
    from wbmpc.mpc.mpc import MPC
    from wbmpc.robots.description import RobotDescription
    from wbmpc.simulation.lockstep import Timing
    from wbmpc.simulation.perturbation import Perturbation

Array = NDArray[np.float64]


class Base(Protocol):
    """The symbolic side of a base in a robot model: names of its state and input, kinematics, dynamics, limits and home.

    ``state``, ``input``, ``parameters``, ``mode``: names by group, of state x (nx), input u (nu), parameters w that hold over the
    horizon and mode values m per node. ``unit_quaternions``: where quaternions begin in x. ``mode_bounds``: lowest and highest
    value of groups of ``mode``. ``ground`` [m]: height of the floor in the model's world (negative where the world's origin is
    above it). ``body_height`` [m]: of the body's frame above the floor at home. ``balances``: the robot falls when it is stopped.
    """

    tree: Tree
    state: dict[str, list[str]]
    input: dict[str, list[str]]
    parameters: dict[str, list[str]]
    mode: dict[str, list[str]]
    mode_bounds: dict[str, tuple[float, float]]
    unit_quaternions: tuple[int, ...]
    ground: float
    body_height: float
    balances: bool

    def chain(self, x: ca.SX) -> Chain: ...
    def motion(self, x: ca.SX, u: ca.SX) -> tuple[dict[int, ca.SX], ca.SX, ca.SX]: ...
    def derivative(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX: ...
    def limits(self, description: RobotDescription) -> Limits: ...
    def home(self, robot: RobotModel) -> Array: ...


class BaseDescription(Protocol):
    """The ``base`` section of a robot file: a frozen pydantic model with ``extra="forbid"``, found by ``type``."""

    type: str
    body: str

    def joints(self) -> Sequence[str]:
        """Names of the file's joints that belong to the base."""

    def joint_groups(self) -> Mapping[str, Sequence[str]]:
        """The same by group, as views and reports show them."""


@dataclass(frozen=True)
class System:
    """A simulated robot with its controller and MPC, ready to run: ``plant``, ``controller``, ``mpc`` and their ``timing``."""

    plant: Any
    controller: Any
    mpc: MPC
    timing: Timing


class BaseType(Protocol):
    """A plug-in. Its instances hold nothing."""

    Description: type[BaseModel]

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
