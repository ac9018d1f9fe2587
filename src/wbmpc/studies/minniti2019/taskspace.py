"""`rezero-taskspace`: an instantaneous task-space controller against the MPC on the hand's steps (the paper's main argument)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from wbmpc import lie
from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.defaults import rezero_mpc, set_home_references
from wbmpc.bases.ball.estimator import BallEstimator
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.ball.posture import resting
from wbmpc.experiments import Experiment
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Reference
from wbmpc.result import Metric, Plot, RunResult, Series
from wbmpc.settings import finished
from wbmpc.simulation.lockstep import Ending, Progress, Timing, part, run_lockstep
from wbmpc.studies.minniti2019.baselines import Controller, Parts, make_controller
from wbmpc.studies.minniti2019.steps import STEPS, target
from wbmpc.studies.minniti2019.task import (
    IDEALISATIONS,
    RezeroSettings,
    count_wheels,
    fault_metrics,
    hand_felt,
    record_rezero,
    robot_of,
)

NAME = "rezero-taskspace"
SUMMARY = "an instantaneous task-space controller against the MPC on the hand's steps (Minniti et al. 2019, section I)"
CONTROLLERS: tuple[Controller, ...] = ("mpc", "taskspace")
HERE = ["neither controller sees a step before it comes"]


class RezeroTaskspaceSettings(RezeroSettings):
    """``settle`` [s] at home, then the eight steps of `rezero-steps`, ``hold`` [s] each."""

    hold: float = Field(5.0, ge=1.0, le=600.0)
    settle: float = Field(4.0, ge=0.5, le=600.0)

    unused: ClassVar[tuple[str, ...]] = (*RezeroSettings.unused, "controller", "brace", "pushed_speed")

    def controllers(self) -> tuple[Controller, ...]:
        return CONTROLLERS


def goals(settings: RezeroTaskspaceSettings, robot: RobotModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (n,) [s] from which poses hold, positions (n, 3) [m], quaternions (n, 4)."""
    home = robot.pose(robot.home)
    poses = [home, *(target(step, *home) for step in STEPS)]
    times = np.array([0.0, *(settings.settle + settings.hold * np.arange(len(STEPS)))])
    return times, np.array([p for p, _ in poses]), np.array([q for _, q in poses])


def drive(
    name: str, settings: RezeroTaskspaceSettings, seed: int, log: Log, progress: Progress | None
) -> tuple[Ending, MPC, BallController]:
    """One controller over all steps; channels are CHANNEL_NAME (none if it ended before its first record)."""
    chosen = settings.model_copy(update={"controller": name})
    robot = robot_of(chosen)
    arm = robot.home[robot.state["arm"]]
    home, torque = robot.equilibrium(arm)
    mpc = rezero_mpc(robot, settings.mpc, settings.cost)
    set_home_references(mpc, robot, torque, home)
    plant = BallPlant(robot.description, home, torque, settings.plant, seed, payload=settings.payload)
    timing = Timing.of(plant.timestep, settings.control.rate, settings.mpc.rate, settings.mpc.delay)
    times, places, turns = goals(settings, robot)
    stances = [resting(robot, p, q) for p, q in zip(places, turns, strict=True)]
    now = lambda t: int(np.searchsorted(times, t + 1e-9, side="right")) - 1
    estimator = BallEstimator(robot, home) if settings.estimator == "filter" else None

    def ask(k: int) -> None:
        mpc.reference["hand"] = Reference.poses([0.0], places[k : k + 1], turns[k])
        mpc.reference["body"] = Reference.constant(stances[k])

    ask(0)
    agent, planner = make_controller(chosen, Parts(robot, mpc, torque, timing.period, estimator, arm))
    mpc.reset(home, torque)
    single = Log()

    def record(t: float, command: Any, plans: Any) -> None:
        ask(now(t + timing.delay * timing.period))
        record_rezero(single, t, plant, agent, command.torque)
        log.add(f"wanted_{name}", t, np.concatenate([places[now(t)], turns[now(t)]]))

    duration = times[-1] + settings.hold
    ending = run_lockstep(plant, agent, planner, timing, duration, record, progress)
    if not single.channels:
        return ending, mpc, agent
    for channel in ("state", "hand_quaternion", "tilt", "torque"):
        for t, row in zip(single.times(channel), single.array(channel), strict=True):
            log.add(f"{channel}_{name}", t, row)
    for t, row in zip(single.times("hand"), hand_felt(single), strict=True):
        log.add(f"hand_{name}", t, row)
    return ending, mpc, agent


