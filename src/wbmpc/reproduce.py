"""All experiments over seeds, each run in a process of its own, and one site of what came out.

A run that crashes or is killed loses nothing but itself; what is finished is not run again.
"""

from __future__ import annotations

import html
import json
import os
import re
import statistics
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from wbmpc.errors import InputError
from wbmpc.output_file import write_text
from wbmpc.report import RUN_FILES, document, goal_text, named, table
from wbmpc.result import Metric
from wbmpc.run_files import definition_in, read_metrics
from wbmpc.units import scale

#: Seeds of one call, at most: those of a robot that balances take about a minute each, in every experiment.
MAX_SEEDS = 1000
_SEEDS = re.compile(r"\s*(?P<first>[0-9]{1,9})(-(?P<last>[0-9]{1,9}))?\s*")
#: Exit codes after which there is a result: completed, or ended early with its figures.
_FINISHED = (0, 1)
_POLL = 0.05
#: What a run says on standard error, beside its own files.
_ERRORS = "errors.txt"
#: Speed and size [pixels] of the clips.
CLIP_SPEED, CLIP_SIZE = 4.0, (640, 360)


@dataclass(frozen=True)
class Job:
    """One run and the directory of its files."""

    name: str
    seed: int
    directory: Path

    @property
    def mark(self) -> Path:
        """A file that is there once the run is finished, not before."""
        return self.directory / "finished"

    @property
    def done(self) -> bool:
        """Whether it is finished."""
        return self.mark.is_file()


def parse_seeds(text: str, where: str = "--seeds", most: int = MAX_SEEDS) -> list[int]:
    """``300-319``, ``3`` or ``1,5-7`` as numbers, ``most`` at most. Raises :class:`InputError` that begins with ``where``."""
    seeds: dict[int, None] = {}
    for part in text.split(","):
        found = _SEEDS.fullmatch(part)
        if found is None or int(found["last"] or found["first"]) < int(found["first"]):
            raise InputError(f"{where}: '{text}': valid: 300-319, 3 or 1,5-7, numbers of up to nine digits")
        target = range(int(found["first"]), int(found["last"] or found["first"]) + 1)
        if len(seeds) + len(target) > most:
            raise InputError(f"{where}: '{text}': these are more than {most} seeds; give fewer in one call")
        seeds |= dict.fromkeys(target)
    return list(seeds)


def plan(names: Iterable[str], seeds: Iterable[int], out: Path) -> list[Job]:
    """All runs, seed by seed, so that every experiment has something to show early."""
    names = list(names)
    return [Job(name, seed, out / name / f"seed{seed}") for seed in seeds for name in names]


def finished(site: Path) -> list[Job]:
    """All finished runs in a directory of :func:`plan`, also of earlier calls, by experiment and seed."""
    places = [mark.parent for mark in site.glob("*/seed*/finished") if re.fullmatch("seed[0-9]+", mark.parent.name)]
    jobs = [Job(place.parent.name, int(place.name.removeprefix("seed")), place) for place in places]
    return sorted(jobs, key=lambda job: (job.name, job.seed))


def jobs_of_site(jobs: Iterable[Job], site: Path, order: Sequence[str] = ()) -> list[Job]:
    """``jobs`` and what else is finished there, by experiment (as in ``order``, others after them) and seed."""
    places = {name: k for k, name in enumerate(order)}
    found = dict.fromkeys([*jobs, *finished(site)])
    return sorted(found, key=lambda job: (places.get(job.name, len(places)), job.name, job.seed))


def runs_of_site(experiments: Iterable[str]) -> list[str]:
    """Patterns of what is in a site's directory as soon as its runs begin; runs of other programs have such folders too."""
    return [f"{name}/seed[0-9]*" for name in experiments]


def command(job: Job) -> list[str]:
    """What the run's process executes."""
    options = ["--seed", str(job.seed), "--out", str(job.directory), "--json"]
    return [sys.executable, "-m", "wbmpc", "run", job.name, *options]


def run_all(
    jobs: list[Job], workers: int, progress: Callable[[float, str], None] | None = None,
    make: Callable[[Job], list[str]] = command,
) -> dict[Job, str]:  # fmt: skip
    """Run what is not finished, ``workers`` at a time; returns why runs gave no result. Ctrl-C ends the runs that go on."""
    waiting, running, failed = [j for j in jobs if not j.done], {}, {}  # type: ignore[var-annotated]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = len(jobs) - len(waiting)
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                job = waiting.pop(0)
                job.directory.mkdir(parents=True, exist_ok=True)
                # of a run that was killed: a new one would go elsewhere; and pipes, whose readers never come
                for name in (*RUN_FILES, _ERRORS):
                    (job.directory / name).unlink(missing_ok=True)
                # a file, not a pipe: it is not read while the run goes on
                with (job.directory / _ERRORS).open("w") as errors:
                    running[job] = subprocess.Popen(
                        make(job), stdout=subprocess.DEVNULL, stderr=errors, env=environment
                    )
            for job, process in list(running.items()):
                if process.poll() is None:
                    continue
                del running[job]
                done += 1
                reason = _finish(job, process.returncode)
                if reason:
                    failed[job] = reason
                if progress is not None:
                    progress(done / len(jobs), f"{done} of {len(jobs)} runs, {len(failed)} failed")
            time.sleep(_POLL)
    finally:
        for process in running.values():
            process.kill()
            process.wait()
    return failed


