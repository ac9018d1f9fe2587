"""The README's figures, from the statistics.json of studies: the words stay as they are, marks say which figure goes where.

A mark is a comment, which is not shown, before the figure and after it:

    <!--= swerve-track hand_error_mean_odometry mm -->1.2 mm (2.1)<!--/-->

names an experiment, a metric, a unit, and may end in ``median`` or ``worst`` (else both: median and worst in brackets), or in
``count`` (in how many runs a metric is not 0; of falls alone). The mark ``commit`` takes the commits that the figures are of; ``age`` is
that of docs/_ext/table_age.py. Marks
without figures keep what they have, and its commits. `python scripts/figures.py` fills them.
"""

from __future__ import annotations

import json
import re
import statistics
from pathlib import Path
from typing import Any

MARK = re.compile(r"(<!--= (?P<what>[^>]*?) -->)(?P<text>.*?)(<!--/-->)")
#: How a unit of the README is made of a metric's own.
UNITS = {"mm": 1e3, "m": 1.0, "%": 100.0, "s": 1.0, "rad": 1.0, "N": 1.0, "1": 1.0}


def of_study(file: Path) -> dict[str, dict[str, dict[str, Any]]]:
    """By experiment and metric: median and worst under the plain protocol; a figure that is not finite is infinite. Values of single runs
    are known of falls alone."""
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for cell in json.loads(file.read_text())["cells"]:
        if cell["condition"] not in ("", "protocol"):
            continue
        known = lambda value: float("inf") if value is None else value
        own = {m: {key: known(f[key]) for key in ("median", "worst")} for m, f in cell["metrics"].items()}
        ended = [float(how == "fell") for how, n in cell.get("outcomes", {}).items() for _ in range(n)]
        own["fell"] = {"median": statistics.median(ended or [0.0]), "worst": max(ended, default=0.0), "values": ended}
        found.setdefault(cell["experiment"], own)
    return found


def fill_from_studies(readme: Path, studies: list[Path]) -> list[str]:
    """Fill the README from statistics of studies; returns the marks that keep what they have."""
    found, commits = dict[str, dict[str, dict[str, Any]]](), set[str]()
    for study in studies:
        found |= of_study(study)
        commits |= set(json.loads(study.read_text())["commit"])
    filled, left = fill(readme.read_text(), found, ", ".join(sorted(commits)))
    readme.write_text(filled)
    return left


def short(value: float) -> str:
    """Two digits."""
    return "not a number" if value != value else f"{value:.0f}" if abs(value) >= 9.95 else f"{value:#.2g}".rstrip(".")


def text(what: str, found: dict[str, dict[str, dict[str, Any]]]) -> str | None:
    """What stands between a pair of marks; None without a figure for it."""
    name, metric, unit, *how = what.split()
    if unit not in UNITS or how not in ([], ["median"], ["worst"], ["count"]):
        raise SystemExit(f"readme: mark '{what}': valid: EXPERIMENT METRIC {'|'.join(UNITS)} [median|worst|count]")
    figures = found.get(name, {}).get(metric)
    if figures is None:
        return None
    if how == ["count"]:
        values = figures.get("values")
        return None if values is None else f"{sum(v != 0 for v in values)} of {len(values)}"
    median, worst = (short(UNITS[unit] * figures[key]) for key in ("median", "worst"))
    shown = "" if unit == "1" else f" {unit}"
    return {"": f"{median}{shown} ({worst})", "median": f"{median}{shown}", "worst": f"{worst}{shown}"}["".join(how)]


def fill(readme: str, found: dict[str, dict[str, dict[str, Any]]], commit: str = "") -> tuple[str, list[str]]:
    """The README with figures between its marks, and the marks for which there are none."""
    figures = {m["what"]: text(m["what"], found) for m in MARK.finditer(readme) if m["what"] not in ("commit", "age")}
    left = [what for what, new in figures.items() if new is None]

    def put(match: re.Match[str]) -> str:
        new = figures.get(match["what"])
        if match["what"] == "commit" and commit and len(left) < len(figures):
            kept = match["text"].split(", ") if left else []
            new = ", ".join(sorted({*kept, *commit.split(", ")}))
        return match[0] if new is None else f"{match[1]}{new}{match[4]}"

    return MARK.sub(put, readme), left
