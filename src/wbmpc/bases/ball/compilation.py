"""The libraries of the ball robot's compiled steps."""

from __future__ import annotations

from wbmpc.kernel.library import Library
from wbmpc.solver.compilation import LIBRARY as DRIVER
from wbmpc.solver.feedback import LIBRARY as POLICY

_STEPS = (
    "disturbance", "inertial_gate_step", "filter_step", "filter_solve", "joint_tracker", "torque_limits", "sensor_faults", "sensor_step",
    "payload_step", "lean_control", "push",
)  # fmt: skip
_PACKAGES = ("bases/ball", "kernel", "constants.py")
LIBRARY = Library("ball robot", packages=_PACKAGES, modules=tuple(f"wbmpc.bases.ball.{m}" for m in _STEPS))
compiled, step = LIBRARY.compiled, LIBRARY.step
#: Steps that ask the model, which is the solver's, and policies: those of a robot that only estimates need no solver.
MODEL = Library(
    "ball robot with its model",
    packages=(*_PACKAGES, "solver"),
    modules=("wbmpc.bases.ball.model_steps",),
    uses=(LIBRARY, DRIVER, POLICY),
)
