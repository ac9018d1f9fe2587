"""A run on disk: metrics.json, log.npz and report.html."""

from __future__ import annotations

import json
import tempfile
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from wbmpc.errors import NotWritten
from wbmpc.log import write_log
from wbmpc.output_file import write_text
from wbmpc.report.provenance import versions
from wbmpc.report.run_page import page, plain
from wbmpc.result import MpcStatistics, RunResult

#: Name of the recording in a run's directory.
RECORDING = "run.mcap"
#: All files of a run.
RUN_FILES = ("metrics.json", "log.npz", "report.html", RECORDING, "run-1.mcap")


def to_json(result: RunResult, files: dict[str, str]) -> dict[str, Any]:
    """The object that ``--json`` prints. A figure that is not finite is null."""
    return {
        "experiment": result.experiment,
        "seed": plain(result.seed),
        "outcome": result.outcome,
        "completed": plain(result.completed),
        "reason": result.reason,
        "metrics": {k: {"value": plain(m.value), "unit": m.unit} for k, m in result.metrics.items()},
        "mpc": None if result.mpc is None else _mpc(result.mpc),
        "files": files,
    }


def _mpc(mpc: MpcStatistics) -> dict[str, Any]:
    return {
        "rate_hz": plain(mpc.rate_hz),
        "solve_ms": {k: plain(round(v, 4)) for k, v in mpc.solve_ms.items()},
        **{key: plain(getattr(mpc, key)) for key in ("deadline_misses", "solves", "failures", "no_step")},
        "failed_share": plain(round(mpc.failed_share, 6)),
    }


def about_run(experiment: str, seed: int, settings: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """What a recording says about its run before it begins: tables by name."""
    started = datetime.now(UTC).isoformat(timespec="seconds")
    run = {"experiment": experiment, "seed": seed, "started": started, "settings": json.dumps(plain(settings))}
    return {"run": run, "versions": versions()}


def outcome(result: RunResult) -> dict[str, Any]:
    """What a recording says at its end."""
    figures = {name: m.value for name, m in result.metrics.items()}
    about = {"outcome": result.outcome, "completed": str(result.completed).lower(), "reason": result.reason}
    return {**about, "metrics": json.dumps(plain(figures))}


def write_run(result: RunResult, directory: Path) -> dict[str, str]:
    """Write all files of a run into ``directory`` (made if missing); returns their paths by kind.

    metrics.json comes last and as a whole: where it is, all that it names is there. Raises :class:`NotWritten` naming a file that
    cannot be written; metrics.json is then in a directory for temporary files, or the message says what would be in it.
    """
    files = {
        n: str(directory / f) for n, f in (("metrics", "metrics.json"), ("log", "log.npz"), ("report", "report.html"))
    }
    if (directory / RECORDING).exists():
        files["recording"] = str(directory / RECORDING)
    targets = {
        n: {"paper": plain(m.paper), "goal": plain(m.goal), "least": plain(m.least), "definition": m.definition}
        for n, m in result.metrics.items()
    }
    more = {
        "targets": targets, "settings": plain(result.settings), "idealisations": result.idealizations,
        "faults": result.faults, "versions": versions(), "command": result.command,
        "wall_time": plain(result.wall_time),
    }  # fmt: skip
    text = json.dumps({**to_json(result, files), **more}, indent=2, allow_nan=False) + "\n"
    try:
        _make(directory)
        write_log(result.log, Path(files["log"]), follow=False)
        write_text(Path(files["report"]), page(result), follow=False)
        write_text(Path(files["metrics"]), text, follow=False)
    except NotWritten as error:
        raise NotWritten(f"{error}; {_elsewhere(result, text)}") from error
    return files


def _make(directory: Path) -> None:
    """A directory, if it is not there: another program may have put something else in its place while the run went on."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise NotWritten(f"{directory}: cannot be made ({error.strerror})") from error


def _elsewhere(result: RunResult, text: str) -> str:
    """Put the figures where there may be room; says where they are, or what they are."""
    try:
        path = Path(tempfile.mkdtemp(prefix=f"wbmpc-{result.experiment}-")) / "metrics.json"
        path.write_text(text)
        return f"the figures of the run are in {path}"
    except OSError:
        figures = {name: plain(m.value) for name, m in result.metrics.items()}
        return f"the figures of the run are {json.dumps(figures)}"
