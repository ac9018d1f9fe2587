"""The whole race in one run on one core: the small race of ``wbmpc bench``, then more peers and where the time goes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from wbmpc.benchmark import race
from wbmpc.benchmark.peers import PEERS
from whole_race import acados_race, closed_loop, scaling
from whole_race.crocoddyl_peer import ball_robot_spec, crocoddyl_figures, lq_spec, torque_arm_spec
from whole_race.floor import profile
from whole_race.qp import quadratic_race
from whole_race.yardstick import yardstick

#: Parts of the race after the small one, for its progress.
PARTS = 5


def crocoddyl_race() -> list[dict[str, Any]]:
    """Nearest problems that crocoddyl can express; see :mod:`whole_race.crocoddyl_peer`."""
    specs = {
        "torque arm, 6 joints, N = 50 (same problem, quadrature of the cost apart)": torque_arm_spec(6, 50),
        "ball robot, N = 65 (nearest: every joint actuated, no limits)": ball_robot_spec(65),
        "swerve, N = 100 (linear-quadratic, no rows: a lower bound)": lq_spec(21, 21, 100),
    }
    figures = crocoddyl_figures(list(specs.values()))
    if isinstance(figures, str):
        return [{"problem": name, "solver": "crocoddyl", "success": False, "error": figures} for name in specs]
    return [{"problem": name, "solver": "crocoddyl", **f} for name, f in zip(specs, figures, strict=True)]


def run_whole_race(repeat: int = 200, progress: race.Progress | None = None) -> dict[str, Any]:
    """Figures of ``wbmpc bench``, acados where ``ACADOS_INSTALL_DIR`` says it is, crocoddyl (installed into the cache directory when
    it is not there), QP solvers, a C build of the same functions, the floor, the scaling and the closed loop. Takes minutes."""
    done = 0

    def note(text: str) -> None:
        if progress is not None:
            progress(0.4 + 0.6 * done / PARTS, text)

    small = None if progress is None else (lambda share, text: progress(0.4 * share, text))
    figures = race.run_benchmark(repeat, small)
    with race.one_core():
        figures["acados"] = acados_race.acados_race(repeat, note)
        note("crocoddyl")
        figures["crocoddyl"] = crocoddyl_race()
        done = 1
        figures |= {"quadratic": [], "yardstick": [], "floor": []}
        for make in race.race_problems().robots:
            problem = make(limits="soft")
            note(f"{problem.name}: a quadratic problem")
            figures["quadratic"] += quadratic_race(problem)
            note(f"{problem.name}: C")
            figures["yardstick"].append(yardstick(problem, repeat))
            note(f"{problem.name}: floor")
            figures["floor"].append(profile(problem, repeat))
        done = 2
        figures["scaling"] = scaled(repeat, note)
        done = 4
        figures["closed_loop"] = closed_loop.closed_loop_race(("wbmpc SQP", *PEERS), note)
    figures["goals"] = [*acados_race.goals(figures["acados"]), *race.goals(figures)]
    return figures


def scaled(repeat: int, note: Callable[[str], None]) -> dict[str, Any]:
    """Time over intervals, joints and hard limits per node."""
    return {
        "intervals": scaling.over_intervals(repeat, PEERS, note),
        "joints": scaling.over_joints(repeat, PEERS, note),
        "limits": scaling.over_limits(repeat, PEERS, note),
    }
