"""Problems that tests and benchmarks share: small ones with known answers, and those of other toolboxes' examples.

``MAKERS`` names them; every maker returns a :class:`TestProblem`.
"""

from collections.abc import Callable
from functools import partial

from wbmpc.benchmark.test_problems.ballbot import ballbot
from wbmpc.benchmark.test_problems.differential import differential_manipulator
from wbmpc.benchmark.test_problems.problem import TestProblem
from wbmpc.benchmark.test_problems.small import cartpole, double_integrator
from wbmpc.benchmark.test_problems.swerve import swerve
from wbmpc.benchmark.test_problems.torque_arm import torque_arm

MAKERS: dict[str, Callable[..., TestProblem]] = {
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
    "TestProblem",
    "ballbot",
    "cartpole",
    "differential_manipulator",
    "double_integrator",
    "swerve",
    "torque_arm",
]
