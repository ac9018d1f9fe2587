"""A ball-balancing robot in MuJoCo physics reaches 0.15 m to the side: plant, controller and MPC of its base type, in a loop of one's own.

Run: python examples/02_ball_robot.py
"""

import numpy as np

import wbmpc as wb

robot = wb.load_robot("rezero")
system = wb.base_type("ball").system(robot, seed=1)  # masses, friction, drive lag … of the plant differ from the model
plant, mpc = system.plant, system.mpc

start = mpc.reference["end_effector"].at(0.0)
aside = start[:3] + [0.0, 0.15, 0.0]
mpc.reference["end_effector"] = wb.Reference.poses([0.0, 2.0], [start[:3], aside], start[3:], hold=True)
end_effector: list[np.ndarray] = []


def record(t: float, command: object, plans: wb.PolicyQueue) -> None:
    """Keep the end effector's true position at every controller tick."""
    end_effector.append(plant.truth().tool)


ending = wb.run_lockstep(*system.parts, 6.0, record)
last = np.array(end_effector[-400:])
print(ending.reason or "the robot stood for 6 s")
print(f"end effector error in the last second: {1e3 * np.linalg.norm(last - aside, axis=1).mean():.2f} mm")
print(f"solve time: median {1e3 * np.median(mpc.statistics.solve_times):.3f} ms at {mpc.rate:.0f} Hz")
