"""What `rezero-frequency` measures and draws."""

from __future__ import annotations

import numpy as np

from wbmpc.log import Log
from wbmpc.result import Metric, Plot, Series
from wbmpc.simulation.lockstep import Ending
from wbmpc.studies.minniti2019.frequency_settings import VARIANTS, RezeroFrequencySettings
from wbmpc.studies.minniti2019.metrics import count_wheels
from wbmpc.studies.minniti2019.step_figures import rise_time


def torque_error(log: Log, name: str) -> np.ndarray:
    """What acts minus what was asked for, (n, drives) [N m]."""
    return log.array(f"acting_{name}") - log.array(f"asked_{name}")


def metrics(settings: RezeroFrequencySettings, log: Log, endings: dict[str, Ending]) -> dict[str, Metric]:
    """Rms torque errors of wheels and arm, rise times, steady errors, by variant; ratios of those that got to the end: the part
    before says nothing to compare with."""
    out: dict[str, Metric] = {}
    lead = settings.controller.ahead if settings.preview else 0.0
    for name in (n for n in endings if f"hand_{n}" in log.channels):
        error = torque_error(log, name)
        wheels = count_wheels(log.array(f"state_{name}"), error)
        t, end_effector = log.times(f"hand_{name}"), log.array(f"hand_{name}")
        step = np.array(settings.step)
        start = settings.settle_time - lead
        window = (t >= start) & (t < start + settings.hold_time)
        done = (end_effector[window] - log.array(f"wanted_{name}")[0]) @ step / (step @ step)
        last = (t >= start + settings.hold_time - 1.0) & (t < start + settings.hold_time)
        steady = np.linalg.norm(end_effector[last] - log.array(f"wanted_{name}")[0] - step, axis=1)
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


def plots(log: Log) -> list[Plot]:
    done = [n for n in VARIANTS if f"hand_{n}" in log.channels]
    t = {n: log.times(f"hand_{n}") for n in done}
    target = log.array(f"wanted_{done[0]}")
    moved = int(np.argmax(np.ptp(target, axis=0)))
    lines = [Series(n, t[n], log.array(f"hand_{n}")[:, moved]) for n in done]
    commanded = log.array(f"asked_{done[0]}")
    count = count_wheels(log.array(f"state_{done[0]}"), commanded)
    wheel = int(np.argmax(np.ptp(commanded[:, :count], axis=0)))  # the one that works most
    wheels = [
        s
        for n in done
        for s in (
            Series(f"{n}, commanded", t[n], log.array(f"asked_{n}")[:, wheel], dashed=True),
            Series(n, t[n], log.array(f"acting_{n}")[:, wheel]),
        )
    ]
    errors = {n: torque_error(log, n) for n in done}
    frequency = {n: np.fft.rfftfreq(len(t[n]), float(np.median(np.diff(t[n])))) for n in done}
    band = {n: np.abs(np.fft.rfft(log.array(f"asked_{n}")[:, wheel])) / len(t[n]) for n in done}
    return [
        Plot(f"End effector, {'xyz'[moved]}", "time [s]", "position [m]", [
            *lines, Series("reference", t[done[0]], target[:, moved], dashed=True),
        ]),
        Plot(f"Torque of wheel {wheel}, commanded and applied", "time [s]", "torque [N m]", wheels),
        Plot(f"Torque error of wheel {wheel}", "time [s]", "torque [N m]", [Series(n, t[n], errors[n][:, wheel]) for n in done]),
        Plot("Torque error of the last arm joint", "time [s]", "torque [N m]", [
            Series(n, t[n], errors[n][:, -1]) for n in done
        ]),
        Plot(f"Commanded torque of wheel {wheel} over frequency", "frequency [Hz]", "amplitude [N m]", [
            Series(n, frequency[n][1:], band[n][1:]) for n in done
        ]),
        Plot("Tilt", "time [s]", "angle [°]", [Series(n, t[n], np.rad2deg(log.array(f"tilt_{n}"))) for n in done]),
    ]  # fmt: skip
