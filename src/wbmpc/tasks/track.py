"""`end-effector-track`: the end effector of any robot follows a path, the base goes where it is needed."""

from __future__ import annotations

from wbmpc.experiment import Experiment, Scenario
from wbmpc.tasks.definitions import DEFINITIONS
from wbmpc.tasks.following import PathTaskSettings, Task
from wbmpc.tasks.loop import Hooks, closed_loop


def build(settings: PathTaskSettings, seed: int) -> Scenario:
    """One run; errors count from when the path begins."""
    task = Task(settings)
    since = settings.settle_time
    hooks = Hooks(metrics=task.metrics)
    return closed_loop(task.robot, task.mpc, task.end, seed, settings, since=since, hooks=hooks, reshape=True)


EXPERIMENT = Experiment.of(
    "end-effector-track",
    "the end effector of any robot follows a path while its base drives",
    PathTaskSettings,
    build,
    DEFINITIONS,
)
