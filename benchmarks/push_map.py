"""The push map of the ball robot: impulses from which it recovers, or after which it still stands, over directions and lengths.

Usage: python benchmarks/push_map.py [--modes end effector ball] [--directions 16] [--lengths 0.05 0.1 0.2 0.4] [--seed 200]
[--controllers mpc lqr scheduled-lqr …] [--criteria recovers stands] [--set KEY=VALUE] [--fine 5] [--processes 2] [--out FOLDER];
``--draw`` only draws what FOLDER has. Every push is kept when it is done: Ctrl-C, and the same command goes on. Without
``--criteria`` only recovering is looked for. To recover, it has to be back and at rest 7 s after the push begins (``--set
pause=``). Baselines have the gains of push_map_gains.json, or of another file (``--gains``; push_map_standing.json has those of a
regulator that only has to stand, and rolls away). Of several controllers the first is compared with each of the others,
direction by direction.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, get_args

import numpy as np
from workers import Workers

from wbmpc.cli.terminal import INTERRUPTED, TERMINATED, terminable
from wbmpc.errors import InputError, WbmpcError
from wbmpc.studies.minniti2019.baselines import Controller
from wbmpc.studies.minniti2019.push_map import (
    CRITERIA,
    FINE,
    MODES,
    Outcome,
    Outcomes,
    Point,
    bracket,
    check,
    next_impulse,
    points,
    push_map,
    read,
    simulated,
)

#: Gains of baselines by what is held and controller, found by benchmarks/regulator_search.py on tuning seeds.
GAINS = Path(__file__).with_name("push_map_gains.json")


def gains(mode: str, controller: str, file: Path | None = None) -> dict[str, float]:
    """Those found for a controller with end effector or ball held; none where none were searched. Raises :class:`InputError` for a file of
    something else."""
    file = file or GAINS
    try:
        found = json.loads(file.read_text()).get(mode, {}).get(controller, {})
        return {str(k): float(v) for k, v in found.items()}
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{file}: this is no file of gains by what is held, controller and name ({error})") from error


def write_gains(mode: str, controller: str, found: dict[str, float]) -> None:
    """Keep them with the others."""
    everything = json.loads(GAINS.read_text())
    everything.setdefault(mode, {})[controller] = found
    GAINS.write_text(json.dumps(everything, indent=1) + "\n")


def settings_with(controller: str, found: dict[str, float]) -> tuple[str, ...]:
    """Settings of a run with that baseline and these gains."""
    key = controller.replace("-", "_")
    return f"controller={controller}", *(f"baseline.{key}.{k}={v:g}" for k, v in found.items())


def settings_of(mode: str, controller: str, file: Path | None = None) -> tuple[str, ...]:
    """Settings of a run with that controller and its gains; none for the MPC."""
    return () if controller == "mpc" else settings_with(controller, gains(mode, controller, file))


def todo_of(given: argparse.Namespace) -> dict[str, list[Point]]:
    """All pushes by controller."""
    of = lambda mode, name: (*settings_of(mode, name, given.gains), *given.given)
    lengths = tuple(given.lengths)
    return {
        name: [p for m in given.modes for p in points(m, given.directions, lengths, given.seed, of(m, name))]
        for name in given.controllers
    }


def run(todo: list[Point], file: Path, workers: Workers, processes: int, fine: float, criteria: Sequence[str]) -> None:
    """All pushes, each written and reported when it is done. Ctrl-C (or SIGTERM) ends the program with a message."""
    started, done = time.time(), read(file)
    left = {p.key for p in todo if next_impulse(done.get(p.key, {}), fine, criteria) is not None}
    push = partial(workers.submit, simulated)
    with terminable() as termination:
        try:
            with workers:
                for point, impulse, outcome in push_map(todo, file, push, processes, fine, criteria):
                    found = done.setdefault(point.key, {})
                    found[impulse] = outcome
                    if next_impulse(found, fine, criteria) is None:
                        left.discard(point.key)
                    said = f"{impulse:g} N s: {outcome_text(outcome)} ({', '.join(limits(found, c) for c in criteria)})"
                    print(
                        f"{len(left)} of {len(todo)} left, {time.time() - started:.0f} s: {point.key}: {said}",
                        flush=True,
                    )
        except KeyboardInterrupt:
            kept = f"what is done is in {file}; the same command goes on from there"
            print(f"interrupted: {kept if file.exists() else 'nothing is done yet'}", file=sys.stderr)
            raise SystemExit(TERMINATED if termination.came else INTERRUPTED) from None


def outcome_text(outcome: Outcome) -> str:
    """An outcome in a word or two."""
    return "recovers" if outcome.recovers else "stands" if outcome.stands else "no"


def limits(found: Outcomes, criterion: str) -> str:
    """A criterion's impulses in words."""
    low, high = bracket(found, criterion) or (0.0, np.inf)
    return f"{criterion} {low:.1f} N s" + ("" if np.isinf(high) else f", not {high:.1f}")


