"""What `slip` measures of the physics steps of one push, and draws."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wbmpc.arrays import Array
from wbmpc.result import Metric, Plot, Series
from wbmpc.simulation.lockstep import Ending
from wbmpc.studies.minniti2019.door_figures import TOUCH

#: Goals: how far a tip may slide [m]; the force's error over the force.
SLIDE_GOAL, FORCE_GOAL = 0.001, 0.06


@dataclass(frozen=True)
class Press:
    """One push on a surface of coefficient ``grip``, with ``force`` [N] that is reached ``rise`` [s] after the touch, until ``end`` [s]: rows of
    ``steps`` (n, 6) as of :class:`wbmpc.studies.minniti2019.touch_plant.TouchPlant`; the ``bound`` (k) of the grip that the robot planned
    with; how the run ended."""

    grip: float
    force: float
    rise: float
    end: float
    steps: Array
    bound: Array
    ending: Ending

    def pushed(self) -> Array:
        """The steps (n, 6) from the first contact to the end of the push, in contact or not."""
        hit = np.flatnonzero(self.steps[:, 1] > 0.0)
        rows = self.steps[hit[0] :] if hit.size else self.steps[:0]
        return np.asarray(rows[rows[:, 0] <= self.end])

    def slides(self) -> Array:
        """How far (n, 2) [m] the tip has slid since it touched, along the surface and up."""
        rows = self.pushed()
        return (
            np.cumsum(rows[:, 4:6], axis=0) * (rows[1, 0] - rows[0, 0]) if len(rows) > 1 else np.zeros((len(rows), 2))
        )

    def figures(self) -> dict[str, float]:
        """Largest slide [m], rms error of the force over it from :data:`TOUCH` after the touch on, peak [N], time without
        contact [s]; all infinite without a touch, or in a run that was given up."""
        rows, names = self.pushed(), ("slide_max", "force_error_ratio", "touch_peak", "time_without_contact")
        since = rows[:, 0] - rows[0, 0] if len(rows) else np.zeros(0)
        late = since >= TOUCH
        if self.ending.reason or not late.any():
            return dict.fromkeys(names, np.inf)
        target = self.force * np.clip(since / max(self.rise, 1e-9), 0.0, 1.0)
        error = float(np.sqrt(np.mean((rows[late, 1] - target[late]) ** 2)) / self.force)
        slid = float(np.linalg.norm(self.slides(), axis=1).max())
        lost = float(np.sum(rows[:, 1] <= 0.0) * (since[1] - since[0]))
        return dict(zip(names, (slid, error, float(rows[:, 1].max()), lost), strict=True))


def metrics(presses: list[Press], plain: list[Press]) -> dict[str, Metric]:
    """The worst of all grips; ``plain``: the same pushes with a cone of one size, as far as there are any."""
    worst = lambda of, name: max(p.figures()[name] for p in of)
    found = {
        "slide_max": Metric(worst(presses, "slide_max"), "m", goal=SLIDE_GOAL),
        "force_error_ratio": Metric(worst(presses, "force_error_ratio"), "1", goal=FORCE_GOAL),
        "touch_peak": Metric(worst(presses, "touch_peak"), "N"),
        "time_without_contact": Metric(worst(presses, "time_without_contact"), "s"),
        "grip_bound_ratio": Metric(max(float(p.bound.max()) / p.grip for p in presses), "1", goal=1.0),
        "fell": Metric(float(any(p.ending.fell for p in presses)), "1", goal=0.0),
    }
    if plain:
        found["slide_max_plain"] = Metric(worst(plain, "slide_max"), "m")
        found["force_error_ratio_plain"] = Metric(worst(plain, "force_error_ratio"), "1")
    return found


def plots(presses: list[Press], plain: list[Press]) -> list[Plot]:
    """Force and slide since the touch, a line for each grip."""

    def series(of: list[Press], label: str, dashed: bool, values: str) -> list[Series]:
        lines = []
        for press in of:
            rows = press.pushed()
            if len(rows) > 1:
                y = rows[:, 1] if values == "force" else 1e3 * np.linalg.norm(press.slides(), axis=1)
                lines.append(Series(f"grip {press.grip:g}{label}", rows[:, 0] - rows[0, 0], y, dashed=dashed))
        return lines

    return [
        Plot(title, "time since the touch [s]", unit, [
            *series(presses, "", False, values), *series(plain, ", plain", True, values)
        ])
        for title, unit, values in (("Force along the normal", "force [N]", "force"), ("Slide of the tip", "slide [mm]", "slide"))
    ]  # fmt: skip
