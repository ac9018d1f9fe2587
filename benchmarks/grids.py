"""End effector error and solve time of `swerve-track` over uniform and geometric grids of the same 10 s horizon.

Usage: python benchmarks/grids.py [--seed 200] [--periods 2] [--json FILE] [--png FILE]
Joint offsets are set to zero: they would hide the planner's part of the error. Everything else as in the experiment. Times are the
quickest tenth of the solves, so that other programs on the machine hardly count.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

from wbmpc.registry import REGISTRY

#: First interval [s] of the geometric grids, which is near the MPC's period; 0: uniform.
FIRST = 0.017
CASES = [(0.0, n) for n in (50, 100, 200, 400)] + [(FIRST, n) for n in (15, 20, 30, 50, 100)]


def run(first: float, intervals: int, seed: int, periods: int) -> dict[str, float | int | str]:
    """Mean and largest end effector error [mm, estimated frame] and the median solve time [ms] of one run."""
    experiment = REGISTRY["swerve-track"]
    base = experiment.config_type()
    settings = base.model_copy(
        update={
            "periods": periods,
            "settle_time": 2.0,
            "mpc": base.mpc.model_copy(update={"first_interval": first, "intervals": intervals}),
            "plant": base.plant.model_copy(update={"joint_offset": 0.0}),
        }
    )
    result = experiment.run(settings, seed, None)
    times = next(p for p in result.plots if p.title == "Solve times").series[0]
    return {
        "grid": "geometric" if first else "uniform",
        "intervals": intervals,
        "error_mean_mm": 1e3 * result.metrics["hand_error_mean_odometry"].value,
        "error_max_mm": 1e3 * result.metrics["hand_error_max_odometry"].value,
        "solve_ms": float(np.percentile(times.y, 10)),
    }


def gain(rows: list[dict]) -> str:
    """How much sooner the quickest geometric grid is done that tracks as well as the best uniform one (within 2 %)."""
    uniform, geometric = ([r for r in rows if r["grid"] == g] for g in ("uniform", "geometric"))
    best = min(uniform, key=lambda r: r["error_mean_mm"])
    equal = [r for r in geometric if r["error_mean_mm"] <= 1.02 * best["error_mean_mm"]]
    if not equal:
        return f"no geometric grid tracks as well as the uniform one of {best['intervals']} intervals"
    least = min(equal, key=lambda r: r["solve_ms"])
    return (
        f"{best['solve_ms'] / least['solve_ms']:.1f} times less time at equal error: {least['intervals']} geometric intervals, "
        f"{least['error_mean_mm']:.3f} mm in {least['solve_ms']:.2f} ms; {best['intervals']} uniform ones, "
        f"{best['error_mean_mm']:.3f} mm in {best['solve_ms']:.2f} ms"
    )


def draw(rows: list[dict], path: Path) -> None:
    """Error over solve time, both on logarithmic axes."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import FixedLocator, NullFormatter, ScalarFormatter

    figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
    for grid, marker in (("uniform", "o"), ("geometric", "s")):
        chosen = [r for r in rows if r["grid"] == grid]
        axes.loglog([r["solve_ms"] for r in chosen], [r["error_mean_mm"] for r in chosen], marker=marker, label=grid)
        for r in chosen:
            axes.annotate(
                f"N={r['intervals']}",
                (r["solve_ms"], r["error_mean_mm"]),
                fontsize=8,
                xytext=(0, 7 if grid == "geometric" else -14),
                ha="center",
                textcoords="offset points",
            )
    axes.set(
        xlabel="time of a solve, quickest tenth [ms]",
        ylabel="mean end effector error [mm]",
        title="swerve-track, 10 s horizon",
    )
    for axis, ticks in ((axes.xaxis, (0.1, 0.2, 0.5, 1, 2, 5, 10)), (axes.yaxis, (0.3, 0.4, 0.5, 0.7, 1, 1.5, 2, 3))):
        axis.set_major_locator(FixedLocator(ticks))
        axis.set_major_formatter(ScalarFormatter())
        axis.set_minor_formatter(NullFormatter())
    axes.margins(0.12, 0.15)
    axes.grid(True, which="both", alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=200)
    parser.add_argument("--periods", type=int, default=2)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--png", type=Path)
    given = parser.parse_args()
    print(f"{'grid':10s}{'N':>6s}{'mean [mm]':>12s}{'max [mm]':>12s}{'solve [ms]':>12s}")
    rows = []
    for first, intervals in CASES:
        print(f"N = {intervals} …", file=sys.stderr, end="\r", flush=True)
        row = run(first, intervals, given.seed, given.periods)
        rows.append(row)
        print(
            f"{row['grid']:10s}{row['intervals']:6d}{row['error_mean_mm']:12.3f}{row['error_max_mm']:12.3f}{row['solve_ms']:12.3f}"
        )
    print(gain(rows))
    if given.json is not None:
        given.json.write_text(json.dumps(rows, indent=2) + "\n")
    if given.png is not None:
        draw(rows, given.png)


if __name__ == "__main__":
    main()
