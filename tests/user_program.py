"""A program of somebody who has installed the package: everything is reached through ``wb``. tests/test_public_api.py checks it with
``mypy --strict``, and runs it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np
from pydantic import BaseModel

import wbmpc as wb


class Settings(BaseModel):
    """Of the experiment."""

    robot: str = "differential-ur10"
    duration: float = 0.1


def problem_of(robot: wb.RobotModel) -> wb.OptimalControlProblem:
    """The end effector follows a pose, within the limits of the inputs."""
    ocp = wb.OptimalControlProblem(robot.dynamics(), horizon=1.0, intervals=10, first_interval=0.02)
    ocp.add(wb.Cost("end_effector", wb.residuals.FramePose(robot, robot.tool), [1000.0] * 3 + [200.0] * 3))
    ocp.add(wb.Cost("speed", wb.residuals.Input(robot), {"base": 0.5, "arm": 0.1}))
    limits = wb.sets.Box(robot.limits.input_lower, robot.limits.input_upper)
    ocp.add(wb.Constraint("limits", wb.residuals.Input(robot, reference=None), limits, hard=True))
    return ocp


def slower(robot: wb.RobotModel) -> wb.MPC:
    """The default problem at another rate, with a weight of one's own."""
    return wb.default_mpc(robot, wb.default_mpc_settings(rate=20.0), wb.DefaultCost(posture=1.0))


def double_integrator() -> wb.OptimalControlProblem:
    """Dynamics and costs of one's own: to the origin with at most 1 m/s²."""
    dynamics = wb.Ode({"x": ["p", "v"]}, {"u": ["a"]}, lambda x, u: ca.vertcat(x[1], u[0]))
    ocp = wb.OptimalControlProblem(dynamics, horizon=3.0, intervals=30)
    ocp.add(wb.Cost("state", wb.residuals.Expression(2, lambda s: s.x), [10.0, 1.0], at="path+terminal"))
    ocp.add(wb.Cost("input", wb.residuals.Expression(1, lambda s: s.u), 0.1))
    ocp.add(wb.Constraint("limit", wb.residuals.Expression(1, lambda s: s.u), wb.sets.Box(-1.0, 1.0), hard=True))
    return ocp


def solve(start: np.ndarray) -> wb.Solution:
    """One solve."""
    solver = wb.Solver(double_integrator(), wb.SQP(iterations=50))
    try:
        return solver.solve(start)
    except wb.SolveFailed as error:
        raise RuntimeError("the origin cannot be reached") from error


def control(start: np.ndarray, steps: int) -> np.ndarray:
    """The state (nx) after receding-horizon control of the model itself."""
    mpc, x = wb.MPC(double_integrator(), rate=20.0), start
    mpc.reset(start)
    for k in range(steps):
        policy: wb.Policy = mpc.update(wb.Observation(k * mpc.period, x))
        x = mpc.solver.simulate(x, policy(k * mpc.period, x), mpc.period)
    return x


def build(settings: Settings, seed: int) -> wb.Scenario:
    """A robot holds its end effector for a moment."""
    robot = wb.load_robot(settings.robot)
    system = wb.base_type(robot.description.base.type).system(robot, seed)
    log = wb.Log()

    def record(t: float, command: object, plans: wb.PolicyQueue) -> None:
        log.add("hand", t, robot.pose(system.controller.state())[0])

    def moved() -> np.ndarray:
        positions = log.array("hand")
        return np.asarray(np.linalg.norm(positions - positions[0], axis=1))

    loop = wb.Loop(system.plant, system.controller, system.mpc, system.timing, settings.duration, record)
    return wb.Scenario.single(
        log,
        loop.run,
        metrics=lambda run: {"moved": wb.Metric(float(moved().max()), "m", goal=0.01)},
        plots=lambda run: [wb.Plot("hand", "s", "m", [wb.Series("moved", log.times("hand"), moved())])],
        idealizations=["none"],
    )


EXPERIMENT = wb.Experiment.of("my-task", "the end effector stays where it is", Settings, build)


def recorded(path: Path) -> tuple[wb.RunResult, wb.Recording]:
    """The experiment run once and recorded, and what the recording says."""
    recorder = wb.Recorder(path, {"run": {"experiment": EXPERIMENT.name}})
    result = EXPERIMENT.run(Settings(), 0, wb.Watch(None, (recorder,)))
    recorder.close({"completed": str(result.completed)})
    return result, wb.read_recording(path)


@dataclass(frozen=True)
class Measured:
    """A measurement: state ``x`` (nx) at ``time`` [s]."""

    time: float
    x: np.ndarray


class Robot:
    """What the real-time runner needs of a robot; here the model itself."""

    def __init__(self, clock: wb.VirtualClock, model: wb.MPC, start: np.ndarray) -> None:
        self.clock, self.model, self.x, self.u, self.time = clock, model, start, np.zeros(1), 0.0

    def read(self) -> Measured:
        """The newest measurement."""
        now = self.clock.now()
        self.x, self.time = self.model.simulate(self.x, self.u, max(now - self.time, 0.0)), now
        return Measured(now, self.x)

    def write(self, command: np.ndarray) -> None:
        """Send a command (nu)."""
        self.u = command

    def stop(self) -> None:
        """Bring it to rest."""
        self.u = np.zeros(1)


class Controller:
    """What the real-time runner needs beside it: ``model`` predicts the state over the latency."""

    def __init__(self, model: wb.MPC, period: float) -> None:
        self.model, self.period, self.x = model, period, np.zeros(2)

    def measure(self, measurement: Measured) -> None:
        """The state."""
        self.x = measurement.x

    def predict(self, t: float, until: float, plans: wb.PolicyQueue) -> wb.Observation:
        """Under the policies that are active until then."""
        x = self.x
        for now in np.arange(t, until - 1e-9, self.period):
            policy = plans.at(now)
            x = self.model.simulate(x, np.zeros(1) if policy is None else policy(now, x), self.period)
        return wb.Observation(until, x)

    def command(self, t: float, plans: wb.PolicyQueue) -> np.ndarray:
        """Of the active policy."""
        assert plans.current is not None
        return plans.current(t, self.x)


def run(start: np.ndarray, duration: float) -> np.ndarray:
    """The state (nx) after a run of the real-time runner in virtual time, with an MPC whose solves take 4 ms."""
    clock, (model, mpc) = wb.VirtualClock(computing=0.004), (wb.MPC(double_integrator(), rate=50.0) for _ in range(2))
    mpc.reset(start)
    robot, settings = Robot(clock, model, start), wb.RealTimeSettings(control_rate=200.0)
    controller: wb.Controller[Measured, np.ndarray] = Controller(model, 1.0 / settings.control_rate)
    wb.RealTimeRunner(robot, controller, mpc, settings, clock).run(duration)
    return robot.x
