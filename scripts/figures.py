"""Tables of results in the documents, from finished runs: docs/results/swerve.md and ball.md, between their marks.

Usage: python scripts/figures.py [--site reproduced …]
Sites are those of `wbmpc reproduce`. Each experiment's rows name the commit that its runs recorded; experiments without runs keep
the rows that they have.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from wbmpc.reproduce import finished

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "benchmarks"))

from goals import goal_rows, goals_markdown, publish  # noqa: E402

#: First letters of an experiment's name, and the page and mark of its robot.
PAGES = {"swerve": "swerve", "rezero": "ball"}


def runs_of(sites: list[Path]) -> dict[str, list[dict[str, Any]]]:
    """Contents of metrics.json by experiment, of one run for each seed: that of the last site that has it."""
    found: dict[str, dict[int, dict[str, Any]]] = {}
    for job in (job for site in sites for job in finished(site)):
        found.setdefault(job.name, {})[job.seed] = json.loads((job.directory / "metrics.json").read_text())
    return {name: [runs[seed] for seed in sorted(runs)] for name, runs in found.items()}


def main() -> None:
    """Publish each robot's table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--site", type=Path, action="append", help="of wbmpc reproduce (default: reproduced)")
    parser.add_argument("--docs", type=Path, default=ROOT / "docs")
    given = parser.parse_args()
    sites = given.site or [ROOT / "reproduced"]
    found = runs_of(sites)
    if not found:
        raise SystemExit(f"figures: {', '.join(map(str, sites))} holds no finished runs: wbmpc reproduce")
    for prefix, page in PAGES.items():
        rows = [row for name in sorted(found) if name.startswith(prefix) for row in goal_rows(name, found[name], {})]
        if rows:
            publish(given.docs / "results" / f"{page}.md", f"{page} goals", goals_markdown(rows), r"\| `")
    print(json.dumps({"experiments": sorted(found)}))


if __name__ == "__main__":
    main()
