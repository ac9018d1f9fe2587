"""A robot, a plan or a run in three dimensions inside a notebook: an object that Jupyter shows, without a network."""

from __future__ import annotations

import html

import numpy as np
from numpy.typing import ArrayLike

from wbmpc.checks import real_numbers
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.policy import Policy
from wbmpc.plots.motion import Motion, picture_points
from wbmpc.report.replay import inline
from wbmpc.result import RunResult
from wbmpc.robots.frames import BASE, frame_names
from wbmpc.simulation.model_picture import ModelPicture
from wbmpc.simulation.scene import SceneReader
from wbmpc.solver.solution import Solution


class Picture3D:
    """What :func:`show` returns: the last expression of a notebook's cell shows it. ``motion``: the pictures that it plays;
    ``title``: what a prompt says of it."""

    def __init__(self, motion: Motion, title: str) -> None:
        self.motion, self.title = motion, title

    def __repr__(self) -> str:
        return f"Picture3D({self.title}; a notebook shows it)"

    def _repr_html_(self) -> str:
        page = html.escape(inline(self.motion))
        return f'<iframe srcdoc="{page}" title="{html.escape(self.title)}" style="width:100%;height:440px;border:0"></iframe>'


def show(
    what: RobotModel | RunResult, states: Solution | Policy | ArrayLike | None = None, times: ArrayLike | None = None
) -> Picture3D:
    """A 3D picture for notebooks: of a recorded run, or of a robot.

    ``states``: of a robot, where it is: a state (nx), by default its home; or states (n, nx) at ``times`` (n,) [s], which it plays
    (left out: one per second); or a :class:`~wbmpc.solver.solution.Solution` or :class:`~wbmpc.mpc.policy.Policy` with its own times.
    States may be longer than the robot's: what wrappers add stands at their end. Raises :class:`InputError` for a run without
    pictures, shorter states, and times that do not rise.
    """
    if isinstance(what, RunResult):
        if what.motion is None or not any(part.times for part in what.motion.parts):
            raise InputError(f"show: {what!r} holds no pictures: it was not recorded; valid: a run with a recording")
        return Picture3D(what.motion, f"{what.experiment}, seed {what.seed}")
    plan = states if isinstance(states, Solution | Policy) else None
    given = what.home if states is None else states if plan is None else plan.x
    rows = np.atleast_2d(real_numbers("states", given))
    times = times if plan is None else plan.times
    at = np.arange(len(rows), dtype=float) if times is None else np.atleast_1d(real_numbers("times", times))
    if rows.ndim != 2 or rows.shape[1] < what.state.size or not np.isfinite(rows).all():
        raise InputError(f"show: finite states (n, {what.state.size}) of {what!r} are needed, got shape {rows.shape}")
    if at.shape != (len(rows),) or not (np.diff(at) > 0.0).all():
        raise InputError(f"show: times ({len(rows)},) that rise are needed, one for each state, got shape {at.shape}")
    return Picture3D(_pictures(what, rows[:, : what.state.size], at), what.description.name)


def _pictures(robot: RobotModel, states: np.ndarray, times: np.ndarray) -> Motion:
    picture, motion = ModelPicture(robot), Motion(period=0.0)
    model = picture.world.model
    names = frame_names(robot.description.base.body, [model.body(i).name for i in range(1, model.nbody)])
    reader = SceneReader(model, BASE, names)
    motion.begin("", reader.scene.plain())
    lift = np.array([0.0, 0.0, -robot.base.ground])
    for t, x, tool in zip(times, states, robot.poses(states), strict=True):
        picture.arrange(x)
        motion.add(float(t), reader.poses(picture.world.data), picture_points(tool[:3] + lift, None, ()))
    return motion
