"""What `swerve-fixed` measures and draws."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from wbmpc.experiment import Run
from wbmpc.log import Log
from wbmpc.result import Metric, Plot, Series, no_comparison
from wbmpc.studies.pankert2022.fixed_motions import PAUSE, Motion
from wbmpc.studies.pankert2022.metrics import rms

#: A base that is asked to move faster than the first and moves slower than the second [m/s] stands still.
ASKED, STANDING = 0.05, 0.01
#: Lever [m] that turns a yaw rate into a speed.
LEVER = 0.4


def errors(log: Log, name: str, reference: Motion, of: str = "odometry") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (n,), position errors (n,) [m] and yaw errors (n,) [rad] in the estimated frame; ``of`` the "base": in the world."""
    t, pose = log.times(f"{of}_{name}"), log.array(f"{of}_{name}")
    difference = pose - reference.path.pose(t)
    return t, np.hypot(difference[:, 0], difference[:, 1]), difference[:, 2]


def standstill(log: Log, name: str, reference: Motion) -> float:
    """Longest time [s] for which a base that was asked to move stood still (true motion, over 0.1 s)."""
    t, pose = log.times(f"base_{name}"), log.array(f"base_{name}")
    twist = reference.path.twist(t)
    target = np.hypot(twist[:, 0], twist[:, 1]) + LEVER * np.abs(twist[:, 2])
    back = np.maximum(np.searchsorted(t, t - 0.1), 0)
    way = pose - pose[back]
    moved = (np.hypot(way[:, 0], way[:, 1]) + LEVER * np.abs(way[:, 2])) / np.maximum(t - t[back], 1e-3)
    still, longest, since = (target > ASKED) & (moved < STANDING), 0.0, None
    for now, flag in zip(t, still, strict=True):
        since = (now if since is None else since) if flag else None
        longest = max(longest, now - since if since is not None else 0.0)
    return longest


def metrics(log: Log, reference: Motion, names: Iterable[str], run: Run) -> dict[str, Metric]:
    """Of the MPC, and of the baselines among ``names`` that got to the end: the part before a fall says nothing to compare with.
    A run that the user ended says nothing about those that are missing."""
    whole = [n for n, outcome in run.outcomes.items() if not outcome.ending.reason]
    done = [n for n in names if (n == "mpc" or n in whole) and f"odometry_{n}" in log.channels]
    off = {n: rms(errors(log, n, reference)[1]) for n in done}
    out = {f"tracking_error_rms_{n}": Metric(v, "m") for n, v in off.items()}
    if {"mpc", "ik"} <= set(whole):
        out["tracking_error_ratio"] = Metric(off["mpc"] / off["ik"], "1", goal=0.5)
    elif "mpc" in whole and not run.ending.interrupted:
        out["tracking_error_ratio"] = no_comparison(0.5)
    for n in done:
        t, position, yaw = errors(log, n, reference)
        out[f"yaw_error_rms_{n}"] = Metric(rms(yaw), "rad")
        out[f"tracking_error_rms_world_{n}"] = Metric(rms(errors(log, n, reference, "base")[1]), "m")
        for segment, (a, b) in reference.spans.items():
            use = (t >= a) & (t <= b + PAUSE)
            if use.any():
                out[f"tracking_error_rms_{n}_{segment}"] = Metric(rms(position[use]), "m")
        out[f"wheel_slip_max_{n}"] = Metric(float(log.array(f"slip_{n}").max()), "m/s")
    if "mpc" in done:
        out["longest_standstill"] = Metric(standstill(log, "mpc", reference), "s", goal=1.0)
    return out


def plots(log: Log, reference: Motion, names: Iterable[str]) -> list[Plot]:
    done = [n for n in names if f"odometry_{n}" in log.channels]
    found = {n: errors(log, n, reference) for n in done}
    path = reference.path.poses[::20]
    return [
        Plot("Base path", "x [m]", "y [m]", [
            Series("reference", path[:, 0], path[:, 1], dashed=True),
            *(Series(n, *log.array(f"odometry_{n}")[::4, :2].T) for n in done),
        ], equal_axes=True),
        Plot("Position error", "time [s]", "error [mm]", [
            Series(n, t, 1e3 * e) for n, (t, e, _) in found.items() if n != "four_wheel"
        ]),
        Plot("Position error, all controllers", "time [s]", "error [m]", [
            Series(n, t, e) for n, (t, e, _) in found.items()
        ]),
        Plot("Yaw error", "time [s]", "error [deg]", [Series(n, t, np.rad2deg(y)) for n, (t, _, y) in found.items()]),
    ]  # fmt: skip
