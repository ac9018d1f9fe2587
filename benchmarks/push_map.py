"""The push map of the ball robot: impulse at which it falls, over directions and lengths. Goes on where it was interrupted.

Usage: python benchmarks/push_map.py [--modes hand ball] [--directions 16] [--lengths 0.05 0.1 0.2 0.4] [--seed 200]
[--controllers mpc lqr scheduled-lqr …] [--set KEY=VALUE] [--fine 5] [--processes 2] [--out FOLDER]; ``--draw`` only draws what
FOLDER has. Rivals have the gains of push_map_gains.json, or of another file (``--gains``; push_map_standing.json has those of a
regulator that only has to stand, and rolls away). Of several controllers the first is compared with each of the others,
direction by direction.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from functools import partial
from pathlib import Path
from typing import get_args

import numpy as np

from wbmpc.configuration import configure
from wbmpc.errors import WbmpcError
from wbmpc.experiments.push_map import FINE, MODES, Point, measure, points, push_map
from wbmpc.experiments.rezero_rivals import Controller

Table = dict[str, list[float | None]]
#: Gains of rivals by what is held and controller, found by benchmarks/regulator_search.py on tuning seeds.
GAINS = Path(__file__).with_name("push_map_gains.json")


def gains(mode: str, controller: str, file: Path | None = None) -> dict[str, float]:
    """Those found for a controller with hand or ball held; none where none were searched."""
    found: dict[str, float] = json.loads((file or GAINS).read_text()).get(mode, {}).get(controller, {})
    return found


def write_gains(mode: str, controller: str, found: dict[str, float]) -> None:
    """Keep them with the others."""
    everything = json.loads(GAINS.read_text())
    everything.setdefault(mode, {})[controller] = found
    GAINS.write_text(json.dumps(everything, indent=1) + "\n")


def settings_of(mode: str, controller: str, file: Path | None = None) -> tuple[str, ...]:
    """Settings of a run with that controller and its gains; none for the MPC."""
    if controller == "mpc":
        return ()
    key = controller.replace("-", "_")
    return f"controller={controller}", *(f"rival.{key}.{k}={v:g}" for k, v in gains(mode, controller, file).items())


def todo_of(given: argparse.Namespace) -> dict[str, list[Point]]:
    """All pushes by controller."""
    of = lambda mode, name: (*settings_of(mode, name, given.gains), *given.given)
    lengths = tuple(given.lengths)
    return {
        name: [p for m in given.modes for p in points(m, given.directions, lengths, given.seed, of(m, name))]
        for name in given.controllers
    }


def _run(todo: list[Point], file: Path, processes: int | None, fine: float) -> None:
    started = time.time()
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        results = push_map(todo, file, lambda left: pool.imap_unordered(partial(measure, fine=fine), left), fine)
        for k, (key, (low, high)) in enumerate(results, start=1):
            falls = "never falls" if high is None else f"falls at {high:.1f} N s"
            done = f"{k} of {len(todo)}, {time.time() - started:.0f} s"
            print(f"{done}: {key}: stands at {low:.1f} N s, {falls}", flush=True)


def summary(todo: dict[str, list[Point]], done: Table) -> list[str]:
    """For each mode, length and controller the impulses [N s] after which the robot stands, and the first controller's over the
    others' in the directions that both have."""
    lines, first = [], next(iter(todo))
    for mode, length in dict.fromkeys((p.mode, p.length) for p in todo[first]):
        stands: dict[str, dict[float, float]] = {}
        for name, chosen in todo.items():
            here = [p for p in chosen if (p.mode, p.length) == (mode, length)]
            of = stands[name] = {
                p.direction: low for p in here if p.key in done and (low := done[p.key][0]) is not None
            }
            if not of:
                continue
            values = list(of.values())
            line = f"{mode} held, {length:g} s, {name}: median {np.median(values):.0f}, least {min(values):.0f}, "
            lines.append(line + f"most {max(values):.0f} N s ({len(of)} of {len(here)} directions)")
            ratios = [stands[first][d] / max(v, 1e-9) for d, v in of.items() if d in stands[first]]
            if name != first and ratios:
                lines.append(
                    f"  {first} over {name}: median {np.median(ratios):.2f}, least {min(ratios):.2f} ({len(ratios)})"
                )
    return lines


