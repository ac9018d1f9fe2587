"""All tables of results in the documents, from finished studies: docs/results/swerve.md and ball.md, and the README's figures.

Usage: python scripts/figures.py [--run] [--runs runs]
The studies are swerve-goals, swerve-loads, rezero-goals and rezero-loads of `wbmpc study`, whose folders are looked for in --runs;
--run does first what of them is not finished (days). Each experiment's rows name the commit that its runs recorded; experiments
without runs keep the rows that they have. How old tables are: docs/_ext/table_age.py.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from readme import fill_from_studies

ROOT = Path(__file__).parents[1]
#: By first letters of an experiment's name, the page and mark of its robot.
PAGES = {"swerve": "swerve", "rezero": "ball"}
#: Units that are shown as others: factor and name.
SHOWN_AS = {"m": (1e3, "mm"), "rad": (180.0 / math.pi, "deg")}
#: What the papers say of experiments for which they give no figure.
PAPER = {
    "rezero-steps": "“acceptable”",
    "rezero-push-hand": "recovers",
    "rezero-push-ball": "recovers",
    "rezero-wholebody": "the ball stays",
    "rezero-taskspace": "argued",
    "rezero-circle": "in the video",
    "rezero-door": "works; the force is missed",
    "rezero-frequency": "“improves”",
}
HEAD = ("experiment", "metric", "goal", "paper", "median (95 %, worst)", "commit", "seeds", "reached")
Cell = dict[str, Any]


def number(value: float | None, factor: float = 1.0) -> str:
    """Three digits, or all of a whole number; None (a figure that is not finite) is ∞."""
    if value is None:
        return "∞"
    return f"{factor * value:.0f}" if abs(factor * value) >= 999.5 else f"{factor * value:.3g}"


def figures(metric: dict[str, Any]) -> str:
    """Median (95 %, worst); of a figure that is to be large, (5 %, worst)."""
    factor = SHOWN_AS.get(metric["unit"], (1.0, ""))[0]
    bad = "p5" if metric["goal"] is None and metric["least"] is not None else "p95"
    return "{} ({}, {})".format(*(number(metric[key], factor) for key in ("median", bad, "worst")))


def row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |\n"


def goals(cells: list[Cell], commit: str) -> str:
    """Every metric with a goal or a paper's figure; an experiment's name stands in its first row."""
    text = row(HEAD) + "|" + " --- |" * len(HEAD) + "\n"
    for cell in cells:
        plain = cell["condition"] in ("", "protocol")
        name = f"`{cell['experiment']}`" + ("" if plain else f", {cell['condition']}")
        for k, (metric, found) in enumerate(cell["metrics"].items()):
            factor, unit = SHOWN_AS.get(found["unit"], (1.0, found["unit"]))
            limits = [(sign, found[key]) for key, sign in (("least", "≥"), ("goal", "≤")) if found[key] is not None]
            goal = " ".join(f"{sign} {number(value, factor)}" for sign, value in limits) or "–"
            said = PAPER.get(cell["experiment"], "–") if k == 0 and plain else "–"
            paper = said if found["paper"] is None else number(found["paper"], factor)
            reached = {True: "yes", False: "**no**", None: ""}[found["met"]]
            shown = f"`{metric}`" + ("" if unit == "1" else f" [{unit}]")
            first = (name, commit) if k == 0 else ("", "")
            text += row([first[0], shown, goal, paper, figures(found), first[1], str(len(cell["seeds"])), reached])
    return text


def loads(cells: list[Cell], commit: str) -> str:
    """For each experiment conditions down and metrics across; how many runs did not complete."""
    text = ""
    for experiment in dict.fromkeys(cell["experiment"] for cell in cells):
        mine = [cell for cell in cells if cell["experiment"] == experiment]
        shown = [(m, SHOWN_AS.get(found["unit"], (1.0, found["unit"]))[1]) for m, found in mine[0]["metrics"].items()]
        heads = ["condition", "failed", *(f"`{m}`" + ("" if unit == "1" else f" [{unit}]") for m, unit in shown)]
        text += (
            f"### `{experiment}`\nMedian (95 %, worst), commit {commit}.\n\n"
            + row(heads)
            + "|"
            + " --- |" * len(heads)
            + "\n"
        )
        for cell in mine:
            failed = cell["failures"]
            cells_ = [figures(cell["metrics"][m]) for m, _ in shown]
            text += row([cell["condition"], f"{failed['failed']} of {failed['count']}", *cells_])
        text += "\n"
    return text


def publish(path: Path, mark: str, text: str, part: str) -> None:
    """Put ``text`` between the lines ``<!-- mark -->`` and ``<!-- end of mark -->`` of a document.

    ``part``: pattern of the lines with which the text's parts begin. What stands there of other parts stays.
    """
    first, last = f"<!-- {mark} -->\n", f"<!-- end of {mark} -->"
    previous, _, rest = path.read_text().partition(first)
    old, end, after = rest.partition(last)
    if not end:
        raise SystemExit(f"figures: {path} has no lines '{first.strip()}' and '{last}' to put the table between")
    path.write_text(previous + first + _renewed(old, text, part) + end + after)


def _renewed(old: str, new: str, part: str) -> str:
    """``old`` with the parts of ``new`` in place of those that begin with the same words, or behind all others."""
    (head, *parts), (_, *others) = (re.split(f"(?m)^(?={part})", text) for text in (new, old))
    name = lambda text: re.split(r"(?<=`) |\n", text)[0]
    kept = {name(p): p for p in others}
    return head + "".join((kept | {name(p): p for p in parts}).values())


def main() -> None:
    """Publish each robot's tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", action="store_true", help="do first what is not finished")
    parser.add_argument("--runs", type=Path, default=ROOT / "runs", help="where the studies' folders are")
    parser.add_argument("--docs", type=Path, default=ROOT / "docs")
    parser.add_argument("--readme", type=Path, default=ROOT / "README.md")
    given = parser.parse_args()
    made, of_goals = [], []
    for robot, page in PAGES.items():
        for kind, write, part in (("goals", goals, r"\| `"), ("loads", loads, "### ")):
            name = f"{robot}-{kind}"
            out = given.runs / name
            if given.run:
                subprocess.run([sys.executable, "-m", "wbmpc", "study", name, "--out", str(out)], check=True)
            if (out / "statistics.json").is_file():
                found = json.loads((out / "statistics.json").read_text())
                text = write(found["cells"], ", ".join(found["commit"]) or "unknown")
                publish(given.docs / "results" / f"{page}.md", f"{page} {kind}", text, part)
                made.append(name)
                of_goals += [out / "statistics.json"] * (kind == "goals")
    if not made:
        raise SystemExit(f"figures: {given.runs} holds no finished studies: wbmpc study swerve-goals")
    kept = fill_from_studies(given.readme, of_goals)
    print(json.dumps({"studies": made, "kept in the README": kept}))


if __name__ == "__main__":
    main()
