"""`wbmpc calibrate`: steer zeros and wheel radii from a recorded run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wbmpc.cli.directories import AsJson, Force, new_file, reject_links
from wbmpc.errors import InputError

if TYPE_CHECKING:
    from wbmpc.bases.calibrator import Calibrator


def _channels(path: Path) -> tuple[dict[str, Any], Path]:
    """The arrays of a run's log (its folder or the log.npz itself), and the file."""
    from wbmpc.run_files import read_log

    file = path / "log.npz" if path.is_dir() else path
    return read_log(file), file


def _calibrator(name: str) -> Calibrator:
    """Of the robot of that name or file. Raises :class:`InputError` where its base type has no calibration."""
    from wbmpc.bases import base_type
    from wbmpc.model.robot import load_robot

    robot = load_robot(name)
    return base_type(robot.description.base.type).calibrator(robot)


def _calibrator_of(file: Path, robot: str | None) -> Calibrator:
    """Of the robot of a log: ``robot``, or else from the metrics.json beside it. Raises :class:`InputError` where these have other
    bases."""
    from wbmpc.run_files import read_metrics

    metrics = file.with_name("metrics.json")
    try:
        recorded = str(read_metrics(metrics)["settings"]["robot"])
    except (InputError, KeyError) as error:
        if robot is None:
            raise InputError(f"--robot: is needed, {metrics} does not say which robot this was") from error
        return _calibrator(robot)
    if robot is None or robot == recorded:
        return _calibrator(recorded)
    found = _calibrator(robot)
    try:
        recorded_base = _calibrator(recorded)
    except InputError:  # a file that is not there any more
        return found
    if not found.has_base_of(recorded_base):
        raise InputError(
            f"--robot: {metrics} says that this was '{recorded}', whose base is another than that of '{robot}'; leave --robot out, or "
            "give the log.npz without the metrics.json beside it"
        )
    return found


def calibrate(
    run_log: Annotated[
        Path, typer.Argument(metavar="RUN_LOG", help="A run's folder or its log.npz, with global poses.")
    ],
    out: Annotated[
        Path | None, typer.Option(help="File to write (default: a new calibration.yaml beside the log).")
    ] = None,
    robot: Annotated[
        str | None, typer.Option(help="Name or file of the robot (default: as the run's settings say).")
    ] = None,
    zero_std: Annotated[
        float, typer.Option(min=1e-6, max=0.6, help="Prior standard deviation of the steer zeros, in rad.")
    ] = 2e-3,
    radius_std: Annotated[
        float,
        typer.Option(
            min=1e-6,
            max=0.25,
            help="Prior relative standard deviation of the common wheel radius; half of it for each single wheel.",
        ),
    ] = 2e-3,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Find steer zeros and wheel radii of a base on steered wheels from a recorded run with global poses; and the zeros of its arm,
    where the run has a tracked end effector.

    Where the record shows errors far beyond the given standard deviations, these are widened; numbers that a record
    contradicts, or does not show at all, are not written.
    """
    channels, file = _channels(run_log)
    target = new_file("--out", out, file.with_name("calibration.yaml"), force)
    calibrator = _calibrator_of(file, robot)
    found = calibrator.find(channels, str(file), zero_std=zero_std, radius_std=radius_std)
    if out is None:
        reject_links("--out", [target])  # one that was put there meanwhile
    found.save(target, follow=out is not None)
    if as_json:
        typer.echo(json.dumps({**found.table(), "file": str(target)}))
        return
    for line in found.lines():
        typer.echo(line)
    typer.echo(f"written to {target}; use it with --set calibration=file --set calibration.file={target}")
