"""A mobile manipulator drives past a pillar and lets a person cross. The model itself is the plant here.

Run: python examples/04_obstacles.py
"""

import numpy as np

import wbmpc as wb

robot = wb.load_robot("differential-ur10")
limits = robot.limits
ocp = wb.OptimalControlProblem(robot.dynamics(), horizon=4.0, intervals=30, first_interval=0.04)
end_effector = wb.residuals.FramePose(robot, robot.tool)
ocp.add(wb.Cost("end_effector", end_effector, [1000.0] * 3 + [100.0] * 3, at="path+terminal"))
ocp.add(wb.Cost("posture", wb.residuals.State(robot, ["arm"]), 1.0))
ocp.add(wb.Cost("speed", wb.residuals.Input(robot, reference=None), 1.0))
speeds = wb.sets.Box(limits.input_lower, limits.input_upper)
ocp.add(wb.Constraint("speeds", wb.residuals.Input(robot, reference=None), speeds, hard=True))
clearance = wb.residuals.Clearance(robot, slots=2, margin=0.05)
ocp.add(wb.Constraint("clearance", clearance, wb.sets.NonNegative(), at="path+terminal", hard=True, slack=1e4))

world = wb.Obstacles()
world.set("pillar", wb.shapes.Cylinder((1.6, -0.35, 0.0), (1.6, -0.35, 1.5), 0.1))
person = wb.shapes.Cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 1.8), 0.2)
mpc = wb.MPC(ocp, rate=25.0, obstacles=world)
position, orientation = robot.pose(robot.home)
ahead = position + [[0.0, 0.0, 0.0], [3.0, 0.0, 0.0]]
mpc.reference["end_effector"] = wb.Reference.poses([0.5, 8.0], ahead, orientation)
mpc.reference["posture"] = wb.Reference.constant(robot.home[robot.state["arm"]])
mpc.reset(robot.home)

x, least = robot.home.copy(), np.inf
for k in range(250):
    t = k / mpc.rate
    world.set("person", person, position=(2.6, -3.5 + 0.5 * t, 0.0), velocity=(0.0, 0.5, 0.0), seen=t)
    policy = mpc.update(wb.Observation(t, x))
    if policy.clearance is not None and policy.clearance.time < t + 0.5:
        least = min(least, policy.clearance.distance)
    if k % 50 == 0:
        print(f"{t:4.1f} s: base at x = {x[0]:.2f} m, in the plan {policy.clearance}")
    x = mpc.solver.simulate(x, policy(t, x), mpc.period)

error = 1e3 * np.linalg.norm(robot.pose(x)[0] - ahead[1])
print(
    f"end effector {error:.1f} mm from its goal, half a second ahead least clearance {1e3 * least:.0f} mm, margin 50 mm"
)