def passed(chosen: list[Point], done: dict[str, Outcomes], criterion: str, fine: float = FINE) -> dict[float, float]:
    """The largest impulse [N s] that passes, by direction, of the pushes that were measured to ``fine`` [N s]."""
    ready = [p for p in chosen if next_impulse(done.get(p.key, {}), fine, (criterion,)) is None]
    return {p.direction: (bracket(done[p.key], criterion) or (0.0, np.inf))[0] for p in ready}


def travel(chosen: list[Point], done: dict[str, Outcomes]) -> float:
    """Farthest that the ball was from its place [m] in a push from which the robot recovered; 0 for none."""
    outcomes = (o for p in chosen for o in done.get(p.key, {}).values())
    return max((o.travel for o in outcomes if o.recovers), default=0.0)


def summary(
    todo: dict[str, list[Point]],
    done: dict[str, Outcomes],
    fine: float = FINE,
    criteria: Sequence[str] = CRITERIA,
) -> list[str]:
    """For each mode, length, controller and criterion the impulses [N s] that were found to ``fine``, the first controller's over
    the others' in the directions that both have, and the farthest way of the ball."""
    lines, first = [], next(iter(todo))
    for mode, length in dict.fromkeys((p.mode, p.length) for p in todo[first]):
        of = {name: [p for p in ps if (p.mode, p.length) == (mode, length)] for name, ps in todo.items()}
        for name, here in of.items():
            for criterion in criteria:
                values = passed(here, done, criterion, fine)
                if values:
                    line = f"{mode} held, {length:g} s, {name} {criterion}: {_spread(list(values.values()))}"
                    lines.append(f"{line} N s ({len(values)} of {len(here)} directions)")
                    lines += _compared(first, name, passed(of[first], done, criterion, fine), values)
            if (way := travel(here, done)) > 0.0:
                lines.append(f"  its ball goes {way:.1f} m at most where it recovers")
    return lines


def _spread(values: list[float]) -> str:
    return f"median {np.median(values):.0f}, least {min(values):.0f}, most {max(values):.0f}"


def _compared(first: str, name: str, own: dict[float, float], other: dict[float, float]) -> list[str]:
    """The first controller's impulses over another's, where the other's are not 0; how often they are."""
    both = [(own[d], v) for d, v in other.items() if d in own]
    ratios = [a / b for a, b in both if b > 0.0]
    if name == first or not both:
        return []
    never = f", {len(both) - len(ratios)} where {name} never does" if len(ratios) < len(both) else ""
    figures = f"median {np.median(ratios):.2f}, least {min(ratios):.2f} " if ratios else ""
    return [f"  {first} over {name}: {figures}({len(ratios)}){never}"]


