"""Plan and replan with a swerve robot: the end effector moves 1 m ahead, the base follows. The model itself is the plant here.

Run: python examples/01_arm_on_swerve.py
"""

import time

import numpy as np

import wbmpc as wb

robot = wb.load_robot("swerve-ur10")
state, given, limits = robot.state, robot.input, robot.limits
ocp = wb.OptimalControlProblem(robot.dynamics(), horizon=5.0, intervals=40, first_interval=0.02)
end_effector = wb.residuals.FramePose(robot, robot.tool)
ocp.add(wb.Cost("end_effector", end_effector, [1000.0] * 3 + [200.0] * 3, at="path+terminal"))
ocp.add(
    wb.Cost(
        "posture", wb.residuals.State(robot), {"base": [1.0, 1.0, 5.0], "leg": 1.0, "arm": 0.05}, at="path+terminal"
    )
)
speeds = {"base": 0.5, "leg": 1.0, "steer": 0.05, "wheel": 0.001, "arm": 0.1}
ocp.add(wb.Cost("speed", wb.residuals.Input(robot), speeds))
ocp.add(wb.Constraint("rolling", wb.residuals.Rolling(robot)))
ocp.add(wb.Constraint("brakes", wb.residuals.LockedJoints(robot)))
box = wb.sets.Box(limits.input_lower, limits.input_upper)
ocp.add(wb.Constraint("limits", wb.residuals.Input(robot, reference=None), box, penalty=wb.RelaxedBarrier(1e-3, 0.02)))

start = time.perf_counter()
mpc = wb.MPC(ocp, rate=50.0)
position, orientation = robot.pose(robot.home)
times = np.linspace(0.0, 8.0, 81)
ahead = np.clip((times - 0.5) / 4.0, 0.0, 1.0)  # 1 m in 4 s
path = position + np.stack([ahead, 0.1 * np.sin(2.0 * np.pi * ahead), 0.0 * ahead], axis=1)
mpc.reference["end_effector"] = wb.Reference.poses(times, path, orientation)
postures = np.tile(robot.home, (times.size, 1))
postures[:, 0] = ahead
mpc.reference["posture"] = wb.Reference(times, postures)
mpc.reset(robot.home)

x, errors = robot.home.copy(), []
for k in range(300):
    t = k / mpc.rate
    policy = mpc.update(wb.Observation(t, x))
    if k == 0:
        print(f"first policy after {time.perf_counter() - start:.2f} s (compiled code is kept for the next start)")
    x = mpc.solver.simulate(x, policy(t, x), mpc.period)
    target = [np.interp(t + mpc.period, times, path[:, i]) for i in range(3)]
    errors.append(np.linalg.norm(robot.pose(x)[0] - target))

solve = 1e3 * np.array(mpc.statistics.solve_times)
print(
    f"base at x = {x[0]:.3f} m, end effector error: mean {1e3 * np.mean(errors):.2f} mm, largest {1e3 * np.max(errors):.2f} mm"
)
print(f"solve time: median {np.median(solve):.3f} ms, largest {solve.max():.3f} ms at {mpc.rate:.0f} Hz")