def _finish(job: Job, code: int) -> str:
    """Mark a run as finished; or say why it has given nothing."""
    if code in _FINISHED and (job.directory / "metrics.json").is_file():
        job.mark.touch()
        return ""
    lines = (job.directory / _ERRORS).read_text(errors="replace").strip().splitlines()
    return lines[-1] if lines else f"the process ended with code {code}"


# ---------------------------------------------------------------------- the site
def summarize(jobs: list[Job]) -> dict[str, Any]:
    """By experiment: the runs' files, and over all finished runs median and worst of each metric beside paper and goal."""
    out: dict[str, Any] = {}
    for job in jobs:
        if job.done:
            out.setdefault(job.name, {"runs": {}})["runs"][job.seed] = read_metrics(job.directory / "metrics.json")
    for entry in out.values():
        runs = list(entry["runs"].values())
        entry["metrics"] = {name: _spread(name, runs) for name in dict.fromkeys(n for r in runs for n in r["metrics"])}
    return out


def _spread(name: str, runs: list[dict[str, Any]]) -> dict[str, Any]:
    having = [r for r in runs if name in r["metrics"]]
    values = [r["metrics"][name]["value"] for r in having]
    # a figure that is not finite is null in the file: as bad as can be
    known = [float("inf") if v is None else float(v) for v in values]
    target = having[0]["targets"].get(name, {})
    median, bounds = statistics.median(known), {key: target.get(key) for key in ("paper", "goal", "least")}
    unit = having[0]["metrics"][name]["unit"]
    # a run that did not complete reaches no goal, whatever it measured before its end, and also if it had no time to measure
    worst = float("inf" if bounds["least"] is None else "-inf")
    counted = [v if r.get("completed", True) else worst for v, r in zip(known, having, strict=True)]
    counted += [worst] * (len(runs) - len(having))
    # the median of falls says nothing: what may never happen is judged by the worst run
    judged = Metric(max(counted) if bounds["goal"] == 0 else statistics.median(counted), unit, **bounds)
    about = {"unit": unit, "definition": definition_in(having[0], name)}
    return {**about, "median": median, "worst": max(known), **bounds, "met": judged.met}


def _outcome(run: dict[str, Any]) -> str:
    """How a run ended, in one word; of files without it as far as it is known."""
    return run.get("outcome") or ("completed" if run.get("completed") else "gave_up")


_OUTCOME = {True: '<span class="met">pass</span>', False: '<span class="missed">falls short</span>', None: ""}
_HEADER = ["metric", "unit", "median", "largest", "paper", "goal", ""]


def _metric_rows(metrics: dict[str, Any]) -> list[list[str]]:
    return [_metric_row(name, m) for name, m in metrics.items()]


def _metric_row(name: str, m: dict[str, Any]) -> list[str]:
    figures = [m[k] for k in ("median", "worst", "paper")]
    shown = scale(m["unit"], *figures, m["goal"], m["least"])
    goal = goal_text(Metric(m["median"], m["unit"], goal=m["goal"], least=m["least"]), shown)
    return [named(name, m["definition"]), html.escape(shown.unit), *map(shown.text, figures), goal, _OUTCOME[m["met"]]]


def write_site(jobs: list[Job], failed: dict[Job, str], out: Path, clips: bool = True) -> Path:
    """The index and a page for each experiment; links are relative, nothing comes from a network. Returns the index.

    ``jobs``: all that it shows (see :func:`jobs_of_site`).
    """
    found, sections = summarize(jobs), []
    names = list(dict.fromkeys(j.name for j in jobs))
    for name in names:
        lost = {j.seed: reason for j, reason in failed.items() if j.name == name}
        if name not in found:
            why = "; ".join(f"seed {s}: {html.escape(r)}" for s, r in lost.items())
            sections.append(f"<h2>{html.escape(name)}</h2><p>No run gave a result. {why}</p>")
            continue
        page = out / name / "index.html"
        write_text(page, _experiment_page(name, found[name], lost, _clip(jobs, name, out, clips)), follow=False)
        outcomes = Counter(_outcome(r) for r in found[name]["runs"].values())
        paper = {
            n: m for n, m in found[name]["metrics"].items() if any(m[k] is not None for k in ("paper", "goal", "least"))
        }
        failed_how = "".join(f", {n} {html.escape(how)}" for how, n in sorted(outcomes.items()) if how != "completed")
        count = f"{outcomes['completed']} of {len(found[name]['runs'])} runs completed{failed_how}" + (
            f", {len(lost)} gave no result" if lost else ""
        )
        link = f'<a href="{html.escape(quote(os.fsencode(name)))}/index.html">{html.escape(name)}</a>'
        sections.append(f"<h2>{link}</h2><p class=sub>{count}.</p>{table(_HEADER, _metric_rows(paper), {2, 3, 4, 5})}")
    about = (
        "Ours: simulated in MuJoCo, plant perturbed; paper: the real robot. Medians over seeds are judged against the goals; "
        "a goal of zero has to hold in every run."
    )
    body = f'<h1>Experiments</h1><p class="sub">{about}</p>{_count(found)}{"".join(sections)}{_versions(found)}'
    index = out / "index.html"
    write_text(index, document("Experiments", body, plots=False), follow=False)
    return index


