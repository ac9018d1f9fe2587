"""What the weight of the end effector's twist does to a step of the ball robot's end effector: rise time against lean, torque and steady error.

Usage: python benchmarks/twist.py [--seeds 200-200] [--out FOLDER]. Goes on where it was interrupted. Minniti et al. 2019 (section
IV-B, at Fig. 4) say that a smaller penalty of the twist makes the end effector quicker. One step of 0.2 m and back with the protocol's
rigid drives and the weights of steps and pushes; linear and angular weights are scaled together.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from rates import STEP
from study import Figures, Kept, drawing

from wbmpc.reproduce import parse_seeds
from wbmpc.studies.minniti2019.frequency_settings import RezeroFrequencySettings

FACTORS = (0.1, 1.0, 10.0, 100.0)
PANELS = (
    ("rise_time_plain", 1.0, "rise time, 10 to 90 % [s]"),
    ("steady_error_plain", 1e3, "steady error of the end effector [mm]"),
    ("tilt_max_plain", 180.0 / np.pi, "largest tilt [deg]"),
)


def settings(factor: float) -> list[str]:
    """Of a run with the twist's weights times a factor."""
    end_effector = RezeroFrequencySettings().cost.end_effector
    return [f"cost.end_effector.{k}={factor * getattr(end_effector, k):g}" for k in ("twist", "angular")]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", default="200-200")
    parser.add_argument("--out", type=Path, default=Path("runs/twist"))
    given = parser.parse_args()
    kept, seeds = Kept(given.out / "twist.json"), parse_seeds(given.seeds)
    rows: list[list[Figures]] = []
    for factor in FACTORS:
        rows.append([kept.run("rezero-frequency", [*settings(factor), *STEP], seed) for seed in seeds])
        shown = ", ".join(f"{k} {s * np.median([r[k] for r in rows[-1]]):.3g}" for k, s, _ in PANELS)
        print(f"twist × {factor:g}: {shown}", flush=True)
    try:
        with drawing(given.out / "twist.png", len(PANELS)) as axes:
            for axis, (key, scale, title) in zip(axes, PANELS, strict=True):
                axis.semilogx(FACTORS, [scale * np.median([r[key] for r in row]) for row in rows], "o-")
                axis.set(title=title, xlabel="weight of the end effector's twist over the default", ylim=(0, None))
                axis.title.set_fontsize(9)
    except ImportError:
        print("matplotlib is not installed: no figure")


if __name__ == "__main__":
    main()
