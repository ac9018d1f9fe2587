"""Floods and nonsense on every input of a controller's node while its robot moves, from a process of its own.

Usage: python benchmarks/ros2_attack.py [--robot swerve-ur10|rezero] [--real-time] [--seconds 3] [--only NAME ...]
For each attack: the controller's state after it, its log lines during it, how much memory it has taken (RSS), and whether the
simulated robot still stands. Then the robot has to take a goal again. Exit status 1 if it does not, if a process ended, or if an
attack has more than 40 log lines or takes more than 100 MB.
"""

from __future__ import annotations

import argparse
import math
import random
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from ros2_processes import Bus, open_bus

LINES, MEMORY = 40, 100.0
NAN, HUGE = math.nan, 1e300
POSE, TWIST = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/Twist"
JOINTS, IMU, CLOCK = "sensor_msgs/msg/JointState", "sensor_msgs/msg/Imu", "rosgraph_msgs/msg/Clock"
NUMBERS, STRING = "std_msgs/msg/Float64MultiArray", "std_msgs/msg/String"
ODOM = {"frame_id": "odom"}
#: Topic, type, messages in turn.
ATTACKS: dict[str, tuple[str, str, list[Any]]] = {
    "goals": ("/goal_pose", POSE, [{"header": ODOM, "pose": {"position": {"x": v}}} for v in (NAN, HUGE, 1e9, -1.0, 1.0)]),
    "strange frames": ("/goal_pose", POSE, [{"header": {"frame_id": "x" * k}} for k in (0, 1, 60_000, 1_000_000)]),
    "end effector": (
        "/end_effector_goal", POSE,
        [{"header": ODOM, "pose": {"position": {"z": z}, "orientation": {"w": w}}} for z in (NAN, -5.0, 50.0) for w in (0.0, 1.0)],
    ),
    "long paths": ("/base_path", "nav_msgs/msg/Path", [{"header": ODOM, "poses": [{"header": ODOM}] * n} for n in (0, 1, 30_000)]),
    "paths": ("/end_effector_path", "nav_msgs/msg/Path", [{"header": ODOM, "poses": [{"header": ODOM}] * n} for n in (2, 300)]),
    "speeds": ("/cmd_vel", TWIST, [{"linear": {"x": v}} for v in (NAN, HUGE, -HUGE, math.inf)]),
    "wrenches": ("/wrench", "geometry_msgs/msg/WrenchStamped", [{"header": ODOM, "wrench": {"force": {"x": v}}} for v in (NAN, HUGE, 50.0)]),
    "legs": ("/legs", JOINTS, [{"name": ["leg_LF"] * n, "position": [v] * m} for n, m, v in ((1, 1, NAN), (2, 2, HUGE), (5, 1, 0.0))]),
    "brakes": ("/brakes", NUMBERS, [{"data": [v] * n} for v in (NAN, 7.0) for n in (0, 4, 8000)]),
    "configuration": ("/leg_configuration", STRING, [{"data": d} for d in ("", "Q", "\n" * 100, "nan,nan,nan,nan", "1," * 20_000)]),
    "second joint states": ("/joint_states", JOINTS, [{"name": ["wheel_LF", "wheel_0"], "position": [NAN, 1.0]}, {}]),
    "false joint states": ("/joint_states", JOINTS, []),  # those that it hears, elsewhere
    "second inertial unit": ("/imu", IMU, [{"angular_velocity": {"z": v}} for v in (5.0, NAN, HUGE)]),
    "second time": ("/clock", CLOCK, [{"clock": {"sec": s}} for s in (0, 2**31 - 1, -(2**31))]),
    "parameters": ("", "", []),
}  # fmt: skip

