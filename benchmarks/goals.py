"""The table of goals: what a study over seeds reached of each experiment's goals, beside the papers' figures."""

from __future__ import annotations

import re
import statistics
from collections.abc import Container, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from wbmpc.errors import InputError

#: Units that are shown as others: factor and name.
SHOWN_AS = {"m": (1e3, "mm"), "rad": (180.0 / np.pi, "deg")}
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


def order_statistics(values: Iterable[float | None]) -> tuple[float, float, float, float, float]:
    """Smallest, 5 %, median, 95 % and largest; a figure that is not finite (None) counts as infinite.

    The median is the usual one, of an even number the mean of the two in the middle; 5 and 95 % are order statistics, nothing
    between values: a mean with infinity is not a figure.
    """
    known = np.array([np.inf if v is None else float(v) for v in values])
    low, high = (float(np.quantile(known, q, method="nearest")) for q in (0.05, 0.95))
    return float(known.min()), low, statistics.median(known.tolist()), high, float(known.max())


def goal_rows(
    name: str, runs: list[dict[str, Any]], goals: Mapping[str, float], also: Container[str] = ()
) -> list[dict[str, Any]]:
    """A row for every metric of ``runs`` (contents of metrics.json) that has a goal or is named in ``also``.

    ``goals``: others than the runs' own. A goal is reached when every run completed and the 95 % value reaches it (the 5 %
    value, for a smallest one); None where there is no goal.
    """
    rows = []
    for metric in dict.fromkeys(n for r in runs for n in r["metrics"]):
        having = [r for r in runs if metric in r["metrics"]]
        target = having[0].get("targets", {}).get(metric, {})
        goal, least = goals.get(metric, target.get("goal")), target.get("least")
        if goal is None and least is None and metric not in also:
            continue
        first, p5, median, p95, last = order_statistics(r["metrics"][metric]["value"] for r in having)
        reached = all(r["completed"] for r in runs) and len(having) == len(runs)
        reached &= (goal is None or p95 <= goal) and (least is None or p5 >= least)
        # of figures with a smallest value only, the small ones are the bad ones
        bad, worst = (p5, first) if goal is None and least is not None else (p95, last)
        rows.append({
            "experiment": name, "metric": metric, "unit": having[0]["metrics"][metric]["unit"], "goal": goal,
            "least": least, "paper": target.get("paper"), "median": median, "p95": bad, "worst": worst,
            "commit": commits(runs), "seeds": [r["seed"] for r in runs], "reached": None if goal is None and least is None else bool(reached),
        })  # fmt: skip
    return rows


def commits(runs: Iterable[Mapping[str, Any]]) -> str:
    """The commits that runs (contents of metrics.json) are of, as they recorded them."""
    found = dict.fromkeys(r.get("versions", {}).get("commit") or "unknown" for r in runs)
    return ", ".join(found)


def number(value: float, factor: float = 1.0) -> str:
    """Three digits, or all of a whole number."""
    shown = factor * value
    return "∞" if not np.isfinite(shown) else f"{shown:.0f}" if abs(shown) >= 999.5 else f"{shown:.3g}"


def goals_markdown(rows: list[dict[str, Any]]) -> str:
    """The rows as a table, lengths in millimetres and angles in degrees; an experiment's name stands in its first row."""
    lines = ["| " + " | ".join(HEAD) + " |", "|" + " --- |" * len(HEAD)]
    named = ""
    for row in rows:
        factor, unit = SHOWN_AS.get(row["unit"], (1.0, row["unit"]))
        first, named = row["experiment"] != named, row["experiment"]
        limits = [(sign, row[key]) for key, sign in (("least", "≥"), ("goal", "≤")) if row[key] is not None]
        goal = " ".join(f"{sign} {number(value, factor)}" for sign, value in limits) or "–"
        said = PAPER.get(named, "–") if first else "–"
        paper = said if row["paper"] is None else number(row["paper"], factor)
        ours = "{} ({}, {})".format(*(number(row[k], factor) for k in ("median", "p95", "worst")))
        reached = {True: "yes", False: "**no**", None: ""}[row["reached"]]
        metric = f"`{row['metric']}`" + ("" if unit == "1" else f" [{unit}]")
        commit = row.get("commit", "unknown") if first else ""
        fields = [f"`{named}`" if first else "", metric, goal, paper, ours, commit, str(len(row["seeds"])), reached]
        lines.append("| " + " | ".join(fields) + " |")
    return "\n".join(lines) + "\n"


def publish(path: Path, mark: str, text: str, part: str = "") -> None:
    """Put ``text`` between the lines ``<!-- mark -->`` and ``<!-- end of mark -->`` of a document.

    ``part``: pattern of the lines with which the text's parts begin. What stands there of other parts stays, so that one experiment
    can be published anew.
    """
    first, last = f"<!-- {mark} -->\n", f"<!-- end of {mark} -->"
    previous, _, rest = path.read_text().partition(first)
    old, end, after = rest.partition(last)
    if not end:
        raise InputError(f"{path}: has no lines '{first.strip()}' and '{last}' to put the table between")
    path.write_text(previous + first + (_renewed(old, text, part) if part else text) + end + after)


def _renewed(old: str, new: str, part: str) -> str:
    """``old`` with the parts of ``new`` in place of those that begin with the same words, or behind all others."""
    (head, *parts), (_, *others) = (re.split(f"(?m)^(?={part})", text) for text in (new, old))
    name = lambda text: re.split(r"(?<=`) |\n", text)[0]
    given = {name(p): p for p in parts}
    kept = {name(p): p for p in others}
    return head + "".join((kept | given).values())
