"""Gains of the ball robot's regulators (LQR, gain-scheduled LQR) for its push map: searched on the model, then in simulation.

Usage: python benchmarks/regulator_search.py [--modes hand ball] [--only lqr scheduled-lqr] [--draws 100] [--best 3] [--seed 0]
       [--standing] [--write] [--file FILE]
First many sets of gains on the model alone (no noise, slip or perturbed masses; slower drives than believed), then the best of them
as the push map measures them, on a tuning seed. What is made large is the mean impulse from which the robot recovers, over four
directions between the axes and the diagonals, pushes of 0.2 s. With ``--standing`` it only has to stand, and what is found is a
regulator that lets the robot roll away for ever. Simulated figures are kept in FILE (JSON lines) and are not measured again. With
``--write`` the best set of each goes to benchmarks/push_map_gains.json, where the push map takes its rivals from.
"""

from __future__ import annotations

import argparse
import copy
from pathlib import Path

import casadi as ca
import numpy as np
from push_map import gains, write_gains
from rezero_rivals import DIRECTIONS, LENGTH, SPACE, Store, candidate, loss

from wbmpc.control import LqrAgent, RegulatorGains
from wbmpc.experiments.push_map import MODES, Point, impulse_at_failure
from wbmpc.experiments.rezero_problem import rezero_mpc
from wbmpc.experiments.rezero_push import LAST, NEAR
from wbmpc.experiments.rezero_rivals import RegulatorSettings, regulator_weights
from wbmpc.experiments.rezero_task import set_home_references
from wbmpc.model import load_robot
from wbmpc.mpc import Plans
from wbmpc.plant import RezeroMeasurement

#: The model's drives [s]: the slowest that a plant has (20 ms + 30 %). A tilt [rad] from which nothing came back.
LAG, FALLEN = 0.026, 0.8
#: The base among the links of the model: after the ball's two, yaw and pitch.
BODY = 4
#: Seconds from the push on in which it has to fall if it does; bisection on the model ends at this [N s].
WATCHED, FINE = 4.0, 10.0


class ModelledRobot:
    """A regulator on the planner's own model: pushes as generalised forces, torques cut to the drives' limits, a lag.

    ``mode``: what is held, "hand" or "ball"."""

    def __init__(self, mode: str) -> None:
        self.mode, self.settings = mode, MODES[mode]()
        self.robot = load_robot("rezero")
        self.home, self.torque = self.robot.equilibrium(self.robot.home[self.robot.state["arm"]])
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

    def agent(self, scheduled: bool, gains: dict[str, float]) -> LqrAgent:
        """With these factors of the weights."""
        given, own = RegulatorSettings(**gains), copy.copy(self._gains)
        own.weights = regulator_weights(self.robot, self.settings, given)
        agent = LqrAgent(self.robot, self.mpc, self.torque, self.period, self.settings.drive_lag, observer=False)
        agent.regulate(own, self.mpc.reference["body"].at, scheduled, given.most)
        return agent

    def generalised(self, q: np.ndarray, force: np.ndarray) -> np.ndarray:
        """The generalised forces (nq) of a horizontal force (2) [N] at the centre of mass of the base."""
        out: np.ndarray = np.array(self._slope(q)).T @ force
        return out

    def stands(self, agent: LqrAgent, direction: float, impulse: float) -> bool:
        """Whether it stays up after a push at the base's centre of mass."""
        return self.pushed(agent, direction, impulse, LENGTH + WATCHED) is not None

    def recovers(self, agent: LqrAgent, direction: float, impulse: float) -> bool:
        """Whether hand or ball are back in their place when the push experiments would push again."""
        states = self.pushed(agent, direction, impulse, self.settings.pause)
        if states is None:
            return False
        last = states[-round(LAST / self.period) :]
        place = self.robot.poses(last)[:, :3] if self.mode == "hand" else last[:, :2]
        wanted = self.robot.pose(self.home)[0] if self.mode == "hand" else self.home[:2]
        return bool(np.linalg.norm(place - wanted, axis=1).max() < NEAR)

    def pushed(self, agent: LqrAgent, direction: float, impulse: float, seconds: float) -> np.ndarray | None:
        """States (n, nx) from a push on, every period; None if it fell."""
        x, torque, n = self.home.copy(), self.torque.copy(), self.robot.base.nq
        blend, push = (
            1.0 - np.exp(-self.period / LAG),
            impulse / LENGTH * np.array([np.cos(direction), np.sin(direction)]),
        )
        states = []
        for k in range(round(seconds / self.period)):
            t = k * self.period
            force = self.generalised(x[:n], push) if t < LENGTH else np.zeros(n)
            self.mpc.solver.set_parameters({"disturbance": force})
            agent.measure(RezeroMeasurement(t, x, 0.0))
            torque = torque + blend * (agent.command(t, Plans()).torque - torque)
            x = agent._step(x, torque, self.period)
            if not np.isfinite(x).all() or np.hypot(x[3], x[4]) > FALLEN:
                return None
            states.append(x)
        return np.array(states)

    def impulse(self, agent: LqrAgent, least: float, standing: bool = False) -> float:
        """Mean impulse [N s] from which it recovers (``standing``: that it stands); 0 when one direction has not even ``least``."""
        passes = self.stands if standing else self.recovers
        if not all(passes(agent, d, max(least, FINE)) for d in DIRECTIONS):
            return 0.0
        at = lambda point, impulse: passes(agent, point.direction, impulse)
        return float(np.mean([impulse_at_failure(Point("hand", d, LENGTH, 0), at, FINE)[0] for d in DIRECTIONS]))


