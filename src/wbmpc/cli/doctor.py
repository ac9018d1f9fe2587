"""`wbmpc doctor`: what is wrong with a robot's file, and how to fix it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Annotated

import typer

from wbmpc.cli.directories import AsJson
from wbmpc.cli.terminal import BAD_INPUT, robot_names
from wbmpc.errors import InputError, printable

if TYPE_CHECKING:
    from wbmpc.robots.findings import Finding

Packages = Annotated[
    list[str] | None,
    typer.Option("--package", metavar="NAME=FOLDER", help="Where a ROS package of the model is; may be repeated."),
]
Arguments = Annotated[
    list[str] | None,
    typer.Option("--argument", metavar="NAME=VALUE", help="Argument of the model's macros (xacro); may be repeated."),
]


def pairs(option: str, given: list[str] | None) -> dict[str, str]:
    """NAME=VALUE of an option that may be repeated; ROS' NAME:=VALUE too."""
    found = {}
    for text in given or []:
        name, sign, value = text.partition("=")
        if not (sign and name.rstrip(":") and value):
            raise InputError(f"{option}: NAME=VALUE is needed, got '{text}'")
        found[name.rstrip(":")] = value
    return found


#: Of what is printed [characters]: a list of pairs has many lines.
WIDTH = 140
#: What findings of a severity are called in the last line.
_COUNTED = {"error": "error", "warning": "warning", "info": "note"}


def collisions(path: str) -> list[Finding]:
    """What of its own a robot that loads keeps apart."""
    from wbmpc.model.robot import load_robot
    from wbmpc.obstacles.pairs import diagnose
    from wbmpc.robots.findings import Finding

    found: list[Finding] = []
    try:
        for finding in diagnose(load_robot(path)):
            found.append(finding)
    except InputError as error:
        found.append(Finding("warning", "collision", "", str(error)))
    return found


def doctor(
    robot: Annotated[
        str,
        typer.Argument(
            help="A robot's YAML, a URDF, xacro or MJCF, or a built-in robot's name.", autocompletion=robot_names
        ),
    ],
    package: Packages = None,
    argument: Arguments = None,
    as_json: AsJson = False,
) -> None:
    """Check a robot's file: list faults, how to fix them, and properties worth knowing. Exit status 2 if there are errors."""
    from wbmpc.robots.doctor import examine_robot
    from wbmpc.robots.read_once import reading_once

    folders = {name: Path(folder) for name, folder in pairs("--package", package).items()}
    with reading_once():
        result = examine_robot(robot, folders, pairs("--argument", argument))
        if not result.count("error") and not folders and Path(result.robot).suffix in (".yaml", ".yml"):
            result = replace(result, findings=(*result.findings, *collisions(result.robot)))
    if as_json:
        findings = [vars(f) for f in result.findings]
        summary = {
            "robot": result.robot, "model": result.model, "errors": result.count("error"),
            "warnings": result.count("warning"),
        }  # fmt: skip
        typer.echo(json.dumps({**summary, "check_ms": round(result.milliseconds, 1), "findings": findings}))
    else:
        for finding in result.findings:
            line = printable(f"{finding.severity:8s}{finding.check:14s}{finding.message}")
            typer.echo(fill(line, WIDTH, subsequent_indent=" " * 22, break_long_words=False, break_on_hyphens=False))
        counts = ((result.count(severity), word) for severity, word in _COUNTED.items())
        typer.echo(f"{result.robot}: {', '.join(f'{n} {word}' + 's' * (n != 1) for n, word in counts)}")
    if result.count("error"):
        raise typer.Exit(BAD_INPUT)
