"""Torque tracking of elastic drives against how fast the end effector is: heavier torques (plain) and filters (frequency-aware).

Usage: python benchmarks/frequency.py [--seeds 200-202] [--out FOLDER]. Goes on where it was interrupted.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from study import Figures, Kept, drawing

from wbmpc.configuration import configure
from wbmpc.registry import REGISTRY
from wbmpc.reproduce import parse_seeds
from wbmpc.studies.minniti2019.frequency_figures import torque_error
from wbmpc.studies.minniti2019.frequency_settings import RezeroFrequencySettings

NAME = "rezero-frequency"
PLAIN = (1.0, 3.0, 10.0, 30.0)
SHAPED = ((5.0, 8.0), (20.0, 2.0), (20.0, 4.0), (20.0, 8.0), (20.0, 16.0))


def variants() -> dict[str, dict[str, list[str]]]:
    """Settings by curve and label."""
    cost = RezeroFrequencySettings().cost.torque
    plain = {
        f"× {w:g}": [
            f"cost.torque.wheel={w * cost.wheel:g}", f"cost.torque.arm={w * cost.arm:g}", "variants=['plain']",
        ]
        for w in PLAIN
    }  # fmt: skip
    shaped = {}
    for zero, ratio in SHAPED:
        groups = [
            f"filters.{g}_{k}={v:g}" for g in ("wheel", "arm") for k, v in (("zero", zero), ("pole", zero * ratio))
        ]
        shaped[f"{zero:g}, {zero * ratio:g}"] = [*groups, "variants=['shaped']"]
    return {"plain": plain, "shaped": shaped}


def median(runs: list[Figures], key: str) -> float:
    return float(np.median([r[key] for r in runs]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", default="200-202")
    parser.add_argument("--out", type=Path, default=Path("runs/frequency"))
    given = parser.parse_args()
    kept, seeds = Kept(given.out / "frequency.json"), parse_seeds(given.seeds)
    found: dict[str, dict[str, list[Figures]]] = {}
    for curve, settings in variants().items():
        found[curve] = {label: [kept.run(NAME, s, seed) for seed in seeds] for label, s in settings.items()}
        for label, runs in found[curve].items():
            wheel, arm = (1e3 * median(runs, f"{k}torque_error_rms_{curve}") for k in ("", "arm_"))
            rise, tilt = median(runs, f"rise_time_{curve}"), median(runs, f"tilt_max_{curve}")
            print(
                f"{curve:7s} {label:9s} wheels {wheel:6.1f} mN m, arm {arm:6.1f} mN m, rise {rise:.3f} s, tilt {tilt:.3f} rad"
            )
    try:
        draw(found, seeds[0], given.out / "frequency.png")
    except ImportError:
        print("matplotlib is not installed: no figure")


def draw(found: dict[str, dict[str, list[Figures]]], seed: int, path: Path) -> None:
    """The trade-off, and one run of each variant: torque of a wheel and its error."""
    names = {"plain": "plain, torque weights × 1 to 30", "shaped": "frequency-aware, zero and pole in rad/s"}
    log = REGISTRY[NAME].run(configure(RezeroFrequencySettings, [], NAME), seed, None).log
    wheel = int(np.argmax(np.ptp(log.array("asked_plain")[:, :3], axis=0)))
    with drawing(path, 3) as (trade, torque, error):
        for curve, by in found.items():
            rise = [median(runs, f"rise_time_{curve}") for runs in by.values()]
            rms = [1e3 * median(runs, f"torque_error_rms_{curve}") for runs in by.values()]
            trade.plot(rise, rms, "o" if curve == "shaped" else "s-", label=names[curve])
            for label, x, y in zip(by, rise, rms, strict=True):
                trade.annotate(label, (x, y), xytext=(6, -2), textcoords="offset points", fontsize=7)
        trade.set(
            xlabel="rise time of the end effector [s]", ylabel="rms torque error of the wheels [mN m]", ylim=(0, None)
        )
        trade.legend(fontsize=7)
        for name in ("plain", "shaped"):
            t = log.times(f"asked_{name}")
            window = (t > 1.5) & (t < 4.5)
            torque.plot(t[window], log.array(f"acting_{name}")[window, wheel], linewidth=0.9, label=name)
            error.plot(t[window], 1e3 * torque_error(log, name)[window, wheel], linewidth=0.7, label=name)
        torque.set(xlabel="time [s]", ylabel=f"acting torque of wheel {wheel} [N m]")
        error.set(xlabel="time [s]", ylabel="its error [mN m]")
        torque.legend(fontsize=8)


if __name__ == "__main__":
    main()
