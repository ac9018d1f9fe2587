"""What `rezero-door` measures and draws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wbmpc import lie
from wbmpc.log import Log
from wbmpc.mpc.mpc import MPC
from wbmpc.result import Metric, Plot, Series
from wbmpc.simulation.lockstep import Ending
from wbmpc.studies.minniti2019.door_settings import RezeroDoorSettings
from wbmpc.studies.minniti2019.metrics import estimated_end_effector, estimator_metrics, rms

#: The peak of the touch is looked for in this time [s] after it, from which on the force counts in full; how the end effector rests, in
#: this time [s] before the end.
TOUCH, REST = 0.1, 1.0


@dataclass(frozen=True)
class Trial:
    """One door pushed with one force [N]: what was recorded, how it ended, what was found out about the robot."""

    force: float
    log: Log
    ending: Ending
    mpc: MPC
    faults: tuple[str, ...] = ()


def normal_force(log: Log) -> np.ndarray:
    """The true force (n,) [N] of the end effector on the panel along its normal."""
    force: np.ndarray = np.sum(log.array("force") * log.array("normal"), axis=1)
    return force


def lean(log: Log) -> np.ndarray:
    """How far (n,) [rad] the base leans towards the panel, against how it stands at the start."""
    up = np.array([lie.euler_zyx_to_rotation(*x[2:5])[:, 2] for x in log.array("state")])
    angle: np.ndarray = np.arcsin(np.sum((up - up[0]) * log.array("normal"), axis=1))
    return angle


def pushed(log: Log) -> tuple[float, np.ndarray]:
    """The time [s] of the first touch (infinite: none) and which samples (n,) count: from :data:`TOUCH` after it until the door is
    open, in contact or not."""
    t, force = log.times("force"), normal_force(log)
    hit = np.flatnonzero(force > 0.0)
    touch = float(t[hit[0]]) if hit.size else np.inf
    return touch, (t >= touch + TOUCH) & (log.array("pushing") > 0.0)


def trial_metrics(trial: Trial) -> dict[str, float]:
    """Figures of one run: force error over the reference (lost contact counts in full), peak of the touch [N], share of
    the time in contact, mean lean [rad], largest angle of the door [rad], rms error of the force estimated without the
    sensor [N], how far the end effector swings at rest and is from where it is wanted [m], whether it fell."""
    log, target = trial.log, trial.force
    touch, use = pushed(log)
    force, t = normal_force(log), log.times("force")
    counted = force[use]
    without_sensor = np.sum(log.array("force_sensorless") * log.array("normal"), axis=1)[use] - counted
    return {
        "force_error_ratio": float(np.sqrt(np.mean((counted - target) ** 2)) / target) if counted.size else np.inf,
        "touch_peak": float(force[(t >= touch) & (t < touch + TOUCH)].max(initial=0.0)),
        "contact_share": float(np.mean(counted > 0.0)) if counted.size else 0.0,
        "lean_mean": float(lean(log)[use].mean()) if counted.size else 0.0,
        "door_angle_max": float(log.array("door")[:, 0].max()),
        "panel_penetration_max": float(log.array("penetration").max()),
        "force_estimate_error_rms": float(np.sqrt(np.mean(without_sensor**2))) if counted.size else np.inf,
        **rest(trial),
        "fell": float(trial.ending.fell),
    }


def rest(trial: Trial) -> dict[str, float]:
    """The end effector in the last :data:`REST` after the release: its largest swing, peak to peak along an axis (true), and the rms of its
    distance from where it is wanted, as the controller sees it [m]; infinite for a run that did not get there."""
    log = trial.log
    t, pushing = log.times("hand"), np.flatnonzero(log.array("pushing") > 0.0)
    use = t > t[-1] - REST
    if trial.ending.reason or not pushing.size or use[pushing[-1]]:
        return {"rest_hand_swing": np.inf, "rest_hand_error": np.inf}
    return {
        "rest_hand_swing": float(np.ptp(log.array("hand")[use], axis=0).max()),
        "rest_hand_error": rms((estimated_end_effector(log) - log.array("hand_wanted"))[use]),
    }


def metrics(trials: Sequence[Trial], names: Sequence[str], goal: float) -> dict[str, Metric]:
    """The figures of the runs by name, those of all runs last; a run that did not happen is infinitely bad. ``goal``: of the
    force's error."""
    figures = {name: trial_metrics(trial) for name, trial in zip(names, trials, strict=False)}
    out: dict[str, Metric] = {}
    for name in names:
        f = figures.get(name, {"force_error_ratio": np.inf, "contact_share": 0.0, "lean_mean": np.inf})
        out[f"force_error_ratio_{name}"] = Metric(f["force_error_ratio"], "1", goal=goal)
        out[f"contact_share_{name}"] = Metric(f["contact_share"], "1")
        out[f"lean_mean_{name}"] = Metric(f["lean_mean"], "rad")
    maximum = lambda key: max(f[key] for f in figures.values())
    out["touch_peak"] = Metric(maximum("touch_peak"), "N")
    out["force_estimate_error_rms"] = Metric(maximum("force_estimate_error_rms"), "N")
    out["panel_penetration_max"] = Metric(maximum("panel_penetration_max"), "m")
    out["door_angle_max"] = Metric(maximum("door_angle_max"), "rad")
    out["rest_hand_swing"] = Metric(maximum("rest_hand_swing"), "m")
    out["rest_hand_error"] = Metric(maximum("rest_hand_error"), "m")
    out["fell"] = Metric(maximum("fell"), "1", goal=0.0)
    return out


