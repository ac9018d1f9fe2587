"""All tables of results in the documents, from finished studies: pages of docs/results, and the README's figures.

Usage: python scripts/figures.py [--run] [--runs runs]
Folders of the studies (STUDIES below) are looked for in --runs; --run does first what of them is not finished (days). Each experiment's rows
name the commit that its runs recorded; experiments without runs keep the rows that they have. How old tables are: docs/_ext/table_age.py.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from readme import fill_from_studies

from wbmpc.units import scale

ROOT = Path(__file__).parents[1]
TABLE_AGE = ROOT / "docs" / "_ext" / "table_age.py"
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
HEAD = ("metric", "goal", "paper", "median", "95 %", "worst", "reached")
Cell = dict[str, Any]


def texts(metric: dict[str, Any], *values: float | None) -> list[str]:
    """Values of a metric in the unit that reads best for all of them, three digits each; None (a figure that is not finite) is ∞."""
    shown = scale(metric["unit"], *(metric[key] for key in ("median", "p95", "goal", "least", "paper")))
    unit = "" if shown.unit == "1" else shown.unit if shown.unit in "%°" else f" {shown.unit}"
    scaled = (None if value is None else shown.factor * value for value in values)
    return ["∞" if v is None else f"{v:.0f}{unit}" if abs(v) >= 999.5 else f"{v:.3g}{unit}" for v in scaled]


def figures(metric: dict[str, Any]) -> list[str]:
    """Median, 95 % and worst; of a figure that is to be large, median, 5 % and worst."""
    bad = "p5" if metric["goal"] is None and metric["least"] is not None else "p95"
    return texts(metric, *(metric[key] for key in ("median", bad, "worst")))


def limits(metric: dict[str, Any]) -> str:
    """The goal: at most, at least, or both."""
    least, most = metric["least"], metric["goal"]
    if least is not None and most is not None:
        low, high = texts(metric, least, most)
        return low if low == high else f"{low} to {high}"
    (text,) = texts(metric, most if least is None else least)
    return "–" if least is None and most is None else f"{'≤' if least is None else '≥'} {text}"


def row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |\n"


def table(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    heads = list(heads)
    return row(heads) + "|" + " --- |" * len(heads) + "\n" + "".join(map(row, rows)) + "\n"


def goals(cells: list[Cell], commit: str) -> str:
    """For each experiment and condition a table of every metric with a goal or a paper's figure."""
    text = ""
    for cell in cells:
        plain = cell["condition"] in ("", "protocol")
        rows, judged = (
            [],
            [m for m, found in cell["metrics"].items() if found["goal"] is not None or found["least"] is not None],
        )
        for metric, found in cell["metrics"].items():
            said = PAPER.get(cell["experiment"], "–") if metric in judged[:1] and plain else "–"
            paper = said if found["paper"] is None else texts(found, found["paper"])[0]
            reached = {True: "yes", False: "**no**", None: ""}[found["met"]]
            rows.append([f"`{metric}`", limits(found), paper, *figures(found), reached])
        name = f"`{cell['experiment']}`" + ("" if plain else f", {cell['condition']}")
        seeds = cell["seeds"]
        head = f"{len(seeds)} runs, seeds {min(seeds)} to {max(seeds)}, commit {commit}; {outcomes(cell)}."
        text += f"### {name}\n{head}\n\n" + table(HEAD, rows)
    return text


def outcomes(cell: Cell) -> str:
    """How the runs ended."""
    found = cell["outcomes"]
    return ", ".join(f"{found[k]} {k.replace('_', ' ')}" for k in sorted(found, key=lambda k: (k != "completed", k)))


def ended(cell: Cell) -> bool:
    """Whether runs ended otherwise than they were to, and count as success nevertheless."""
    return cell["failures"]["failed"] < sum(n for how, n in cell["outcomes"].items() if how != "completed")


