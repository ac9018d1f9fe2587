"""Both robots over a ROS 2 bus: `wbmpc ros2 sim` and `wbmpc ros2 control` in two processes, loopback, a private domain.

Usage: python benchmarks/ros2_bus.py [--robot swerve rezero] [--seconds 60] [--only-stream] [--fifo] [--json FILE]
First `swerve-track` and `rezero-steps`, on the bus in lockstep and inside one process, same seed;
then the stream of commands is timed in real time: how regular it is, whether a message is lost, from state to command; and after
it the loop without a bus (benchmarks/realtime.py), for as long and at the same rates.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from ros2_processes import Bus, Recorder, matched, open_bus
from ros2_stream import balance, drive, stream, without_bus

from wbmpc.bases.ball.ros_settings import BallRosSettings
from wbmpc.bases.swerve.ros_settings import SwerveRosSettings
from wbmpc.log import Log
from wbmpc.model.robot import load_robot
from wbmpc.registry import REGISTRY
from wbmpc.ros2.bus import DEFAULT
from wbmpc.ros2.convert import header, path, upright
from wbmpc.studies.minniti2019.step_figures import progress_of, rise_time
from wbmpc.studies.minniti2019.step_goals import STEADY, STEPS
from wbmpc.studies.minniti2019.steps import RezeroStepsSettings, Schedule
from wbmpc.studies.pankert2022.track_references import END_EFFECTOR_ORIENTATION, PERIOD_LENGTH, SwerveTrackSettings
from wbmpc.studies.paths import SinePath

#: Offsets of the end effector's path [m], as in the experiment; a path begins this long after it was sent [s].
AHEAD, SIDE, HEIGHT, LEAD = 0.30, 0.65, 0.80, 2.0


def sine(settings: SwerveTrackSettings) -> SinePath:
    """The end effector's path of the experiment; it begins at 0.5 s."""
    s = settings
    return SinePath(s.variant.amplitude, PERIOD_LENGTH * s.periods, s.periods, s.speed, start=0.5, ramp=2.0)


def end_effector_of(way: SinePath, t: np.ndarray) -> np.ndarray:
    """Positions (n, 3) [m] of the end effector's reference at times t (n) [s]."""
    along, across = way.point(t)
    return np.stack([along + AHEAD, SIDE + across, np.full_like(along, HEIGHT)], axis=1)


