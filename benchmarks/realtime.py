"""Both robots in real time: an MPC at its rate beside a 400 Hz controller, MuJoCo in a process of its own.

Usage: python benchmarks/realtime.py [--robot rezero swerve] [--rate HZ] [--seconds 60] [--process] [--fifo] [--json FILE]
Missed deadlines, latency and jitter are counted; nothing here waits for the computation.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import platform
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from wbmpc import lie
from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.defaults import RezeroCost, rezero_mpc, set_home_references
from wbmpc.bases.ball.lean_control import LeanControl
from wbmpc.bases.ball.messages import BallCommand
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.ball.sent_torques import DriveSettings
from wbmpc.bases.ball.settings import PUSHED_SPEED
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.defaults import SwerveCost, swerve_mpc
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.bases.swerve.tracking import TrackingSettings
from wbmpc.model.robot import load_robot
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Reference
from wbmpc.runtime.clock import WallClock
from wbmpc.runtime.runner import RealTimeRunner
from wbmpc.runtime.safety import RealTimeSettings
from wbmpc.runtime.shared_memory import Sizes
from wbmpc.settings import MpcSettings
from wbmpc.studies.minniti2019.settings import RezeroSettings
from wbmpc.studies.minniti2019.step_goals import STEPS, target
from wbmpc.studies.paths import SinePath
from wbmpc.view.physics import Simulated

SETTLE, HOLD = 5.0, 5.0
BALL = RezeroSettings()
PATH = SinePath(0.498, 15.96, 6, 0.255, start=0.5, ramp=2.0)
END_EFFECTOR_ORIENTATION = lie.rotation_to_quaternion(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]))


@dataclass(frozen=True)
class Case:
    """A robot with its task: ``end_effector`` (n, 3) [m] over times is what it is to follow; ``judged``: at which times it counts."""

    rate: float
    make_mpc: Callable[[float], MPC]
    make_plant: Callable[[], Any]
    make_controller: Callable[[MPC, Any, float], Any]
    stop: Any
    end_effector: Callable[[np.ndarray], np.ndarray]
    judged: Callable[[np.ndarray], np.ndarray]
    note: str


# ---------------------------------------------------------------------- ball robot
def rezero_poses() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Home, then the steps one after another, home again: times (n) [s], positions (n, 3) [m], quaternions (n, 4)."""
    robot = load_robot("rezero")
    home = robot.pose(robot.home)
    poses = [home, *(target(s, *home) for s in STEPS), home]
    times = [0.0, *(SETTLE + HOLD * np.arange(len(STEPS) + 1))]
    return np.array(times), np.array([p for p, _ in poses]), np.array([q for _, q in poses])


def make_rezero_mpc(rate: float) -> MPC:
    """N = 26 over 1.3 s; the references of the steps."""
    robot = load_robot("rezero")
    settings = MpcSettings(rate=rate, horizon=1.3, intervals=26, first_interval=0.0, barrier_mu=1e-2)
    mpc = rezero_mpc(robot, settings, RezeroCost())
    home, torque = robot.base.numeric.equilibrium(robot.home[robot.state["arm"]])
    set_home_references(mpc, robot, torque)
    mpc.reference["end_effector"] = Reference.poses(*rezero_poses(), hold=True)
    mpc.reset(home, torque)
    return mpc


def make_rezero_plant() -> BallPlant:
    """Perturbed against the model, sensors with noise, as in the experiments."""
    robot = load_robot("rezero")
    return BallPlant(robot.description, *robot.base.numeric.equilibrium(robot.home[robot.state["arm"]]), None, 0)


def make_rezero_controller(own: MPC, plant: BallPlant, rate: float) -> BallController:
    """The experiments' controller with an MPC of its own as its model, on the simulator's state."""
    robot = load_robot("rezero")
    arm = robot.home[robot.state["arm"]]
    robot.base.numeric.mass_matrix(robot.home[: robot.base.nq])  # builds the function: not in the first tick
    controller = BallController(
        robot, own, robot.base.numeric.equilibrium(arm)[1], 1.0 / rate, DriveSettings(BALL.actuator_time_constant)
    )
    controller.learned.lean_control = LeanControl(robot, arm, RezeroCost().lean, PUSHED_SPEED)
    return controller


def rezero_case() -> Case:
    times, positions, _ = rezero_poses()
    index = lambda t: np.searchsorted(times, t, side="right") - 1
    return Case(
        1000.0, make_rezero_mpc, make_rezero_plant, make_rezero_controller, BallCommand(np.zeros(6)),
        lambda t: positions[index(t)], lambda t: np.abs(t - times[index(t)] - 3.0) < 0.5,
        "end effector error from 2.5 to 3.5 s after each step: later the end effector already leans into the next one, which it sees coming",
    )  # fmt: skip


