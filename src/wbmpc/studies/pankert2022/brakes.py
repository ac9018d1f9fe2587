"""`swerve-brakes`: what the brakes hold, and whether they answer (Pankert et al. 2022, sections II-C and IV-A, Fig. 4)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from wbmpc.bases.swerve.brakes import BRAKE_TORQUE
from wbmpc.bases.swerve.configurations import CONFIGURATIONS
from wbmpc.experiment import Experiment, Outcome, Part, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import load_robot
from wbmpc.result import Metric, Plot, Series
from wbmpc.simulation.lockstep import Ending, Progress, contacts_of
from wbmpc.studies.pankert2022 import brake_tests
from wbmpc.studies.pankert2022.brake_tests import Bench, Found, SwerveBrakesSettings
from wbmpc.studies.pankert2022.definitions import DEFINITIONS

NAME = "swerve-brakes"
SUMMARY = "pushes with brakes closed and open, slip of a brake, brakes that do not answer (Pankert et al. 2022, Fig. 4)"

IDEALIZATIONS = [
    "the body and the legs are rigid: the paper's robot also bends",
    "tires are soft contacts, not a tire model; a closed brake is dry friction of 200 N m",
    "the time that a brake takes to open and to close is assumed",
    "the wheels stand parallel to the body and their drives hold them still",
]
#: What is wrong with the brake that is tried in the search for faults, and how that test is called.
KINDS: dict[str | None, str] = {
    None: "a brake that is sound", "closed": "a brake that is stuck closed", "open": "a brake that is stuck open",
}  # fmt: skip


def build(settings: SwerveBrakesSettings, seed: int) -> Scenario:
    """All tests one after the other, each on its own plant of the same seed."""
    bench = Bench(settings, load_robot(settings.robot), seed, Log())
    brake_tests.reject(bench.robot)
    moved, slip, slides, faults = (dict[Any, Any]() for _ in range(4))

    def test(name: str, into: dict[Any, Any], key: Any, run: Callable[..., Any], *arguments: Any) -> Part:
        def kept(progress: Progress | None) -> Outcome:
            result = into[key] = run(bench, *arguments, progress)
            ending = Ending(contacts=contacts_of(*bench.plants[-1:]))
            return Outcome(ending, [str(fault) for fault in result.real] if isinstance(result, Found) else ())

        return Part(name, kept)

    pushes = [(name, state) for name in CONFIGURATIONS for state in ("closed", "open")]
    return Scenario(
        bench.log,
        [
            *(test(f"push in {n}, brakes {s}", moved, (n, s == "open"), brake_tests.push, n, s == "open") for n, s in pushes),
            test("slip of a brake", slip, "torque", brake_tests.slip_torque),
            *(test(f"sliding in {n}", slides, n, brake_tests.slide_force, n) for n in CONFIGURATIONS),
            *(test(name, faults, kind, brake_tests.fault, kind) for kind, name in KINDS.items()),
        ],
        lambda run: _metrics(moved, slip["torque"], slides, faults), lambda run: _plots(bench.log, bench.left_front),
        IDEALIZATIONS,
    )  # fmt: skip


def _metrics(
    moved: dict[tuple[str, bool], float],
    slip: float,
    slides: dict[str, float],
    faults: dict[str | None, Found],
) -> dict[str, Metric]:
    closed = {n: v for (n, is_open), v in moved.items() if not is_open}
    opened = {n: v for (n, is_open), v in moved.items() if is_open}
    return {
        "displacement_closed": Metric(max(closed.values()), "m", goal=3e-4),
        "displacement_open": Metric(max(opened.values()), "m"),
        **{f"displacement_closed_{n}": Metric(v, "m") for n, v in closed.items()},
        **{f"displacement_open_{n}": Metric(v, "m") for n, v in opened.items()},
        "brake_slip_torque": Metric(slip, "N m", paper=BRAKE_TORQUE, goal=206.0, least=195.0),
        "slide_force": Metric(min(slides.values()), "N"),
        "fault_detection_time_closed": Metric(faults["closed"].time, "s", goal=2.0),
        "fault_detection_time_open": Metric(faults["open"].time, "s", goal=2.0),
        "false_alarms": Metric(float(sum(len(f.alarms) for f in faults.values())), "1", goal=0.0),
    }


def _plots(log: Log, tried: int) -> list[Plot]:
    def sideways(state: str) -> list[Series]:
        names = [n for n in CONFIGURATIONS if f"push_{n}_{state}" in log.channels]
        return [Series(n, log.times(f"push_{n}_{state}"), 1e3 * log.array(f"push_{n}_{state}")[:, 1]) for n in names]

    slip = log.array("slip")
    legs = [
        Series(f"{'sound' if kind == 'none' else f'stuck {kind}'}", log.times(c), np.degrees(log.array(c)[:, tried]))
        for kind in ("none", "closed", "open")
        for c in [f"fault_{kind}"]
    ]
    legs.append(
        Series("reference", log.times("fault_none"), np.degrees(log.array("fault_none")[:, 4 + tried]), dashed=True)
    )
    slides = [Series(n, log.array(f"slide_{n}")[:, 0], 1e3 * log.array(f"slide_{n}")[:, 1]) for n in CONFIGURATIONS]
    return [
        Plot("Pushed sideways, brakes closed (Fig. 4b)", "time [s]", "displacement [mm]", sideways("closed")),
        Plot("Pushed sideways, brakes open (Fig. 4a)", "time [s]", "displacement [mm]", sideways("open")),
        Plot("Slip of a closed brake", "torque about the hinge [N m]", "angle [°]", [
            Series("left front leg", slip[:, 0], np.degrees(slip[:, 1])),
        ]),
        Plot("Pushed until it slides, brakes closed", "force [N]", "displacement [mm]", slides),
        Plot("Left front leg, its brake sound or stuck", "time [s]", "leg angle [°]", legs),
    ]  # fmt: skip


EXPERIMENT = Experiment.of(NAME, SUMMARY, SwerveBrakesSettings, build, DEFINITIONS[NAME])