def figures(log: Log, name: str) -> dict[str, float]:
    """Integral of the hand's position error [m s] (estimated frame), of its orientation error [rad s], of the squared torques'
    change against rest [(N m)² s], largest tilt [rad]."""
    t, wanted, torque = log.times(f"hand_{name}"), log.array(f"wanted_{name}"), log.array(f"torque_{name}")
    error = np.linalg.norm(log.array(f"hand_{name}") - wanted[:, :3], axis=1)
    turned = [
        np.linalg.norm(lie.quaternion_log(lie.quaternion_multiply(q, lie.quaternion_conjugate(w))))
        for q, w in zip(log.array(f"hand_quaternion_{name}"), wanted[:, 3:], strict=True)
    ]
    return {
        "position": float(np.trapezoid(error, t)),
        "orientation": float(np.trapezoid(turned, t)),
        "torque": float(np.trapezoid(np.sum((torque - torque[0]) ** 2, axis=1), t)),
        "tilt": float(log.array(f"tilt_{name}").max()),
    }


def run(settings: RezeroTaskspaceSettings, seed: int, progress: Progress | None = None) -> RunResult:
    """Both controllers, one after the other, on the same plant. How the rival ends is told, and is not the run's failure."""
    log, mpc, ending, faults = Log(), None, Ending(), list[str]()
    endings, agents = dict[str, Ending](), list[BallController]()
    for k, name in enumerate(CONTROLLERS):
        ended, made, agent = drive(name, settings, seed, log, part(progress, k, len(CONTROLLERS), name))
        endings[name], mpc = ended, made if name == "mpc" else mpc
        agents.append(agent)
        faults += [f"{name}: {fault}" for fault in agent.faults]
        if ended.interrupted or (ended.reason and name == "mpc"):
            ending = replace(ended, reason=f"{name}: {ended.reason}")
        elif ended.reason:
            faults.append(f"{name}: {ended.reason}; nothing is compared with it")
        if ended.interrupted:
            break
    assert mpc is not None
    return finished(
        NAME, seed, settings, ending, mpc, log, metrics=lambda: {**_metrics(log, endings), **fault_metrics(*agents)},
        plots=lambda: _plots(log), idealisations=[*HERE, *IDEALISATIONS], faults=faults,
    )  # fmt: skip


def _metrics(log: Log, endings: dict[str, Ending]) -> dict[str, Metric]:
    """Integrals of a controller that did not get to the end are infinite, and there is no ratio to it: the part before says
    nothing. (What the user ended has been integrated as far as it got.)"""
    done = {name: figures(log, name) for name in endings if f"hand_{name}" in log.channels}
    lost = {name for name, e in endings.items() if e.reason and not e.interrupted}
    whole = lambda name, value: np.inf if name in lost else value
    out = {f"hand_error_integral_{name}": Metric(whole(name, f["position"]), "m s") for name, f in done.items()}
    out |= {f"hand_turn_integral_{name}": Metric(whole(name, f["orientation"]), "rad s") for name, f in done.items()}
    if "taskspace" in endings:
        if not any(e.reason for e in endings.values()):
            out["torque_squared_ratio"] = Metric(done["taskspace"]["torque"] / done["mpc"]["torque"], "1")
        out["falls_taskspace"] = Metric(float(endings["taskspace"].fell), "1")
    out |= {f"tilt_max_{name}": Metric(f["tilt"], "rad") for name, f in done.items()}
    out["fell"] = Metric(float(endings["mpc"].fell), "1", goal=0.0)
    return out


def _plots(log: Log) -> list[Plot]:
    done = [n for n in CONTROLLERS if f"hand_{n}" in log.channels]
    t = {n: log.times(f"hand_{n}") for n in done}
    error = {n: np.linalg.norm(log.array(f"hand_{n}") - log.array(f"wanted_{n}")[:, :3], axis=1) for n in done}

    def wheels(name: str) -> np.ndarray:
        torque = log.array(f"torque_{name}")
        return np.abs(torque[:, : count_wheels(log.array(f"state_{name}"), torque)])

    return [
        Plot("Hand position error", "time [s]", "error [mm]", [Series(n, t[n], 1e3 * error[n]) for n in done]),
        *(
            Plot(f"Hand, {axis}", "time [s]", "position [m]", [
                *(Series(n, t[n], log.array(f"hand_{n}")[:, i]) for n in done),
                Series("asked", t[done[0]], log.array(f"wanted_{done[0]}")[:, i], dashed=True),
            ])
            for i, axis in enumerate("xyz")
        ),
        Plot("Tilt", "time [s]", "angle [deg]", [Series(n, t[n], np.rad2deg(log.array(f"tilt_{n}"))) for n in done]),
        Plot("Largest wheel torque", "time [s]", "torque [N m]", [
            Series(n, t[n], wheels(n).max(axis=1)) for n in done
        ]),
    ]  # fmt: skip


EXPERIMENT = Experiment(NAME, SUMMARY, RezeroTaskspaceSettings, run)