# ---------------------------------------------------------------------- swerve base
def swerve_hand(t: np.ndarray) -> np.ndarray:
    along, across = PATH.point(t)
    return np.stack([along + 0.30, 0.65 + across, 0.80 + 0.0 * along], axis=1)


def make_swerve_mpc(rate: float, intervals: int = 50) -> MPC:
    """A horizon of 10 s on a grid that is fine near now; the references of the sine."""
    robot = load_robot("swerve-ur10")
    mpc = swerve_mpc(robot, MpcSettings(rate=rate, horizon=10.0, intervals=intervals), SwerveCost())
    t = np.arange(0.0, PATH.end + 0.5, 0.02)
    mpc.reference["end_effector"] = Reference.poses(t, swerve_hand(t), END_EFFECTOR_ORIENTATION)
    s, speed = PATH.arc(t)
    share = PATH.length / PATH.arc_length
    states, inputs = np.tile(robot.home, (t.size, 1)), np.zeros((t.size, robot.input.size))
    states[:, robot.state["base"]] = np.stack([s * share, 0.0 * s, 0.0 * s], axis=1)
    inputs[:, robot.input["base"].start] = speed * share
    mpc.reference["state"], mpc.reference["input"] = Reference(t, states), Reference(t, inputs)
    mpc.reset(robot.home)
    return mpc


def make_swerve_plant() -> SwervePlant:
    """Perturbed against the model, sensors with noise, as in the experiments."""
    robot = load_robot("swerve-ur10")
    return SwervePlant(robot.description, robot.state.split(robot.home), None, 0)


def make_swerve_controller(own: MPC, plant: SwervePlant, rate: float) -> SwerveController:
    """The experiments' controller, odometry of the wheels alone."""
    return SwerveController(
        load_robot("swerve-ur10"), plant.truth().pose, 1.0 / rate, tracking=TrackingSettings(lag=0.020)
    )


def swerve_case(intervals: int) -> Case:
    return Case(
        200.0, partial(make_swerve_mpc, intervals=intervals), make_swerve_plant, make_swerve_controller,
        SwerveCommand.stop(), swerve_hand, lambda t: t > 3.0, "end effector error along the sine from 3 s on",
    )  # fmt: skip


# ---------------------------------------------------------------------- one run
class Watched:
    """A controller that keeps its estimated state at every eighth tick."""

    def __init__(self, controller: Any) -> None:
        self.controller, self.times, self.states, self._ticks = controller, [], [], 0
        self.measure, self.predict = controller.measure, controller.predict

    @property
    def clamped(self) -> bool:
        return bool(self.controller.clamped)

    def command(self, t: float, plans: Any) -> Any:
        """The controller's command."""
        if self._ticks % 8 == 0:
            self.times.append(t)
            self.states.append(self.controller.state())
        self._ticks += 1
        return self.controller.command(t, plans)


def place(core: int | None, fifo: bool) -> None:
    """Where this process runs, and whether before all others."""
    if core is not None:
        os.sched_setaffinity(0, {core})
    if fifo:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))


def cpu_seconds(pid: int) -> float:
    """Processor time [s] that a process has used."""
    parts = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(parts[11]) + int(parts[12])) / os.sysconf("SC_CLK_TCK")


def errors(case: Case, times: np.ndarray, end_effector: np.ndarray) -> np.ndarray:
    """Distances [m] to the reference where they count."""
    use = (times >= 0.0) & case.judged(np.maximum(times, 0.0))
    return np.linalg.norm(end_effector[use] - case.end_effector(times[use]), axis=1)


