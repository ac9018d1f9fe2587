"""Solves in receding horizon, 100 000 or as many as are asked for: growth of the memory, drift of the solve time.

Usage: python benchmarks/soak.py [--robot rezero swerve arm mixed] [--solves 100000] [--minutes 20] [--json FILE]
`mixed` solves the problems of all robots in turn.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import platform
import time
from pathlib import Path
from typing import Any

import numpy as np

from wbmpc.bases.ball.defaults import RezeroCost, rezero_mpc, set_home_references
from wbmpc.bases.swerve.defaults import SwerveCost, swerve_mpc
from wbmpc.model.robot import load_robot
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem, Reference
from wbmpc.ocp.residuals import FramePose, Input
from wbmpc.ocp.sets import Box
from wbmpc.settings import MpcSettings
from wbmpc.studies.paths import SinePath
from wbmpc.types import Observation

#: Between two solves [s]; the spread of what the state is off its plan.
PERIOD, NOISE = 0.005, 1e-3
#: Solves between two looks at the memory.
SAMPLE = 100


def rezero(seconds: float) -> MPC:
    """The ball robot's end effector goes to and fro by 0.1 m every three seconds; 20 intervals over 1 s."""
    robot = load_robot("rezero")
    mpc = rezero_mpc(robot, MpcSettings(horizon=1.0, intervals=20, first_interval=0.0, barrier_mu=1e-2), RezeroCost())
    home, torque = robot.base.numeric.equilibrium(robot.home[robot.state["arm"]])
    set_home_references(mpc, robot, torque)
    position, quaternion = robot.pose(home)
    times = np.arange(0.0, seconds, 3.0)
    steps = np.outer(np.arange(times.size) % 2, [0.1, 0.0, 0.0])
    mpc.reference["end_effector"] = Reference.poses(times, position + steps, quaternion, hold=True)
    mpc.reset(home, torque)
    return mpc


def swerve(seconds: float) -> MPC:
    """The swerve robot along a sine that goes on; 20 intervals over 5 s."""
    robot = load_robot("swerve-ur10")
    mpc = swerve_mpc(robot, MpcSettings(horizon=5.0, intervals=20, first_interval=0.05), SwerveCost())
    path = SinePath(0.3, 2.66 * seconds / 10.0, seconds / 10.0, 0.25, start=0.5, ramp=2.0)
    t = np.arange(0.0, seconds, 0.1)
    along, across = path.point(t)
    position, quaternion = robot.pose(robot.home)
    mpc.reference["end_effector"] = Reference.poses(
        t, position + np.stack([along, across, 0.0 * t], axis=1), quaternion
    )
    states, inputs = np.tile(robot.home, (t.size, 1)), np.zeros((t.size, robot.input.size))
    arc, rate = path.arc(t)
    share = path.length / path.arc_length
    states[:, 0], inputs[:, 0] = arc * share, rate * share
    mpc.reference["state"], mpc.reference["input"] = Reference(t, states), Reference(t, inputs)
    mpc.reset(robot.home)
    return mpc


def arm(seconds: float) -> MPC:
    """A fixed arm between two poses, which change every two seconds; 20 intervals over 1 s, hard limits."""
    robot = load_robot("ur5")
    ocp = OptimalControlProblem(robot.dynamics(), horizon=1.0, intervals=20)
    ocp.add(Cost("end_effector", FramePose(robot, robot.tool), [1000.0] * 3 + [100.0] * 3))
    ocp.add(Cost("speed", Input(robot), 0.1))
    box = Box(robot.limits.input_lower, robot.limits.input_upper)
    ocp.add(Constraint("limits", Input(robot), box, hard=True))
    mpc = MPC(ocp, rate=1.0 / PERIOD)
    position, quaternion = robot.pose(robot.home)
    times = np.arange(0.0, seconds, 2.0)
    steps = np.outer(np.arange(times.size) % 2, [0.0, 0.1, 0.05])
    mpc.reference["end_effector"] = Reference.poses(times, position + steps, quaternion, hold=True)
    mpc.reset(robot.home)
    return mpc


