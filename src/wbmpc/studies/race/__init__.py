"""Problems that tests and benchmarks share: small ones with known answers, and those of other toolboxes' examples.

``MAKERS`` names them; every maker returns a :class:`SampleProblem`.
"""

from collections.abc import Callable
from functools import partial

from wbmpc.benchmark.problems import SampleProblem
from wbmpc.studies.race.ballbot import ballbot
from wbmpc.studies.race.differential import differential_manipulator
from wbmpc.studies.race.small import cartpole, double_integrator
from wbmpc.studies.race.swerve import swerve
from wbmpc.studies.race.torque_arm import torque_arm

MAKERS: dict[str, Callable[..., SampleProblem]] = {
    "double-integrator": double_integrator,
    "cartpole": cartpole,
    "ballbot": ballbot,
    "differential-manipulator": differential_manipulator,
    "swerve-base": partial(swerve, arm=False),
    "swerve-arm": partial(swerve, arm=True),
    "swerve-brakes": partial(swerve, arm=True, brakes="events"),
    "torque-arm": torque_arm,
}

__all__ = [
    "MAKERS",
    "SampleProblem",
    "ballbot",
    "cartpole",
    "differential_manipulator",
    "double_integrator",
    "swerve",
    "torque_arm",
]