def track(bus: Bus, settings: SwerveTrackSettings, rest: float) -> float:
    """Let the end effector follow the sine on the bus: mean error [m] in the estimated frame, 2 s after the beginning and later."""
    recorder, way = Recorder(bus.node), sine(settings)
    goal = bus.node.publisher("/goal_pose", "geometry_msgs/msg/PoseStamped")
    paths = {n: bus.node.publisher(f"/{n}_path", "nav_msgs/msg/Path", DEFAULT) for n in ("end_effector", "base")}
    bus.wait_for(lambda: recorder.time > 0.0 and recorder.rows["odom"], 60.0)
    begin = recorder.time
    bus.wait_for(lambda: recorder.time - begin > rest and all(map(matched, (goal, *paths.values()))), 60.0 + rest)
    goal.publish({"header": header(0.0, "odom")})  # to stay: in lockstep time then passes as fast as the commands come
    bus.wait_for(lambda: "running" in bus.said, 60.0)
    start = recorder.time + LEAD
    t = np.arange(0.0, way.end + 0.5, 0.02)
    s, _ = way.arc(t)
    base = [upright(np.array([x, 0.0, 0.0])) for x in s * way.length / way.arc_length]
    paths["base"].publish(
        path(start, "odom", np.array([p for p, _ in base]), np.array([q for _, q in base]), start + t)
    )
    paths["end_effector"].publish(
        path(start, "odom", end_effector_of(way, t), np.tile(END_EFFECTOR_ORIENTATION, (t.size, 1)), start + t)
    )
    bus.wait_for(lambda: "path" in bus.said, 60.0)
    bus.wait_for(lambda: recorder.time > start + way.end + 0.4 or "stopped" in bus.said, 600.0)
    if "running" not in bus.said:
        raise RuntimeError(f"{bus.said}\n{bus.output()}")
    times, end_effector = recorder.end_effector_in_estimate()
    use = (times > start + 2.0) & (times < start + way.end + 0.4)
    return float(np.linalg.norm(end_effector[use] - end_effector_of(way, times[use] - start), axis=1).mean())


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
    end effector; a step is two poses 1 ms apart."""
    robot = load_robot("rezero")
    schedule, lift = Schedule.of(settings, robot), np.array([0.0, 0.0, robot.base.radius])
    recorder, node = Recorder(bus.node), bus.node
    goal = node.publisher("/end_effector_path", "nav_msgs/msg/Path", DEFAULT)
    bus.wait_for(lambda: recorder.rows["base"] and matched(goal), 60.0)
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
    end_effector = np.array(sorted(recorder.poses["hand"]))
    t, felt = recorder.end_effector_in_estimate()
    log = Log()
    for row in end_effector:
        log.add("hand", row[0] - start, row[1:4] - lift)
        log.add("hand_quaternion", row[0] - start, row[4:8])
    rises, steady = [], []
    for k in range(count):
        begin, end = schedule.times[k + 1], schedule.times[k + 1] + settings.hold_time
        window = (log.times("hand") >= begin - lead) & (log.times("hand") < end - lead)
        rises.append(rise_time(log.times("hand")[window], progress_of(k, log, schedule, window)))
        last = (t - start >= end - lead - STEADY) & (t - start < end - lead)
        steady.append(float(np.linalg.norm(felt[last] - lift - schedule.positions[k + 1], axis=1).mean()))
    return Steps(max(rises), max(steady), recorder.tilt())


def inside(settings: SwerveTrackSettings, seed: int) -> float:
    """The same in one process."""
    result = REGISTRY["swerve-track"].run(settings, seed, None)
    return result.metrics["hand_error_mean_odometry"].value


def swerve(given: argparse.Namespace) -> dict[str, Any]:
    """`swerve-track` on the bus and in one process; the stream of commands while the base drives in real time."""
    settings = SwerveTrackSettings(periods=given.periods, speed=given.speed, settle_time=given.rest)
    figures: dict[str, Any] = {}
    if not given.only_stream:
        with open_bus(61, given.seed, lockstep=not given.realtime, factor=1.0 if given.realtime else 10.0) as bus:
            figures["bus"], figures["controller"] = track(bus, settings, given.rest), bus.figures
        figures["inside"] = inside(settings, given.seed)
    if given.seconds > 0.0:
        with open_bus(62, given.seed, lockstep=False, fifo=given.fifo) as bus:
            figures["stream"] = stream(bus, given.seconds, drive(bus, given.seconds), given.fifo)
            figures["controller in real time"] = bus.figures
        figures["without a bus"] = without_bus("swerve", SwerveRosSettings().mpc.rate, given.seconds, given.fifo)
    return figures


def ball(given: argparse.Namespace) -> dict[str, Any]:
    """`rezero-steps` on the bus and in one process; the stream of commands while it balances in real time."""
    settings = RezeroStepsSettings(final_hold_time=0.0)
    figures: dict[str, Any] = {}
    if not given.only_stream:
        with open_bus(63, given.seed, factor=10.0, robot="rezero") as bus:
            figures["bus"], figures["controller"] = asdict(steps(bus, settings)), bus.figures
        figures["inside"] = asdict(steps_inside(settings, given.seed))
    if given.seconds > 0.0:
        with open_bus(64, given.seed, lockstep=False, robot="rezero", fifo=given.fifo) as bus:
            figures["stream"] = stream(bus, given.seconds, balance(bus), given.fifo)
            figures["controller in real time"] = bus.figures
        figures["without a bus"] = without_bus("rezero", BallRosSettings().mpc.rate, given.seconds, given.fifo)
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robot", choices=["swerve", "rezero"], nargs="+", default=["swerve", "rezero"])
    parser.add_argument("--periods", type=int, default=1)
    parser.add_argument("--speed", type=float, default=0.255, help="of the end effector [m/s]")
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