MAKE = {"rezero": rezero, "swerve": swerve, "arm": arm}
MIXED = "mixed"


def resident() -> int:
    """Memory of this process [bytes]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


class Run:
    """One problem in receding horizon from the state that the plan of the last solve comes to, with noise."""

    def __init__(self, name: str, seconds: float) -> None:
        self.mpc = MAKE[name](seconds)
        self._plan = self.mpc.solver.trajectory(copy=False)
        self._rng, self._x, self._count = np.random.default_rng(0), self._plan.x[0].copy(), 0

    def solve(self) -> bool:
        """Whether it gave a plan."""
        done = self.mpc.advance(Observation(self._count * PERIOD, self._x))
        plan = self._plan
        share = PERIOD / (plan.grid[1] - plan.grid[0])
        noise = NOISE * PERIOD * self._rng.normal(size=self._x.size)
        self._x = (1.0 - share) * plan.x[0] + share * plan.x[1] + noise
        self._count += 1
        return done


def run(name: str, solves: int, seconds: float = np.inf) -> dict[str, Any]:
    """Figures by name, after ``solves``, or what was done of them within ``seconds``; times of a tenth are of the same problems in each
    tenth."""
    names = list(MAKE) if name == MIXED else [name]
    runs = [Run(n, solves * PERIOD / len(names) + 10.0) for n in names]
    times, memory, failures = np.full(solves, np.nan), np.full(solves // SAMPLE + 1, np.nan), 0
    start, done = time.perf_counter(), 0
    while done < solves and time.perf_counter() - start < seconds:
        if done % SAMPLE == 0:
            memory[done // SAMPLE] = resident()
        one = runs[done % len(runs)]
        failures += not one.solve()
        times[done], done = one.mpc.solve_time, done + 1
    times, memory, tenth = times[:done], memory[: (done - 1) // SAMPLE + 1], max(done // 10, 1)
    memory = memory[len(memory) // 100 + (len(memory) > 1) :]
    # the first hundredth is left out of the growth: buffers and caches come into being
    return {
        "robot": name, "solves": done, "intervals": runs[0].mpc.ocp.intervals, "failures": failures,
        "seconds": time.perf_counter() - start, "memory_first": memory[0], "memory_last": memory[-1],
        "growth": memory[-1] - memory[0], "median_first": float(np.median(times[:tenth])),
        "median_last": float(np.median(times[-tenth:])), "median": float(np.median(times)),
        "p99": float(np.percentile(times, 99)), "max": float(times[len(runs):].max(initial=0.0)),
        "quickest_first": float(np.percentile(times[:tenth], 10)), "quickest_last": float(np.percentile(times[-tenth:], 10)),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robot", nargs="*", default=["rezero", "swerve"], choices=[*MAKE, MIXED])
    parser.add_argument("--solves", type=int, default=100_000)
    parser.add_argument("--minutes", type=float, default=np.inf, help="stop after so long, whatever is done")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    given = parser.parse_args()
    gc.freeze()
    print(f"{platform.processor() or platform.machine()}, load {os.getloadavg()[0]:.2f} before")
    results = []
    for name in given.robot:
        r = run(name, given.solves, 60.0 * given.minutes)
        results.append(r)
        first, last = 1e3 * r["median_first"], 1e3 * r["median_last"]
        print(
            f"\n{name}, N = {r['intervals']}: {r['solves']} solves in {r['seconds']:.0f} s, {r['failures']} failed\n"
            f"  resident memory          {r['memory_first'] / 2**20:.1f} MiB, grown by {r['growth'] / 1024:.0f} KiB\n"
            f"  median solve             first tenth {first:.4f} ms, last tenth {last:.4f} ms: {100 * (last / first - 1):+.1f} %\n"
            f"  quickest tenth below     {1e3 * r['quickest_first']:.4f} ms, {1e3 * r['quickest_last']:.4f} ms\n"
            f"  median, p99, largest     {1e3 * r['median']:.4f}, {1e3 * r['p99']:.4f}, {1e3 * r['max']:.4f} ms",
            flush=True,
        )
    if given.json is not None:
        given.json.write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
