"""`rezero-frequency`: torque tracking of elastic drives, plain and frequency-aware (Minniti et al. 2019, section III-D)."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.defaults import rezero_problem, set_home_references
from wbmpc.bases.ball.fall_detection import FallPredictor
from wbmpc.bases.ball.model import ball_base
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.ball.posture import resting
from wbmpc.bases.ball.sent_torques import DriveSettings
from wbmpc.experiment import Experiment, Loop, Outcome, Part, Scenario
from wbmpc.log import Log
from wbmpc.model.augment import InputFilter
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Reference, frequency_aware
from wbmpc.settings import Nothing
from wbmpc.simulation.lockstep import Progress
from wbmpc.studies.minniti2019.definitions import DEFINITIONS
from wbmpc.studies.minniti2019.frequency_control import FrequencyAwareController
from wbmpc.studies.minniti2019.frequency_figures import metrics, plots
from wbmpc.studies.minniti2019.frequency_settings import RezeroFrequencySettings
from wbmpc.studies.minniti2019.metrics import append_as, fault_metrics
from wbmpc.studies.minniti2019.task import IDEALIZATIONS, RezeroRecord, ball_robot, estimator_of
from wbmpc.types import Timing

NAME = "rezero-frequency"
SUMMARY = "torque tracking of elastic drives with and without frequency-aware MPC (Minniti et al. 2019, section III-D)"
HERE = [
    "springs, rotors and torque loops are assumed (not published), and the model of the controller does not know them; rotors "
    "do not react on the housing (1 / gear ratio of the torque); encoders sit at the joints' side of the springs",
    "a wheel whose spring pulls more than its traction slips without inertia of its own, and its encoder reads the ball's turning",
    "the computation takes a constant 10 ms",
]


def frequency_mpc(settings: RezeroFrequencySettings, shaped: bool) -> MPC:
    """The MPC of the ball robot, with or without filters on its torques."""
    f, cost, robot = settings.shaped, settings.controller.weights, ball_robot(settings)
    planning = settings.controller.planning(settings.mpc)
    if not shaped or isinstance(f, Nothing):
        return MPC(rezero_problem(robot, planning, cost), planning.solver(), planning.rate)
    torque = cost.torque.model_copy(
        update={"wheel": f.wheel_weight * cost.torque.wheel, "arm": f.arm_weight * cost.torque.arm}
    )
    plain = rezero_problem(robot, planning, cost.model_copy(update={"torque": torque}))
    filters = {"wheel": InputFilter(f.wheel_zero, f.wheel_pole), "arm": InputFilter(f.arm_zero, f.arm_pole)}
    return MPC(frequency_aware(plain, filters), planning.solver(), planning.rate)


def drive(
    name: str, settings: RezeroFrequencySettings, seed: int, log: Log, progress: Progress | None = None
) -> Outcome:
    """One variant over the step and back; channels are CHANNEL_NAME (none if it ended before its first record)."""
    robot = ball_robot(settings)
    home, torque = ball_base(robot).numeric.equilibrium(robot.home[robot.state["arm"]])
    mpc = frequency_mpc(settings, name == "shaped")
    set_home_references(mpc, robot, torque, home)
    position, quaternion = robot.pose(home)
    times = np.array([0.0, settings.settle_time, settings.settle_time + settings.hold_time])
    places = np.array([position, position + settings.step, position])
    mpc.reference["end_effector"] = Reference.poses(times, places, quaternion, hold=True)
    rest = [home, resting(robot, places[1], quaternion), home]
    mpc.reference["body"] = Reference(times, np.array(rest), "hold")
    plant = BallPlant(robot.description, home, torque, settings.perturbation, seed, payload=settings.payload)
    timing = Timing.of(plant.timestep, settings.control.rate, settings.mpc.rate, settings.mpc.computation_delay)
    own = (
        timing.period, DriveSettings(settings.actuator_time_constant), settings.controller.learns,
        estimator_of(settings.controller, robot, home), FallPredictor(robot, robot.home[robot.state["arm"]]),
    )  # fmt: skip
    controller: BallController
    if name == "shaped":
        controller = FrequencyAwareController(robot, mpc, torque, *own)
        mpc.reset(*controller.memory.dynamics.equilibrium(home, torque))
    else:
        controller = BallController(robot, mpc, torque, *own)
        mpc.reset(home, torque)
    single, target = Log(), torque.copy()
    rows = RezeroRecord(single, plant, controller)
    for channel in (f"acting_{name}", f"asked_{name}"):
        log.label(channel, [*robot.input.groups["wheel"], *robot.input.groups["arm"]], "N m")
    log.label(f"wanted_{name}", "xyz", "m")

    def record(t: float, command: Any, plans: Any) -> None:
        k = int(np.searchsorted(times, t + 1e-9, side="right")) - 1
        if not settings.preview:
            ahead = int(np.searchsorted(times, t + timing.delay * timing.period + 1e-9, side="right")) - 1
            mpc.reference["end_effector"] = Reference.poses([0.0], places[ahead : ahead + 1], quaternion)
            mpc.reference["body"] = Reference.constant(rest[ahead])
        log.add(f"acting_{name}", t, plant.torque)
        log.add(f"asked_{name}", t, target.copy())  # the command before this one, which has acted until now
        target[:] = command.torque
        log.add(f"wanted_{name}", t, places[k])
        rows.add(t, command.torque)

    outcome = Loop(plant, controller, mpc, timing, float(times[-1]) + settings.hold_time, record).run(progress)
    append_as(single, log, name, ("state", "tilt", "torque"))
    return outcome


def build(settings: RezeroFrequencySettings, seed: int) -> Scenario:
    """Both variants, one after the other, on the same plant. The first that ends early, or the one that the user ends, gives the
    reason, with its name."""
    log = Log()
    return Scenario(
        log, [Part(name, partial(drive, name, settings, seed, log)) for name in settings.variants],
        lambda run: {
            **metrics(settings, log, {name: o.ending for name, o in run.outcomes.items()}),
            **fault_metrics(*(o.controller for o in run.outcomes.values())),
        },
        lambda run: plots(log), [*HERE, *IDEALIZATIONS[:3]], compared=True,
    )  # fmt: skip


EXPERIMENT = Experiment.of(NAME, SUMMARY, RezeroFrequencySettings, build, DEFINITIONS[NAME])
