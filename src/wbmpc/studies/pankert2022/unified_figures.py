"""What `swerve-unified` measures and draws."""

from __future__ import annotations

import numpy as np

from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.result import Drawing, Metric, Plot, Series
from wbmpc.stability import StanceOf, draw
from wbmpc.stability.assessment import Assessment
from wbmpc.stability.geometry import overlap_regions
from wbmpc.studies.pankert2022.metrics import in_both_frames, largest, rms, traveled

#: Errors of the base [m, rad] at the end with which it counts as there; what may keep it from there.
THERE, TURNED = 0.05, 0.05
REACH_NOTE = (
    "the end effector weighs more: where the arm does not reach what it holds from the goal, the base ends short of it"
)


def metrics(log: Log, begin: float, free: bool, faults: int, held: int) -> dict[str, Metric]:
    use = log.times("hand") >= begin
    if not use.any():
        use[:] = True
    error = lambda a, b: (log.array(a) - log.array(b))[use]
    base = log.array("base")[use]
    off = tuple(error(name, "hand_reference") for name in ("hand", "hand_odometry"))
    drift = tuple(error(name, "base_reference") for name in ("base", "base_odometry"))
    place, yaw = tuple(d[:, :2] for d in drift), tuple(d[:, 2] for d in drift)
    margins = log.array("support_margin")[use]
    metrics = {
        **in_both_frames("hand_error_rms", rms, off, "m", goal=0.003),
        **in_both_frames("hand_error_max", largest, off, "m"),
        **in_both_frames("base_position_error_rms", rms, place, "m"),
        **in_both_frames("base_yaw_error_rms", rms, yaw, "rad"),
        **in_both_frames("base_position_error_end", lambda e: largest(e[-1:]), place, "m", goal=THERE, note=REACH_NOTE),
        **in_both_frames("base_yaw_error_end", lambda e: largest(e[-1:]), yaw, "rad", goal=TURNED, note=REACH_NOTE),
        "base_travel": Metric(traveled(base), "m"),
        "support_margin_end": Metric(float(margins[-1, 0]), "m"),
        "support_margin_min": Metric(float(margins[:, 0].min()), "m", larger_is_better=True),
        "wheel_slip_max": Metric(float(log.array("wheel_slip")[use].max()), "m/s"),
        "brake_faults": Metric(float(faults), "1", goal=0.0),
        "legs_held": Metric(float(held), "1"),
    }
    if not free:
        opened = log.array("brake")[use].max(axis=1) > 0.5
        legs = error("leg", "leg_reference")[opened]
        metrics["leg_angle_error_rms"] = Metric(float(np.sqrt(np.mean(legs**2))) if legs.size else 0.0, "rad")
    return metrics


def plots(log: Log, robot: RobotModel, begin: float) -> list[Plot | Drawing]:
    t, base, odometry, target = (log.times("base"), *map(log.array, ("base", "base_odometry", "base_reference")))
    end_effector, legs, goals = (
        log.array("hand_odometry"),
        np.degrees(log.array("leg")),
        np.degrees(log.array("leg_reference")),
    )
    margins = 1e3 * log.array("support_margin")
    names = [n.removeprefix("leg_") for n in robot.state.groups["leg"]]
    error = lambda a: 1e3 * np.linalg.norm(log.array(a) - log.array("hand_reference"), axis=1)
    use, offsets = t >= begin, {"world": base - target, "estimated frame": odometry - target}
    return [
        Plot("Base and end effector from above", "x [m]", "y [m]", [
            Series("base", base[:, 0], base[:, 1]), Series("base, reference", target[:, 0], target[:, 1], dashed=True),
            Series("end effector, estimated frame", end_effector[use, 0], end_effector[use, 1]),
        ], equal_axes=True),
        Plot("End effector error", "time [s]", "error [mm]", [
            Series("estimated frame", t[use], error("hand_odometry")[use]), Series("world", t[use], error("hand")[use]),
        ]),
        *(Plot(f"Base error, {frame}", "time [s]", "error [mm]", [
            Series(n, t, 1e3 * off[:, k]) for k, n in enumerate("xy")
        ]) for frame, off in offsets.items()),
        Plot("Base yaw error", "time [s]", "error [°]", [
            Series(frame, t, np.degrees(off[:, 2])) for frame, off in offsets.items()
        ]),
        Plot("Leg angles", "time [s]", "angle [°]", [
            *(Series(n, t, legs[:, k]) for k, n in enumerate(names)),
            *(Series(f"{n}, reference", t, goals[:, k], dashed=True) for k, n in enumerate(names)),
        ]),
        Plot("Zero-moment point", "time [s]", "margin [mm]", [
            Series("to the next triangle", t, margins[:, 0]), Series("to the polygon", t, margins[:, 1]),
        ]),
        _picture(robot, "At the start", log.array("state")[int(np.argmax(use))]),
        _picture(robot, "At the end", log.array("state")[-1]),
    ]  # fmt: skip


def _picture(robot: RobotModel, title: str, x: np.ndarray) -> Drawing:
    """The stance at a state, in axes of the base."""
    x = x.copy()
    x[robot.state["base"]] = 0.0
    stance = StanceOf(robot)(x)
    return Drawing(title, draw(Assessment(robot, "angles", x, stance, overlap_regions(stance.feet))))
