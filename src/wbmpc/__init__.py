"""Whole-body model predictive control for mobile manipulators."""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_PLACES = {
    "load_robot": "wbmpc.model",
    "RobotModel": "wbmpc.model",
    "Layout": "wbmpc.model",
    "DriveLag": "wbmpc.model",
    "Equations": "wbmpc.model",
    "FrequencyShaping": "wbmpc.model",
    "InputFilter": "wbmpc.model",
    "InputRate": "wbmpc.model",
    "Constraint": "wbmpc.ocp",
    "Cost": "wbmpc.ocp",
    "Mode": "wbmpc.ocp",
    "ModeSchedule": "wbmpc.ocp",
    "OptimalControlProblem": "wbmpc.ocp",
    "Reference": "wbmpc.ocp",
    "RelaxedBarrier": "wbmpc.ocp",
    "SmoothL1": "wbmpc.ocp",
    "frequency_aware": "wbmpc.ocp",
    "residuals": "wbmpc.ocp",
    "sets": "wbmpc.ocp",
    "AugmentedLagrangian": "wbmpc.ocp",
    "ILQR": "wbmpc.solver",
    "InteriorPoint": "wbmpc.solver",
    "SLQ": "wbmpc.solver",
    "SQP": "wbmpc.solver",
    "Solver": "wbmpc.solver",
    "Solution": "wbmpc.solver",
    "Status": "wbmpc.solver",
    "FilterMemory": "wbmpc.mpc",
    "MPC": "wbmpc.mpc",
    "Observation": "wbmpc.mpc",
    "Policy": "wbmpc.mpc",
    "RealTime": "wbmpc.mpc",
    "WallClock": "wbmpc.mpc",
    "RobotInterface": "wbmpc.mpc",
    "Runner": "wbmpc.mpc",
    "InputError": "wbmpc.errors",
    "SolveFailed": "wbmpc.errors",
    "SolverBusy": "wbmpc.errors",
    "WbmpcError": "wbmpc.errors",
}
__all__ = ["__version__", *_PLACES]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first used, so that importing the package costs nothing."""
    if name not in _PLACES:
        raise AttributeError(f"module 'wbmpc' has no attribute '{name}'")
    module = import_module(_PLACES[name])
    return module if _PLACES[name].endswith(f".{name}") else getattr(module, name)


def __dir__() -> list[str]:
    return sorted(__all__)
