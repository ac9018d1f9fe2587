"""`wbmpc export`: a controller for a robot's own program."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from wbmpc.cli.directories import AsJson, Force, reject_existing, reject_links, writable_directory
from wbmpc.cli.terminal import ABORTED
from wbmpc.errors import printable


def export(
    problem: Annotated[
        str,
        typer.Argument(
            help="FILE.py with a function 'make_mpc' or an MPC named 'mpc', or FILE.py:NAME for another one."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Directory for the files.")],
    prefix: Annotated[
        str, typer.Option(help="Prefix of all names in C; several controllers need different ones.")
    ] = "controller",
    target: Annotated[str, typer.Option(help="Processor: native, x86-64-v3 or aarch64.")] = "native",
    samples: Annotated[int, typer.Option(help="Samples of each reference, and events, that there is room for.")] = 100,
    check: Annotated[
        bool, typer.Option("--check", help="Compile the example, run it, compare it with the loop in Python.")
    ] = False,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Write an MPC as an object file with a C header, which needs no Python."""
    from wbmpc.embedded.check import check as compare
    from wbmpc.embedded.check import tools
    from wbmpc.embedded.exporter import export as write
    from wbmpc.embedded.exporter import files
    from wbmpc.registry import load_mpc

    if check:
        tools(target)
    written = [out / name for name in files(prefix, check)]
    reject_links("--out", written)
    reject_existing("--out", written, force)
    mpc = load_mpc(problem)
    with writable_directory("--out", out):
        done = write(mpc, out, prefix=prefix, target=target, samples=samples)
        compared = compare(done, mpc) if check else None
    if as_json:
        found = {
            "object": str(out / f"{prefix}.o"), "target": target, "object_bytes": done.object_size,
            "block_bytes": done.block_size,
        }  # fmt: skip
        found |= {"defined": done.symbols.defined, "undefined": done.symbols.undefined}
        found |= {} if compared is None else {"check": {**vars(compared), "passed": compared.passed}}
        typer.echo(json.dumps(found))
    else:
        typer.echo(
            printable(
                f"{out / prefix}.o: {done.object_size / 1000:.0f} kB for {target}, block {done.block_size / 1000:.0f} kB"
            )
        )
        typer.echo(
            printable(f"functions: {', '.join(done.symbols.defined)}; needs: {', '.join(done.symbols.undefined)}")
        )
        if compared is not None:
            typer.echo(f"check: {compared}")
    if compared is not None and not compared.passed:
        raise typer.Exit(ABORTED)
