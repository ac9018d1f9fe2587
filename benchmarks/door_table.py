"""The door with and without its equation (a), its estimated impedance (b) and the friction cone (c): doors, forces, seeds.

Usage: python benchmarks/door_table.py [--seeds 200-200] [--doors free heavy …] [--forces 8 16 …] [--schemes paper a+b+c …]
       [--file FILE]
Runs that FILE (one JSON line each) already has are not done again: an interrupted study goes on where it was, and calls with
other ranges add to it. The tables are of everything in FILE.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from wbmpc.reproduce import parse_seeds
from wbmpc.studies.minniti2019.door import push_door
from wbmpc.studies.minniti2019.door_figures import trial_metrics
from wbmpc.studies.minniti2019.door_problem import DoorScheme
from wbmpc.studies.minniti2019.door_settings import DOORS, RezeroDoorSettings

#: Which parts of the scheme are on. "paper": the wrench is a free input (Minniti et al. 2019).
SCHEMES = {
    "paper": (False, False, False),
    "c": (False, False, True),
    "a": (True, False, False),
    "a+c": (True, False, True),
    "a+b": (True, True, False),
    "a+b+c": (True, True, True),
}
#: Contact counts as lost when the end effector is off the panel for more than this share of the push, or when the robot falls.
LOST = 0.02


def measure(scheme: str, door: str, force: float, seed: int) -> dict[str, Any]:
    """Figures of one run."""
    row, identify, cone = SCHEMES[scheme]
    known = DoorScheme(row=row, identify=identify, cone=cone)
    settings = RezeroDoorSettings(scheme=known, door=door, lean_share=10.0)  # type: ignore[arg-type]  # all forces as they are asked
    trial = push_door(settings, force, seed)
    return {"scheme": scheme, "door": door, "force": force, "seed": seed, **trial_metrics(trial)}


def cell(runs: list[dict[str, Any]]) -> str:
    """Median error in % of the reference, worst in brackets; F for falls, L for lost contact (how many of how many)."""
    errors = 100.0 * np.array([r["force_error_ratio"] for r in runs])
    text = f"{np.median(errors):.1f}" + (f" ({errors.max():.1f})" if len(runs) > 1 else "")
    fell, lost = sum(r["fell"] > 0 for r in runs), sum(r["contact_share"] < 1.0 - LOST for r in runs)
    many = lambda k: "" if len(runs) == 1 else f" {k}/{len(runs)}"
    return text + (f" F{many(fell)}" if fell else f" L{many(lost)}" if lost else "")


def tables(runs: list[dict[str, Any]]) -> str:
    """A table for each door: schemes by forces; and where each scheme loses contact."""
    out = []
    for door in dict.fromkeys(r["door"] for r in runs):
        here = [r for r in runs if r["door"] == door]
        forces = sorted({r["force"] for r in here})
        out += [
            f"\n{door}: rms force error [% of the reference]",
            "| scheme |" + "".join(f" {f:g} N |" for f in forces),
        ]
        out.append("| --- |" + " --- |" * len(forces))
        for scheme in SCHEMES:
            row = [[r for r in here if r["scheme"] == scheme and r["force"] == f] for f in forces]
            if any(row):
                out.append(f"| {scheme} |" + "".join(f" {cell(c) if c else ''} |" for c in row))
                failed = [r["force"] for c in row for r in c if r["fell"] or r["contact_share"] < 1.0 - LOST]
                first = (
                    f"from {min(failed):g} N on"
                    if failed
                    else f"never up to {max(f for f, c in zip(forces, row) if c):g} N"
                )
                out.append(f"  contact lost, or fell: {first}")
    return "\n".join(out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", default="200-200", help="as 200-203 or 200,205")
    parser.add_argument("--doors", nargs="+", choices=list(DOORS), default=list(DOORS))
    parser.add_argument("--forces", nargs="+", type=float, default=[8.0, 16.0, 24.0])
    parser.add_argument("--schemes", nargs="+", choices=list(SCHEMES), default=list(SCHEMES))
    parser.add_argument("--file", type=Path, default=Path("door_table.jsonl"))
    given = parser.parse_args()
    runs = [json.loads(line) for line in given.file.read_text().splitlines()] if given.file.exists() else []
    key = lambda r: (r["scheme"], r["door"], r["force"], r["seed"])
    done = {key(r) for r in runs}
    todo = [
        (scheme, door, force, seed)
        for seed in parse_seeds(given.seeds)
        for door in given.doors
        for force in given.forces
        for scheme in given.schemes
        if (scheme, door, force, seed) not in done
    ]
    for k, job in enumerate(todo, start=1):
        runs.append(measure(*job))
        with given.file.open("a") as file:
            file.write(json.dumps(runs[-1]) + "\n")
        print(f"{k} of {len(todo)}: {' '.join(map(str, job))}: {cell(runs[-1:])}", flush=True)
    print(tables(runs))


if __name__ == "__main__":
    main()
