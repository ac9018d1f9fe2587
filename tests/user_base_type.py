"""A base type of somebody who has installed the package: everything is reached through ``wb``. tests/test_public_api.py checks it with
``mypy --strict``, and loads and runs a robot with it."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import casadi as ca
import mujoco  # type: ignore[import-untyped]  # MuJoCo has no types
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

import wbmpc as wb

Array = NDArray[np.float64]


class RailDescription(wb.BaseDescription):
    """A cart on a straight rail: the name of its sliding joint."""

    type: Literal["rail"]
    axis: str

    def joint_groups(self) -> dict[str, list[str]]:
        return {"rail": [self.axis]}


class RailBase:
    """State and input: the cart's position and speed, and the arm's. The rail's frame is the model's world."""

    def __init__(self, description: wb.RobotDescription, spec: mujoco.MjSpec) -> None:
        self.tree = wb.read_tree(spec, description.base.body)
        self.state = {**description.base.joint_groups(), "arm": list(description.arm.joints)}
        self.input = self.state
        self._links = [self.tree.joint(name) for names in self.state.values() for name in names]
        self.parameters: dict[str, list[str]] = {}
        self.mode: dict[str, list[str]] = {}
        self.mode_bounds: dict[str, tuple[float, float]] = {}
        self.unit_quaternions: tuple[int, ...] = ()
        self.brakes: dict[str, str] = {}
        self.rolling_groups: tuple[str, ...] = ()
        self.steering_groups: tuple[str, ...] = ()
        self.ground, self.body_height, self.balances, self.wheels = 0.0, 0.0, False, 0
        self.footprint: wb.Footprint | None = None
        self.twist: Array = np.eye(3)

    def root_pose(self, x: ca.SX) -> wb.FramePose:
        return wb.FramePose(ca.SX(3, 1), ca.SX([1.0, 0.0, 0.0, 0.0]), ca.SX.eye(3))

    def chain(self, x: ca.SX) -> wb.Chain:
        return wb.Chain(self.tree.links, {link: x[k] for k, link in enumerate(self._links)}, self.root_pose(x))

    def velocities(self, x: ca.SX, u: ca.SX) -> tuple[dict[int, ca.SX], ca.SX, ca.SX]:
        return {link: u[k] for k, link in enumerate(self._links)}, ca.SX(3, 1), ca.SX(3, 1)

    def derivative(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        return u

    def rolling(self, x: ca.SX, u: ca.SX, m: ca.SX) -> ca.SX:
        return ca.SX(0, 1)

    def constraints(self, robot: wb.RobotModel, *, hard: bool = True) -> list[wb.Constraint]:
        return []

    def limits(self, description: wb.RobotDescription) -> wb.Limits:
        return wb.joint_limits(self, description, tuple(self.state), description.limits.velocity, {}, {})

    def home(self, robot: wb.RobotModel) -> Array:
        return wb.joint_home(self, robot.description, tuple(self.state))


class RailPerturbation(wb.Perturbation):
    """``bend`` [rad]: how far the cart's encoder is off."""

    bend: float = Field(default=0.0, ge=0, le=1)


@dataclass(frozen=True)
class Speeds:
    """A command: of cart and arm [m/s, rad/s]."""

    values: Array