def loads(cells: list[Cell], commit: str) -> str:
    """For each experiment conditions, and robots where there are several, down and metrics with their goals across; how many runs did not
    complete."""
    text = ""
    for experiment in dict.fromkeys(cell["experiment"] for cell in cells):
        mine = [cell for cell in cells if cell["experiment"] == experiment]
        names = list(mine[0]["metrics"])
        several, rows = len({cell.get("robot") for cell in mine}) > 1, []
        for cell in mine:
            failed, found = cell["failures"], cell["metrics"]
            shown = ("{} ({}, {})".format(*figures(found[m])) for m in names)
            unsuccessful = f"{failed['failed']} of {failed['count']}"
            name = ", ".join(filter(None, (several * (cell.get("robot") or ""), cell["condition"])))
            rows.append([name, f"{unsuccessful}; {outcomes(cell)}" if ended(cell) else unsuccessful, *shown])
        text += f"### `{experiment}`\nMedian (95 %, worst), commit {commit}.\n\n"
        heads = [f"`{m}` {limits(mine[0]['metrics'][m])}".removesuffix(" –") for m in names]
        text += table(["robot" if several else "condition", "failed", *heads], rows)
    return text


def publish(path: Path, mark: str, text: str) -> None:
    """Put ``text`` between the lines ``<!-- mark -->`` and ``<!-- end of mark -->`` of a document.

    Its parts begin with a heading of the third level; parts that it does not have stay.
    """
    first, last = f"<!-- {mark} -->\n", f"<!-- end of {mark} -->"
    previous, _, rest = path.read_text().partition(first)
    old, end, after = rest.partition(last)
    if not end:
        raise SystemExit(f"figures: {path} has no lines '{first.strip()}' and '{last}' to put the table between")
    path.write_text(previous + first + _renewed(old, text) + end + after)


def _renewed(old: str, new: str) -> str:
    """``old`` with the parts of ``new`` in place of those with the same heading, or behind all others."""
    parts = lambda text: {p.partition("\n")[0]: p for p in re.split("(?m)^(?=### )", text)[1:]}
    return "".join((parts(old) | parts(new)).values())


#: By study, the page of its tables, their mark there, and what writes them.
STUDIES = {
    "swerve-goals": ("swerve", "swerve goals", goals),
    "swerve-loads": ("swerve", "swerve loads", loads),
    "rezero-goals": ("ball", "ball goals", goals),
    "rezero-loads": ("ball", "ball loads", loads),
    "obstacles": ("obstacles", "obstacles", loads),
    "swerve-fast": ("motion", "fast motion", loads),
    "swerve-wipe": ("motion", "wiping", loads),
    "touch": ("motion", "touch", loads),
    "slip": ("motion", "slip", loads),
    "legs": ("motion", "legs", loads),
    "gallery": ("robots", "gallery", loads),
    "gallery-arms": ("robots", "arms", loads),
}


def main() -> None:
    """Publish each study's tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", action="store_true", help="do first what is not finished")
    parser.add_argument("--runs", type=Path, default=ROOT / "runs", help="where the studies' folders are")
    parser.add_argument("--docs", type=Path, default=ROOT / "docs")
    parser.add_argument("--readme", type=Path, default=ROOT / "README.md")
    given = parser.parse_args()
    made, of_goals = [], []
    for name, (page, mark, write) in STUDIES.items():
        out = given.runs / name
        if given.run:
            subprocess.run([sys.executable, "-m", "wbmpc", "study", name, "--out", str(out)], check=True)
        if (out / "statistics.json").is_file():
            found = json.loads((out / "statistics.json").read_text())
            text = write(found["cells"], ", ".join(found["commit"]) or "unknown")
            publish(given.docs / "results" / f"{page}.md", mark, text)
            made.append(name)
            of_goals += [out / "statistics.json"] * (write is goals)
    if not made:
        raise SystemExit(f"figures: {given.runs} holds no finished studies: wbmpc study swerve-goals")
    kept = fill_from_studies(given.readme, of_goals)
    if given.readme == ROOT / "README.md":
        subprocess.run([sys.executable, str(TABLE_AGE), "--write"], stdout=subprocess.DEVNULL, check=True)
    print(json.dumps({"studies": made, "kept in the README": kept}))


if __name__ == "__main__":
    main()
