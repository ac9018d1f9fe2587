"""`rezero-frequency`: torque tracking of elastic drives, plain and frequency-aware (Minniti et al. 2019, section III-D)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.defaults import RezeroCost, rezero_problem, set_home_references
from wbmpc.bases.ball.estimator import BallEstimator
from wbmpc.bases.ball.fall_detection import FallPredictor
from wbmpc.bases.ball.frequency import FrequencyAwareController
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.ball.posture import resting
from wbmpc.bases.ball.settings import STEPS_AND_PUSHES
from wbmpc.experiments import Experiment
from wbmpc.log import Log
from wbmpc.model.augment import InputFilter
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Reference, frequency_aware
from wbmpc.result import Metric, Plot, RunResult, Series
from wbmpc.settings import Settings, Weight, finished
from wbmpc.simulation.lockstep import Ending, Progress, Timing, part, run_lockstep
from wbmpc.simulation.perturbation import Perturbation
from wbmpc.studies.minniti2019.steps import rise_time
from wbmpc.studies.minniti2019.task import (
    IDEALISATIONS,
    RezeroSettings,
    ball_robot,
    count_wheels,
    fault_metrics,
    hand_felt,
    record_rezero,
)

NAME = "rezero-frequency"
SUMMARY = "torque tracking of elastic drives with and without frequency-aware MPC (Minniti et al. 2019, section III-D)"
VARIANTS = ("plain", "shaped")
#: Shorter steps [m] are not told from the hand's noise.
LEAST_STEP = 0.01
HERE = [
    "springs, rotors and torque loops are assumed (not published), and the model of the controller does not know them; rotors "
    "do not react on the housing (1 / gear ratio of the torque); encoders sit at the joints' side of the springs",
    "a wheel whose spring pulls more than its traction slips without inertia of its own, and its encoder reads the ball's turning",
    "the computation takes a constant 10 ms",
]
#: Springs that resonate at 15 Hz with the freely rolling ball, and at 18 to 31 Hz with the arm; they take the place of the lag.
ELASTIC = Perturbation(wheel_spring=40.0, arm_spring=300.0, drive_lag=0.0)


class FilterSettings(Settings):
    """ν = (pole / zero) (s + zero) / (s + pole) u in rad/s for wheels and arm; ``wheel_weight`` and ``arm_weight``: factors of the
    torques' weights with the filter, so that the hand rises as fast as without."""

    wheel_zero: float = Field(20.0, gt=0)
    wheel_pole: float = Field(160.0, gt=0)
    arm_zero: float = Field(20.0, gt=0)
    arm_pole: float = Field(160.0, gt=0)
    wheel_weight: Weight = 1.0
    arm_weight: Weight = 1.0


