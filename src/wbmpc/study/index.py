"""Studies and searches below a directory, for the list of runs and its page: read from their small files, and from rows of those
that were interrupted."""

from __future__ import annotations

import html
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

from wbmpc.errors import InputError, described
from wbmpc.input_file import load_json
from wbmpc.run_index import folders
from wbmpc.study.files import ABOUT, DATABASE, JOURNAL, PAGE, PARTS, ROWS, STATISTICS, TRIALS

_HEADS = ("study", "experiments", "runs", "not completed", "at goal", "written", "commit")


@dataclass(frozen=True)
class StudyEntry:
    """A study, or a search of settings (``trials``: how many it has finished; else None), in a ``directory``.

    ``planned`` (None: not known) and ``finished`` runs, ``failed`` of these did not complete. ``goals``: how many figures of its
    combinations reach their goal with 95 % of the runs, of how many. ``ended``: when it was last written. ``page``: its page, None
    where there is none yet. ``note``: what is missing, or cannot be read.
    """

    directory: Path
    ended: datetime
    title: str = ""
    experiments: tuple[str, ...] = ()
    planned: int | None = None
    finished: int = 0
    failed: int = 0
    goals: tuple[int, int] = (0, 0)
    commit: str = ""
    trials: int | None = None
    page: Path | None = None
    note: str = ""

    @property
    def runs(self) -> str:
        """``240 of 480``; of a search ``200 trials``."""
        if self.trials is not None:
            return f"{self.trials} trials"
        return f"{self.finished} of {'?' if self.planned is None else self.planned}"

    @property
    def at_goal(self) -> str:
        """``3 of 6``; empty without goals."""
        return f"{self.goals[0]} of {self.goals[1]}" if self.goals[1] else ""

    def to_json(self) -> dict[str, Any]:
        """The object that ``--json`` prints."""
        return {
            "directory": str(self.directory), "title": self.title, "experiments": list(self.experiments), "planned": self.planned,
            "finished": self.finished, "failed": self.failed, "trials": self.trials, "commit": self.commit, "note": self.note,
            "goals": {"reached": self.goals[0], "of": self.goals[1]}, "ended": self.ended.isoformat(timespec="seconds"),
            "page": None if self.page is None else str(self.page),
        }  # fmt: skip


def find_studies(root: Path) -> list[StudyEntry]:
    """The studies and searches below ``root``, the newest first, as deep as :func:`wbmpc.run_index.find_runs` looks."""
    found = []
    for directory, files in folders(root):
        if ABOUT in files:
            found.append(_read(directory, _study))
        elif DATABASE in files or TRIALS in files:
            found.append(_read(directory, _search))
    return sorted(found, key=lambda entry: (entry.ended, str(entry.directory)), reverse=True)


def _read(directory: Path, read: Any) -> StudyEntry:
    """An entry; one with a note where its files are damaged."""
    written = [_time(directory / name) for name in (ABOUT, STATISTICS, ROWS, JOURNAL, DATABASE, TRIALS)]
    page = directory / PAGE
    about: dict[str, Any] = {"ended": max(written), "page": page if page.is_file() else None}
    try:
        return StudyEntry(directory, **{**about, **read(directory)})
    except (InputError, OSError) as error:
        return StudyEntry(directory, **about, note=str(error))
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        return StudyEntry(directory, **about, note=f"{directory}: its files are no study's ({described(error)})")


def _time(path: Path) -> datetime:
    try:
        return datetime.fromtimestamp(path.stat().st_mtime, UTC)
    except (OSError, ValueError, OverflowError):  # also times of no calendar
        return datetime.fromtimestamp(0.0, UTC)


def _study(directory: Path) -> dict[str, Any]:
    """What a study's own files say. Rows that its tables do not have yet are counted."""
    about, tables = load_json(directory / ABOUT), directory / STATISTICS
    planned = about.get("planned")
    experiments = tuple(dict.fromkeys(str(c["experiment"]) for c in about["combinations"].values()))
    found: dict[str, Any] = {
        "title": str(about["title"]), "experiments": experiments, "planned": None if planned is None else int(planned),
    }  # fmt: skip
    if tables.is_file():
        found |= _figures(load_json(tables))
    if (directory / JOURNAL).is_file() or (directory / PARTS).is_dir() or not tables.is_file():
        from wbmpc.study.store import Store
        from wbmpc.study.work import ERROR, LOST

        outcomes = Counter(row["outcome"] for row in Store(directory).outcomes().values())
        finished = sum(n for outcome, n in outcomes.items() if outcome not in (ERROR, LOST))
        found |= {"finished": finished, "failed": finished - outcomes["completed"]}
        found["note"] = "was interrupted or is running; the same command continues"
    return found


def _figures(tables: dict[str, Any]) -> dict[str, Any]:
    """Of statistics.json."""
    cells = tables["cells"]
    met = [m["met"] for cell in cells for m in cell["metrics"].values() if m["met"] is not None]
    lost = sum(map(int, tables["lost"].values()))
    return {
        "planned": int(tables["planned"]), "finished": int(tables["finished"]), "goals": (sum(map(bool, met)), len(met)),
        "failed": sum(int(cell["failures"]["failed"]) for cell in cells), "commit": ", ".join(map(str, tables["commit"])),
        "note": f"{lost} runs without a result" if lost else "",
    }  # fmt: skip


def _search(directory: Path) -> dict[str, Any]:
    """What a search has written; while it goes on its trials are in a database that is left alone."""
    trials = directory / TRIALS
    if not trials.is_file():
        return {
            "title": directory.name,
            "trials": 0,
            "note": "the search was interrupted or is running; the same command continues",
        }
    found = load_json(trials)
    fine = sum(bool(trial["feasible"]) for trial in found)
    return {"title": directory.name, "trials": len(found), "note": f"{fine} of them keep the constraints"}


def section(studies: Sequence[StudyEntry], beside: Path) -> str:
    """The table of studies as a part of the page of runs; links are relative to ``beside``. Empty without studies."""
    if not studies:
        return ""
    heads = "".join(f"<th{_side(k)}>{name}</th>" for k, name in enumerate(_HEADS))
    rows = "".join(f"<tr>{_cells(entry, beside)}</tr>" for entry in studies)
    table = f'<div class="card scroll"><table><tr>{heads}</tr>{rows}</table></div>'
    return f'<section id="Studies"><h2>Studies</h2>{table}</section>'


def _side(column: int) -> str:
    return " class=n" if column in (2, 3, 4) else ""


def _cells(entry: StudyEntry, beside: Path) -> str:
    name = html.escape(os.path.relpath(entry.directory, beside))
    if entry.page is not None:
        name = f'<a href="{html.escape(quote(os.fsencode(os.path.relpath(entry.page, beside))))}">{name}</a>'
    note = f'<span class="note">{html.escape(entry.note)}</span>' if entry.note else ""
    count = entry.finished if entry.trials is None else entry.trials
    reached, judged = entry.goals
    values = {2: count, 3: entry.failed, 4: reached / judged if judged else ""}
    texts = (
        name + note, html.escape(", ".join(entry.experiments)), entry.runs, "" if entry.trials is not None else str(entry.failed),
        entry.at_goal, f"{entry.ended:%Y-%m-%d %H:%M:%S}", html.escape(entry.commit),
    )  # fmt: skip
    data = lambda k: f' data-v="{values[k]}"' if k in values else ""
    return "".join(f"<td{_side(k)}{data(k)}>{text}</td>" for k, text in enumerate(texts))