#: Sends the messages of an attack as fast as it can, or asks the services of parameters for nonsense.
ATTACKER = """
import random, sys, time
sys.path.insert(0, sys.argv[1])
from ros2_attack import ATTACKS
from wbmpc.ros2 import open_node
from wbmpc.errors import RunAborted
topic, kind, messages = ATTACKS[sys.argv[2]]
node, sent = open_node("attacker", "dds"), 0
if topic:
    publisher = node.publisher(topic, kind)
    heard = []
    if not messages:
        node.subscribe(topic, kind, heard.append)
        while not heard:
            time.sleep(0.01)
        stamp = {"sec": heard[0].header.stamp.sec + 1}
        messages = [{"header": {"stamp": stamp}, "name": heard[0].name, "position": heard[0].position + v} for v in (0.02, 0.3)]
    encoded = [publisher._types.encode(kind, m) for m in messages]
    time.sleep(1.0)
    end = time.monotonic() + float(sys.argv[3])
    while time.monotonic() < end:
        publisher.send(encoded[sent % len(encoded)])
        sent += 1
else:
    values = [{"type": t, "double_value": v, "string_value": "x" * n} for t in (0, 3, 4, 8, 99) for v in (float("nan"), 1e300) for n in (0, 1000)]
    end = time.monotonic() + float(sys.argv[3])
    names = ["cost.state.yaw", "cost.end_effector.weight", "robot", "", "no.such", "x" * 1000, "cost", "use_sim_time"]
    while time.monotonic() < end:
        asked = [{"name": random.choice(names), "value": random.choice(values)} for _ in range(random.choice((0, 1, 20, 5000)))]
        try:
            node.call("/wbmpc/set_parameters", "rcl_interfaces/srv/SetParameters", {"parameters": asked}, timeout=0.2)
        except RunAborted:
            pass
        sent += 1
print(sent)
node.close()
"""


def memory(pid: int) -> float:
    """Of a process [MB]."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(float(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1e3


def start(bus: Bus) -> None:
    """A goal near by, again until it is taken."""
    goal = bus.node.publisher("/goal_pose", POSE)
    bus.wait_for(lambda: goal._writer.get_matched_subscriptions(), 20.0)
    end = time.monotonic() + 60.0  # of a busy machine: in lockstep nothing else depends on it
    while not bus.said.startswith("running: base to a goal"):
        if time.monotonic() > end:
            raise TimeoutError(bus.said)
        goal.publish({"header": {"frame_id": "base_link"}, "pose": {"position": {"x": random.choice((-0.05, 0.05))}}})
        time.sleep(0.5)


def attack(bus: Bus, name: str, seconds: float) -> bool:
    """One line of the table; whether it is well."""
    lines, before = bus.output().count("\n"), memory(bus.control.pid)
    command = [sys.executable, "-c", ATTACKER, str(Path(__file__).parent), name, str(seconds)]
    run = subprocess.run(command, env=bus.environment, capture_output=True, text=True, timeout=seconds + 60.0)
    said = bus.said
    time.sleep(3.5)  # who published is gone
    ended = [
        f"{n}, {p.returncode}" for n, p in (("controller", bus.control), ("simulator", bus.sim)) if p.poll() is not None
    ]
    lines = bus.output().count("\n") - lines
    grown = memory(bus.control.pid) - before if bus.control.poll() is None else 0.0
    why = f"ended: {', '.join(ended)}" if ended else ""
    if not ended:
        try:
            start(bus)
        except TimeoutError as error:
            why = f"takes no goal: {error}"
    print(f"{name:22s} {run.stdout.strip():>8s} sent {lines:4d} lines {grown:7.1f} MB  {said[:90]}  {why}", flush=True)
    if run.returncode:
        print(run.stderr)
    return not why and lines <= LINES and grown <= MEMORY and not run.returncode


def main() -> int:
    """Run; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("--robot", default="swerve-ur10")
    parser.add_argument("--real-time", action="store_true", help="not in lockstep, at 100 Hz")
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--only", nargs="*", default=list(ATTACKS), choices=list(ATTACKS))
    given = parser.parse_args()
    safety = {"clock": 20.0, **({"watchdog": 1.0, "policy": 10.0} if given.real_time else {})}
    settings = {"safety": safety, **({"rates": {"control": 100}} if given.real_time else {})}
    with open_bus(55, 3, not given.real_time, robot=given.robot, settings=settings) as bus:
        start(bus)
        found = []
        for name in given.only:
            found.append(attack(bus, name, given.seconds))
            if bus.control.poll() is not None or bus.sim.poll() is not None:
                break
        print(bus.output()[-3000:] if not all(found) else "all well")
    return 0 if all(found) else 1


if __name__ == "__main__":
    sys.exit(main())