def draw(todo: dict[str, list[Point]], done: Table, path: Path) -> None:
    """One polar panel for each mode: what it stands, by direction; a line for each length and controller."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    everything = [p for chosen in todo.values() for p in chosen]
    modes, lengths = list(dict.fromkeys(p.mode for p in everything)), sorted({p.length for p in everything})
    figure, axes = plt.subplots(
        1, len(modes), figsize=(6 * len(modes), 6.6), layout="constrained", squeeze=False, subplot_kw={"polar": True}
    )
    colours = plt.get_cmap("viridis")(np.linspace(0.0, 0.85, len(lengths)))
    for axis, mode in zip(axes[0], modes, strict=True):
        for (name, points_), style in zip(todo.items(), ("-", "--", ":", "-."), strict=False):
            for length, colour in zip(lengths, colours, strict=True):
                asked = [p for p in points_ if (p.mode, p.length) == (mode, length)]
                chosen = [p for p in asked if p.key in done]
                if not chosen:
                    continue
                ring = [*chosen, chosen[0]] if chosen == asked else chosen  # no line across what is missing
                stands = [done[p.key][0] or 0.0 for p in ring]
                axis.plot(
                    [p.direction for p in ring], stands, style, color=colour, marker=".", label=f"{length:g} s, {name}"
                )
        axis.set_title(f"impulse after which it stands [N s], {mode} held", fontsize=11)
        axis.set_ylim(0.0, None)
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    figure.savefig(path, dpi=100)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--modes", nargs="+", choices=list(MODES), default=["hand", "ball"])
    parser.add_argument("--directions", type=int, default=16)
    parser.add_argument("--lengths", type=float, nargs="+", default=[0.05, 0.1, 0.2, 0.4])
    parser.add_argument("--seed", type=int, default=200)
    parser.add_argument("--set", dest="given", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--controllers", nargs="+", choices=get_args(Controller), default=["mpc"])
    parser.add_argument("--gains", type=Path, help="of rivals")
    parser.add_argument(
        "--fine",
        type=float,
        default=FINE,
        help="a bisection ends at this [N s]; coarser results of FOLDER are gone on with",
    )
    parser.add_argument("--processes", type=int, help="all cores when left out")
    parser.add_argument("--out", type=Path, default=Path("runs/push-map"))
    parser.add_argument("--draw", action="store_true", help="run nothing")
    given = parser.parse_args()
    if given.directions < 1 or given.fine <= 0.0 or min(given.lengths) <= 0.0 or given.seed < 0:
        parser.error("--directions needs at least 1, --lengths and --fine numbers above 0, --seed a number from 0 on")
    if given.gains is not None and not given.gains.is_file():
        parser.error(f"--gains: there is no file '{given.gains}'")
    file = given.out / "push_map.json"
    todo = todo_of(given)
    everything = [p for chosen in todo.values() for p in chosen]
    try:
        for mode, settings in {(p.mode, p.given) for p in everything}:
            configure(MODES[mode], settings, f"rezero-push-{mode}")
    except WbmpcError as error:  # told here, before any process starts
        parser.error(str(error))
    given.out.mkdir(parents=True, exist_ok=True)
    if not given.draw:
        _run(everything, file, given.processes, given.fine)
    done = json.loads(file.read_text()) if file.exists() else {}
    print("\n".join(summary(todo, done)))
    try:
        draw(todo, done, given.out / "push-map.png")
    except ImportError:
        print("matplotlib is not installed: no figure")


if __name__ == "__main__":
    main()
