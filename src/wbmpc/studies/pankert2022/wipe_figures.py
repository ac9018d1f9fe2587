"""What `swerve-wipe` measures and draws."""

from __future__ import annotations

import numpy as np

from wbmpc.arrays import Array
from wbmpc.log import Log
from wbmpc.result import Metric, Plot, Series
from wbmpc.studies.pankert2022.metrics import in_both_frames, rms
from wbmpc.studies.pankert2022.wipe_control import Wipe

#: Goals: rms error of the force over the force; rms error along the path [m].
FORCE_GOAL, PATH_GOAL = 0.10, 0.002
#: The force is judged from so long [s] after its rise; what is not this force [N] is no contact; of so many physics steps one is drawn.
AFTER, CONTACT, THINNED = 0.1, 0.1, 20


def metrics(log: Log, wipe: Wipe, steps: Array, grip: float) -> dict[str, Metric]:
    """``steps`` (n, 3): as of :class:`wbmpc.studies.pankert2022.wipe_plant.WipePlant`; a run that did not touch has no figures but those."""
    t, push = steps[:, 0], steps[:, 1]
    begin, end = wipe.began + AFTER, wipe.ended
    use, first = (t >= begin) & (t <= end), t[push > 0.0]
    rows = log.times("hand")
    late = (rows >= begin) & (rows <= end)
    if not use.any() or late.sum() < 2:
        return {}
    target = log.array("hand_reference")[late]
    errors = [log.array(name)[late] - target for name in ("hand", "hand_odometry")]
    along = lambda error: rms(error[:, 0])
    on_the_wall = lambda error: rms(error[:, [0, 2]])
    estimated = log.array("coefficient")[late]
    return {
        "force_error_ratio": Metric(rms(push[use] - wipe.order.force) / wipe.order.force, "1", goal=FORCE_GOAL),
        "force_mean": Metric(float(push[use].mean()), "N"),
        "force_max": Metric(float(push.max()), "N"),
        "touch_peak": Metric(float(push[(t >= first[0]) & (t <= first[0] + AFTER)].max()), "N"),
        "time_without_contact": Metric(float(np.sum(push[use] < CONTACT) * (t[1] - t[0])), "s"),
        **in_both_frames("path_error_rms", on_the_wall, errors, "m", goal=PATH_GOAL),
        **in_both_frames("path_error_rms{}_along", along, errors, "m"),
        "friction_error": Metric(float(abs(np.nanmean(estimated) - grip)), "1"),
        "base_travel": Metric(float(np.ptp(log.array("base")[late][:, 0])), "m"),
    }


def plots(log: Log, wipe: Wipe, steps: Array) -> list[Plot]:
    t, push = steps[::THINNED, 0], steps[::THINNED, 1]
    rows, target, world = log.times("hand"), log.array("hand_reference"), log.array("hand")
    ordered = wipe.force(rows)
    return [
        Plot("Force along the normal", "time [s]", "force [N]", [
            Series("true", t, push), Series("ordered", rows, ordered, dashed=True),
        ]),
        Plot("Error on the wall", "time [s]", "error [mm]", [
            Series("along", rows, 1e3 * (world - target)[:, 0]), Series("up", rows, 1e3 * (world - target)[:, 2]),
        ]),
        Plot("Place of the wall", "along [m]", "across [mm]", [
            Series("estimated", target[:, 0], 1e3 * log.array("wall")[:, 0]), Series("true", target[:, 0], 1e3 * log.array("wall")[:, 1]),
        ]),
        Plot("Friction over force", "time [s]", "coefficient", [Series("estimated", rows, log.array("coefficient"))]),
    ]  # fmt: skip
