"""Problems that tests and benchmarks share: small ones with known answers, and those of other toolboxes' examples.

``MAKERS`` names them; every maker returns a :class:`ZooProblem`.
"""

from collections.abc import Callable
from functools import partial

from wbmpc.zoo.ballbot import ballbot
from wbmpc.zoo.differential import differential_manipulator
from wbmpc.zoo.problem import Equations, Rows, ZooProblem
from wbmpc.zoo.small import cartpole, double_integrator
from wbmpc.zoo.swerve import swerve
from wbmpc.zoo.torque_arm import torque_arm

MAKERS: dict[str, Callable[..., ZooProblem]] = {
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
    "Equations",
    "Rows",
    "ZooProblem",
    "ballbot",
    "cartpole",
    "differential_manipulator",
    "double_integrator",
    "swerve",
    "torque_arm",
]
