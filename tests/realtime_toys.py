"""A double integrator with its MPC, controller and robot for the tests of the real-time runner, and faults to put into them.

The plant is exact in its own (virtual or wall) time: x' = v, v' = u with u held, so predictions have a truth.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from toys import Rows, ToyDynamics
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.ocp import Cost, OptimalControlProblem
from wbmpc.runtime.clock import Clock, VirtualClock
from wbmpc.runtime.runner import RealTimeRunner
from wbmpc.runtime.safety import RealTimeSettings
from wbmpc.types import Observation

START = np.array([1.0, 0.0])
#: Of the controller [s].
PERIOD = 1.0 / 400.0


def problem() -> OptimalControlProblem:
    """ẍ = u + w to the origin: 20 intervals over 1 s."""
    dynamics = ToyDynamics(2, 1, lambda x, u, w, m: ca.vertcat(x[1], u[0] + w[0]), parameters=1)
    ocp = OptimalControlProblem(dynamics, 1.0, 20)
    ocp.add(Cost("state", Rows(2, lambda s: s.x), [10.0, 1.0], at="path+terminal", terminal_weight=[50.0, 10.0]))
    ocp.add(Cost("input", Rows(1, lambda s: s.u), 0.1))
    return ocp


def make_mpc(rate: float = 50.0) -> MPC:
    mpc = MPC(problem(), rate=rate, first_iterations=3)
    mpc.reset(START)
    return mpc


def make_nothing() -> MPC:
    raise ValueError("no robot of that name")


def make_killed() -> MPC:
    os.kill(os.getpid(), signal.SIGKILL)
    raise AssertionError("killed before")


def integrate(x: np.ndarray, u: float, h: float) -> np.ndarray:
    """The exact motion under a constant input."""
    return np.array([x[0] + x[1] * h + 0.5 * u * h * h, x[1] + u * h])


@dataclass(frozen=True)
class Measured:
    time: float
    x: np.ndarray


@dataclass(frozen=True)
class Force:
    u: np.ndarray


class ToyController:
    """Predicts exactly, tick by tick, under the policies that it knows; ``limit`` of the input."""

    def __init__(self, period: float, limit: float = np.inf) -> None:
        self.period, self.limit, self.clamped = period, limit, False
        self.measured = Measured(0.0, START)
        self.predictions: list[Observation] = []

    def measure(self, measurement: Measured) -> None:
        self.measured = measurement

    def predict(self, t: float, until: float, plans: PolicyQueue) -> Observation:
        x = self.measured.x
        for k in range(round((until - t) / self.period)):
            policy = plans.at(t + k * self.period)
            x = integrate(x, self._input(policy, t + k * self.period, x), self.period)
        self.predictions.append(Observation(until, x))
        return self.predictions[-1]

    def _input(self, policy: Any, t: float, x: np.ndarray) -> float:
        return 0.0 if policy is None else float(np.clip(policy(t, x)[0], -self.limit, self.limit))

    def command(self, t: float, plans: PolicyQueue) -> Force:
        assert plans.current is not None
        self.clamped = bool(abs(plans.current(t, self.measured.x)[0]) > self.limit)
        return Force(np.array([self._input(plans.current, t, self.measured.x)]))


@dataclass
class ToyRobot:
    """The plant behind the robot interface. ``fault(robot)`` is called at every read."""

    clock: Clock
    fault: Callable[[ToyRobot], None] = lambda robot: None
    x: np.ndarray = field(default_factory=START.copy)
    u: float = 0.0
    reads: int = 0
    stops: int = 0
    writes: list[float] = field(default_factory=list)
    history: list[tuple[float, np.ndarray]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.frozen: Measured | None = None
        self._time = 0.0

    def read(self) -> Measured:
        now = self.clock.now()
        self.x, self._time = integrate(self.x, self.u, now - self._time), now
        self.history.append((now, self.x))
        self.reads += 1
        self.fault(self)
        return self.frozen or Measured(now, self.x)

    def write(self, command: Force) -> None:
        self.u = float(command.u[0])
        self.writes.append(self.clock.now())

    def stop(self) -> None:
        self.u = 0.0
        self.stops += 1


class FaultyMPC(MPC):
    """``fault(number of the update)`` may raise, sleep, or return False: the solve then counts as failed."""

    def __init__(self, fault: Callable[[int], bool | None], rate: float = 50.0) -> None:
        super().__init__(problem(), rate=rate, first_iterations=3)
        self.reset(START)
        self.number, self.inject = 0, fault

    def advance(self, observation: Observation) -> bool:
        usable = super().advance(observation)
        self.number += 1
        if self.inject(self.number) is False:
            self.solver.warm_start(np.full(self.solver.problem.nx, 1e200))  # what a failed solve leaves behind
            return False
        return usable


def make_faulty(fault: str, after: int = 30) -> FaultyMPC:
    """An MPC that a process can make itself: after so many updates it fails, is late once, or hangs."""
    actions: dict[str, Callable[[int], bool | None]] = {
        "fails": lambda n: False if n > after else None,
        "late": lambda n: time.sleep(0.25) if n == after else None,
        "hangs": lambda n: time.sleep(3.0) if n == after else None,
    }
    return FaultyMPC(actions[fault])


def virtual(
    computing: float | Callable[[], float] = 0.0, mpc: MPC | None = None, limit: float = np.inf, **settings: Any
) -> RealTimeRunner:
    """A runner in virtual time; every solve takes ``computing`` [s]."""
    clock = VirtualClock(computing)
    return RealTimeRunner(
        ToyRobot(clock), ToyController(PERIOD, limit), mpc or make_mpc(), RealTimeSettings(**settings), clock
    )


def wait_for(condition: Callable[[], bool], seconds: float = 60.0) -> bool:
    """Whether the condition comes true in time: long, for the machine may be busy."""
    end = time.perf_counter() + seconds
    while not condition():
        if time.perf_counter() > end:
            return False
        time.sleep(0.002)
    return True


# ---------------------------------------------------------------------- faults
def raises(text: str, kind: type[Exception] = RuntimeError) -> Callable[..., Any]:
    def fault(*ignored: object) -> None:
        raise kind(text)

    return fault


def at(read: int, action: Callable[[ToyRobot], None]) -> Callable[[ToyRobot], None]:
    """From this read on."""
    return lambda robot: action(robot) if robot.reads >= read else None


def freeze(robot: ToyRobot) -> None:
    robot.frozen = robot.frozen or Measured(robot.clock.now(), robot.x)


def lose(robot: ToyRobot) -> None:
    robot.frozen = Measured(robot.clock.now(), np.array([0.1, np.nan]))
