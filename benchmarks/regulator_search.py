"""Gains of the ball robot's regulators (LQR, gain-scheduled LQR) for its push map: searched on the model, then in simulation.

Usage: python benchmarks/regulator_search.py [--modes end effector ball] [--only lqr scheduled-lqr] [--walks 3] [--sets 50] [--best 3]
       [--first 0] [--seeds 0 3] [--write] [--file FILE]
First random walks on the model alone (no noise, slip or perturbed masses; slower drives than believed): about the best set of
gains so far, made small is how far end effector or ball are from their place when the next push would come, or how early the robot falls,
over five directions; the push (0.2 s) gets harder whenever all five are recovered from. Then a race of the walks' best sets, and
of those that there are, as the push map measures them, in four other directions on tuning seeds. Simulated pushes are kept in
FILE (JSON lines) and are not simulated again. With ``--write`` the winner goes to benchmarks/push_map_gains.json, where the push
map takes its baselines from.
"""

from __future__ import annotations

import argparse
import copy
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
from ball_baselines import SPACE, Store, candidate
from push_map import gains, settings_with, write_gains

from wbmpc.bases.ball.defaults import rezero_mpc, set_home_references
from wbmpc.bases.ball.sent_torques import DriveSettings
from wbmpc.model.robot import load_robot
from wbmpc.studies.minniti2019.baselines import RegulatorSettings, regulator_weights
from wbmpc.studies.minniti2019.lqr import LqrController, RegulatorGains
from wbmpc.studies.minniti2019.push_map import MODES, Point
from wbmpc.studies.minniti2019.recovery import LAST, NEAR

Gains = dict[str, float]
CONTROLLERS = ("lqr", "scheduled-lqr")

#: The model's drives [s]: the slowest that a plant has (20 ms + 30 %). A tilt [rad] from which nothing came back.
LAG, FALLEN = 0.026, 0.8
#: The base among the links of the model: after the ball's two, yaw and pitch.
BODY = 4
#: Length [s] of all pushes; their directions [rad] on the model, which is symmetric, and, between those, in simulation.
LENGTH = 0.2
MODELLED = tuple(np.deg2rad([90.0, 0.0, 180.0, 45.0, 135.0]).tolist())
SIMULATED = tuple(np.deg2rad([22.5, 112.5, 202.5, 292.5]).tolist())
#: The first impulse [N s] of a walk, and what it is raised by; what a race raises it by.
GENTLE, RAISE, HARDER = 10.0, 4.0, 10.0
#: How near [m] end effector or ball have to be on the model, where nothing disturbs them: half of what is asked in simulation.
NEARER = 0.5 * NEAR