class RailPlant:
    """Drives that follow speeds at once: MuJoCo's positions are integrals of the commands."""

    timestep, has_physics, fell, rests, fall_reason = 0.005, True, False, True, ""

    def __init__(self, robot: wb.RobotModel, perturbation: wb.Perturbation | None, edit: wb.Edit | None) -> None:
        self.robot, self.description, self.time = robot, robot.description, 0.0
        self.bend = RailPerturbation.of(perturbation, robot.description).bend
        spec = wb.load_spec(robot.description)
        if edit is not None:
            edit(spec)
        self.model = spec.compile()
        self.data, self.world = mujoco.MjData(self.model), self
        self.arrange(robot.home)

    @property
    def diverged(self) -> bool:
        return not np.isfinite(self.data.qpos).all()

    def arrange(self, state: Array) -> None:
        self.data.qpos[:] = state
        mujoco.mj_forward(self.model, self.data)

    def measure(self) -> Array:
        return np.array(self.data.qpos + [self.bend, 0.0])

    def step(self, command: Speeds, steps: int = 1) -> None:
        self.time += steps * self.timestep
        self.arrange(self.data.qpos + steps * self.timestep * command.values)

    def push(self, force: Array) -> None: ...

    def end_pushes(self) -> None: ...

    def truth(self) -> wb.Truth:
        tip, x = self.data.site(self.robot.description.arm.tool), np.array(self.data.qpos)
        turn = np.array(tip.xmat).reshape(3, 3)
        joints = {name: float(value) for name, value in zip(self.robot.state.names, x, strict=True)}
        return wb.Truth(self.time, np.zeros(3), np.array(tip.xpos), turn, np.array(tip.xpos), turn, 0.0, x, joints)


class RailController:
    """Follows the MPC's policy from the measured state."""

    faults: Sequence[wb.Fault] = ()

    def __init__(self, robot: wb.RobotModel) -> None:
        self.robot, self._x = robot, robot.home

    def measure(self, measurement: Array) -> None:
        self._x = measurement

    def state(self) -> Array:
        return self._x

    def predict(self, t: float, until: float, plans: wb.PolicyQueue) -> wb.Observation:
        return wb.Observation(until, self._x)

    def command(self, t: float, plans: wb.PolicyQueue) -> Speeds:
        assert plans.current is not None
        return Speeds(plans.current(t, self._x))

    def stop(self) -> Speeds:
        return Speeds(np.zeros(2))


class WithinReach:
    """A shape that does not change."""

    def __init__(self, robot: wb.RobotModel) -> None:
        self.narrowest, self.free, self.narrow = robot.home, wb.Mode("rigid"), False

    def update(self, t: float, ahead: wb.Reference | None = None) -> None: ...


class RailBaseType(wb.BaseType):
    """The plug-in."""

    Description = RailDescription

    def check(self, description: wb.RobotDescription, model: mujoco.MjModel) -> None:
        if not isinstance(description.base, RailDescription):
            raise wb.InputError(f"{description.source}: key 'base.type': a rail is needed")

    def model(self, description: wb.RobotDescription, spec: mujoco.MjSpec) -> wb.Base:
        return RailBase(description, spec)

    def perturbation(self) -> type[RailPerturbation]:
        return RailPerturbation

    def plant(
        self, robot: wb.RobotModel, perturbation: wb.Perturbation | None, seed: int, edit: wb.Edit | None = None
    ) -> wb.SimulatedRobot:
        return RailPlant(robot, perturbation, edit)

    def system(
        self, robot: wb.RobotModel, seed: int, perturbation: wb.Perturbation | None = None, mpc: wb.MPC | None = None,
        edit: wb.Edit | None = None, calibration: Mapping[str, Array] | None = None,
    ) -> wb.System:  # fmt: skip
        plant, mpc = self.plant(robot, perturbation, seed, edit), mpc or wb.default_mpc(robot)
        controller: wb.RobotController[Array, Speeds] = RailController(robot)
        return wb.System(plant, controller, mpc, wb.Timing.of(plant.timestep, 200.0, mpc.rate, 0.0))

    def reshaping(self, robot: wb.RobotModel, mpc: wb.MPC, controller: wb.Controller[Array, Speeds]) -> wb.Reshaping:
        return WithinReach(robot)


#: Broken methods, for tests of what is said then.
def fail(*given: Any, **named: Any) -> Any:
    raise ValueError("it is broken")


def leave(*given: Any, **named: Any) -> Any:
    raise SystemExit(0)


def leave_at_once(*given: Any, **named: Any) -> Any:
    os._exit(0)


def nothing(*given: Any, **named: Any) -> Any:
    return None
