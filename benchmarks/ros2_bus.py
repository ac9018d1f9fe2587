"""Both robots over a ROS 2 bus: `wbmpc ros2 sim` and `wbmpc ros2 control` in two processes, loopback, a private domain.

Usage: python benchmarks/ros2_bus.py [--robot swerve rezero] [--seconds 60] [--only-stream] [--fifo] [--json FILE]
First `swerve-track` and `rezero-steps`, on the bus in lockstep and inside one process, same seed;
then the stream of commands is timed in real time: how regular it is, whether a message is lost, from state to command; and after
it the loop without a bus (benchmarks/realtime.py), for as long and at the same rates.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wbmpc import lie
from wbmpc.experiments import REGISTRY
from wbmpc.experiments.paths import SinePath
from wbmpc.experiments.rezero_steps import (
    STEADY,
    STEPS,
    RezeroStepsSettings,
    Schedule,
    progress_of,
    rise_time,
)
from wbmpc.experiments.swerve_track import HAND_ORIENTATION, PERIOD_LENGTH, SwerveTrackSettings
from wbmpc.log import Log
from wbmpc.model import load_robot
from wbmpc.ros2 import DEFAULT, Network, Qos, open_node
from wbmpc.ros2.convert import header, path, planar, pose, read_pose, seconds, upright
from wbmpc.ros2.settings import BallSettings, RosSettings
from wbmpc.ros2.sim import TRUTH_HAND, TRUTH_ODOM

#: Offsets of the hand's path [m], as in the experiment; a path begins this long after it was sent [s].
AHEAD, SIDE, HEIGHT, LEAD = 0.30, 0.65, 0.80, 2.0
CONTROLLERS = ("wheel", "steer", "arm", "brake")


def private(domain: int) -> dict[str, str]:
    """Environment of a bus that nobody else is on."""
    tag = f"<CycloneDDS><Domain><Discovery><Tag>{uuid.uuid4()}</Tag></Discovery></Domain></CycloneDDS>"
    own = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "CYCLONEDDS_URI": tag}
    return {**os.environ, **own}


class Bus:
    """The two processes and a node that watches them. ``said``: the last state of the controller."""

    def __init__(
        self,
        environment: dict[str, str],
        seed: int,
        lockstep: bool,
        factor: float,
        config: str,
        robot: str,
        fifo: bool = False,
    ) -> None:
        self.log = tempfile.TemporaryFile("w+")  # noqa: SIM115
        run = [sys.executable, "-m", "wbmpc", "ros2"]
        given = [robot, "--backend", "dds", "--config", config, *(["--lockstep"] if lockstep else [])]
        given += ["--fifo"] if fifo else []
        sim = [*run, "sim", *given, "--seed", str(seed), "--factor", str(factor)]
        start = lambda command: subprocess.Popen(command, env=environment, stdout=self.log, stderr=self.log)
        self.start_control = lambda: start([*run, "control", *given])
        self.control = self.start_control()
        self.node: Any = open_node("watcher", "dds", Network.of(environment))
        self.said, self.level = "", 0
        self.node.subscribe("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", self._diagnostics)
        self.wait_for(lambda: "waiting" in self.said, 120.0)  # the controller has built its solver
        self.start_sim = lambda: start(sim)
        self.sim = self.start_sim()
        self.wait_for(lambda: self.said == "waiting for a goal", 60.0)

    def _diagnostics(self, message: Any) -> None:
        self.said, self.level = message.status[0].message, message.status[0].level
        self.figures = {v.key: v.value for v in message.status[0].values}

    def wait_for(self, condition: Callable[[], object], limit: float) -> None:
        """Wait for a condition [s]; show the processes' output if it does not come."""
        end = time.monotonic() + limit
        while not condition():
            if time.monotonic() > end:
                raise TimeoutError(f"the controller says: '{self.said}'\n{self.output()}")
            time.sleep(0.01)

    def output(self) -> str:
        """What both processes have written."""
        self.log.flush()
        self.log.seek(0)
        return self.log.read()

    def close(self) -> None:
        """End both processes."""
        for process in (self.control, getattr(self, "sim", None)):
            if process is not None and process.poll() is None:
                process.terminate()
        for process in (self.control, getattr(self, "sim", None)):
            if process is not None:
                process.wait(10.0)
        self.node.close()
        self.log.close()


