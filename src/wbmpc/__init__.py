"""Whole-body model predictive control for mobile manipulators."""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_MODULES = {
    "load_robot": "wbmpc.model.robot",
    "RobotModel": "wbmpc.model.robot",
    "Layout": "wbmpc.model.layout",
    "DriveLag": "wbmpc.model.augment",
    "Ode": "wbmpc.model.ode",
    "FrequencyShaping": "wbmpc.model.augment",
    "InputFilter": "wbmpc.model.augment",
    "InputRate": "wbmpc.model.augment",
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
    "FilterMemory": "wbmpc.mpc.filters",
    "MPC": "wbmpc.mpc.mpc",
    "Observation": "wbmpc.types",
    "Policy": "wbmpc.mpc.policy",
    "RealTimeSettings": "wbmpc.runtime.safety",
    "WallClock": "wbmpc.runtime.clock",
    "RobotInterface": "wbmpc.runtime.runner",
    "RealTimeRunner": "wbmpc.runtime.runner",
    "InputError": "wbmpc.errors",
    "SolveFailed": "wbmpc.errors",
    "SolverBusy": "wbmpc.errors",
    "WbmpcError": "wbmpc.errors",
}
__all__ = ["__version__", *_MODULES]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first used, so that importing the package costs nothing."""
    if name not in _MODULES:
        raise AttributeError(f"module 'wbmpc' has no attribute '{name}'")
    module = import_module(_MODULES[name])
    return module if _MODULES[name].endswith(f".{name}") else getattr(module, name)


def __dir__() -> list[str]:
    return sorted(__all__)
