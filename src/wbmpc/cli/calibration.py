"""`wbmpc calibrate`: steer zeros and wheel radii from a recorded run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wbmpc.cli.directories import Force, new_file
from wbmpc.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from wbmpc.bases.calibrator import Calibrator, WheelFit
    from wbmpc.estimation.wheel_calibration import WheelCalibration
    from wbmpc.model.wheels import ModuleGeometry

    Array = NDArray[np.float64]


def _channels(path: Path) -> tuple[dict[str, Any], Path]:
    """The arrays of a run's log (its folder or the log.npz itself), and the file."""
    from wbmpc.run_files import read_log

    file = path / "log.npz" if path.is_dir() else path
    return read_log(file), file


#: Bases whose places [m] and directions [rad] differ by less are the same: descriptions are measured, and measured again.
SAME_BASE = 0.02


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
    if not _same_base(found.geometry, recorded_base.geometry):
        raise InputError(
            f"--robot: {metrics} says that this was '{recorded}', whose base is another than that of '{robot}'; leave --robot out, or "
            "give the log.npz without the metrics.json beside it"
        )
    return found


def _same_base(one: ModuleGeometry, other: ModuleGeometry) -> bool:
    """Whether the modules of two robots hang at the same places in the same way; their radii are what a calibration finds."""
    import numpy as np

    if one.modules != other.modules or one.legs_move != other.legs_move:
        return False
    places = lambda g: np.concatenate([g.hinge, g.steer_axes(np.zeros(g.modules))], axis=1)
    turned = np.abs(np.angle(np.exp(1j * (one.wheel_heading - other.wheel_heading))))
    return bool(np.allclose(places(one), places(other), atol=SAME_BASE) and turned.max() < SAME_BASE)


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
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
) -> None:
    """Find steer zeros and wheel radii of a base on steered wheels from a recorded run with global poses; and the zeros of its arm,
    where the run has a tracked end effector.

    Where the record shows errors far beyond the given standard deviations, these are widened; numbers that a record
    contradicts, or does not show at all, are not written.
    """
    from wbmpc.estimation.wheel_calibration import WheelCalibration

    channels, file = _channels(run_log)
    target = new_file("--out", out, file.with_name("calibration.yaml"), force)
    calibrator = _calibrator_of(file, robot)
    names = calibrator.names
    prior = WheelCalibration.unknown(calibrator.geometry, zero_std, 0.5 * radius_std, radius_std)
    fit = calibrator.fit(channels, prior, str(file))
    hidden = [_words(names, kind, *ways) for kind, ways in fit.hidden().items() if len(ways[1])]
    arm = calibrator.fit_arm(channels, str(file))
    notes = [f"not shown: {text}" for text in hidden]
    fit.calibration.save(target, names, notes=notes, arm=arm, robot=calibrator.robot)
    if as_json:
        _print_json(fit, names, hidden, target, arm)
        return
    for name, row in (arm or {}).items():
        typer.echo(f"{name}: zero {1e3 * row['offset']:.2f} mrad (std {1e3 * row['offset_std']:.2f})")
    _print(fit, names, hidden, target, prior)


def _words(names: list[str], kind: str, weights: Array, std: Array) -> str:
    """Combinations (k, n) of the wheels' numbers and their standard deviations (k)."""
    sums = [
        " ".join(f"{w:+.2f} {name}" for w, name in zip(row, names, strict=True) if abs(w) > 0.05) for row in weights
    ]
    what = f"{sums[0]} of the" if len(sums) == 1 else f"{len(sums)} of {len(names)} combinations of the"
    return f"{what} {kind} (std {1e3 * std.max():.2f} {'mrad' if kind == 'steer zeros' else 'per mille'}, as before)"


def _print_json(fit: WheelFit, names: list[str], hidden: list[str], target: Path, arm: Any) -> None:
    found, std = fit.calibration, fit.calibration.std
    rows = {
        name: {
            "steer_zero": float(found.steer_offset[i]),
            "wheel_radius": float(found.wheel_radius[i]),
            "steer_zero_std": float(std[0][i]),
            "wheel_radius_std": float(std[1][i]),
        }
        for i, name in enumerate(names)
    }
    poses = {"used": fit.used, "given": fit.given}
    typer.echo(
        json.dumps({"modules": rows, "poses": poses, "not_shown": hidden, "arm": arm or {}, "file": str(target)})
    )


def _print(fit: WheelFit, names: list[str], hidden: list[str], target: Path, prior: WheelCalibration) -> None:
    found, std = fit.calibration, fit.calibration.std
    for i, name in enumerate(names):
        typer.echo(
            f"{name}: steer zero {1e3 * found.steer_offset[i]:.2f} mrad (std {1e3 * std[0][i]:.2f}), "
            f"radius {1e3 * found.wheel_radius[i]:.3f} mm (std {1e3 * found.wheel_radius[i] * std[1][i]:.3f})"
        )
    mean = found.covariance[: found.modules, : found.modules].mean() ** 0.5
    typer.echo(f"mean of the steer zeros {1e3 * found.steer_offset.mean():.2f} mrad (std {1e3 * mean:.2f})")
    for text in hidden:
        typer.echo(f"not shown by this drive: {text}")
    if (fit.previous.covariance != prior.covariance).any():
        zero, radius = (float(s.max()) for s in fit.previous.std)
        typer.echo(
            f"the wheels are farther off than was believed; taken to be before: zeros {1e3 * zero:.3g} mrad, radii "
            f"{100 * radius:.2g} % (--zero-std, --radius-std)"
        )
    lost = "; the others do not fit the drive" if fit.given > fit.used else ""
    typer.echo(f"{fit.used} of {fit.given} global poses used{lost}")
    typer.echo(f"written to {target}; use it with --set calibration={target}")