@contextmanager
def open_bus(
    domain: int,
    seed: int,
    lockstep: bool = True,
    factor: float = 1.0,
    settings: dict[str, Any] | None = None,
    robot: str = "swerve-ur10",
    fifo: bool = False,
) -> Iterator[Bus]:
    """Both processes on a private bus, ready for a goal."""
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "bus.yaml"
        config.write_text(json.dumps(settings or {}))
        bus = Bus(private(domain), seed, lockstep, factor, str(config), robot, fifo)
        try:
            yield bus
        finally:
            bus.close()


class Recorder:
    """Poses from the bus over their stamps: true base and hand, estimated base. ``rows``: time [s], x, y, yaw (``base``,
    ``odom``); ``poses``: time [s], position (3) [m], quaternion (4)."""

    def __init__(self, node: Any) -> None:
        self.rows: dict[str, list[list[float]]] = {"base": [], "odom": []}
        self.poses: dict[str, list[list[float]]] = {"base": [], "odom": [], "hand": []}
        take = lambda name: lambda m: self._take(name, m.header, m.pose.pose)
        node.subscribe(TRUTH_ODOM, "nav_msgs/msg/Odometry", take("base"), Qos(depth=100))
        node.subscribe("/odom", "nav_msgs/msg/Odometry", take("odom"), Qos(depth=100))
        hand = lambda m: self._take("hand", m.header, m.pose)
        node.subscribe(TRUTH_HAND, "geometry_msgs/msg/PoseStamped", hand, Qos(depth=100))

    def _take(self, name: str, head: Any, given: Any) -> None:
        position, turned = read_pose(given, name)
        self.poses[name].append([seconds(head.stamp), *position, *turned])
        if name in self.rows:
            self.rows[name].append([seconds(head.stamp), *planar(position, turned)])

    @property
    def time(self) -> float:
        """The newest stamp [s]."""
        return self.rows["base"][-1][0] if self.rows["base"] else 0.0

    def hand_in_estimate(self) -> tuple[np.ndarray, np.ndarray]:
        """Times (n) [s] and positions (n, 3) of the hand in the estimated frame: estimated base, true hand in the base."""
        base, hand, odom = (np.array(sorted(self.poses[n])) for n in ("base", "hand", "odom"))
        t = hand[(hand[:, 0] > odom[0, 0]) & (hand[:, 0] < odom[-1, 0]), 0]
        true, tool, seen = (_at(rows, t) for rows in (base, hand, odom))
        turned = [
            lie.quaternion_to_rotation(s[3:]) @ lie.quaternion_to_rotation(b[3:]).T @ (h[:3] - b[:3]) + s[:3]
            for b, h, s in zip(true, tool, seen, strict=True)
        ]
        return t, np.array(turned)

    def tilt(self) -> float:
        """The largest true lean [rad]."""
        up = [lie.quaternion_to_rotation(np.array(row[4:]))[2, 2] for row in self.poses["base"]]
        return float(np.arccos(np.clip(min(up), -1.0, 1.0)))


