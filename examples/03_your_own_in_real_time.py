"""A system of your own in real time: a gantry crane carries its load 2 m within hard limits, without letting it swing.
The MPC runs at 100 Hz in a thread beside a 400 Hz control loop, by the wall clock; the "robot" is a simulated crane.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

import wbmpc as wb

LENGTH, GRAVITY, LIMIT, REST = 1.0, 9.81, 3.0, np.zeros(1)


def crane(x, u):
    """x: position of the trolley [m], angle of the rope [rad], their rates; u: the trolley's acceleration [m/s²]."""
    return ca.vertcat(x[2], x[3], u[0], -(GRAVITY * ca.sin(x[1]) + u[0] * ca.cos(x[1])) / LENGTH)


def make_mpc() -> wb.MPC:
    dynamics = wb.Ode({"x": ["position", "angle", "speed", "rate"]}, {"u": ["acceleration"]}, crane)
    ocp = wb.OptimalControlProblem(dynamics, horizon=3.0, intervals=60)
    error = wb.residuals.Expression(4, lambda s: s.x - np.array([2.0, 0.0, 0.0, 0.0]))
    effort = wb.residuals.Expression(1, lambda s: s.u)
    ocp.add(wb.Cost("error", error, [10.0, 5.0, 1.0, 1.0], at="path+terminal"))
    ocp.add(wb.Cost("effort", effort, 0.1))
    ocp.add(wb.Constraint("limit", effort, wb.sets.Box(-LIMIT, LIMIT), hard=True))
    mpc = wb.MPC(ocp, rate=100.0)
    mpc.reset(np.zeros(4))
    return mpc


@dataclass
class Measurement:
    time: float
    x: np.ndarray


class Crane:
    """What the runner needs of a robot: read, write, stop. Yours would talk to a bus."""

    def __init__(self, clock, model):
        self.clock, self.model, self.time, self.x, self.u = clock, model, 0.0, np.zeros(4), REST

    def read(self):
        now = self.clock.now()
        self.x, self.time = self.model.solver.simulate(self.x, self.u, max(now - self.time, 0.0)), now
        return Measurement(now, self.x)

    def write(self, command):
        self.u = command

    def stop(self):
        self.u = REST


class Controller:
    """From measurements to observations and commands; ``model`` predicts over the computation's latency."""

    def __init__(self, model, period):
        self.model, self.period = model, period

    def measure(self, measurement):
        self.x = measurement.x

    def predict(self, t, until, plans):
        x = self.x
        for now in np.arange(t, until - 1e-9, self.period):
            policy = plans.at(now)
            x = self.model.solver.simulate(x, REST if policy is None else policy(now, x), self.period)
        return wb.Observation(until, x)

    def command(self, t, plans):
        return plans.current(t, self.x)  # holds the hard limits of the inputs


clock, model = wb.WallClock(), make_mpc()
robot, settings = Crane(clock, model), wb.RealTimeSettings(control_rate=400.0)
print(wb.RealTimeRunner(robot, Controller(model, 1 / 400), make_mpc(), settings, clock).run(4.0))
print(f"load at {robot.x[0]:.3f} m, rope at {np.rad2deg(robot.x[1]):.2f} degrees")
