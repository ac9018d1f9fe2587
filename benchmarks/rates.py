"""What the MPC's rate does to the ball robot: push recovery and end effector error at 80, 200, 400 and 1000 Hz, in one figure.

Usage: python benchmarks/rates.py [--seeds 200-200] [--same-delay] [--out FOLDER]. Goes on where it was interrupted. The computation
takes one period (what a faster MPC is for); with ``--same-delay`` there is a second line with 10 ms, as in the protocol. Everything
else is the experiments' default but for the controller's rate, 1000 Hz where the MPC's is.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from study import Figures, Kept, drawing

from wbmpc.reproduce import parse_seeds
from wbmpc.studies.minniti2019.push_map import Point, bracket, measure

RATES = (80.0, 200.0, 400.0, 1000.0)
DELAYS = {"delay of one period": None, "same delay, 10 ms": 0.010}
#: One step of the end effector, 0.2 m and back, with the protocol's rigid drives.
STEP = (
    "variants=['plain']", "plant.wheel_spring=0", "plant.arm_spring=0", "plant.actuator_time_constant=0.02", "actuator_time_constant=0.02",
    "settle_time=1.5", "hold_time=3.5",
)  # fmt: skip
PUSHES = ("forces=[100, 200]", "settle_time=2", "pause=5")
#: Directions [rad] of the pushes of 0.2 s that are made stronger until the robot falls.
DIRECTIONS = np.deg2rad([45.0])


def settings(rate: float, delay: float | None) -> list[str]:
    control = 1000.0 if rate > 400.0 else 400.0
    return [
        f"mpc.rate={rate:g}",
        f"control.rate={control:g}",
        f"mpc.computation_delay={1.0 / rate if delay is None else delay:g}",
    ]


def limits(kept: Kept, given: list[str], seed: int) -> list[float]:
    """Impulses [N s] that the robot stands, by direction."""
    points = [Point("hand", float(d), 0.2, seed, tuple(given)) for d in DIRECTIONS]
    limit = lambda point: (bracket(measure(point, criteria=("stands",)), "stands") or (0.0, np.inf))[0]
    return [kept.get(p.key, lambda p=p: {"stands": limit(p)})["stands"] for p in points]


def measured(kept: Kept, rate: float, delay: float | None, seeds: list[int]) -> Figures:
    """Medians over the seeds."""
    given, rows = settings(rate, delay), []
    for seed in seeds:
        step = kept.run("rezero-frequency", [*given, *STEP], seed)
        pushes = kept.run("rezero-push-hand", [*given, *PUSHES], seed)
        rows.append({
            "steady": 1e3 * step["steady_error_plain"], "rise": step["rise_time_plain"],
            "pushed": 1e3 * pushes["hand_error_max"], "rms": 1e3 * pushes["hand_error_rms"],
            "tilt": np.rad2deg(pushes["tilt_max"]), "lost": pushes["not_recovered"], "solve": pushes["solve_ms"],
            "impulse": float(np.mean(limits(kept, given, seed))) if delay is None else np.nan,
        })  # fmt: skip
    return {k: float(np.median([r[k] for r in rows])) for k in rows[0]}


PANELS = (
    ("impulse", "impulse of 0.2 s that it stands [N s]\n(45°)"),
    ("pushed", "largest end effector error, pushes of 100 and 200 N [mm]"),
    ("rms", "rms end effector error in the same runs [mm]"),
    ("steady", "steady end effector error after a step of 0.2 m [mm]"),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", default="200-200")
    parser.add_argument("--same-delay", action="store_true")
    parser.add_argument("--out", type=Path, default=Path("runs/rates"))
    given = parser.parse_args()
    kept, seeds = Kept(given.out / "rates.json"), parse_seeds(given.seeds)
    found: dict[str, list[Figures]] = {}
    for name, delay in list(DELAYS.items())[: 2 if given.same_delay else 1]:
        found[name] = []
        for rate in RATES:
            row = measured(kept, rate, delay, seeds)
            found[name].append(row)
            print(f"{name}, {rate:4.0f} Hz: " + ", ".join(f"{k} {v:.3g}" for k, v in row.items()), flush=True)
    try:
        with drawing(given.out / "rates.png", len(PANELS)) as axes:
            for axis, (key, title) in zip(axes, PANELS, strict=True):
                for name, rows in found.items():
                    axis.semilogx(RATES, [r[key] for r in rows], "o-", label=name)
                top = np.nanmax([r[key] for rows in found.values() for r in rows])
                axis.set(title=title, xlabel="MPC rate [Hz]", ylim=(0, 1.15 * top))
                axis.title.set_fontsize(9)
                axis.set_xticks(RATES, [f"{r:g}" for r in RATES])
                axis.minorticks_off()
            axes[0].legend(fontsize=8, loc="lower left")
    except ImportError:
        print("matplotlib is not installed: no figure")


if __name__ == "__main__":
    main()
