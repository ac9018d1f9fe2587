"""The stream of commands on a bus in real time: how regular it is, whether a message is lost, from state to command; and the loop
without a bus."""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from ros2_processes import Bus, matched

from wbmpc.model.robot import load_robot
from wbmpc.ros2.bus import Qos
from wbmpc.ros2.convert import header, pose


def on_grid(t: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (n) of the periods to which times t (n) [s] belong, and how far they are off [s]. Where the grid lies all of them
    say, as a mean direction: a single one that was late, the first above all, says nothing."""
    phase = period * np.angle(np.mean(np.exp(2j * np.pi * t / period))) / (2.0 * np.pi)
    ticks = np.round((t - phase) / period)
    off = t - phase - ticks * period
    return ticks, off - np.median(off)


def by_the_sender(first: dict[str, str], last: dict[str, str]) -> dict[str, Any]:
    """What the controller's own clock says of the commands between two diagnostics: share that left within 1 ms of their time
    (ticks that were skipped did not), and which part of the tick took long before the others."""
    grown = {k: int(last[k]) - int(first[k]) for k in last if k.startswith("late commands")}
    skipped, sent = (int(last[k]) - int(first[k]) for k in ("missed deadlines of the controller", "commands sent"))
    late = sum(grown.values()) + skipped
    return {
        "within 1 ms of their time": 1.0 - late / (sent + skipped), "commands": sent, "skipped ticks": skipped,
        "late by": {k.removeprefix("late commands: "): n for k, n in grown.items() if n},
        **{k: last[k] for k in last if k.startswith(("command after", "tick begins", "tick takes"))},
    }  # fmt: skip


def spread_of(off: np.ndarray) -> dict[str, int]:
    """How many arrivals are off their place by more than so many milliseconds."""
    sides = (("later than ", 1.0), ("earlier than ", -1.0))
    return {
        f"{side}{1e3 * limit:g} ms": int(np.sum(sign * off > limit))
        for side, sign in sides
        for limit in (2.5e-4, 5e-4, 1e-3, 2e-3, 5e-3)
    }


def stream(bus: Bus, seconds_: float, send: Callable[[], None], fifo: bool) -> dict[str, Any]:
    """Times of the wheels' commands and of the joint states as they come to a third process, from the goal that ``send`` sends;
    and what the sender's clock says of the same time, to within the second between two diagnostics."""
    arrivals: dict[str, list[float]] = {"command": [], "state": []}
    take = lambda name: lambda message: arrivals[name].append(time.perf_counter())
    many = Qos(depth=1000)
    bus.node.subscribe("/wheel_controller/commands", "std_msgs/msg/Float64MultiArray", take("command"), many)
    bus.node.subscribe("/joint_states", "sensor_msgs/msg/JointState", take("state"), many)
    time.sleep(1.0)  # both ends know each other
    send()
    bus.wait_for(lambda: bus.said.startswith("running"), 60.0)
    gc.collect()
    gc.disable()
    if fifo:  # the watch is not to be late itself
        for thread in os.listdir("/proc/self/task"):
            os.sched_setscheduler(int(thread), os.SCHED_FIFO, os.sched_param(20))
    time.sleep(1.0)  # what has waited for the watch has come
    first, load, begin = len(arrivals["command"]), os.getloadavg()[0], bus.figures
    time.sleep(seconds_)
    t, states, period = np.array(arrivals["command"][first:]), np.array(arrivals["state"]), 1.0 / 400.0
    gc.enable()
    if fifo:
        for thread in os.listdir("/proc/self/task"):
            os.sched_setscheduler(int(thread), os.SCHED_OTHER, os.sched_param(0))
    previous = bus.figures
    bus.wait_for(lambda: bus.figures is not previous, 60.0)
    if not bus.said.startswith("running"):
        raise RuntimeError(f"the stream ended: {bus.said}\n{bus.output()}")
    sent, received = int(bus.figures["commands sent"]), len(arrivals["command"])
    ticks, off = on_grid(t - t[0], period)
    last = states[np.maximum(np.searchsorted(states, t) - 1, 0)]
    expected = round((t[-1] - t[0]) / period) + 1
    return {
        "load": load, "commands": t.size, "expected": expected,
        "within 1 ms of their time": np.unique(ticks[np.abs(off) < 1e-3]).size / expected,
        "by the sender's clock": by_the_sender(begin, bus.figures), "off their place": spread_of(off),
        "late after [s]": [round(float(v - t[0]), 3) for v in t[off > 1e-3][:100]],
        "longest gap [ms]": 1e3 * float(np.diff(t).max()),
        "sent since the start": sent, "received since the start": received,
        "state to command, median [ms]": 1e3 * float(np.median(t - last)),
        "state to command, 99 % [ms]": 1e3 * float(np.percentile(t - last, 99)),
    }  # fmt: skip


def without_bus(robot: str, rate: float, seconds_: float, fifo: bool) -> dict[str, Any]:
    """The same controller and MPC (``rate`` [Hz]) at 400 Hz with the physics over shared memory, in processes of their own."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "figures.json"
        given = ["--robot", robot, "--rate", str(rate), "--seconds", str(seconds_), "--json", str(file)]
        command = [sys.executable, str(Path(__file__).parent / "realtime.py"), *given, *(["--fifo"] if fifo else [])]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        (found,) = json.loads(file.read_text())
    return {
        "state": found["state"], "load": os.getloadavg()[0],
        "ticks": found["ticks"], "missed ticks": found["misses"], "MPC [Hz]": found["rate"],
        "tick begins late, median [ms]": 1e3 * found["jitter"]["median"],
        "tick begins late, 99 % [ms]": 1e3 * found["jitter"]["p99"],
        "tick takes, median [ms]": 1e3 * found["tick"]["median"],
    }  # fmt: skip


def drive(bus: Bus, seconds_: float) -> Callable[[], None]:
    """A goal for the base that takes as long."""
    goal = bus.node.publisher("/goal_pose", "geometry_msgs/msg/PoseStamped")
    bus.wait_for(lambda: matched(goal), 60.0)
    return lambda: goal.publish({"header": header(0.0, "odom"), "pose": {"position": {"x": 0.3 * seconds_}}})


def balance(bus: Bus) -> Callable[[], None]:
    """A goal for the ball robot's end effector: 0.2 m ahead."""
    robot = load_robot("rezero")
    position, turned = robot.pose(robot.home)
    goal = bus.node.publisher("/end_effector_goal", "geometry_msgs/msg/PoseStamped")
    bus.wait_for(lambda: matched(goal), 60.0)
    at = pose(position + [0.2, 0.0, robot.base.radius], turned)
    return lambda: goal.publish({"header": header(0.0, "odom"), "pose": at})
