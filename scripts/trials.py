"""The trials of finished searches, kept beside the results: docs/results/trials/STUDY.csv, a row for each.

Usage: python scripts/trials.py [--runs runs]
A search is `wbmpc tune STUDY`, whose folder is looked for in --runs. tests/test_trials.py compares what experiments use with the best trial.
"""

from __future__ import annotations

import argparse
import csv
import json
from pathlib import Path

import pyarrow.parquet

from wbmpc.study.files import ROWS, TRIAL_ROWS, TRIALS
from wbmpc.study.study import Study

ROOT = Path(__file__).parents[1]


def keep(study: Study, found: Path, out: Path) -> None:
    """Write the trials of the search of a ``study`` in the folder ``found`` to the file ``out``."""
    tune = study.definition.tune
    assert tune is not None
    commits = set(pyarrow.parquet.read_table(found / TRIAL_ROWS / ROWS, columns=["commit"])["commit"].to_pylist())
    about = [" ".join(map(str, tune.seeds)), " ".join(sorted(commits))]
    out.parent.mkdir(parents=True, exist_ok=True)
    with out.open("w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["trial", "objective", "feasible", *tune.search, "seeds", "commit"])
        for t in json.loads((found / TRIALS).read_text()):
            value = f"{sum(t['values']):.6g}" if t["values"] else ""
            rows.writerow([t["trial"], value, int(t["feasible"]), *t["settings"].values(), *about])


def main() -> None:
    """Keep the trials of each study of the package that has some."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=Path, default=ROOT / "runs", help="where the studies' folders are")
    given, kept = parser.parse_args(), []
    for file in sorted((ROOT / "src" / "wbmpc" / "studies").rglob("*.yaml")):
        if (given.runs / file.stem / TRIALS).is_file():
            keep(
                Study.load(file, given.runs / file.stem),
                given.runs / file.stem,
                ROOT / "docs/results/trials" / f"{file.stem}.csv",
            )
            kept.append(file.stem)
    if not kept:
        raise SystemExit(f"trials: {given.runs} holds no finished search: wbmpc tune swerve-tune-four-wheel")
    print(json.dumps({"kept": kept}))


if __name__ == "__main__":
    main()
