"""Messages that every robot has, and what a simulated robot is. Those of one base type are in its ``messages`` module."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np

from wbmpc.arrays import Array
from wbmpc.checks import absolute_time, real_numbers, whole
from wbmpc.errors import InputError

if TYPE_CHECKING:
    import mujoco

    from wbmpc.robots import RobotDescription

#: Changes a MuJoCo specification before it is compiled: blocks, cables, doors, a payload.
Edit = Callable[["mujoco.MjSpec"], None]

#: A global pose so little [s] ahead of the last message counts as of then (another clock, a message on its way); others do not count.
POSE_AHEAD = 0.1


@dataclass(frozen=True)
class Observation:
    """State ``x`` (nx) at time ``t`` [s]: for the MPC, the state predicted for the moment its policy becomes active."""

    t: float
    x: np.ndarray

    def __post_init__(self) -> None:
        if type(self.t) is not float:
            object.__setattr__(self, "t", absolute_time("observation", self.t))
        object.__setattr__(self, "x", real_numbers("observation", self.x))


@dataclass(frozen=True)
class GlobalPose:
    """What a localization says: ``pose`` (x, y, yaw) of the base at ``time`` [s], with its ``covariance`` (3, 3)."""

    time: float
    pose: Array
    covariance: Array


@dataclass(frozen=True)
class Truth:
    """What really is at ``time`` [s].

    ``pose`` (x, y, yaw) of the base, yaw not wrapped; ``tilt`` [rad] of its z axis; ``tool`` (3) [m] and
    ``tool_rotation`` (3, 3) in the world of the planner (its z = 0 is ``-base.ground`` above the floor);
    ``tool_in_base`` (3) [m] and ``tool_rotation_in_base`` (3, 3) in the base's own (also tilted) frame; ``state`` (nx) in the
    planner's layout; ``joints`` [rad] by name. With wheels: ``slip`` (n) [m/s], speed of the contact points over the floor;
    ``wheel_force`` (n) [N], vertical forces of the ground in the last physics step. ``joint_speeds`` [rad/s] by name.
    """

    time: float
    pose: Array
    tool: Array
    tool_rotation: Array
    tool_in_base: Array
    tool_rotation_in_base: Array
    tilt: float
    state: Array
    joints: dict[str, float]
    slip: Array = field(default_factory=lambda: np.zeros(0))
    wheel_force: Array = field(default_factory=lambda: np.zeros(0))
    joint_speeds: dict[str, float] = field(default_factory=dict)


CommandT = TypeVar("CommandT", contravariant=True)
MeasurementT = TypeVar("MeasurementT", covariant=True)


class Plant(Protocol[CommandT, MeasurementT]):
    """A simulated robot, whose physics step is ``timestep`` [s]."""

    timestep: float

    @property
    def time(self) -> float:
        """Simulated time [s]."""

    @property
    def fell(self) -> bool:
        """Whether the robot lies."""

    @property
    def diverged(self) -> bool:
        """Whether numbers are not finite."""

    @property
    def has_physics(self) -> bool:
        """Whether bodies touch each other, as contacts and clearances need."""

    @property
    def rests(self) -> bool:
        """Whether nothing moves."""

    @property
    def fall_reason(self) -> str:
        """What counted as the fall, empty without one."""

    def end_pushes(self) -> None:
        """Nothing pushes the robot any more."""

    def measure(self) -> MeasurementT:
        """What the sensors say at :attr:`time`."""

    def step(self, command: CommandT, steps: int = 1) -> None:
        """Hold a ``command`` for ``steps`` physics steps."""

    def truth(self) -> Truth:
        """What really is."""


class SimulatedRobot(Plant[Any, Any], Protocol):
    """A plant that can be shown, in MuJoCo's ``model`` and ``data``."""

    @property
    def description(self) -> RobotDescription:
        """Of the robot."""

    @property
    def model(self) -> mujoco.MjModel:
        """MuJoCo's model."""

    @property
    def data(self) -> mujoco.MjData:
        """MuJoCo's data."""

    @property
    def world(self) -> Any:
        """Its ``frames(height)`` are those of :class:`wbmpc.simulation.world.World`."""

    def push(self, force: Array) -> None:
        """Push the base with a ``force`` (3) [N] until changed."""

    def arrange(self, state: Array) -> None:
        """Put the bodies where a ``state`` (nx) has them."""


@dataclass(frozen=True)
class Timing:
    """``period`` [s] of the controller, which is ``steps`` physics steps; the MPC is called at every ``mpc_every``-th tick, and its policies
    become active ``delay`` ticks later."""

    period: float
    steps: int
    mpc_every: int
    delay: int

    @classmethod
    def of(cls, timestep: float, control_rate: float, mpc_rate: float, delay: float) -> Timing:
        """Check ``control_rate`` [Hz], ``mpc_rate`` [Hz] and ``delay`` [s] against the physics step ``timestep`` [s]."""
        steps = whole("control.rate", 1.0 / control_rate, timestep, "physics steps", rate=control_rate)
        period = steps * timestep
        if mpc_rate > control_rate:
            raise InputError(
                f"mpc.rate: {mpc_rate:g} Hz is faster than the controller (control.rate), {control_rate:g} Hz, which follows the "
                f"plans; valid: the controller's rate or a whole part of it"
            )
        every = whole("mpc.rate", 1.0 / mpc_rate, period, "controller periods", rate=mpc_rate)
        return cls(period, steps, every, whole("mpc.computation_delay", delay, period, "controller periods", minimum=0))
