"""`wbmpc stability`: how a robot stands."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Annotated

import typer

from wbmpc.cli.directories import AsJson, Force, new_file
from wbmpc.errors import InputError
from wbmpc.output_file import write_text


def stability(
    robot: Annotated[str, typer.Argument(help="A robot's name (see 'wbmpc list') or its YAML file.")],
    configuration: Annotated[
        str | None,
        typer.Option(
            help="A configuration of the legs by its name, or a position (rad, m of legs that slide) per leg: 0.1,-0.1,0,0 (default: home)."
        ),
    ] = None,
    wrench: Annotated[
        str,
        typer.Option(
            help="External force (N) on the end effector, or force and moment (N m): 0,0,-50; z along the ground's normal."
        ),
    ] = "0,0,0",
    arm: Annotated[str | None, typer.Option(help="Angles of the arm's joints (rad; default: home).")] = None,
    slope: Annotated[float, typer.Option(help="Slope of the ground (rad).")] = 0.0,
    uphill: Annotated[
        float, typer.Option(help="Direction in which the ground rises, relative to straight ahead (rad).")
    ] = 0.0,
    plot: Annotated[Path | None, typer.Option(help="Write a drawing from above (SVG).")] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Support polygon, support triangles and zero-moment point of a robot at rest."""
    from wbmpc.model.robot import load_robot
    from wbmpc.stability import assess, draw, slope_gravity

    if not abs(slope) < 0.5 * math.pi:
        raise InputError(f"--slope: must be between -1.57 and 1.57 rad, got {slope:g}")
    if not math.isfinite(uphill):
        raise InputError(f"--uphill: must be finite, got {uphill:g}")
    if plot is not None and plot.suffix.lower() != ".svg":
        raise InputError(f"--plot: '{plot}' must end with .svg")
    if plot is not None:
        new_file("--plot", plot, plot, force)
    model = load_robot(robot)
    push = _numbers("--wrench", wrench, (3, 6))
    joints = None if arm is None else _numbers("--arm", arm, (len(model.state.groups["arm"]),))
    result = assess(model, configuration, [*push, 0.0, 0.0, 0.0][:6], slope_gravity(slope, uphill), joints)
    files = {}
    if plot is not None:
        write_text(plot, draw(result))
        files["plot"] = str(plot)
    if as_json:
        typer.echo(json.dumps({**result.summary(), "files": files}, allow_nan=False))
    else:
        typer.echo(result.text())
        if files:
            typer.echo(f"drawing: {plot}")


def _numbers(option: str, text: str, sizes: tuple[int, ...]) -> list[float]:
    """Finite numbers of an option, separated by commas or blanks."""
    from wbmpc.checks import parse_number

    valid = " or ".join(map(str, sizes))
    try:
        values = [parse_number(v) for v in text.replace(",", " ").split()]
    except ValueError:
        raise InputError(f"{option}: {valid} numbers are needed, got '{text}'") from None
    if len(values) not in sizes or not all(map(math.isfinite, values)):
        raise InputError(f"{option}: {valid} finite numbers are needed, got '{text}'")
    return values
