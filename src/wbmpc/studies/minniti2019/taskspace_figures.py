"""What `rezero-taskspace` measures and draws."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from wbmpc import lie
from wbmpc.experiment import Outcome
from wbmpc.log import Log
from wbmpc.result import Metric, Plot, Series
from wbmpc.studies.minniti2019.metrics import count_wheels

CONTROLLERS = ("mpc", "taskspace")


def figures(log: Log, name: str) -> dict[str, float]:
    """Integral of the end effector's position error [m s] (estimated frame), of its orientation error [rad s], of the squared torques'
    change against rest [(N m)² s], largest tilt [rad]."""
    t, target, torque = log.times(f"hand_{name}"), log.array(f"wanted_{name}"), log.array(f"torque_{name}")
    error = np.linalg.norm(log.array(f"hand_{name}") - target[:, :3], axis=1)
    turned = [
        np.linalg.norm(lie.quaternion_log(lie.quaternion_multiply(q, lie.quaternion_conjugate(w))))
        for q, w in zip(log.array(f"hand_quaternion_{name}"), target[:, 3:], strict=True)
    ]
    return {
        "position": float(np.trapezoid(error, t)),
        "orientation": float(np.trapezoid(turned, t)),
        "torque": float(np.trapezoid(np.sum((torque - torque[0]) ** 2, axis=1), t)),
        "tilt": float(log.array(f"tilt_{name}").max()),
    }


def metrics(log: Log, outcomes: Mapping[str, Outcome]) -> dict[str, Metric]:
    """Integrals of a controller that did not get to the end are infinite, and there is no ratio to it: the part before says
    nothing. (What the user ended has been integrated as far as it got.)"""
    endings = {name: outcome.ending for name, outcome in outcomes.items()}
    done = {name: figures(log, name) for name in endings if f"hand_{name}" in log.channels}
    lost = {name for name, e in endings.items() if e.reason and not e.interrupted}
    whole = lambda name, value: np.inf if name in lost else value
    out = {f"hand_error_integral_{name}": Metric(whole(name, f["position"]), "m s") for name, f in done.items()}
    out |= {f"hand_turn_integral_{name}": Metric(whole(name, f["orientation"]), "rad s") for name, f in done.items()}
    if "taskspace" in endings:
        if not any(e.reason for e in endings.values()):
            out["torque_squared_ratio"] = Metric(done["taskspace"]["torque"] / done["mpc"]["torque"], "1")
        out["falls_taskspace"] = Metric(float(endings["taskspace"].fell), "1")
    out |= {f"tilt_max_{name}": Metric(f["tilt"], "rad") for name, f in done.items()}
    out["fell"] = Metric(float(endings["mpc"].fell), "1", goal=0.0)
    return out


def plots(log: Log) -> list[Plot]:
    done = [n for n in CONTROLLERS if f"hand_{n}" in log.channels]
    t = {n: log.times(f"hand_{n}") for n in done}
    error = {n: np.linalg.norm(log.array(f"hand_{n}") - log.array(f"wanted_{n}")[:, :3], axis=1) for n in done}

    def wheels(name: str) -> np.ndarray:
        torque = log.array(f"torque_{name}")
        return np.abs(torque[:, : count_wheels(log.array(f"state_{name}"), torque)])

    return [
        Plot("End effector position error", "time [s]", "error [mm]", [Series(n, t[n], 1e3 * error[n]) for n in done]),
        *(
            Plot(f"End effector, {axis}", "time [s]", "position [m]", [
                *(Series(n, t[n], log.array(f"hand_{n}")[:, i]) for n in done),
                Series("reference", t[done[0]], log.array(f"wanted_{done[0]}")[:, i], dashed=True),
            ])
            for i, axis in enumerate("xyz")
        ),
        Plot("Tilt", "time [s]", "angle [°]", [Series(n, t[n], np.rad2deg(log.array(f"tilt_{n}"))) for n in done]),
        Plot("Largest wheel torque", "time [s]", "torque [N m]", [
            Series(n, t[n], wheels(n).max(axis=1)) for n in done
        ]),
    ]  # fmt: skip
