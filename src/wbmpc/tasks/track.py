"""`end-effector-track`: the end effector of any robot follows a path, the base goes where it is needed."""

from __future__ import annotations

from wbmpc.experiment import Experiment, Scenario
from wbmpc.tasks.loop import closed_loop
from wbmpc.tasks.path_settings import AnyPath, Line, follow, timed
from wbmpc.tasks.settings import TaskSettings


class TrackSettings(TaskSettings):
    """``path``: a line, circle, sine, poses, or the table of a csv file."""

    path: AnyPath = Line()


def build(settings: TrackSettings, seed: int) -> Scenario:
    """One run; errors count from when the path begins."""
    robot, mpc = settings.prepare()
    path, start = settings.path, mpc.reference["end_effector"].at(0.0)
    curve = path.curve(robot, start[:3], start[3:])
    reference, end = timed(curve, path.speed, path.ramp, settings.settle_time)
    follow(robot, mpc, reference)
    return closed_loop(robot, mpc, end + 1.0, seed, settings, since=settings.settle_time)


EXPERIMENT = Experiment.of(
    "end-effector-track", "the end effector of any robot follows a path while its base drives", TrackSettings, build
)
