"""`rezero-taskspace`: an instantaneous task-space controller against the MPC on the end effector's steps (the paper's main argument)."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from pydantic import Field

from wbmpc.bases.ball.posture import resting
from wbmpc.experiment import Experiment, Outcome, Part, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.ocp import Reference
from wbmpc.simulation.lockstep import Progress
from wbmpc.studies.minniti2019.controller_settings import TaskspaceSettings, TrackedMpc
from wbmpc.studies.minniti2019.definitions import DEFINITIONS
from wbmpc.studies.minniti2019.metrics import append_as, fault_metrics
from wbmpc.studies.minniti2019.settings import RezeroSettings
from wbmpc.studies.minniti2019.step_goals import STEPS, target
from wbmpc.studies.minniti2019.task import IDEALIZATIONS, RezeroRecord, ball_system, robot_of
from wbmpc.studies.minniti2019.taskspace_figures import CONTROLLERS, metrics, plots

NAME = "rezero-taskspace"
SUMMARY = "an instantaneous task-space controller against the MPC on the end effector's steps (Minniti et al. 2019, section I)"
HERE = ["neither controller sees a step before it comes"]


class RezeroTaskspaceSettings(RezeroSettings):
    """``settle_time`` [s]: time at home before the task; ``hold_time`` [s]: of each of the eight steps of `rezero-steps`, which follow;
    ``controller``: the MPC; ``taskspace``: the task-space controller."""

    hold_time: float = Field(5.0, ge=1.0, le=600.0)
    settle_time: float = Field(4.0, ge=0.5, le=600.0)
    controller: TrackedMpc = TrackedMpc()
    taskspace: TaskspaceSettings = TaskspaceSettings()


def goals(settings: RezeroTaskspaceSettings, robot: RobotModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (n,) [s] from which poses hold, positions (n, 3) [m], quaternions (n, 4)."""
    home = robot.pose(robot.home)
    poses = [home, *(target(step, *home) for step in STEPS)]
    times = np.array([0.0, *(settings.settle_time + settings.hold_time * np.arange(len(STEPS)))])
    return times, np.array([p for p, _ in poses]), np.array([q for _, q in poses])


def drive(
    name: str, settings: RezeroTaskspaceSettings, seed: int, log: Log, progress: Progress | None = None
) -> Outcome:
    """One controller over all steps; channels are CHANNEL_NAME (none if it ended before its first record)."""
    chosen = settings.controller if name == "mpc" else settings.taskspace
    robot = robot_of(settings, chosen)
    times, places, turns = goals(settings, robot)
    stances = [resting(robot, p, q) for p, q in zip(places, turns, strict=True)]
    now = lambda t: int(np.searchsorted(times, t + 1e-9, side="right")) - 1
    references = lambda k: {
        "end_effector": Reference.poses([0.0], places[k : k + 1], turns[k]), "body": Reference.constant(stances[k]),
    }  # fmt: skip
    system = ball_system(settings, chosen, seed, robot.home[robot.state["arm"]], references(0))
    single, timing = Log(), system.timing
    rows = RezeroRecord(single, system.plant, system.controller)
    log.label(f"wanted_{name}", ("x", "y", "z", "qw", "qx", "qy", "qz"), [*"mmm", *"1111"])

    def record(t: float, command: Any, plans: Any) -> None:
        for term, reference in references(now(t + timing.delay * timing.period)).items():
            system.mpc.reference[term] = reference
        rows.add(t, command.torque)
        log.add(f"wanted_{name}", t, np.concatenate([places[now(t)], turns[now(t)]]))

    outcome = system.loop(times[-1] + settings.hold_time, record).run(progress)
    append_as(single, log, name, ("state", "hand_quaternion", "tilt", "torque"))
    return replace(outcome, mpc=system.mpc if name == "mpc" else None)


def build(settings: RezeroTaskspaceSettings, seed: int) -> Scenario:
    """Both controllers, one after the other, on the same plant. A baseline that ends early does not fail the run."""
    log = Log()
    return Scenario(
        log, [Part(n, partial(drive, n, settings, seed, log), baseline=n != "mpc") for n in CONTROLLERS],
        lambda run: {**metrics(log, run.outcomes), **fault_metrics(*(o.controller for o in run.outcomes.values()))},
        lambda run: plots(log), [*HERE, *IDEALIZATIONS], compared=True,
    )  # fmt: skip


EXPERIMENT = Experiment.of(NAME, SUMMARY, RezeroTaskspaceSettings, build, DEFINITIONS[NAME])
