"""`rezero-steps`: the ball robot takes steps of the end effector's pose with its base free (Minniti et al. 2019, Fig. 4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from pydantic import Field, model_validator

from wbmpc.bases.ball.posture import resting
from wbmpc.experiment import Experiment, Scenario
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Reference
from wbmpc.studies.minniti2019.definitions import DEFINITIONS
from wbmpc.studies.minniti2019.settings import ControlledSettings
from wbmpc.studies.minniti2019.step_figures import metrics, plots
from wbmpc.studies.minniti2019.step_goals import IMPOSSIBLE, STEADY, STEPS, target
from wbmpc.studies.minniti2019.task import Task, ball_robot, task_scenario
from wbmpc.types import Timing

NAME = "rezero-steps"
SUMMARY = "the ball robot takes steps of the end effector's pose, base free (Minniti et al. 2019, Fig. 4)"

IDEALIZATIONS = ["with preview=true the MPC sees a step coming one horizon ahead, and leaves for it early"]
#: A move takes at least so long [s].
MOVING = 0.5


class RezeroStepsSettings(ControlledSettings):
    """``settle_time`` [s]: time at home before the steps; ``hold_time`` [s]: time for which each step is held; ``final_hold_time`` [s]:
    time at home after the steps.

    ``preview``: whether the MPC sees a step before it comes.
    """

    hold_time: float = Field(5.0, ge=STEADY + MOVING, le=600.0)
    settle_time: float = Field(5.0, ge=0.5, le=600.0)
    final_hold_time: float = Field(10.0, ge=0.0, le=600.0)
    preview: bool = False

    @property
    def lead(self) -> float:
        """How long before a goal the robot may start towards it [s]."""
        return self.controller.ahead if self.preview else 0.0

    @model_validator(mode="after")
    def _windows(self) -> Self:
        minimum = STEADY + max(self.lead, MOVING)
        way_out = "; a smaller controller.plan.horizon or preview=false needs less" if self.lead > MOVING else ""
        if self.hold_time < minimum - 1e-9:
            raise ValueError(
                f"hold_time={self.hold_time:g}: a step needs {minimum:g} s, {STEADY:g} s to be judged and before that the preview "
                f"(controller.plan.horizon) or {MOVING:g} s to move{way_out}"
            )
        if self.settle_time < self.lead - 1e-9:
            raise ValueError(
                f"settle_time={self.settle_time:g}: at least the preview of {self.lead:g} s (controller.plan.horizon) is needed{way_out}"
            )
        return self


@dataclass(frozen=True)
class Schedule:
    """Home for ``settle_time``, the steps one after another, the impossible one, home again: times and poses that hold."""

    times: np.ndarray
    positions: np.ndarray
    quaternions: np.ndarray
    duration: float

    @classmethod
    def of(cls, settings: RezeroStepsSettings, robot: RobotModel) -> Schedule:
        home = robot.pose(robot.home)
        poses = [home, *(target(s, *home) for s in (*STEPS, IMPOSSIBLE)), home]
        times = [0.0, *(settings.settle_time + settings.hold_time * np.arange(len(STEPS) + 2))]
        duration = times[-1] + settings.final_hold_time
        return cls(np.array(times), np.array([p for p, _ in poses]), np.array([q for _, q in poses]), duration)

    def reference(self) -> Reference:
        return Reference.poses(self.times, self.positions, self.quaternions, hold=True)

    def body(self, robot: RobotModel) -> Reference:
        """How the robot rests with its end effector in these poses: so that a weight on the arm's posture moves no end effector."""
        states = [resting(robot, p, q) for p, q in zip(self.positions, self.quaternions, strict=True)]
        return Reference(self.times, np.array(states), "hold")

    def at(self, t: float) -> int:
        return int(np.searchsorted(self.times, t + 1e-9, side="right")) - 1


def build(settings: RezeroStepsSettings, seed: int) -> Scenario:
    """One run over all steps."""
    robot = ball_robot(settings)
    schedule = Schedule.of(settings, robot)
    body = schedule.body(robot)

    shown = -1

    def hide_future(mpc: MPC, timing: Timing, t: float) -> None:
        """Without preview the present target holds for the whole horizon."""
        nonlocal shown
        i = schedule.at(t + timing.delay * timing.period)
        if i == shown:
            return
        shown = i
        mpc.reference["end_effector"] = Reference.poses([0.0], schedule.positions[i : i + 1], schedule.quaternions[i])
        mpc.reference["body"] = Reference.constant(body.values[i])

    references = {"end_effector": schedule.reference(), "body": body}
    return task_scenario(
        settings, seed,
        Task(robot.home[robot.state["arm"]], schedule.duration, references),
        lambda log, ending: metrics(log, schedule, settings, ending.fell), lambda log: plots(log, schedule, robot),
        IDEALIZATIONS, None if settings.preview else hide_future,
    )  # fmt: skip


EXPERIMENT = Experiment.of(NAME, SUMMARY, RezeroStepsSettings, build, DEFINITIONS[NAME])
