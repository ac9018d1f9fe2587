"""What `swerve-unified` measures and draws."""

from __future__ import annotations

import numpy as np

from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.result import Drawing, Metric, Plot, Series
from wbmpc.stability import StanceOf, draw
from wbmpc.stability.assessment import Assessment
from wbmpc.stability.geometry import overlap_regions
from wbmpc.studies.pankert2022.metrics import rms, travelled

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
    drift = error("base_reference", "base_odometry")
    margins = log.array("support_margin")[use]
    metrics = {
        "hand_error_rms": Metric(rms(error("hand_odometry", "hand_reference")), "m", goal=0.005),
        "hand_error_max": Metric(float(np.linalg.norm(error("hand_odometry", "hand_reference"), axis=1).max()), "m"),
        "hand_error_rms_world": Metric(rms(error("hand", "hand_reference")), "m"),
        "base_travel": Metric(travelled(base), "m"),
        "base_position_error_rms": Metric(rms(drift[:, :2]), "m"),
        "base_yaw_error_rms": Metric(rms(drift[:, 2:]), "rad"),
        "base_position_error_end": Metric(float(np.hypot(*drift[-1, :2])), "m", goal=THERE, goal_note=REACH_NOTE),
        "base_yaw_error_end": Metric(float(abs(drift[-1, 2])), "rad", goal=TURNED, goal_note=REACH_NOTE),
        "support_margin_end": Metric(float(margins[-1, 0]), "m"),
        "support_margin_min": Metric(float(margins[:, 0].min()), "m"),
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
    use = t >= begin
    return [
        Plot("Base and end effector from above", "x [m]", "y [m]", [
            Series("base", base[:, 0], base[:, 1]), Series("base, reference", target[:, 0], target[:, 1], dashed=True),
            Series("end effector, estimated frame", end_effector[use, 0], end_effector[use, 1]),
        ], equal_axes=True),
        Plot("End effector error", "time [s]", "error [mm]", [
            Series("estimated frame", t[use], error("hand_odometry")[use]), Series("world", t[use], error("hand")[use]),
        ]),
        Plot("Base error, estimated frame", "time [s]", "error [mm, mrad]", [
            Series(n, t, 1e3 * (odometry - target)[:, k]) for k, n in enumerate(("x", "y", "yaw"))
        ]),
        Plot("Leg angles", "time [s]", "angle [deg]", [
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
