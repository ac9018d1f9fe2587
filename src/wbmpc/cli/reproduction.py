"""`wbmpc reproduce`: all experiments, and one site."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Annotated

import typer

from wbmpc.cli.directories import AsJson, resumed_directory
from wbmpc.cli.terminal import INTERRUPTED, experiment_names, progress_bar


def reproduce(
    context: typer.Context,
    only: Annotated[
        list[str] | None,
        typer.Option(help="An experiment (default: all); may be repeated.", autocompletion=experiment_names),
    ] = None,
    seeds: Annotated[str, typer.Option(help="Seeds, as 300-319, 3 or 1,5-7.")] = "300-319",
    out: Annotated[Path, typer.Option(help="Directory of the site; what is finished there is not run again.")] = Path(
        "reproduced"
    ),
    workers: Annotated[int, typer.Option(min=0, help="Runs at a time (0: as many as there are cores).")] = 0,
    clips: Annotated[bool, typer.Option("--clips/--no-clips", help="Draw a clip of each experiment.")] = True,
    as_json: AsJson = False,
) -> None:
    """Run the experiments over seeds and write one site: figures compared with the papers', clips, a page for every run.

    The site shows all finished runs of its directory, also those of earlier calls.
    """
    from wbmpc.reproduce import jobs_of_site, parse_seeds, plan, run_all, runs_of_site, summarize, write_site

    names = [context.obj.find(name).name for name in only] if only else list(context.obj.registry)
    jobs = plan(names, parse_seeds(seeds), out)
    verbose = not (as_json or context.obj.quiet)
    with resumed_directory("--out", out, runs_of_site(context.obj.registry)), progress_bar("reproduce", verbose) as bar:
        # hours go by: in a pipe every finished run is a line
        progress = bar or (lambda _, note: typer.echo(note, err=True) if verbose else None)
        try:
            failed = run_all(jobs, workers or len(os.sched_getaffinity(0)), progress)
        except KeyboardInterrupt:
            done = f"{sum(job.done for job in jobs)} of {len(jobs)} runs are finished"
            typer.echo(f"wbmpc: interrupted: {done}; the same command continues from there", err=True)
            raise typer.Exit(INTERRUPTED) from None
    jobs = jobs_of_site(jobs, out, list(context.obj.registry))
    index = write_site(jobs, failed, out, clips)
    lost = [{"experiment": j.name, "seed": j.seed, "reason": reason} for j, reason in failed.items()]
    if as_json:
        figures = {name: entry["metrics"] for name, entry in summarize(jobs).items()}
        finite = json.loads(json.dumps(figures), parse_constant=lambda _: None)
        typer.echo(json.dumps({"index": str(index), "experiments": finite, "failed": lost}))
    else:
        for run in lost:
            typer.echo(f"{run['experiment']}, seed {run['seed']}, gave no result: {run['reason']}")
        typer.echo(f"the site is {index}")
    if lost:
        raise typer.Exit(1)
