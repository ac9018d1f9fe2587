"""What `touch` measures of the physics steps of one touch, and draws."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wbmpc.arrays import Array
from wbmpc.result import Metric, Plot, Series
from wbmpc.simulation.lockstep import Ending

#: A push may pass the wanted force by this share; a loss of contact may be so long [s]; what the limit of the speed may cost [s].
OVER, LOST, EXTRA = 0.2, 0.020, 1.0
#: The speed of a touch is the mean over this time [s] before it; drawn are so many seconds about it.
BEFORE, DRAWN = 0.005, (0.1, 0.6)


@dataclass(frozen=True)
class Touch:
    """One approach with a commanded ``speed`` [m/s] from ``begin`` [s] on, to push with ``force`` [N] until ``end`` [s]: rows of ``steps``
    (n, 4) as of :class:`wbmpc.studies.minniti2019.touch_plant.TouchPlant`, and how the run ended."""

    speed: float
    force: float
    begin: float
    end: float
    steps: Array
    ending: Ending

    @property
    def first(self) -> int | None:
        """The step of the first contact; None: there was none."""
        hit = np.flatnonzero(self.steps[:, 1] > 0.0)
        return int(hit[0]) if hit.size else None

    @property
    def touched(self) -> float:
        """When [s] after the beginning the tip touches; infinite if it never does."""
        return np.inf if self.first is None else float(self.steps[self.first, 0] - self.begin)

    @property
    def impact(self) -> float:
        """The speed [m/s] towards the panel just before the touch; infinite without one."""
        if self.first is None:
            return np.inf
        t = self.steps[:, 0]
        before = (t < t[self.first]) & (t >= t[self.first] - BEFORE)
        return float(self.steps[before, 3].mean()) if before.any() else np.inf

    def pushed(self) -> Array:
        """The steps (n, 4) from the first contact to the end of the push."""
        if self.first is None:
            return self.steps[:0]
        rows = self.steps[self.first :]
        return np.asarray(rows[rows[:, 0] <= self.end])

    @property
    def peak(self) -> float:
        """The largest force [N] along the normal in the push; infinite without a touch or in a run that was given up."""
        rows = self.pushed()
        return float(rows[:, 1].max()) if rows.size and not self.ending.reason else np.inf

    @property
    def lost(self) -> float:
        """The longest time [s] without contact in the push; infinite as ``peak`` is."""
        rows = self.pushed()
        return longest(rows[:, 0], rows[:, 1] > 0.0) if rows.size and not self.ending.reason else np.inf


def longest(t: Array, on: np.ndarray) -> float:
    """The longest time [s] in which ``on`` (n) is false, of samples at equal intervals."""
    if t.size < 2:
        return 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[True], on, [True]]).astype(int)))
    runs = edges[1::2] - edges[::2]
    return float(runs.max(initial=0) * (t[1] - t[0]))


def metrics(touches: list[Touch], plain: list[Touch]) -> dict[str, Metric]:
    """The worst of all commanded speeds; ``plain``: the same approaches without the limit of their speed, as far as there are any."""
    found = {
        "touch_peak_ratio": Metric(max(t.peak / t.force for t in touches), "1", goal=1.0 + OVER),
        "contact_lost_max": Metric(max(t.lost for t in touches), "s", goal=LOST),
        "touch_speed_max": Metric(max(t.impact for t in touches), "m/s"),
        "touch_time_max": Metric(max(t.touched for t in touches), "s"),
    }
    if plain:
        pairs = list(zip(touches, plain, strict=False))
        late = max(t.touched - p.touched if np.isfinite(p.touched) else np.inf for t, p in pairs)
        found["touch_time_extra"] = Metric(late, "s", goal=EXTRA)
        found["touch_peak_ratio_plain"] = Metric(max(p.peak / p.force for p in plain), "1")
        found["contact_lost_max_plain"] = Metric(max(p.lost for p in plain), "s")
    return found


def plots(touches: list[Touch], plain: list[Touch]) -> list[Plot]:
    """Force and speed about the touch, a line for each commanded speed."""

    def series(of: list[Touch], column: int, label: str, dashed: bool) -> list[Series]:
        lines = []
        for touch in of:
            if touch.first is None:
                continue
            t = touch.steps[:, 0] - touch.steps[touch.first, 0]
            use = (t >= -DRAWN[0]) & (t <= DRAWN[1])
            lines.append(Series(f"{touch.speed:g} m/s{label}", t[use], touch.steps[use, column], dashed=dashed))
        return lines

    name = ", plain"
    return [
        Plot(title, "time since the touch [s]", unit, [*series(touches, k, "", False), *series(plain, k, name, True)])
        for title, unit, k in (
            ("Force along the normal", "force [N]", 1),
            ("Speed towards the panel", "speed [m/s]", 3),
        )
    ]
