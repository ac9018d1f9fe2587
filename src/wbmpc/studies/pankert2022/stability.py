"""`swerve-stability`: support polygon and support triangles of H, X and A (Pankert et al. 2022, Table I, Fig. 2)."""

from __future__ import annotations

from functools import partial

from wbmpc.bases.swerve.configurations import CONFIGURATIONS
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.perturbation import SwervePerturbation
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.experiment import Experiment, Outcome, Part, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.result import Drawing, Metric
from wbmpc.settings import Robot, Settings
from wbmpc.simulation.lockstep import Progress, watched
from wbmpc.stability import Assessment, assess, draw
from wbmpc.studies.pankert2022.definitions import DEFINITIONS

NAME = "swerve-stability"
SUMMARY = "support polygon and triangles of H, X and A (Pankert et al. 2022, Table I)"

IDEALIZATIONS = [
    "pure geometry, no physics: wheels touch the ground in points under the steer axes",
    "the recording alone is of physics: the robot, as described, stands in each configuration with its brakes closed",
    "the paper gives no leg angles: 45 degrees for X, 0.498 rad inwards and 0.747 rad outwards for A reproduce its table",
]
#: Table I of the paper [m²]: support polygon, largest region in which two support triangles overlap.
TABLE = {"H": (1.16, 0.29), "X": (1.81, 0.45), "A": (1.17, 0.76)}
#: Half a unit of the table's last digit [m²].
ROUNDING = 0.005
#: How long the robot stands in each configuration for the recording [s], and how often its state is recorded [Hz].
STANDING, RATE = 1.0, 100


class SwerveStabilitySettings(Settings):
    """``robot``: with two front and two rear legs on hinges."""

    robot: Robot = "swerve-ur10"


def build(settings: SwerveStabilitySettings, seed: int) -> Scenario:
    """The areas of Table I from the robot's geometry. Nothing is random: the seed has no effect."""
    robot, log = load_robot(settings.robot), Log()
    found = {name: assess(robot, name) for name in CONFIGURATIONS}
    legs = robot.state.groups["leg"]
    log.label("leg", legs, robot.state.unit_groups["leg"])
    log.label("feet", [f"{axis}, {leg}" for leg in legs for axis in "xy"], "m")
    for k, a in enumerate(found.values()):
        log.add("leg", float(k), a.x[robot.state["leg"]])
        log.add("feet", float(k), a.stance.feet.ravel())
        log.add("zero_moment_point", float(k), a.stance.zmp)
    return Scenario(
        log, [Part(name, partial(_stand, robot, a)) for name, a in found.items()], lambda run: _metrics(found),
        lambda run: [Drawing(f"Configuration {n}", draw(a)) for n, a in found.items()], IDEALIZATIONS,
    )  # fmt: skip


def _stand(robot: RobotModel, assessment: Assessment, progress: Progress | None) -> Outcome:
    """For who watches: the robot at rest in a configuration."""
    plant = SwervePlant(robot.description, robot.state.split(assessment.x), SwervePerturbation.none())
    stop = SwerveCommand.stop(swerve_base(robot).geometry.modules, len(robot.input.groups["arm"]))
    with watched(plant, 1.0 / RATE, STANDING, progress) as tick:
        for k in range(round(STANDING * RATE)):
            tick(k / RATE, stop)
            plant.step(stop, round(1.0 / (RATE * plant.timestep)))
    return Outcome()


def _metrics(found: dict[str, Assessment]) -> dict[str, Metric]:
    metrics = {}
    for column, kind in enumerate(("support_polygon_area", "double_support_area")):
        for name, a in found.items():
            value, paper = (a.polygon_area, a.double_support_area)[column], TABLE[name][column]
            metrics[f"{kind}_{name}"] = Metric(value, "m2", paper=paper, goal=paper + ROUNDING, least=paper - ROUNDING)
    return metrics


EXPERIMENT = Experiment.of(NAME, SUMMARY, SwerveStabilitySettings, build, DEFINITIONS[NAME])
