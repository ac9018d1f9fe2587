"""`wbmpc calibrate`: steer zeros and wheel radii from a recorded run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from wbmpc.cli.directories import Force, new_file
from wbmpc.errors import InputError


def _channels(path: Path) -> tuple[dict[str, Any], Path]:
    """The arrays of a run's log (its folder or the log.npz itself), and the file."""
    import zipfile

    import numpy as np

    file = path / "log.npz" if path.is_dir() else path
    if not file.is_file():
        raise InputError(f"{file}: there is no such file; give a run's folder or its log.npz")
    try:
        with np.load(file, allow_pickle=False) as log:
            return {name: log[name] for name in log.files}, file
    except (ValueError, OSError, AttributeError, zipfile.BadZipFile) as error:
        raise InputError(f"{file}: this is not the log of a run (log.npz)") from error


def _robot_of(file: Path, given: str | None) -> str:
    """The robot of a log: as given, or from the metrics.json beside it."""
    if given is not None:
        return given
    metrics = file.with_name("metrics.json")
    try:
        return str(json.loads(metrics.read_text())["settings"]["robot"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"--robot: is needed, {metrics} does not say which robot this was") from error


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
    force: Force = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
) -> None:
    """Find steer zeros and wheel radii of a swerve base from a recorded run with global poses."""
    from wbmpc import estimation
    from wbmpc.experiments.swerve_calibrate import steer_joints, swerve_robot

    channels, file = _channels(run_log)
    target = new_file("--out", out, file.with_name("calibration.yaml"), force)
    model = swerve_robot(_robot_of(file, robot))
    record = estimation.WheelRecord.of(channels, str(file))
    odometry, names = estimation.replay(model.base.geometry, record), steer_joints(model)
    found, poses = odometry.calibration, {"used": odometry.taken, "given": len(record.places)}
    found.save(target, names)
    std = found.std
    if as_json:
        rows = {
            name: {"steer_zero": float(found.steer_zero[i]), "wheel_radius": float(found.wheel_radius[i])}
            for i, name in enumerate(names)
        }
        typer.echo(json.dumps({"modules": rows, "poses": poses, "file": str(target)}))
        return
    for i, name in enumerate(names):
        typer.echo(
            f"{name}: steer zero {1e3 * found.steer_zero[i]:.2f} mrad (std {1e3 * std[0][i]:.2f}), "
            f"radius {1e3 * found.wheel_radius[i]:.3f} mm (std {1e3 * found.wheel_radius[i] * std[1][i]:.3f})"
        )
    mean = found.covariance[: found.modules, : found.modules].mean() ** 0.5
    typer.echo(f"mean of the steer zeros {1e3 * found.steer_zero.mean():.2f} mrad (std {1e3 * mean:.2f})")
    lost = poses["given"] - poses["used"]
    typer.echo(
        f"{poses['used']} of {poses['given']} global poses used" + ("; the others do not fit the drive" if lost else "")
    )
    typer.echo(f"written to {target}; use it with --set calibration={target}")
