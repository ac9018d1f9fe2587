"""Settings that experiments share. Every key can be set from the command line (``--set mpc.rate=100``)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, model_validator

from wbmpc.log import Log
from wbmpc.loop import Ending
from wbmpc.mpc import MPC
from wbmpc.plant.localisation import Localisation
from wbmpc.plant.perturbation import Perturbation
from wbmpc.result import Drawing, Metric, MpcStatistics, Plot, RunResult
from wbmpc.solver import SQP, InteriorPoint

Weight = Annotated[float, Field(ge=0)]


class Settings(BaseModel):
    """Base of all settings: unknown keys are errors, values are frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _no_truths(cls, data: Any) -> Any:
        """True and false (YAML: yes, on, no, off) are no numbers, though Python takes them for 1 and 0."""
        for name, value in data.items() if isinstance(data, dict) else ():
            field = cls.model_fields.get(name)
            kinds = () if field is None else (field.annotation, *get_args(field.annotation))
            if isinstance(value, bool) and field is not None and not {bool, Any} & set(kinds):
                raise ValueError(f"{name}: a number or text is needed, not true or false")
        return data

    def refuse_unread(self, where: str, *names: str) -> None:
        """Raise :class:`ValueError` for the first of the settings of these names that is not its default: nothing uses it
        ``where`` (such as "with legs=targets")."""
        for name in names:
            if getattr(self, name) != type(self).model_fields[name].default:
                raise ValueError(f"{name}: nothing uses it {where}")


class MpcSettings(Settings):
    """``rate`` [Hz]; ``horizon`` [s] with ``intervals``; ``first_interval`` [s] of a geometric grid (0: uniform);
    ``delay`` [s]: modelled computation time; ``iterations`` per update; ``limits``: by an interior
    point (hard) or relaxed barriers (soft), both with ``barrier_mu``; ``start_anew``: see
    :class:`wbmpc.solver.InteriorPoint`."""

    rate: float = Field(50.0, gt=0, ge=1e-3, le=10_000)
    horizon: float = Field(10.0, gt=0, le=1000)
    intervals: int = Field(50, ge=1, le=1000)
    first_interval: float = Field(0.017, ge=0, le=1000)
    delay: float = Field(0.010, ge=0, le=1.0)
    iterations: int = Field(1, ge=1, le=50)
    limits: Literal["hard", "soft"] = "hard"
    barrier_mu: float = Field(3e-3, gt=0, le=1e6)
    start_anew: bool = True

    def solver(self) -> SQP:
        """The solver's real-time settings."""
        interior_point = InteriorPoint("real_time", self.barrier_mu, start_anew=self.start_anew)
        return SQP.real_time(self.iterations, interior_point=interior_point)


class ControlSettings(Settings):
    """``rate`` [Hz] of the tracking controller."""

    rate: float = Field(400.0, gt=0, ge=1e-3, le=10_000)


class LocalisationSettings(Settings):
    """A source of global poses: ``rate`` [Hz], ``age`` [s] at delivery, noise of ``position`` [m] and ``yaw`` [rad]."""

    rate: float = Field(10.0, gt=0, le=1000)
    age: float = Field(0.050, ge=0, le=0.4)
    position: float = Field(0.005, gt=0, le=100)
    yaw: float = Field(0.002, gt=0, le=3.2)

    def source(self, seed: int) -> Localisation:
        """The simulated source."""
        return Localisation(self.rate, self.age, self.position, self.yaw, seed)


class ExperimentSettings(Settings):
    """What every experiment has."""

    mpc: MpcSettings = MpcSettings()
    control: ControlSettings = ControlSettings()
    plant: Perturbation = Perturbation()


def finished(
    name: str,
    seed: int,
    settings: ExperimentSettings,
    ending: Ending,
    mpc: MPC,
    log: Log,
    *,
    metrics: Callable[[], dict[str, Metric]],
    plots: Callable[[], Sequence[Plot | Drawing]],
    idealisations: list[str],
    faults: Sequence[str] = (),
) -> RunResult:
    """The result of a run however it ended, with the ``faults`` that it found in its robot. A run that ended before its first
    record has neither figures nor plots."""
    m = mpc.statistics
    statistics = MpcStatistics.of(mpc.rate, m.solve_times, m.solves, m.failures, m.no_step)
    reason = ending.reason or statistics.fault
    figures, drawn = (metrics(), list(plots())) if log.channels else ({}, [])
    return RunResult(
        name, seed, not reason, reason, figures, statistics, log, drawn, idealisations,
        settings.model_dump(mode="json"), ending.interrupted, list(faults),
    )  # fmt: skip
