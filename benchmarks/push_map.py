"""The push map of the ball robot: impulse at which it falls, over directions and lengths. Goes on where it was interrupted.

Usage: python benchmarks/push_map.py [--modes hand ball] [--directions 16] [--lengths 0.05 0.1 0.2 0.4] [--seed 200]
[--set controller=lqr] [--fine 5] [--processes 2] [--out FOLDER]; ``--draw`` only draws what FOLDER has.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from functools import partial
from pathlib import Path

import numpy as np

from wbmpc.configuration import configure
from wbmpc.errors import WbmpcError
from wbmpc.experiments.push_map import FINE, MODES, Point, measure, points, push_map

Table = dict[str, list[float | None]]


def _run(todo: list[Point], file: Path, processes: int | None, fine: float) -> None:
    started = time.time()
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        results = push_map(todo, file, lambda left: pool.imap_unordered(partial(measure, fine=fine), left))
        for k, (key, (low, high)) in enumerate(results, start=1):
            falls = "never falls" if high is None else f"falls at {high:.1f} N s"
            done = f"{k} of {len(todo)}, {time.time() - started:.0f} s"
            print(f"{done}: {key}: stands at {low:.1f} N s, {falls}", flush=True)


def summary(todo: list[Point], done: Table) -> list[str]:
    """One line for each mode and length: impulses [N s] after which the robot stands."""
    lines = []
    for mode, length, given in dict.fromkeys((p.mode, p.length, p.given) for p in todo):
        chosen = [p.key for p in todo if (p.mode, p.length, p.given) == (mode, length, given)]
        stands = [low for key in chosen if key in done and (low := done[key][0]) is not None]
        if stands:
            who = " ".join(given) or "controller=mpc"
            figures = f"median {np.median(stands):.0f}, least {min(stands):.0f}, most {max(stands):.0f} N s"
            lines.append(f"{mode} held, {length:g} s, {who}: {figures} ({len(stands)} of {len(chosen)} directions)")
    return lines


def draw(todo: list[Point], done: Table, path: Path) -> None:
    """One polar panel for each mode: what it stands, by direction; a line for each length and controller."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    modes, lengths = list(dict.fromkeys(p.mode for p in todo)), sorted({p.length for p in todo})
    who = list(dict.fromkeys(p.given for p in todo))
    figure, axes = plt.subplots(
        1, len(modes), figsize=(6 * len(modes), 6.6), layout="constrained", squeeze=False, subplot_kw={"polar": True}
    )
    colours = plt.get_cmap("viridis")(np.linspace(0.0, 0.85, len(lengths)))
    for axis, mode in zip(axes[0], modes, strict=True):
        for given, style in zip(who, ("-", "--", ":", "-."), strict=False):
            for length, colour in zip(lengths, colours, strict=True):
                chosen = [p for p in todo if (p.mode, p.length, p.given) == (mode, length, given) and p.key in done]
                if not chosen:
                    continue
                ring = [*chosen, chosen[0]] if len(chosen) > 2 else chosen
                name = f"{length:g} s" + (f", {' '.join(given)}" if given else "")
                stands = [done[p.key][0] or 0.0 for p in ring]
                axis.plot([p.direction for p in ring], stands, style, color=colour, marker=".", label=name)
        axis.set_title(f"impulse after which it stands [N s], {mode} held", fontsize=11)
        axis.set_ylim(0.0, None)
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=min(len(lengths), 4))
    figure.savefig(path, dpi=100)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--modes", nargs="+", choices=list(MODES), default=["hand", "ball"])
    parser.add_argument("--directions", type=int, default=16)
    parser.add_argument("--lengths", type=float, nargs="+", default=[0.05, 0.1, 0.2, 0.4])
    parser.add_argument("--seed", type=int, default=200)
    parser.add_argument("--set", dest="given", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument(
        "--rival", action="append", default=[], help="settings of a rival that is drawn too, in one string"
    )
    parser.add_argument("--fine", type=float, default=FINE, help="a bisection ends at this [N s]")
    parser.add_argument("--processes", type=int, help="all cores when left out")
    parser.add_argument("--out", type=Path, default=Path("runs/push-map"))
    parser.add_argument("--draw", action="store_true", help="run nothing")
    given = parser.parse_args()
    if given.directions < 1 or given.fine <= 0.0 or min(given.lengths) <= 0.0 or given.seed < 0:
        parser.error("--directions needs at least 1, --lengths and --fine numbers above 0, --seed a number from 0 on")
    file = given.out / "push_map.json"
    sets = [tuple(given.given), *(tuple(r.split()) for r in given.rival)]
    lengths = tuple(given.lengths)
    todo = [p for s in sets for m in given.modes for p in points(m, given.directions, lengths, given.seed, s)]
    try:
        for mode, settings in {(p.mode, p.given) for p in todo}:
            configure(MODES[mode], settings, f"rezero-push-{mode}")
    except WbmpcError as error:  # told here, before any process starts
        parser.error(str(error))
    given.out.mkdir(parents=True, exist_ok=True)
    if not given.draw:
        _run(todo, file, given.processes, given.fine)
    done = json.loads(file.read_text()) if file.exists() else {}
    print("\n".join(summary(todo, done)))
    try:
        draw(todo, done, given.out / "push-map.png")
    except ImportError:
        print("matplotlib is not installed: no figure")


if __name__ == "__main__":
    main()