def _at(rows: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Poses (n, 7) at times t (n), between the recorded ones."""
    turned = rows[:, 4:].copy()
    for k in range(1, len(turned)):
        turned[k] *= np.sign(turned[k] @ turned[k - 1]) or 1.0
    columns = np.concatenate([rows[:, 1:4], turned], axis=1).T
    found = np.stack([np.interp(t, rows[:, 0], c) for c in columns], axis=1)
    found[:, 3:] /= np.linalg.norm(found[:, 3:], axis=1)[:, None]
    return found


def sine(settings: SwerveTrackSettings) -> SinePath:
    """The hand's path of the experiment; it begins at 0.5 s."""
    s = settings
    return SinePath(s.amplitude, PERIOD_LENGTH * s.periods, s.periods, s.speed, start=0.5, ramp=2.0)


def hand_of(way: SinePath, t: np.ndarray) -> np.ndarray:
    """Positions (n, 3) [m] of the hand's reference at times t (n) [s]."""
    along, across = way.point(t)
    return np.stack([along + AHEAD, SIDE + across, np.full_like(along, HEIGHT)], axis=1)


def track(bus: Bus, settings: SwerveTrackSettings, rest: float) -> float:
    """Let the hand follow the sine on the bus: mean error [m] in the estimated frame, 2 s after the beginning and later."""
    recorder, way = Recorder(bus.node), sine(settings)
    goal = bus.node.publisher("/goal_pose", "geometry_msgs/msg/PoseStamped")
    paths = {n: bus.node.publisher(f"/{n}_path", "nav_msgs/msg/Path", DEFAULT) for n in ("hand", "base")}
    bus.wait_for(lambda: recorder.time > 0.0 and recorder.rows["odom"], 60.0)
    begin = recorder.time
    bus.wait_for(lambda: recorder.time - begin > rest and all(map(_matched, (goal, *paths.values()))), 60.0 + rest)
    goal.publish({"header": header(0.0, "odom")})  # to stay: in lockstep time then passes as fast as the commands come
    bus.wait_for(lambda: "running" in bus.said, 60.0)
    start = recorder.time + LEAD
    t = np.arange(0.0, way.end + 0.5, 0.02)
    s, _ = way.arc(t)
    base = [upright(np.array([x, 0.0, 0.0])) for x in s * way.length / way.arc_length]
    paths["base"].publish(
        path(start, "odom", np.array([p for p, _ in base]), np.array([q for _, q in base]), start + t)
    )
    paths["hand"].publish(path(start, "odom", hand_of(way, t), np.tile(HAND_ORIENTATION, (t.size, 1)), start + t))
    bus.wait_for(lambda: "path" in bus.said, 60.0)
    bus.wait_for(lambda: recorder.time > start + way.end + 0.4 or "stopped" in bus.said, 600.0)
    if "running" not in bus.said:
        raise RuntimeError(f"{bus.said}\n{bus.output()}")
    times, hand = recorder.hand_in_estimate()
    use = (times > start + 2.0) & (times < start + way.end + 0.4)
    return float(np.linalg.norm(hand[use] - hand_of(way, times[use] - start), axis=1).mean())


@dataclass(frozen=True)
class Steps:
    """How the ball robot took the steps: slowest rise [s] from 10 to 90 %, largest mean error [m] at the end of a step in the
    estimated frame, largest lean [rad]."""

    rise: float
    steady: float
    tilt: float


def steps_inside(settings: RezeroStepsSettings, seed: int) -> Steps:
    """`rezero-steps` in one process."""
    m = REGISTRY["rezero-steps"].run(settings, seed, None).metrics
    return Steps(*(m[n].value for n in ("rise_time_max", "steady_position_error_max", "tilt_max")))


def steps(bus: Bus, settings: RezeroStepsSettings, count: int = len(STEPS)) -> Steps:
    """The same on the bus, or the first ``count`` steps: the schedule of poses is sent as one path of the
    hand; a step is two poses 1 ms apart."""
    robot = load_robot("rezero")
    schedule, lift = Schedule.of(settings, robot), np.array([0.0, 0.0, robot.base.radius])
    recorder, node = Recorder(bus.node), bus.node
    goal = node.publisher("/hand_path", "nav_msgs/msg/Path", DEFAULT)
    bus.wait_for(lambda: recorder.rows["base"] and _matched(goal), 60.0)
    # the robot is held until it is commanded: the path's first moment is when it starts
    times, positions, turned = [0.0], [schedule.positions[0]], [schedule.quaternions[0]]
    for k in range(1, schedule.times.size):
        for at, number in ((schedule.times[k] - 1e-3, k - 1), (schedule.times[k], k)):
            times.append(float(at))
            positions.append(schedule.positions[number])
            turned.append(schedule.quaternions[number])
    times.append(schedule.duration + 5.0)
    positions.append(positions[-1])
    turned.append(turned[-1])
    goal.publish(path(0.0, "odom", np.array(positions) + lift, np.array(turned), times))
    bus.wait_for(lambda: "running" in bus.said, 60.0)
    start = float(bus.figures["began at [s]"])
    end = start + schedule.times[count + 1]
    bus.wait_for(lambda: recorder.time > end or "stopped" in bus.said or bus.sim.poll() is not None, 900.0)
    if recorder.time < end:
        raise RuntimeError(f"{bus.said}\n{bus.output()}")
    return judged(recorder, schedule, settings, start, count)


def judged(recorder: Recorder, schedule: Schedule, settings: RezeroStepsSettings, start: float, count: int) -> Steps:
    """The figures of `rezero-steps` from what was seen on the bus."""
    lift, lead = np.array([0.0, 0.0, load_robot("rezero").base.radius]), settings.lead
    hand = np.array(sorted(recorder.poses["hand"]))
    t, felt = recorder.hand_in_estimate()
    log = Log()
    for row in hand:
        log.add("hand", row[0] - start, row[1:4] - lift)
        log.add("hand_quaternion", row[0] - start, row[4:8])
    rises, steady = [], []
    for k in range(count):
        begin, end = schedule.times[k + 1], schedule.times[k + 1] + settings.hold
        window = (log.times("hand") >= begin - lead) & (log.times("hand") < end - lead)
        rises.append(rise_time(log.times("hand")[window], progress_of(k, log, schedule, window)))
        last = (t - start >= end - lead - STEADY) & (t - start < end - lead)
        steady.append(float(np.linalg.norm(felt[last] - lift - schedule.positions[k + 1], axis=1).mean()))
    return Steps(max(rises), max(steady), recorder.tilt())


def inside(settings: SwerveTrackSettings, seed: int) -> float:
    """The same in one process."""
    result = REGISTRY["swerve-track"].run(settings, seed, None)
    return result.metrics["hand_error_mean_odometry"].value


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
    before = bus.figures
    bus.wait_for(lambda: bus.figures is not before, 60.0)
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
    bus.wait_for(lambda: _matched(goal), 60.0)
    return lambda: goal.publish({"header": header(0.0, "odom"), "pose": {"position": {"x": 0.3 * seconds_}}})


def balance(bus: Bus) -> Callable[[], None]:
    """A goal for the ball robot's hand: 0.2 m ahead."""
    robot = load_robot("rezero")
    position, turned = robot.pose(robot.home)
    goal = bus.node.publisher("/hand_goal", "geometry_msgs/msg/PoseStamped")
    bus.wait_for(lambda: _matched(goal), 60.0)
    at = pose(position + [0.2, 0.0, robot.base.radius], turned)
    return lambda: goal.publish({"header": header(0.0, "odom"), "pose": at})


def swerve(given: argparse.Namespace) -> dict[str, Any]:
    """`swerve-track` on the bus and in one process; the stream of commands while the base drives in real time."""
    settings = SwerveTrackSettings(periods=given.periods, speed=given.speed, rest=given.rest)
    figures: dict[str, Any] = {}
    if not given.only_stream:
        with open_bus(61, given.seed, lockstep=not given.realtime, factor=1.0 if given.realtime else 10.0) as bus:
            figures["bus"], figures["controller"] = track(bus, settings, given.rest), bus.figures
        figures["inside"] = inside(settings, given.seed)
    if given.seconds > 0.0:
        with open_bus(62, given.seed, lockstep=False, fifo=given.fifo) as bus:
            figures["stream"] = stream(bus, given.seconds, drive(bus, given.seconds), given.fifo)
            figures["controller in real time"] = bus.figures
        figures["without a bus"] = without_bus("swerve", RosSettings().mpc.rate, given.seconds, given.fifo)
    return figures


def ball(given: argparse.Namespace) -> dict[str, Any]:
    """`rezero-steps` on the bus and in one process; the stream of commands while it balances in real time."""
    settings = RezeroStepsSettings(rest=0.0)
    figures: dict[str, Any] = {}
    if not given.only_stream:
        with open_bus(63, given.seed, factor=10.0, robot="rezero") as bus:
            figures["bus"], figures["controller"] = asdict(steps(bus, settings)), bus.figures
        figures["inside"] = asdict(steps_inside(settings, given.seed))
    if given.seconds > 0.0:
        with open_bus(64, given.seed, lockstep=False, robot="rezero", fifo=given.fifo) as bus:
            figures["stream"] = stream(bus, given.seconds, balance(bus), given.fifo)
            figures["controller in real time"] = bus.figures
        figures["without a bus"] = without_bus("rezero", BallSettings().mpc.rate, given.seconds, given.fifo)
    return figures


def _matched(publisher: Any) -> bool:
    return bool(publisher._writer.get_matched_subscriptions())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robot", choices=["swerve", "rezero"], nargs="+", default=["swerve", "rezero"])
    parser.add_argument("--periods", type=int, default=1)
    parser.add_argument("--speed", type=float, default=0.255, help="of the hand [m/s]")
    parser.add_argument("--rest", type=float, default=20.0, help="standing before [s]")
    parser.add_argument("--seed", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=60.0, help="of the command stream; 0: none")
    parser.add_argument("--realtime", action="store_true", help="follow the sine in real time too, not in lockstep")
    parser.add_argument("--only-stream", action="store_true", help="time the stream of commands and nothing else")
    parser.add_argument("--fifo", action="store_true", help="the controller before all other processes")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    given = parser.parse_args()
    figures = {name: {"swerve": swerve, "rezero": ball}[name](given) for name in given.robot}
    print(json.dumps(figures, indent=2))
    if given.json is not None:
        given.json.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
