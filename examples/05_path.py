"""An end effector goes round a closed path as fast as its robot can. The model itself is the plant here.

Run: python examples/05_path.py
"""

import numpy as np

import wbmpc as wb

robot = wb.load_robot("ridgeback-ur5")
mpc = wb.default_mpc(robot, progress=robot.tool)
position, orientation = robot.pose(robot.home)
circle = wb.Path.circle(position, position + [0.0, 0.5, 0.0], quaternion=orientation)
mpc.path.follow(circle, speed=2.0, acceleration=1.0)

x, worst = robot.home, 0.0
for k in range(round(6.0 * mpc.rate)):
    t = k / mpc.rate
    policy = mpc.update(wb.Observation(t, x))
    x = mpc.simulate(x, policy(t, x), mpc.period)
    worst = max(worst, np.linalg.norm(robot.pose(x)[0] - mpc.path.pose(t + mpc.period)[:3]))
rounds = mpc.path.progress(6.0) / circle.length
print(f"{rounds:.1f} rounds in 6 s, never farther than {1e3 * worst:.0f} mm from where it is to be")
