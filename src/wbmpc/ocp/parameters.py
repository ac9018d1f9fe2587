"""Values of the parameter vectors of a transcription: weights, mode values, switches of terms."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from wbmpc.errors import InputError, unknown_name
from wbmpc.ocp.schedule import DEFAULT, ModeSchedule

if TYPE_CHECKING:
    from wbmpc.ocp.transcription import Transcription


def default_weights(t: Transcription) -> np.ndarray:
    """The vector ``w`` with the weights as the terms state them and the model's parameters at zero."""
    w = np.zeros(t.constant.size)
    for cost in t.ocp.costs:
        if cost.at != "terminal":
            w[t.constant.slices[f"path.{cost.name}"]] = cost.expand(cost.weight)
        if cost.at != "path":
            end = cost.weight if cost.terminal_weight is None else cost.terminal_weight
            w[t.constant.slices[f"terminal.{cost.name}"]] = cost.expand(end)
    return w


def mode_tables(t: Transcription, schedule: ModeSchedule) -> np.ndarray:
    """One row of [mode values, switches] per mode of the schedule."""
    rows = []
    for mode in schedule.modes:
        values = t.ocp.dynamics.mode.vector(mode.values)
        names = [t.ocp.terms[name].modes or () for name in t.switched]
        rows.append(np.concatenate([values, [float(mode.name in n) for n in names]]))
    return np.array(rows).reshape(len(schedule.modes), -1)


def check_schedule(t: Transcription, schedule: ModeSchedule) -> None:
    """Raise :class:`InputError` for mode values out of range, or a mode that a term names and no schedule has: one that is
    neither among the problem's ``modes`` nor, if it has none, in this schedule."""
    declared, used = t.ocp.modes, list(dict.fromkeys(mode.name for mode in schedule.modes))
    for name in used if declared and schedule is not DEFAULT else ():
        if name not in declared:
            raise unknown_name("mode", name, declared, where="mode schedule")
    unset = " (no mode schedule is set)" if schedule is DEFAULT else ""
    for term in (t.ocp.terms[name] for name in t.switched):
        for name in term.modes or ():
            if name not in (declared or used):
                raise unknown_name("mode", name, declared or used, where=f"term '{term.name}', modes{unset}")
    bounds = getattr(t.ocp.dynamics, "mode_bounds", {})
    for mode, (group, (low, high)) in product(schedule.modes, bounds.items()):
        values = np.atleast_1d(np.asarray(mode.values.get(group, low), float))
        if np.any((values < low) | (values > high)):
            raise InputError(f"mode '{mode.name}': values of '{group}' must be from {low:g} to {high:g}, got {values}")
