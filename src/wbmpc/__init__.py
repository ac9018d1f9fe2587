"""Whole-body model predictive control for mobile manipulators."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # what type checkers see; a test compares it with the table below
    from wbmpc.bases import base_type as base_type
    from wbmpc.bases.base import Base as Base
    from wbmpc.bases.base import BaseDescription as BaseDescription
    from wbmpc.bases.base import BaseType as BaseType
    from wbmpc.bases.base import Reshaping as Reshaping
    from wbmpc.bases.base import System as System
    from wbmpc.bases.footprint import Footprint as Footprint
    from wbmpc.clearance.lattice import plan_route as plan_route
    from wbmpc.control.protocols import Controller as Controller
    from wbmpc.control.protocols import Fault as Fault
    from wbmpc.control.protocols import Monitor as Monitor
    from wbmpc.control.protocols import RobotController as RobotController
    from wbmpc.default_problem import DefaultCost as DefaultCost
    from wbmpc.default_problem import default_mpc as default_mpc
    from wbmpc.default_problem import default_mpc_settings as default_mpc_settings
    from wbmpc.embedded.exporter import export as export
    from wbmpc.errors import InputError as InputError
    from wbmpc.errors import NoRoute as NoRoute
    from wbmpc.errors import SolveFailed as SolveFailed
    from wbmpc.errors import SolverBusy as SolverBusy
    from wbmpc.errors import WbmpcError as WbmpcError
    from wbmpc.estimation.offset import OffsetObserver as OffsetObserver
    from wbmpc.experiment import Experiment as Experiment
    from wbmpc.experiment import Loop as Loop
    from wbmpc.experiment import Scenario as Scenario
    from wbmpc.log import Log as Log
    from wbmpc.mapping import LocalMap as LocalMap
    from wbmpc.mapping import distance_grid as distance_grid
    from wbmpc.model.augment import DriveLag as DriveLag
    from wbmpc.model.augment import FrequencyShaping as FrequencyShaping
    from wbmpc.model.augment import InputFilter as InputFilter
    from wbmpc.model.augment import InputRate as InputRate
    from wbmpc.model.augment import WithPath as WithPath
    from wbmpc.model.joints import Limits as Limits
    from wbmpc.model.joints import joint_home as joint_home
    from wbmpc.model.joints import joint_limits as joint_limits
    from wbmpc.model.kinematics import Chain as Chain
    from wbmpc.model.kinematics import FramePose as FramePose
    from wbmpc.model.layout import Layout as Layout
    from wbmpc.model.ode import Ode as Ode
    from wbmpc.model.robot import RobotModel as RobotModel
    from wbmpc.model.robot import load_robot as load_robot
    from wbmpc.model.tree import read_tree as read_tree
    from wbmpc.mpc.alternatives import Alternatives as Alternatives
    from wbmpc.mpc.filters import FilterMemory as FilterMemory
    from wbmpc.mpc.mpc import MPC as MPC
    from wbmpc.mpc.policy import Policy as Policy
    from wbmpc.mpc.policy_queue import PolicyQueue as PolicyQueue
    from wbmpc.mpc.reference_pacing import PacedReferences as PacedReferences
    from wbmpc.mpc.route import follow_route as follow_route
    from wbmpc.obstacles import Obstacles as Obstacles
    from wbmpc.obstacles import shapes as shapes
    from wbmpc.ocp import AugmentedLagrangian as AugmentedLagrangian
    from wbmpc.ocp import Constraint as Constraint
    from wbmpc.ocp import Cost as Cost
    from wbmpc.ocp import Mode as Mode
    from wbmpc.ocp import ModeSchedule as ModeSchedule
    from wbmpc.ocp import OptimalControlProblem as OptimalControlProblem
    from wbmpc.ocp import Path as Path
    from wbmpc.ocp import Reference as Reference
    from wbmpc.ocp import RelaxedBarrier as RelaxedBarrier
    from wbmpc.ocp import SmoothL1 as SmoothL1
    from wbmpc.ocp import add_progress as add_progress
    from wbmpc.ocp import frequency_aware as frequency_aware
    from wbmpc.ocp import path_problem as path_problem
    from wbmpc.ocp import residuals as residuals
    from wbmpc.ocp import sets as sets
    from wbmpc.recording.reader import Recording as Recording
    from wbmpc.recording.reader import read_recording as read_recording
    from wbmpc.recording.recorder import Recorder as Recorder
    from wbmpc.result import Metric as Metric
    from wbmpc.result import Plot as Plot
    from wbmpc.result import RunResult as RunResult
    from wbmpc.result import Series as Series
    from wbmpc.robots import RobotDescription as RobotDescription
    from wbmpc.robots import load_spec as load_spec
    from wbmpc.ros2 import open_node as open_node
    from wbmpc.runtime.clock import VirtualClock as VirtualClock
    from wbmpc.runtime.clock import WallClock as WallClock
    from wbmpc.runtime.runner import RealTimeRunner as RealTimeRunner
    from wbmpc.runtime.safety import RealTimeSettings as RealTimeSettings
    from wbmpc.runtime.shared_memory import Sizes as Sizes
    from wbmpc.runtime.stop_control import RobotInterface as RobotInterface
    from wbmpc.simulation.inline import show as show
    from wbmpc.simulation.lockstep import Watch as Watch
    from wbmpc.simulation.lockstep import run_lockstep as run_lockstep
    from wbmpc.simulation.perturbation import Perturbation as Perturbation
    from wbmpc.solver import ILQR as ILQR
    from wbmpc.solver import SLQ as SLQ
    from wbmpc.solver import SQP as SQP
    from wbmpc.solver import InteriorPoint as InteriorPoint
    from wbmpc.solver import Solution as Solution
    from wbmpc.solver import Solver as Solver
    from wbmpc.solver import Status as Status
    from wbmpc.solver import Trajectory as Trajectory
    from wbmpc.study.study import Study as Study
    from wbmpc.tasks.loop import Hooks as Hooks
    from wbmpc.tasks.loop import Surroundings as Surroundings
    from wbmpc.tasks.loop import closed_loop as closed_loop
    from wbmpc.tasks.settings import SimulationSettings as SimulationSettings
    from wbmpc.tasks.settings import TaskSettings as TaskSettings
    from wbmpc.tasks.simulation import simulate as simulate
    from wbmpc.types import Edit as Edit
    from wbmpc.types import Observation as Observation
    from wbmpc.types import SimulatedRobot as SimulatedRobot
    from wbmpc.types import Timing as Timing
    from wbmpc.types import Truth as Truth

__version__ = "0.2.0"

#: Public names by the module that has them.
_NAMES = {
    "wbmpc.bases": "base_type",
    "wbmpc.bases.base": "Base BaseDescription BaseType Reshaping System",
    "wbmpc.bases.footprint": "Footprint",
    "wbmpc.clearance.lattice": "plan_route",
    "wbmpc.control.protocols": "Controller Fault Monitor RobotController",
    "wbmpc.default_problem": "DefaultCost default_mpc default_mpc_settings",
    "wbmpc.embedded.exporter": "export",
    "wbmpc.errors": "InputError NoRoute SolveFailed SolverBusy WbmpcError",
    "wbmpc.estimation.offset": "OffsetObserver",
    "wbmpc.experiment": "Experiment Loop Scenario",
    "wbmpc.log": "Log",
    "wbmpc.mapping": "LocalMap distance_grid",
    "wbmpc.model.augment": "DriveLag FrequencyShaping InputFilter InputRate WithPath",
    "wbmpc.model.joints": "Limits joint_home joint_limits",
    "wbmpc.model.kinematics": "Chain FramePose",
    "wbmpc.model.layout": "Layout",
    "wbmpc.model.ode": "Ode",
    "wbmpc.model.robot": "RobotModel load_robot",
    "wbmpc.model.tree": "read_tree",
    "wbmpc.mpc.alternatives": "Alternatives",
    "wbmpc.mpc.filters": "FilterMemory",
    "wbmpc.mpc.mpc": "MPC",
    "wbmpc.mpc.reference_pacing": "PacedReferences",
    "wbmpc.mpc.policy": "Policy",
    "wbmpc.mpc.policy_queue": "PolicyQueue",
    "wbmpc.mpc.route": "follow_route",
    "wbmpc.obstacles": "Obstacles shapes",
    "wbmpc.ocp": (
        "AugmentedLagrangian Constraint Cost Mode ModeSchedule OptimalControlProblem Path Reference RelaxedBarrier "
        "SmoothL1 add_progress frequency_aware path_problem residuals sets"
    ),
    "wbmpc.recording.reader": "Recording read_recording",
    "wbmpc.recording.recorder": "Recorder",
    "wbmpc.result": "Metric Plot RunResult Series",
    "wbmpc.robots": "RobotDescription load_spec",
    "wbmpc.ros2": "open_node",
    "wbmpc.runtime.clock": "VirtualClock WallClock",
    "wbmpc.runtime.runner": "RealTimeRunner",
    "wbmpc.runtime.safety": "RealTimeSettings",
    "wbmpc.runtime.shared_memory": "Sizes",
    "wbmpc.runtime.stop_control": "RobotInterface",
    "wbmpc.simulation.inline": "show",
    "wbmpc.simulation.lockstep": "Watch run_lockstep",
    "wbmpc.simulation.perturbation": "Perturbation",
    "wbmpc.solver": "ILQR InteriorPoint SLQ SQP Solution Solver Status Trajectory",
    "wbmpc.study.study": "Study",
    "wbmpc.tasks.loop": "Hooks Surroundings closed_loop",
    "wbmpc.tasks.settings": "SimulationSettings TaskSettings",
    "wbmpc.tasks.simulation": "simulate",
    "wbmpc.types": "Edit Observation SimulatedRobot Timing Truth",
}
_MODULES = {name: module for module, names in _NAMES.items() for name in names.split()}
__all__ = ["__version__", *_MODULES]


if not TYPE_CHECKING:  # a type checker knows the names above, and no other

    def __getattr__(name: str) -> Any:
        """Load a public name when it is first used, so that importing the package costs nothing."""
        if name not in _MODULES:
            from wbmpc.errors import did_you_mean

            raise AttributeError(f"module 'wbmpc' has no attribute '{name}'{did_you_mean(name, _MODULES)}")
        module = import_module(_MODULES[name])
        found = module if _MODULES[name].endswith(f".{name}") else getattr(module, name)
        if isinstance(found, type) and hasattr(found, "model_rebuild"):
            found.model_rebuild()  # settings get their signature, which help() shows, when they are used
        return found


def __dir__() -> list[str]:
    return sorted(__all__)
