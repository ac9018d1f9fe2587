"""Hand error and solve time of `swerve-track` over uniform and geometric grids of the same 10 s horizon.

Usage: python benchmarks/grids.py [--seed 200] [--periods 2] [--json FILE] [--png FILE]
Joint offsets are set to zero: they would hide the planner's part of the error. Everything else as in the experiment.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from wbmpc.experiments import REGISTRY

#: First interval [s] of the geometric grids, which is near the MPC's period; 0: uniform.
FIRST = 0.017
CASES = [(0.0, n) for n in (50, 100, 200, 400)] + [(FIRST, n) for n in (15, 20, 30, 50, 100)]


def run(first: float, intervals: int, seed: int, periods: int) -> dict[str, float | int | str]:
    """Mean and largest hand error [mm, estimated frame] and the median solve time [ms] of one run."""
    experiment = REGISTRY["swerve-track"]
    base = experiment.config_type()
    settings = base.model_copy(
        update={
            "periods": periods,
            "mpc": base.mpc.model_copy(update={"first_interval": first, "intervals": intervals}),
            "plant": base.plant.model_copy(update={"joint_offset": 0.0}),
        }
    )
    result = experiment.run(settings, seed, None)
    return {
        "grid": "geometric" if first else "uniform",
        "intervals": intervals,
        "error_mean_mm": 1e3 * result.metrics["hand_error_mean_odometry"].value,
        "error_max_mm": 1e3 * result.metrics["hand_error_max_odometry"].value,
        "solve_ms": result.mpc.solve_ms["median"],
    }


def draw(rows: list[dict], path: Path) -> None:
    """Error over solve time, both on logarithmic axes."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6, 4))
    for grid, marker in (("uniform", "o"), ("geometric", "s")):
        chosen = [r for r in rows if r["grid"] == grid]
        axes.loglog([r["solve_ms"] for r in chosen], [r["error_mean_mm"] for r in chosen], marker=marker, label=grid)
        for r in chosen:
            axes.annotate(
                f"N={r['intervals']}",
                (r["solve_ms"], r["error_mean_mm"]),
                fontsize=8,
                xytext=(4, 4),
                textcoords="offset points",
            )
    axes.set(xlabel="median solve time [ms]", ylabel="mean hand error [mm]", title="swerve-track, 10 s horizon")
    axes.grid(True, which="both", alpha=0.3)
    axes.legend()
    figure.tight_layout()
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
    if given.json is not None:
        given.json.write_text(json.dumps(rows, indent=2) + "\n")
    if given.png is not None:
        draw(rows, given.png)


if __name__ == "__main__":
    main()
