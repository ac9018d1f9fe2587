"""One table of a study under the protocol: every figure with a goal beside the paper's, over seeds.

Used by robustness.py (table.md begins with it, table.json has it as ``overview``, ``--docs`` puts it into a document).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

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
#: Units in which lengths and angles are shown: (factor, name).
UNITS = {"m": (1e3, "mm"), "rad": (180.0 / np.pi, "deg")}
HEAD = ("experiment", "metric", "goal", "paper", "ours: median (95 %, worst)", "seeds", "reached")


def reached(s: Mapping[str, Any]) -> bool | None:
    """Whether the 95 % value is at most the goal, and the 5 % value at least the least one; None without either."""
    if s["goal"] is None and s["least"] is None:
        return None
    return bool((s["goal"] is None or s["p95"] <= s["goal"]) and (s["least"] is None or s["p5"] >= s["least"]))


def rows(
    experiment: str, seeds: int, statistics: Mapping[str, dict[str, Any]], also: Iterable[str]
) -> list[dict[str, Any]]:
    """The figures that have a goal, and those named ``also``, in the order of the experiment; statistics as
    ``robustness.Cell`` has them."""
    return [
        {"experiment": experiment, "metric": name, "seeds": seeds, "reached": reached(s), **s}
        for name, s in statistics.items()
        if reached(s) is not None or name in also
    ]


def number(value: float | None, factor: float = 1.0) -> str:
    """Three digits, or all of a whole number; a dash for what there is not."""
    if value is None:
        return "–"
    shown = factor * value
    return "∞" if not np.isfinite(shown) else f"{shown:.0f}" if abs(shown) >= 999.5 else f"{shown:.3g}"


def _goal(s: Mapping[str, Any], factor: float) -> str:
    if reached(s) is None:
        return "–"
    low, high = (number(s[k], factor) for k in ("least", "goal"))
    return f"≤ {high}" if s["least"] is None else f"≥ {low}" if s["goal"] is None else f"{low} to {high}"


def markdown(table: list[dict[str, Any]]) -> str:
    """The rows as a table; the name of an experiment stands in its first row."""
    lines = ["| " + " | ".join(HEAD) + " |", "|" + " --- |" * len(HEAD)]
    named = ""
    for row in table:
        factor, unit = UNITS.get(row["unit"], (1.0, row["unit"]))
        first, named = row["experiment"] != named, row["experiment"]
        metric = f"`{row['metric']}`" + ("" if unit == "1" else f" [{unit}]")
        paper = PAPER.get(named, "–") if first and row["paper"] is None else number(row["paper"], factor)
        ours = "{} ({}, {})".format(*(number(row[k], factor) for k in ("median", "p95", "worst")))
        verdict = {True: "yes", False: "**no**", None: ""}[row["reached"]]
        cells = [f"`{named}`" if first else "", metric, _goal(row, factor), paper, ours, str(row["seeds"]), verdict]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def put(text: str, mark: str, table: str) -> str:
    """The text of a document with the table between ``<!-- MARK -->`` and ``<!-- end of MARK -->`` in place of what is there."""
    start, end = f"<!-- {mark} -->", f"<!-- end of {mark} -->"
    if text.count(start) != 1 or text.count(end) != 1:
        raise SystemExit(f"no place for the table: '{start}' and '{end}' must each be there once")
    before, rest = text.split(start)
    return f"{before}{start}\n{table}\n{end}{rest.split(end)[1]}"