def _count(found: dict[str, Any]) -> str:
    """How many goals are reached, and which are not."""
    judged = {f"{name}: {metric}": m["met"] for name, e in found.items() for metric, m in e["metrics"].items()}
    judged = {key: met for key, met in judged.items() if met is not None}
    short = [html.escape(key) for key, met in judged.items() if not met]
    text = f"{len(judged) - len(short)} of {len(judged)} goals pass" + (f"; short: {', '.join(short)}" if short else "")
    return f'<div class="card summary {"fair" if short else ""}">{text}.</div>' if judged else ""


def _versions(found: dict[str, Any]) -> str:
    runs = [run for entry in found.values() for run in entry["runs"].values()]
    rows: dict[str, list[str]] = {}
    for run in runs:
        for key, value in run["versions"].items():
            rows.setdefault(key, [])
            rows[key] += [value] if value not in rows[key] else []
    cells = "".join(f"<dt>{html.escape(k)}</dt><dd>{html.escape(', '.join(v))}</dd>" for k, v in rows.items())
    return f'<h2>Machine and versions</h2><div class="card" style="padding: 10px 16px"><dl>{cells}</dl></div>'


def _experiment_page(name: str, entry: dict[str, Any], lost: dict[int, str], clip: str) -> str:
    runs = []
    for seed, run in entry["runs"].items():
        state = "completed" if run.get("completed") else html.escape(f"{_outcome(run)}: {run.get('reason') or ''}")
        runs.append([f'<a href="seed{seed}/report.html">seed {seed}</a>', state])
    runs += [[f"seed {seed}", f"no result: {html.escape(reason)}"] for seed, reason in lost.items()]
    shown, first = next(iter(entry["runs"].items()))
    ideal = "".join(f"<li>{html.escape(line)}</li>" for line in first["idealisations"])
    settings = html.escape(json.dumps(first["settings"], indent=2))
    body = f"""<h1>{html.escape(name)}</h1><p class="sub"><a href="../index.html">all experiments</a></p>
<h2>Figures</h2>{table(_HEADER, _metric_rows(entry["metrics"]), {2, 3, 4, 5})}
<h2>Clip</h2>{clip}
<h2>Redrawn figures</h2><p class="sub">Seed {shown}, at its plots; they can be zoomed.</p>
<iframe class="card" style="width: 100%; height: 900px" title="plots of seed {shown}" src="seed{shown}/report.html#plots"></iframe>
<h2>Runs</h2><p class="sub">Each run's page has its plots.</p>{table(["run", ""], runs, set())}
<h2>What is idealized</h2><ul class="card">{ideal}</ul>
<h2>Settings</h2><details class="card"><summary>Settings of all runs</summary><pre>{settings}</pre></details>
{_versions({name: entry})}"""
    return document(name, body, plots=False)


def _clip(jobs: list[Job], name: str, out: Path, target: bool) -> str:
    """The clip of the first finished run, drawn once; or why there is none."""
    path, job = out / name / "clip.mp4", next(j for j in jobs if j.name == name and j.done)
    if path.is_symlink():  # the name is ours, and what it leads to is not
        path.unlink()
    if target and not (path.is_file() and path.stat().st_mtime >= job.mark.stat().st_mtime):
        from wbmpc.recording.reader import read_recording
        from wbmpc.view.render import render
        from wbmpc.view.replay import Film

        try:
            render(Film(read_recording(job.directory)), path, (0.0, float("inf")), CLIP_SIZE, CLIP_SPEED)
        except InputError as error:
            return f"<p>There is no clip: {html.escape(str(error))}</p>"
    if not path.is_file():
        return "<p>There is no clip: it was not asked for.</p>"
    return f'<video controls loop muted style="width: 100%" src="clip.mp4"></video><p class="sub">{CLIP_SPEED:g} times as fast.</p>'
