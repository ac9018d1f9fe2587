"""What `swerve-plaster` measures and draws: passes, the coat on the wall, stops."""

from __future__ import annotations

import numpy as np

from wbmpc.log import Log
from wbmpc.result import Metric, Plot, Series
from wbmpc.studies.pankert2022 import plaster_wall as wall
from wbmpc.studies.pankert2022.metrics import rms


def pass_spread(lines: wall.Lines, t: np.ndarray, across: np.ndarray) -> float:
    """Root mean square [m] of how far passes differ from their mean across the wall (k,), place by place along the path."""
    number, s = lines.arc(t)
    use = (t >= lines.start) & (t <= lines.end)
    cell, offset = (s / 0.05).astype(int), []
    for k in np.unique(cell[use]):
        here = [across[use & (cell == k) & (number == n)].mean() for n in np.unique(number[use & (cell == k)])]
        offset += [v - np.mean(here) for v in here]
    return float(np.sqrt(np.mean(np.square(offset)))) if offset else float("nan")


def coat(end_effector: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Thickness (nz, nx) [volume per area for a rate of 1/s] on the wall's grid: along (nx,), up (nz,) [m].

    ``end_effector`` (k, 3) every ``step`` [s]. The cone's cross-section at the wall is a paraboloid whose radius grows with the
    distance, at a constant rate.
    """
    along, up = (
        np.arange(wall.AHEAD - 0.2, wall.AHEAD + wall.LENGTH + 0.2, wall.GRID),
        np.arange(wall.LOWEST - 0.2, wall.LOWEST + 0.9, wall.GRID),
    )
    thick = np.zeros((up.size, along.size))
    for x, y, z in end_effector:
        radius = wall.CONE * max(wall.WALL - y, 1e-3)
        i, j = (slice(*np.searchsorted(g, (v - radius, v + radius))) for g, v in ((along, x), (up, z)))
        square = ((along[i] - x) ** 2)[None, :] + ((up[j] - z) ** 2)[:, None]
        thick[j, i] += step * 2.0 / (np.pi * radius**2) * np.clip(1.0 - square / radius**2, 0.0, None)
    return along, up, thick


def judged(along: np.ndarray, up: np.ndarray, thick: np.ndarray) -> np.ndarray:
    """The part of the coat that is judged: between the outer lines, without the ends where the end effector turns."""
    i = (along >= wall.AHEAD + wall.ENDS) & (along <= wall.AHEAD + wall.LENGTH - wall.ENDS)
    j = (up >= wall.LOWEST + 0.5 * wall.APART) & (up <= wall.LOWEST + (wall.LINES - 1.5) * wall.APART)
    return thick[np.ix_(j, i)]


def stops(t: np.ndarray, end_effector: np.ndarray, target: np.ndarray) -> int:
    """How often the end effector stood though it was asked to move."""
    step = t[1] - t[0]
    speed = lambda p: np.linalg.norm(np.gradient(p, step, axis=0), axis=1)
    still = (speed(end_effector) < wall.STOP_SPEED) & (speed(target) > 2.0 * wall.STOP_SPEED)
    count = round(wall.STOP_TIME / step)
    long = np.convolve(still, np.ones(count))[: still.size] >= count
    return int(np.sum(long[1:] & ~long[:-1]))


def metrics(log: Log, references: wall.WallReferences, sensors: bool) -> dict[str, Metric]:
    t, lines = log.times("hand"), references.lines
    use = t >= lines.start
    if use.sum() < 2:
        return {}
    end_effector, target, odometry = (log.array(n)[use] for n in ("hand", "hand_reference", "hand_odometry"))
    part = judged(*coat(end_effector, float(t[1] - t[0])))
    spread = pass_spread(lines, t[use], odometry[:, 1])
    goal = lambda value: value if sensors else None
    number, _ = lines.arc(t[use])
    spreads = {
        "pass_spread_rms": Metric(spread, "m", goal=0.003),
        "pass_spread_rms_world": Metric(pass_spread(lines, t[use], end_effector[:, 1]), "m"),
    }
    return {
        **(spreads if number.max() > 0 else {}),  # one pass differs from nothing
        "hand_error_rms": Metric(rms(odometry - target), "m"),
        "hand_error_rms_world": Metric(rms(end_effector - target), "m", goal=goal(0.004)),
        "hand_error_rms_world_normal": Metric(rms(end_effector[:, 1] - target[:, 1]), "m"),
        "wall_distance_min": Metric(float((wall.WALL - end_effector[:, 1]).min()), "m", least=wall.NEAREST),
        "path_length": Metric(float(np.sum(np.linalg.norm(np.diff(target, axis=0), axis=1))), "m"),
        "stops": Metric(float(stops(t[use], end_effector, target)), "1", goal=0.0),
        "coat_variation": Metric(float(part.std() / part.mean()), "1", goal=goal(0.10)),
        "coat_gaps": Metric(float(np.mean(part < wall.GAP * part.mean())), "1", goal=goal(0.0)),
        "base_error_rms_world": Metric(rms((log.array("base_odometry") - log.array("base"))[use][:, :2]), "m"),
        "wheel_slip_max": Metric(float(log.array("wheel_slip")[use].max()), "m/s"),
    }


def plots(log: Log, references: wall.WallReferences) -> list[Plot]:
    t, end_effector, target, odometry = (
        log.times("hand"), log.array("hand"), log.array("hand_reference"), log.array("hand_odometry"),
    )  # fmt: skip
    use = t >= references.lines.start
    along, up, thick = (
        coat(end_effector[use], float(t[1] - t[0])) if use.sum() > 1 else (np.zeros(1),) * 2 + (np.ones((1, 1)),)
    )
    mean = max(float(thick.mean()), 1e-12)
    return [
        Plot("Lines on the wall", "along [m]", "up [m]", [
            Series("reference", target[use, 0], target[use, 2], dashed=True), Series("hand", end_effector[use, 0], end_effector[use, 2]),
        ], equal_axes=True),
        Plot("Distance from the wall", "time [s]", "distance [mm]", [
            Series("world", t, 1e3 * (wall.WALL - end_effector[:, 1])), Series("estimated frame", t, 1e3 * (wall.WALL - odometry[:, 1])),
        ]),
        Plot("Coat at five heights", "along [m]", "thickness over mean", [
            Series(f"{up[k]:.2f} m", along, thick[k] / mean) for k in np.linspace(0, up.size - 1, 7).astype(int)[1:-1]
        ]),
        Plot("End effector error", "time [s]", "error [mm]", [
            Series("estimated frame", t, 1e3 * np.linalg.norm(odometry - target, axis=1)),
            Series("world", t, 1e3 * np.linalg.norm(end_effector - target, axis=1)),
        ]),
    ]  # fmt: skip
