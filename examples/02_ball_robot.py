"""A ball-balancing robot in MuJoCo physics reaches 0.15 m to the side: problem, MPC, controller and plant by hand.

Run: python examples/02_ball_robot.py
"""

import numpy as np

import wbmpc as wb
from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.defaults import RezeroCost, rezero_mpc
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.ball.sent_torques import DriveSettings
from wbmpc.settings import MpcSettings

robot = wb.load_robot("rezero")
home, torque = robot.base.numeric.equilibrium(robot.home[robot.state["arm"]])
settings = MpcSettings(rate=80.0, horizon=1.3, intervals=26, first_interval=0.0, barrier_mu=1e-2)
mpc = rezero_mpc(robot, settings, RezeroCost())

position, orientation = robot.pose(home)
aside = position + [0.0, 0.15, 0.0]
mpc.reference["end_effector"] = wb.Reference.poses([0.0, 2.0], [position, aside], orientation, hold=True)
mpc.reference["body"] = wb.Reference.constant(home)
mpc.reference["twist"] = wb.Reference.constant(np.zeros(6))
mpc.reference["torque"] = wb.Reference.constant(torque)
mpc.reset(home, torque)

plant = BallPlant(robot.description, home, torque, seed=1)  # masses, friction, drive lag … differ from the model
timing = wb.Timing.of(plant.timestep, control_rate=400.0, mpc_rate=settings.rate, delay=settings.computation_delay)
controller = BallController(robot, mpc, torque, timing.period, DriveSettings(lag=0.02))
end_effector: list[np.ndarray] = []


def record(t: float, command: object, plans: wb.PolicyQueue) -> None:
    """Keep the end effector's true position at every controller tick."""
    end_effector.append(plant.truth().tool)


ending = wb.run_lockstep(plant, controller, mpc, timing, 6.0, record)
last = np.array(end_effector[-400:])
print(ending.reason or "the robot stood for 6 s")
print(f"end effector error in the last second: {1e3 * np.linalg.norm(last - aside, axis=1).mean():.2f} mm")
print(f"solve time: median {1e3 * np.median(mpc.statistics.solve_times):.3f} ms at {mpc.rate:.0f} Hz")