def draw(
    todo: dict[str, list[Point]], done: dict[str, Outcomes], path: Path, fine: float, criteria: Sequence[str]
) -> None:
    """Polar panels by mode (down) and criterion (across): impulses by direction, a line for each length and controller."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    everything = [p for chosen in todo.values() for p in chosen]
    modes, lengths = list(dict.fromkeys(p.mode for p in everything)), sorted({p.length for p in everything})
    figure, axes = plt.subplots(
        len(modes), len(criteria), figsize=(6 * len(criteria), 6 * len(modes) + 0.6), layout="constrained", squeeze=False,
        subplot_kw={"polar": True},
    )  # fmt: skip
    colours = plt.get_cmap("viridis")(np.linspace(0.0, 0.85, max(len(lengths), len(todo))))
    for mode, row in zip(modes, axes, strict=True):
        for criterion, axis in zip(criteria, row, strict=True):
            for j, (name, points_) in enumerate(todo.items()):
                for k, length in enumerate(lengths):
                    here = [p for p in points_ if (p.mode, p.length) == (mode, length)]
                    values = passed(here, done, criterion, fine)
                    colour = colours[k if len(lengths) > 1 else j]
                    _ring(axis, values, len(here), f"{length:g} s, {name}", ("-", "--", ":", "-.")[j % 4], colour)
            axis.set_title(f"impulse at which it {criterion} [N s], {mode} held", fontsize=11)
            axis.set_ylim(0.0, None)
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    figure.savefig(path, dpi=100)
    plt.close(figure)


def _ring(axis: Any, values: dict[float, float], asked: int, label: str, style: str, colour: Any) -> None:
    """Values over directions, as a ring if all that were ``asked`` are there, as points else: no line across what is missing."""
    directions, whole = list(values), len(values) == asked
    if directions:
        ring = [*directions, directions[0]] if whole else directions
        line = style if whole else "none"
        axis.plot(ring, [values[d] for d in ring], linestyle=line, color=colour, marker="o", label=label)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--modes", nargs="+", choices=list(MODES), default=["hand", "ball"])
    parser.add_argument("--directions", type=int, default=16)
    parser.add_argument("--lengths", type=float, nargs="+", default=[0.05, 0.1, 0.2, 0.4])
    parser.add_argument("--seed", type=int, default=200)
    parser.add_argument("--set", dest="given", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--controllers", nargs="+", choices=get_args(Controller), default=["mpc"])
    parser.add_argument("--gains", type=Path, help="of baselines")
    parser.add_argument(
        "--criteria",
        nargs="+",
        choices=CRITERIA,
        default=["recovers"],
        help="a bisection for each; standing takes longest",
    )
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
    if given.directions < 1 or not 0.0 < given.fine < math.inf or given.seed < 0:
        parser.error("--directions needs at least 1, --fine a number above 0, --seed a number from 0 on")
    if given.processes is not None and given.processes < 1:
        parser.error("--processes needs at least 1")
    if given.gains is not None and not given.gains.is_file():
        parser.error(f"--gains: there is no file '{given.gains}'")
    file = given.out / "pushes.json"
    try:  # reported here, before any process starts
        todo = todo_of(given)
        everything = [p for chosen in todo.values() for p in chosen]
        for point in {(p.mode, p.length, p.given): p for p in everything}.values():
            check(point)
        done = read(file)
        if not given.draw:
            given.out.mkdir(parents=True, exist_ok=True)
        elif not any(p.key in done for p in everything):
            raise InputError(f"--draw: there are no such pushes in '{file}'")
    except WbmpcError as error:
        parser.error(str(error))
    except OSError as error:
        parser.error(f"--out: '{given.out}' cannot be a folder ({error.strerror})")
    if not given.draw:
        processes = given.processes or os.cpu_count() or 1
        try:
            run(everything, file, Workers(processes), processes, given.fine, given.criteria)
        except WbmpcError as error:  # what only the plant rejects, in the process of a push
            parser.error(str(error))
    done = read(file)
    print("\n".join(summary(todo, done, given.fine, given.criteria)))
    try:
        draw(todo, done, given.out / "push-map.png", given.fine, given.criteria)
    except ImportError:
        print("matplotlib is not installed: no figure")


if __name__ == "__main__":
    main()