def search(
    robot: ModelledRobot, controller: str, draws: int, first: int, standing: bool = False
) -> list[tuple[float, dict[str, float]]]:
    """Impulses [N s] and gains, the best first: the gains that there are, ``draws`` from the whole space, as many about the best so
    far. Both controllers get the same draws from the whole space; another ``first`` gives others. ``standing``: it
    only has to stand."""
    space, rng = SPACE[controller], np.random.default_rng(first)
    own = getattr(robot.settings.rival, controller.replace("-", "_"))
    start = {k: float(getattr(own, k)) for k in space} | gains(robot.mode, controller)
    found: list[tuple[float, dict[str, float]]] = [(0.0, start)]
    for k in range(1 + 2 * draws):
        tried = candidate(space, rng, found[0][1] if k > draws else None) if k else found.pop()[1]
        least = 0.5 * found[0][0] if found else 0.0
        agent = robot.agent(controller == "scheduled-lqr", tried)
        impulse = robot.impulse(agent, least, standing)
        found = sorted([*found, (impulse, tried)], key=lambda f: -f[0])
        if found[0][1] is tried:
            print(f"  {k} of {2 * draws}: {impulse:.3g} N s, {tried}", flush=True)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--modes", nargs="+", choices=list(MODES), default=["hand", "ball"])
    parser.add_argument("--only", nargs="+", choices=["lqr", "scheduled-lqr"], default=["lqr", "scheduled-lqr"])
    parser.add_argument("--draws", type=int, default=100, help="from the whole space, and as many about the best")
    parser.add_argument("--best", type=int, default=3, help="sets that are simulated")
    parser.add_argument("--first", type=int, default=0, help="of the random numbers: another search has others")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--standing", action="store_true", help="it need not come back")
    parser.add_argument("--write", action="store_true", help="the best gains into push_map_gains.json")
    parser.add_argument("--file", type=Path, default=Path("regulators.jsonl"))
    given = parser.parse_args()
    for mode in given.modes:
        task = f"standing-{mode}" if given.standing else f"map-{mode}"
        robot = ModelledRobot(mode)
        for controller in given.only:
            print(f"{mode} held, {controller}, on the model:", flush=True)
            found = search(robot, controller, given.draws, given.first, given.standing)
            store, best = Store(given.file), []
            for modelled, tried in found[: given.best]:
                simulated = -loss(store, task, controller, tried, given.seed)
                print(f"  {tried}: {simulated:.0f} N s simulated, {modelled:.0f} N s on the model", flush=True)
                best.append((simulated, tried))
            if given.write:
                write_gains(mode, controller, max(best or found, key=lambda f: f[0])[1])


if __name__ == "__main__":
    main()