class RezeroFrequencySettings(RezeroSettings):
    """``step`` (3) [m] of the hand and back, ``settle`` [s] before it, ``hold`` [s] of each; ``filters`` of the shaped variant;
    ``preview``: whether the MPC sees the step before it comes; ``variants`` that are run."""

    plant: Perturbation = ELASTIC
    cost: RezeroCost = STEPS_AND_PUSHES
    drive_lag: float = Field(0.006, ge=0, le=0.5)
    filters: FilterSettings = FilterSettings()
    step: tuple[float, float, float] = (0.2, 0.0, 0.0)
    settle: float = Field(3.0, ge=0.5, le=60.0)
    hold: float = Field(5.0, ge=1.0, le=60.0)
    preview: bool = True
    variants: tuple[str, ...] = VARIANTS

    unused: ClassVar[tuple[str, ...]] = (
        *RezeroSettings.unused, "controller", "rival", "tracking", "weigh", "brace", "pushed_speed", "drive_dead_time",
    )  # fmt: skip

    def idle(self) -> dict[str, str]:
        filters = [f"filters.{name}" for name in FilterSettings.model_fields]
        return super().idle() | ({} if "shaped" in self.variants else dict.fromkeys(filters, "variants=[plain]"))

    @field_validator("step")
    @classmethod
    def _somewhere(cls, value: tuple[float, float, float]) -> tuple[float, float, float]:
        length = float(np.linalg.norm(value))
        if not LEAST_STEP <= length <= 1.0:
            raise ValueError(f"a step of {LEAST_STEP:g} to 1 m is needed: its rise is measured")
        return value

    @model_validator(mode="after")
    def _rest_before(self) -> Self:
        if self.preview and self.settle < self.mpc.horizon:
            raise ValueError(
                f"settle: {self.settle:g} s before a step that is seen {self.mpc.horizon:g} s ahead (mpc.horizon): at least "
                "as long, or preview=false"
            )
        return self

    @field_validator("variants")
    @classmethod
    def _known(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        if not value or not set(value) <= set(VARIANTS) or len(set(value)) < len(value):
            raise ValueError(f"valid: some of {', '.join(VARIANTS)}, each once")
        return value


def frequency_mpc(settings: RezeroFrequencySettings, shaped: bool) -> MPC:
    """The MPC of the ball robot, with or without filters on its torques."""
    f, cost, robot = settings.filters, settings.cost, ball_robot(settings)
    if not shaped:
        return MPC(rezero_problem(robot, settings.mpc, cost), settings.mpc.solver(), settings.mpc.rate)
    torque = cost.torque.model_copy(
        update={"wheel": f.wheel_weight * cost.torque.wheel, "arm": f.arm_weight * cost.torque.arm}
    )
    plain = rezero_problem(robot, settings.mpc, cost.model_copy(update={"torque": torque}))
    filters = {"wheel": InputFilter(f.wheel_zero, f.wheel_pole), "arm": InputFilter(f.arm_zero, f.arm_pole)}
    return MPC(frequency_aware(plain, filters), settings.mpc.solver(), settings.mpc.rate)


def drive(
    name: str, settings: RezeroFrequencySettings, seed: int, log: Log, progress: Progress | None
) -> tuple[Ending, MPC, BallController]:
    """One variant over the step and back; channels are CHANNEL_NAME (none if it ended before its first record)."""
    robot = ball_robot(settings)
    home, torque = robot.equilibrium(robot.home[robot.state["arm"]])
    mpc = frequency_mpc(settings, name == "shaped")
    set_home_references(mpc, robot, torque, home)
    position, quaternion = robot.pose(home)
    times = np.array([0.0, settings.settle, settings.settle + settings.hold])
    places = np.array([position, position + settings.step, position])
    mpc.reference["hand"] = Reference.poses(times, places, quaternion, hold=True)
    rest = [home, resting(robot, places[1], quaternion), home]
    mpc.reference["body"] = Reference(times, np.array(rest), "hold")
    plant = BallPlant(robot.description, home, torque, settings.plant, seed, payload=settings.payload)
    timing = Timing.of(plant.timestep, settings.control.rate, settings.mpc.rate, settings.mpc.delay)
    estimator = BallEstimator(robot, home) if settings.estimator == "filter" else None
    own = (
        timing.period,
        settings.drive_lag,
        settings.observer,
        estimator,
        FallPredictor(robot, robot.home[robot.state["arm"]]),
    )
    agent: BallController
    if name == "shaped":
        agent = FrequencyAwareController(robot, mpc, torque, *own)
        mpc.reset(*agent.memory.dynamics.equilibrium(home, torque))
    else:
        agent = BallController(robot, mpc, torque, *own)
        mpc.reset(home, torque)
    single, asked = Log(), torque.copy()

    def record(t: float, command: Any, plans: Any) -> None:
        k = int(np.searchsorted(times, t + 1e-9, side="right")) - 1
        if not settings.preview:
            ahead = int(np.searchsorted(times, t + timing.delay * timing.period + 1e-9, side="right")) - 1
            mpc.reference["hand"] = Reference.poses([0.0], places[ahead : ahead + 1], quaternion)
            mpc.reference["body"] = Reference.constant(rest[ahead])
        log.add(f"acting_{name}", t, plant.torque)
        log.add(f"asked_{name}", t, asked.copy())  # the command before this one, which has acted until now
        asked[:] = command.torque
        log.add(f"wanted_{name}", t, places[k])
        record_rezero(single, t, plant, agent, command.torque)

    ending = run_lockstep(plant, agent, mpc, timing, float(times[-1]) + settings.hold, record, progress)
    if not single.channels:
        return ending, mpc, agent
    for channel in ("state", "tilt", "torque"):
        for t, row in zip(single.times(channel), single.array(channel), strict=True):
            log.add(f"{channel}_{name}", t, row)
    for t, row in zip(single.times("hand"), hand_felt(single), strict=True):
        log.add(f"hand_{name}", t, row)
    return ending, mpc, agent


def run(settings: RezeroFrequencySettings, seed: int, progress: Progress | None = None) -> RunResult:
    """Both variants, one after the other, on the same plant. The first that ends early, or the one that the user ends, gives the
    reason, with its name."""
    log, endings, ending, mpc, agents = Log(), dict[str, Ending](), Ending(), None, dict[str, BallController]()
    for k, name in enumerate(settings.variants):
        ended, mpc, agents[name] = drive(name, settings, seed, log, part(progress, k, len(settings.variants), name))
        endings[name] = ended
        if ended.interrupted or (ended.reason and not ending.reason):
            ending = replace(ended, reason=f"{name}: {ended.reason}")
        if ended.interrupted:
            break
    assert mpc is not None
    return finished(
        NAME, seed, settings, ending, mpc, log,
        metrics=lambda: {**metrics(settings, log, endings), **fault_metrics(*agents.values())}, plots=lambda: _plots(log),
        idealisations=[*HERE, *IDEALISATIONS[:3]], faults=[f"{name}: {fault}" for name, a in agents.items() for fault in a.faults],
    )  # fmt: skip


def torque_error(log: Log, name: str) -> np.ndarray:
    """What acts minus what was asked for, (n, drives) [N m]."""
    return log.array(f"acting_{name}") - log.array(f"asked_{name}")


def metrics(settings: RezeroFrequencySettings, log: Log, endings: dict[str, Ending]) -> dict[str, Metric]:
    """Rms torque errors of wheels and arm, rise times, steady errors, by variant; ratios of those that got to the end: the part
    before says nothing to compare with."""
    out: dict[str, Metric] = {}
    lead = settings.mpc.horizon if settings.preview else 0.0
    for name in (n for n in endings if f"hand_{n}" in log.channels):
        error = torque_error(log, name)
        wheels = count_wheels(log.array(f"state_{name}"), error)
        t, hand = log.times(f"hand_{name}"), log.array(f"hand_{name}")
        step = np.array(settings.step)
        start = settings.settle - lead
        window = (t >= start) & (t < start + settings.hold)
        done = (hand[window] - log.array(f"wanted_{name}")[0]) @ step / (step @ step)
        last = (t >= start + settings.hold - 1.0) & (t < start + settings.hold)
        steady = np.linalg.norm(hand[last] - log.array(f"wanted_{name}")[0] - step, axis=1)
        squares = lambda part: float(np.sqrt(np.mean(np.sum(part**2, axis=1) / part.shape[1])))
        out |= {
            f"torque_error_rms_{name}": Metric(squares(error[:, :wheels]), "N m"),
            f"arm_torque_error_rms_{name}": Metric(squares(error[:, wheels:]), "N m"),
            f"rise_time_{name}": Metric(rise_time(t[window], done), "s"),
            f"steady_error_{name}": Metric(float(steady.mean()) if steady.size else float("inf"), "m"),
            f"tilt_max_{name}": Metric(float(log.array(f"tilt_{name}").max()), "rad"),
            f"fell_{name}": Metric(float(endings[name].fell), "1", goal=0.0),
        }
    if len(endings) == len(VARIANTS) and not any(e.reason for e in endings.values()):
        ratio = lambda key: out[f"{key}_shaped"].value / out[f"{key}_plain"].value
        out["torque_error_ratio"] = Metric(ratio("torque_error_rms"), "1", goal=0.5)
        out["rise_time_ratio"] = Metric(ratio("rise_time"), "1", goal=1.05, least=0.95)
    return out


def _plots(log: Log) -> list[Plot]:
    done = [n for n in VARIANTS if f"hand_{n}" in log.channels]
    t = {n: log.times(f"hand_{n}") for n in done}
    wanted = log.array(f"wanted_{done[0]}")
    moved = int(np.argmax(np.ptp(wanted, axis=0)))
    lines = [Series(n, t[n], log.array(f"hand_{n}")[:, moved]) for n in done]
    asked = log.array(f"asked_{done[0]}")
    count = count_wheels(log.array(f"state_{done[0]}"), asked)
    wheel = int(np.argmax(np.ptp(asked[:, :count], axis=0)))  # the one that works most
    wheels = [
        s
        for n in done
        for s in (
            Series(f"{n}: asked", t[n], log.array(f"asked_{n}")[:, wheel], dashed=True),
            Series(f"{n}: acting", t[n], log.array(f"acting_{n}")[:, wheel]),
        )
    ]
    errors = {n: torque_error(log, n) for n in done}
    frequency = {n: np.fft.rfftfreq(len(t[n]), float(np.median(np.diff(t[n])))) for n in done}
    band = {n: np.abs(np.fft.rfft(log.array(f"asked_{n}")[:, wheel])) / len(t[n]) for n in done}
    return [
        Plot(f"Hand, {'xyz'[moved]}", "time [s]", "position [m]", [
            *lines, Series("asked", t[done[0]], wanted[:, moved], dashed=True),
        ]),
        Plot(f"Torque of wheel {wheel}, asked and acting", "time [s]", "torque [N m]", wheels),
        Plot(f"Torque error of wheel {wheel}", "time [s]", "torque [N m]", [Series(n, t[n], errors[n][:, wheel]) for n in done]),
        Plot("Torque error of the last arm joint", "time [s]", "torque [N m]", [
            Series(n, t[n], errors[n][:, -1]) for n in done
        ]),
        Plot(f"Asked torque of wheel {wheel} over frequency", "frequency [Hz]", "amplitude [N m]", [
            Series(n, frequency[n][1:], band[n][1:]) for n in done
        ]),
        Plot("Tilt", "time [s]", "angle [deg]", [Series(n, t[n], np.rad2deg(log.array(f"tilt_{n}"))) for n in done]),
    ]  # fmt: skip


EXPERIMENT = Experiment(NAME, SUMMARY, RezeroFrequencySettings, run)
