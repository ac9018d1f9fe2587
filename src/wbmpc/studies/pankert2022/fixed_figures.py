"""What `swerve-fixed` measures and draws."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from wbmpc.experiment import Run
from wbmpc.log import Log
from wbmpc.result import Metric, Plot, Series
from wbmpc.studies.pankert2022.fixed_motions import PAUSE, Motion
from wbmpc.studies.pankert2022.metrics import in_both_frames, no_comparison, rms

#: A base that is asked to move faster than the first and moves slower than the second [m/s] stands still.
ASKED, STANDING = 0.05, 0.01
#: Goals [m] of the error in the world.
ODOMETRY_ALONE, WITH_LIDAR = 0.010, 0.004
#: A wheel that turns by more [rad] within so long [s] turns about.
FLIP, FLIP_TIME = 2.5, 1.0
#: Lever [m] that turns a yaw rate into a speed.
LEVER = 0.4


def errors(log: Log, name: str, reference: Motion, of: str = "base") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (n,), position errors (n,) [m] and yaw errors (n,) [rad] in the world; ``of`` the "odometry": in the estimated frame."""
    t, pose = log.times(f"{of}_{name}"), log.array(f"{of}_{name}")
    difference = pose - reference.path.pose(t)
    return t, np.hypot(difference[:, 0], difference[:, 1]), difference[:, 2]


def _errors_of(log: Log, n: str, reference: Motion, flip: float, goal: float | None) -> dict[str, Metric]:
    """Those of one controller, over the run, up to the first ``flip`` [s] of a wheel, and by motion."""
    frames = [errors(log, n, reference, of) for of in ("base", "odometry")]
    t, position, yaw = frames[0][0], [f[1] for f in frames], [f[2] for f in frames]
    part = lambda use: [p[use] for p in position]
    out = in_both_frames(f"tracking_error_rms{{}}_{n}", rms, position, "m", goal=goal)
    out |= in_both_frames(f"tracking_error_rms{{}}_{n}_no_flip", rms, part(t <= flip), "m")
    out |= in_both_frames(f"yaw_error_rms{{}}_{n}", rms, yaw, "rad")
    for segment, (a, b) in reference.spans.items():
        use = (t >= a) & (t <= b + PAUSE)
        if use.any():
            out |= in_both_frames(f"tracking_error_rms{{}}_{n}_{segment}", rms, part(use), "m")
    out[f"wheel_slip_max_{n}"] = Metric(float(log.array(f"slip_{n}").max()), "m/s")
    return out


def first_flip(log: Log, names: Iterable[str]) -> float:
    """When [s] the first wheel of a run turns by more than :data:`FLIP` within :data:`FLIP_TIME`; infinite if none does."""
    first = float("inf")
    for n in names:
        t, steer = log.times(f"steer_{n}"), log.array(f"steer_{n}")
        back = np.searchsorted(t, t - FLIP_TIME)
        flips = np.flatnonzero(np.abs(steer - steer[back]).max(axis=1) > FLIP)
        first = min(first, float(t[back[flips[0]]]) if flips.size else first)
    return first


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


def metrics(log: Log, reference: Motion, names: Iterable[str], run: Run, lidar: bool = False) -> dict[str, Metric]:
    """Of the MPC, and of the baselines among ``names`` that got to the end: the part before a fall says nothing to compare with.
    A run that the user ended says nothing about those that are missing. ``lidar``: with global poses, which the goals depend on."""
    whole = [n for n, outcome in run.outcomes.items() if not outcome.ending.reason]
    done = [n for n in names if (n == "mpc" or n in whole) and f"odometry_{n}" in log.channels]
    goal, ratio = (WITH_LIDAR, 0.5) if lidar else (ODOMETRY_ALONE, 1.0)
    out: dict[str, Metric] = {}
    for n in done:
        out |= _errors_of(log, n, reference, first_flip(log, done), goal if n == "mpc" else None)
    if {"mpc", "ik"} <= set(whole):
        of = lambda name: out[name.format("mpc")].value / out[name.format("ik")].value
        out["tracking_error_ratio_world"] = Metric(of("tracking_error_rms_world_{}"), "1", goal=ratio)
        out["tracking_error_ratio"] = Metric(of("tracking_error_rms_{}"), "1")
    elif "mpc" in whole and not run.ending.interrupted:
        out |= {"tracking_error_ratio_world": no_comparison(ratio), "tracking_error_ratio": no_comparison()}
    if "mpc" in done:
        out["longest_standstill"] = Metric(standstill(log, "mpc", reference), "s", goal=1.0)
    return out


def plots(log: Log, reference: Motion, names: Iterable[str]) -> list[Plot]:
    done = [n for n in names if f"odometry_{n}" in log.channels]
    found, own = ({n: errors(log, n, reference, of) for n in done} for of in ("base", "odometry"))
    path = reference.path.poses[::20]
    return [
        Plot("Base path", "x [m]", "y [m]", [
            Series("reference", path[:, 0], path[:, 1], dashed=True),
            *(Series(n, *log.array(f"base_{n}")[::4, :2].T) for n in done),
        ], equal_axes=True),
        *(Plot(f"Position error, {frame}", "time [s]", "error [mm]", [
            Series(n, t, 1e3 * e) for n, (t, e, _) in of.items() if n != "four_wheel"
        ]) for frame, of in (("world", found), ("estimated frame", own))),
        Plot("Position error of all controllers, world", "time [s]", "error [m]", [
            Series(n, t, e) for n, (t, e, _) in found.items()
        ]),
        Plot("Yaw error, world", "time [s]", "error [°]", [Series(n, t, np.rad2deg(y)) for n, (t, _, y) in found.items()]),
    ]  # fmt: skip