def worst_estimates(trials: Sequence[Trial]) -> dict[str, Metric]:
    """The estimator's figures, the worst of all runs."""
    found = [estimator_metrics(trial.log) for trial in trials]
    return {k: Metric(max(f[k].value for f in found), m.unit) for k, m in found[0].items()}


def door_plots(name: str, trial: Trial, settings: RezeroDoorSettings) -> list[Plot]:
    """The paper's Fig. 9 for one force, with what was planned; door, impedance and torques."""
    log, target = trial.log, trial.force
    t, normal, state = log.times("force"), log.array("normal"), log.array("state")
    touch, _ = pushed(log)
    along = lambda channel: np.sum(log.array(channel) * normal, axis=1)
    tangential = np.linalg.norm(log.array("force") - normal_force(log)[:, None] * normal, axis=1)
    reference = target * np.clip((t - touch) / max(settings.rise_time, 1e-9), 0.0, 1.0) * log.array("pushing")
    label = f"{target:g} N"
    door, believed_door = np.rad2deg(log.array("door")), np.rad2deg(log.array("door_estimated"))
    impedance, first = log.array("impedance"), np.maximum(np.abs(log.array("impedance")[0]), 1e-9)
    parts = zip(("inertia", "damping", "resistance"), (impedance / first).T, strict=True)
    return [
        Plot(f"Force at the end effector, reference {label} (Fig. 9, above)", "time [s]", "force [N]", [
            Series("along the normal, true", t, normal_force(log)), Series("measured, in contact", t, along("force_measured")),
            Series("estimated without the sensor", t, along("force_sensorless")),
            Series("planned", t, along("force_planned")), Series("reference", t, reference, dashed=True),
            Series("tangential", t, tangential),
        ]),
        Plot(f"Base, reference {label} (Fig. 9, below)", "time [s]", "angle [°]", [
            Series("pitch", t, np.rad2deg(state[:, 3])), Series("roll", t, np.rad2deg(state[:, 4])),
            Series("lean into the door", t, np.rad2deg(lean(log))),
            Series("in contact (times 10)", t, 10.0 * (normal_force(log) > 0.0), dashed=True),
        ]),
        Plot(f"Door, reference {label}", "time [s]", "angle [°], rate [°/s]", [
            Series("angle", t, door[:, 0]), Series("angle, estimated", t, believed_door[:, 0], dashed=True),
            Series("rate", t, door[:, 1]), Series("rate, estimated", t, believed_door[:, 1], dashed=True),
        ]),
        Plot(f"Believed impedance over the first guess, reference {label}", "time [s]", "ratio", [
            Series(part, t, values) for part, values in parts
        ]),
        Plot(f"From above, reference {label}", "x [m]", "y [m]", [
            Series("hand", *log.array("hand")[:, :2].T), Series("ball", *state[:, :2].T),
        ], equal_axes=True),
    ]  # fmt: skip