class ModelledRobot:
    """A regulator on the planner's own model: pushes as generalised forces, torques cut to the drives' limits, a lag.

    ``mode``: what is held, "hand" or "ball"."""

    def __init__(self, mode: str) -> None:
        self.mode, self.settings = mode, MODES[mode]()
        self.robot = load_robot("rezero")
        self.home, self.torque = self.robot.base.numeric.equilibrium(self.robot.home[self.robot.state["arm"]])
        self.mpc = rezero_mpc(self.robot, self.settings.mpc, self.settings.cost)
        set_home_references(self.mpc, self.robot, self.torque, self.home)
        self.mpc.reset(self.home, self.torque)
        self.period = 1.0 / self.settings.control.rate
        weights = regulator_weights(self.robot, self.settings, RegulatorSettings())
        self._gains = RegulatorGains(self.robot, weights, self.period)

        base, q = self.robot.base, ca.SX.sym("q", self.robot.base.nq)
        pose = base.chain(q).link_pose(BODY)
        place = pose.position + pose.rotation @ ca.DM(base.tree.links[BODY].com)
        self._slope = ca.Function("slope", [q], [ca.densify(ca.jacobian(place[:2], q))])

    def controller(self, scheduled: bool, gains: Gains) -> LqrController:
        """With these factors of the weights."""
        given, own = RegulatorSettings(**gains), copy.copy(self._gains)
        own.weights = regulator_weights(self.robot, self.settings, given)
        controller = LqrController(
            self.robot,
            self.mpc,
            self.torque,
            self.period,
            DriveSettings(self.settings.actuator_time_constant),
            observer=False,
        )
        controller.regulate(own, lambda t: self.home, scheduled, given.max_error)
        return controller

    def generalised(self, q: np.ndarray, force: np.ndarray) -> np.ndarray:
        """The generalised forces (nq) of a horizontal force (2) [N] at the centre of mass of the base."""
        out: np.ndarray = np.array(self._slope(q)).T @ force
        return out

    def loss(self, controller: LqrController, direction: float, impulse: float) -> float:
        """How bad a push [N s] ends, when the push experiments would push again: e/(1 + e) for a largest error e [m] of end effector or
        ball, 1 to 2 for a fall, more the earlier."""
        states = self.pushed(controller, direction, impulse, self.settings.pause)
        steps = round(self.settings.pause / self.period)
        if len(states) < steps:
            return 2.0 - len(states) / steps
        last = states[-round(LAST / self.period) :]
        place = self.robot.poses(last)[:, :3] if self.mode == "hand" else last[:, :2]
        target = self.robot.pose(self.home)[0] if self.mode == "hand" else self.home[:2]
        error = float(np.linalg.norm(place - target, axis=1).max())
        return error / (1.0 + error)

    def losses(self, controller: LqrController, impulse: float, maximum: float = np.inf) -> list[float]:
        """Over the directions, until their sum is beyond ``maximum``."""
        found: list[float] = []
        for direction in MODELLED:
            found.append(self.loss(controller, direction, impulse))
            if sum(found) > maximum:
                break
        return found

    def pushed(self, controller: LqrController, direction: float, impulse: float, seconds: float) -> np.ndarray:
        """States (n, nx) from a push on, every period, until it falls."""
        x, torque, n = self.home.copy(), self.torque.copy(), self.robot.base.nq
        blend = 1.0 - np.exp(-self.period / LAG)
        push = impulse / LENGTH * np.array([np.cos(direction), np.sin(direction)])
        states = []
        for k in range(round(seconds / self.period)):
            t = k * self.period
            if t < LENGTH + self.period:
                force = self.generalised(x[:n], push) if t < LENGTH else np.zeros(n)
                self.mpc.solver.set_parameters({"disturbance": force})
            target = controller.limits.possible(controller._law(t, x, None)[1])
            torque = torque + blend * (target - torque)
            x = controller._step(x, torque, self.period)
            if not np.isfinite(x).all() or np.hypot(x[3], x[4]) > FALLEN:
                break
            states.append(x)
        return np.array(states)


def back(losses: list[float]) -> bool:
    """Whether it recovered in all directions, with some margin."""
    return len(losses) == len(MODELLED) and max(losses) < NEARER / (1.0 + NEARER)


def walk(
    robot: ModelledRobot, controller: str, start: Gains, sets: int, rng: np.random.Generator
) -> tuple[float, Gains]:
    """The impulse [N s] that ``sets`` of gains are at in the end (the best recovers from ``RAISE`` less), and the best. Steps are
    longer after a better set and shorter after a worse one: some of five are better (Rechenberg's rule)."""
    best, impulse, step = start, GENTLE, 0.5
    losses = lambda tried, *more: robot.losses(robot.controller(controller == "scheduled-lqr", tried), impulse, *more)
    found = losses(best)
    for _ in range(1, sets):
        while back(found):
            impulse += RAISE
            found = losses(best)
        tried = candidate(SPACE[controller], rng, best, step)
        other = losses(tried, sum(found))
        step *= 0.9
        if sum(other) < sum(found):
            best, found, step = tried, other, min(1.0, 1.5 * step / 0.9)
    return impulse, best


