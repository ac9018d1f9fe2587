"""`rezero-door`: the ball robot pushes a door open with a target force (Minniti et al. 2019, section IV-D, Fig. 8 and 9)."""

from __future__ import annotations

from functools import partial

from wbmpc.experiment import Experiment, Outcome, Part, Scenario
from wbmpc.log import Log
from wbmpc.simulation.lockstep import Progress
from wbmpc.studies.minniti2019.definitions import DEFINITIONS
from wbmpc.studies.minniti2019.door_figures import Trial, door_plots, metrics, worst_estimates
from wbmpc.studies.minniti2019.door_settings import FORCE_GOAL, RezeroDoorSettings
from wbmpc.studies.minniti2019.door_trial import push_door
from wbmpc.studies.minniti2019.task import IDEALIZATIONS

NAME = "rezero-door"
SUMMARY = "the ball robot pushes a door open with a target force (Minniti et al. 2019, Fig. 8 and 9)"
LABELS = ("low", "high")
HERE = [
    "the door's hinge is where it is believed to be within door_position_error and door_spread; the closed panel's place is learned from the "
    "touch, the hinge from the end effector's way",
    "the panel's edges and the door's frame have no contact but with the panel's box",
    "the force sensor has noise of 0.1 N and a bias of 0.1 N for each axis; it stands between end effector and tip",
    "the closer's torque is constant, dry friction is Coulomb's",
]


def build(settings: RezeroDoorSettings, seed: int) -> Scenario:
    """A run for each force, weakest first; a fall ends it."""
    trials: list[Trial] = []

    def push(force: float, progress: Progress | None) -> Outcome:
        trials.append(push_door(settings, force, settings.speed, seed, progress))
        log.extend(trials[-1].log, f"_{names[len(trials) - 1]}")
        return Outcome(trials[-1].ending, trials[-1].faults, None, trials[-1].mpc)

    names, log = LABELS[-len(settings.forces) :], Log()
    return Scenario(
        log, [Part(f"{force:g} N", partial(push, force)) for force in sorted(settings.forces)],
        lambda run: {**metrics(trials, names, FORCE_GOAL.get(settings.door, 0.08)), **worst_estimates(trials)},
        lambda run: [plot for name, t in zip(names, trials, strict=False) for plot in door_plots(name, t, settings)],
        [*HERE, *IDEALIZATIONS],
    )  # fmt: skip


EXPERIMENT = Experiment.of(NAME, SUMMARY, RezeroDoorSettings, build, DEFINITIONS[NAME])