def run(
    name: str, case: Case, rate: float, seconds: float, control: float, process: bool, fifo: bool
) -> dict[str, Any]:
    """One run in real time; figures by name."""
    own, plant = case.make_mpc(rate), case.make_plant()
    clock = WallClock()
    cores = sorted(os.sched_getaffinity(0))
    first, last = (cores[0], cores[-1]) if len(cores) > 1 else (None, None)
    robot = Simulated(case.make_plant, plant.measure(), case.stop, clock, first, fifo)
    controller = Watched(case.make_controller(own, plant, control))
    make = partial(case.make_mpc, rate)
    settings = RealTimeSettings(control, max_policy_age=0.25, records=200_000)
    runner = RealTimeRunner(
        robot, controller, make if process else make(), settings, clock, sizes=Sizes.of(own.solver.ocp),
        parameters=lambda: own.solver.parameters, setup=partial(place, last, fifo),
    )  # fmt: skip
    # with the MPC elsewhere the controller sits beside the physics; else on the other core with the MPC's thread
    place(first if process else last, fifo)
    gc.collect()
    gc.disable()
    runner.start()
    parts = {"physics": robot.process.pid, "controller" if process else "controller and MPC": os.getpid()}
    parts |= {"MPC": runner.process_id} if process else {}
    began, previous = clock.now(), {part: cpu_seconds(pid) for part, pid in parts.items()}
    while clock.now() < seconds and not runner.stopped:
        clock.wait(min(clock.now() + 0.05, seconds))
    load = {p: (cpu_seconds(pid) - previous[p]) / (clock.now() - began) for p, pid in parts.items()}
    report = runner.report()
    runner.shutdown()
    robot.close()
    gc.enable()
    model = load_robot("rezero" if name == "rezero" else "swerve-ur10")
    estimated = np.array([model.pose(x)[0] for x in controller.states])
    figures = {
        "estimated": errors(case, np.array(controller.times), estimated),
        "world": errors(case, *robot.end_effector()),
    }
    return {
        "robot": name, "mpc": "process" if process else "thread", "fifo": fifo, "target_rate": rate, "control_rate": control,
        "fell": bool(robot.board["fell"]), "largest_tilt": robot.board["tilt"], "physics_behind": int(robot.board["behind"]),
        "load": load, "note": case.note,
        "hand_error_mean": {k: float(v.mean()) if v.size else None for k, v in figures.items()},
        "hand_error_max": {k: float(v.max()) if v.size else None for k, v in figures.items()},
        **report.as_dict(), "rate": report.updates / report.seconds,
    }  # fmt: skip


def show(r: dict[str, Any]) -> None:
    """One run as a table."""
    ms = lambda s, keys: ", ".join(f"{1e3 * s[k]:.3f}" for k in keys)
    error = {k: f"{1e3 * v:.1f}" if v is not None else "-" for k, v in r["hand_error_mean"].items()}
    rows = [
        ("state", r["state"]),
        ("rate of the MPC [Hz]", f"{r['rate']:.1f} of {r['target_rate']:.0f}"),
        ("missed deadlines of the MPC", f"{r['mpc_misses']} of {r['updates']} (failed solves: {r['failures']})"),
        ("missed deadlines of the controller", f"{r['misses']} of {r['ticks']}"),
        ("updates without a new observation", str(r["repeated"])),
        ("solve: median, p95, max [ms]", ms(r["solve"], ("median", "p95", "max"))),
        ("update, to the hand-over [ms]", ms(r["update"], ("median", "p95", "max"))),
        ("observation to policy ready [ms]", ms(r["ready"], ("median", "p95", "max"))),
        ("observation to policy in force [ms]", ms(r["latency"], ("median", "p95", "max"))),
        ("policies in force; late ones", f"{r['policies']}; {r['late']}"),
        ("tick begins late: p50, p99, max [ms]", ms(r["jitter"], ("median", "p99", "max"))),
        ("tick takes: p50, p99, max [ms]", ms(r["tick"], ("median", "p99", "max"))),
        ("clamped ticks", str(r["clamped"])),
        ("fell; largest tilt [rad]", f"{'yes' if r['fell'] else 'no'}; {r['largest_tilt']:.3f}"),
        ("mean end effector error, estimated; world [mm]", f"{error['estimated']}; {error['world']}"),
        ("physics too slow for real time", f"{r['physics_behind']} times"),
        ("share of a core", ", ".join(f"{k} {100 * v:.0f} %" for k, v in r["load"].items())),
    ]
    print(f"\n{r['robot']}, MPC in a {r['mpc']}, controller at {r['control_rate']:.0f} Hz, {r['seconds']:.1f} s")
    for label, value in rows:
        print(f"  {label:42s}{value}")
    print(f"  ({r['note']})", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robot", nargs="*", default=["rezero", "swerve"], choices=["rezero", "swerve"])
    parser.add_argument("--rate", type=float, help="of the MPC [Hz]; left out: 1000 and 200")
    parser.add_argument("--control", type=float, default=400.0, help="rate of the controller [Hz]")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--intervals", type=int, default=50, help="of the swerve robot's horizon")
    parser.add_argument("--process", action="store_true", help="the MPC in a process of its own")
    parser.add_argument("--fifo", action="store_true", help="real-time priority for controller, MPC and physics")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    given = parser.parse_args()
    cores = len(os.sched_getaffinity(0))
    where = "controller and physics share one, the MPC has the other" if given.process else (
        "physics on one, controller and MPC threads on the other"
    )  # fmt: skip
    print(f"{platform.processor() or platform.machine()}, {cores} cores, load {os.getloadavg()[0]:.2f} before; {where}")
    runs = []
    for name in given.robot:
        case = rezero_case() if name == "rezero" else swerve_case(given.intervals)
        runs.append(run(name, case, given.rate or case.rate, given.seconds, given.control, given.process, given.fifo))
        show(runs[-1])
    if given.json is not None:
        given.json.write_text(json.dumps(runs, indent=2) + "\n")


if __name__ == "__main__":
    main()