def search(robot: ModelledRobot, controller: str, walks: int, sets: int, first: int) -> list[tuple[float, Gains]]:
    """What ``walks`` ended with, the best first: the first two are from the gains that there are for this controller and for the
    other, the rest from anywhere, the same places for both; another ``first`` gives others."""
    space, found = SPACE[controller], []
    for k in range(walks):
        rng = np.random.default_rng([first, k])
        start = candidate(space, rng, None)
        if k < 2:
            start = present(robot, CONTROLLERS[CONTROLLERS.index(controller) - k])
        found.append(walk(robot, controller, start, sets, rng))
        print(f"  walk {k + 1}, {sets} sets: at {found[-1][0]:g} N s, {found[-1][1]}", flush=True)
    return sorted(found, key=lambda f: -f[0])


def present(robot: ModelledRobot, controller: str) -> Gains:
    """The gains that there are."""
    own = getattr(robot.settings.baseline, controller.replace("-", "_"))
    return {k: float(getattr(own, k)) for k in SPACE[controller]} | gains(robot.mode, controller)


def race(
    sets: list[Gains], first: float, recovers: Callable[[Gains, float, int], bool], tasks: int
) -> tuple[float, int, Gains]:
    """The impulse [N s] after which one of the ``sets`` recovers in most of the ``tasks`` and none in all, in how many, and which.

    ``recovers``: from an impulse, in a task. From ``first`` on the impulse is raised whenever one set has done all tasks; a set
    that cannot do more than the best is left."""
    impulse, maximum, best = first, -1, sets[0]
    for tried in sets:
        while True:
            done = failed = 0
            while done + failed < tasks and tasks - failed > maximum:
                passed = recovers(tried, impulse, done + failed)
                done, failed = done + passed, failed + (not passed)
            if done <= maximum:
                break
            maximum, best = done, tried
            if done < tasks:
                break
            impulse, maximum = impulse + HARDER, -1
    return impulse, maximum, best


def simulated(store: Store, mode: str, controller: str, seeds: list[int]) -> Callable[[Gains, float, int], bool]:
    """Whether the robot recovers in simulation, as the push map asks: tasks are seeds and directions."""

    def recovers(tried: Gains, impulse: float, task: int) -> bool:
        direction, seed = SIMULATED[task // len(seeds)], seeds[task % len(seeds)]
        passed = store.recovers(Point(mode, direction, LENGTH, seed, settings_with(controller, tried)), impulse)
        case = f"{np.rad2deg(direction):g} deg, seed {seed}, {impulse:g} N s"
        print(f"  {tried}, {case}: {'recovers' if passed else 'no'}", flush=True)
        return passed

    return recovers


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--modes", nargs="+", choices=list(MODES), default=["hand", "ball"])
    parser.add_argument("--only", nargs="+", choices=CONTROLLERS, default=list(CONTROLLERS))
    parser.add_argument("--walks", type=int, default=3, help="on the model")
    parser.add_argument("--sets", type=int, default=50, help="of each walk")
    parser.add_argument("--best", type=int, default=3, help="walks whose sets are simulated")
    parser.add_argument("--first", type=int, default=0, help="of the random numbers: another search has others")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 3])
    parser.add_argument("--write", action="store_true", help="the best gains into push_map_gains.json")
    parser.add_argument("--file", type=Path, default=Path("regulators.jsonl"))
    given = parser.parse_args()
    for mode in given.modes:
        robot = ModelledRobot(mode)
        for controller in given.only:
            print(f"{mode} held, {controller}, on the model:", flush=True)
            found = search(robot, controller, given.walks, given.sets, given.first)[: given.best]
            least = max(HARDER, HARDER * (found[0][0] // HARDER - 1.0))  # in simulation it is less than on the model
            recovers = simulated(Store(given.file), mode, controller, given.seeds)
            tasks = len(SIMULATED) * len(given.seeds)
            sets = [*(f[1] for f in found), *(present(robot, name) for name in CONTROLLERS)]
            impulse, done, best = race(sets, least, recovers, tasks)
            print(f"{mode} held, {controller}: {done} of {tasks} from {impulse:g} N s with {best}", flush=True)
            if given.write:
                write_gains(mode, controller, best)


if __name__ == "__main__":
    main()
