"""The table of goals: what a study over seeds reached of each experiment's goals, beside the papers' figures."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

#: Units that are shown as others: factor and name.
SHOWN_AS = {"m": (1e3, "mm"), "rad": (180.0 / np.pi, "deg")}
HEAD = ("experiment", "metric", "unit", "goal", "paper", "ours: median (95 %, worst)", "seeds", "reached")


def order_statistics(values: Iterable[float | None]) -> tuple[float, float, float, float, float]:
    """Smallest, 5 %, median, 95 % and largest; a figure that is not finite (None) counts as infinite.

    Order statistics, nothing between values: a mean with infinity is not a figure.
    """
    known = np.array([np.inf if v is None else float(v) for v in values])
    low, middle, high = (float(np.quantile(known, q, method="nearest")) for q in (0.05, 0.5, 0.95))
    return float(known.min()), low, middle, high, float(known.max())


def goal_rows(name: str, runs: list[dict[str, Any]], goals: dict[str, float]) -> list[dict[str, Any]]:
    """A row for every metric of ``runs`` (contents of metrics.json) that has a goal; ``goals``: others than the runs' own.

    A goal is reached when every run completed and the 95 % value reaches it (the 5 % value, for a smallest one).
    """
    rows = []
    for metric in dict.fromkeys(n for r in runs for n in r["metrics"]):
        having = [r for r in runs if metric in r["metrics"]]
        target = having[0].get("targets", {}).get(metric, {})
        goal, least = goals.get(metric, target.get("goal")), target.get("least")
        if goal is None and least is None:
            continue
        first, p5, median, p95, last = order_statistics(r["metrics"][metric]["value"] for r in having)
        reached = all(r["completed"] for r in runs) and len(having) == len(runs)
        reached &= (goal is None or p95 <= goal) and (least is None or p5 >= least)
        # of figures with a smallest value only, the small ones are the bad ones
        bad, worst = (p5, first) if goal is None else (p95, last)
        rows.append({
            "experiment": name, "metric": metric, "unit": having[0]["metrics"][metric]["unit"], "goal": goal,
            "least": least, "paper": target.get("paper"), "median": median, "p95": bad, "worst": worst,
            "seeds": [r["seed"] for r in runs], "reached": bool(reached),
        })  # fmt: skip
    return rows


def goals_markdown(rows: list[dict[str, Any]]) -> str:
    """The rows as a table, lengths in millimetres and angles in degrees."""
    lines = ["| " + " | ".join(HEAD) + " |", "|" + " --- |" * len(HEAD)]
    for row in rows:
        factor, unit = SHOWN_AS.get(row["unit"], (1.0, row["unit"]))
        text = lambda v, f=factor: "∞" if not np.isfinite(v) else f"{f * v:.3g}"
        goal = " ".join(
            f"{sign} {text(row[key])}" for key, sign in (("least", "≥"), ("goal", "≤")) if row[key] is not None
        )
        paper = "–" if row["paper"] is None else text(row["paper"])
        ours = f"{text(row['median'])} ({text(row['p95'])}, {text(row['worst'])})"
        reached = "yes" if row["reached"] else "**no**"
        fields = [f"`{row['experiment']}`", row["metric"], unit, goal, paper, ours, str(len(row["seeds"])), reached]
        lines.append("| " + " | ".join(fields) + " |")
    return "\n".join(lines) + "\n"
