"""Public robots with default weights, kinematically: four paths of 5 m and jumps of the goal for each, without tuning.

``python benchmarks/gallery.py [--robots NAME …] [--quick] [--out FILE.json] [--study FOLDER]``. Robots of the package come from their own
small files, others from the Python packages that provide their descriptions (``pip install example-robot-data hello-robot-stretch-urdf``):
these are described by `wbmpc new --yes` first, and skipped where their package is not installed. With ``--study`` nothing runs: the study
"gallery" in MuJoCo is written with the descriptions of all robots, for ``wbmpc study FOLDER/gallery.yaml``.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.optimize import least_squares

from wbmpc.clearance.rows import SELF_REACH, SelfRows
from wbmpc.cli import main as wbmpc
from wbmpc.cli.study import built_in_studies
from wbmpc.default_problem import ACCELERATION_SHARE
from wbmpc.errors import WbmpcError
from wbmpc.experiment import run_scenario
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.obstacles.floor import floor_boxes, heights
from wbmpc.obstacles.pairs import self_pairs
from wbmpc.ocp.clearance_residuals import SelfClearance, stopping_time
from wbmpc.ocp.scaling import reach
from wbmpc.tasks import goals, track
from wbmpc.tasks.following import PathTaskSettings, Task
from wbmpc.yaml_file import load_yaml

#: Robots of other people's designs in small files of the package.
OWN = ("fetch", "ffw-sg2", "panda", "panda-omni", "pr2", "ridgeback-ur5", "tidybot", "ur5", "vega")
#: Others: distribution, end of the model's path in it, options of `wbmpc new`.
PACKAGED = {
    "tiago": ("example-robot-data", "tiago_description/robots/tiago_no_hand.urdf", ()),
    "tiago-dual": ("example-robot-data", "tiago_description/robots/tiago_dual.urdf", ("--arm", "left")),
    "stretch": ("hello-robot-stretch-urdf", "SE3/stretch_description_SE3_eoa_wrist_dw3_tool_sg3.urdf", ()),
}
#: Goals: mean error of the end effector [m], error at a goal [m], median solve time [ms] of at most so many states.
MEAN, AT_GOAL, SOLVE_MS, STATES = 2e-4, 5e-3, 0.5, 20
#: Length [m] of a path; of the short form. Radius of a circle over the reach of a robot whose base stands, and shares of it that are
#: tried; poses of a circle that are checked, distance [rad, m] to ends of ranges, least singular value of the six of a pose.
LENGTH, SHORT, RADIUS, SMALLER = 5.0, 0.3, 0.2, (1.0, 0.75, 0.5, 0.35)
DENSE, EDGE, SINGULAR, RANK = 60, 0.05, 0.02, 6
HEAD = (
    "robot", "states", "mean error on paths [mm]", "worst path", "jumps reached", "at the goal [mm]", "solve, median [ms]",
    "solves without a plan", "note",
)  # fmt: skip


@dataclass(frozen=True)
class Row:
    """What came out of one robot: mean errors [m] of paths, why runs failed, share of goals that were reached, the largest error [m] at
    them, median solve time [ms], solves that gave no plan (the one before went on); ``skipped``: why nothing was run."""

    robot: str
    states: int = 0
    errors: tuple[float, ...] = ()
    failures: tuple[str, ...] = ()
    reached: float = 0.0
    at_goal: float = 0.0
    solve_ms: float = 0.0
    lost: int = 0
    skipped: str = ""

    @property
    def missed(self) -> list[str]:
        """Goals that it misses."""
        found = [f"failed: {text}" for text in self.failures]
        if not self.states:
            return found
        found += ["mean error"] if self.errors and np.mean(self.errors) > MEAN else []
        found += ["jumps"] if self.reached < 1.0 or self.at_goal > AT_GOAL else []
        return found + (["solve time"] if self.states <= STATES and self.solve_ms > SOLVE_MS else [])

    def cells(self) -> list[str]:
        """As a row of the table."""
        if self.skipped:
            return self._empty(f"skipped: {self.skipped}")
        if not self.states:
            return self._empty("; ".join(self.missed))
        mean, worst = 1e3 * float(np.mean(self.errors)), 1e3 * max(self.errors)
        return [
            self.robot, str(self.states), f"{mean:.3f}", f"{worst:.3f}", f"{100 * self.reached:.0f} %",
            f"{1e3 * self.at_goal:.2f}", f"{self.solve_ms:.2f}", str(self.lost), "; ".join(self.missed),
        ]  # fmt: skip

    def _empty(self, note: str) -> list[str]:
        return [self.robot, *["–"] * (len(HEAD) - 2), " ".join(note.split()).replace("|", "/")]


def packaged(name: str, folder: Path) -> Path:
    """The robot file that `wbmpc new --yes` writes for a model of an installed package. Raises ``PackageNotFoundError`` without it, and
    :class:`WbmpcError` with what the command says where it fails."""
    distribution, ending, options = PACKAGED[name]
    model = next((f.locate() for f in files(distribution) or () if str(f).endswith(ending)), None)
    if model is None:
        raise WbmpcError(f"{distribution} has no file {ending}")
    out, said = folder / f"{name}.yaml", io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
        failed = wbmpc(["new", str(model), "--yes", "--out", str(out), *options])
    if failed:  # the error comes after warnings
        raise WbmpcError((said.getvalue().strip().splitlines() or [f"wbmpc new {model}"])[-1])
    sys.stderr.write(said.getvalue())
    return out


def paths(robot: RobotModel, length: float) -> Iterator[dict[str, Any]]:
    """Four of a length [m]: of a robot whose base stands, the largest circles that it reaches, up to :data:`RADIUS`."""
    if robot.description.base.moves:
        yield {"kind": "line", "length": length, "direction": 0.7, "climb": 0.05 * length}
        yield {"kind": "circle", "length": length}
        yield {"kind": "circle", "length": length, "turn": True, "direction": 1.5}
        yield {"kind": "sine", "length": length}
        return
    for vertical in (False, True):
        for direction in (0.0, np.pi / 2.0):
            for share in SMALLER:
                laps = max(1.0, length / (2.0 * np.pi * share * RADIUS * reach(robot)))
                found = {"kind": "circle", "length": length, "laps": laps, "vertical": vertical, "direction": direction}
                if share == SMALLER[-1] or reached(robot, found):
                    yield found
                    break


def reached(robot: RobotModel, path: dict[str, Any]) -> bool:
    """Whether a standing robot has a posture within its ranges, away from singular ones, for every pose of one lap: by SciPy's least
    squares, each from the posture before; and whether such a motion is one that plans allow."""
    settings = PathTaskSettings.model_validate(
        {"robot": str(robot.description.source), "plant": "kinematic", "path": path}
    )
    task, task_speed = Task(settings), settings.path.speed
    lower, upper = robot.limits.state_lower + EDGE, robot.limits.state_upper - EDGE
    x, states = np.clip(robot.home, lower, upper), []
    for goal in task.path.at(np.linspace(0.0, task.path.length / path["laps"], DENSE)):

        def off(x: np.ndarray, goal: np.ndarray = goal) -> np.ndarray:
            position, turned = robot.pose(x)
            return np.concatenate([position - goal[:3], turned * np.sign(turned @ goal[3:]) - goal[3:]])

        fit = least_squares(off, x, bounds=(lower, upper), xtol=1e-12, ftol=1e-12, gtol=1e-12)
        x = fit.x
        if np.abs(fit.fun).max() > 1e-5 or np.linalg.svd(fit.jac, compute_uv=False)[RANK - 1] < SINGULAR:
            return False
        states.append(x)
    return allowed(robot, np.array(states), task.path.length / path["laps"] / task_speed / (DENSE - 1))


def allowed(robot: RobotModel, states: np.ndarray, interval: float) -> bool:
    """Whether states (n, nx) every ``interval`` [s] are motions that plans allow: near the floor, between pairs of the robot's parts, and by
    accelerations of an arm that has no other postures for the same poses."""
    boxes, found = floor_boxes(robot), []
    if len(robot.state.groups["arm"]) <= RANK:
        changes = np.diff(states[:, robot.state["arm"]], n=2, axis=0) / interval**2
        found.append(ACCELERATION_SHARE * robot.limits.input_rate[robot.input["arm"]] - np.abs(changes))
    if boxes:
        found.append(approached(robot, heights(robot, list(boxes), states), [b.margin for b in boxes], interval))
    if robot.description.collision.self.pairs and self_pairs(robot):
        rows = SelfRows(SelfClearance(robot))
        found.append(approached(robot, np.minimum(rows.measure(states), SELF_REACH), rows.margins, interval))
    return all((rows >= 0.0).all() for rows in found)


def approached(
    robot: RobotModel, apart: np.ndarray, margins: Sequence[float] | np.ndarray, interval: float
) -> np.ndarray:
    """Of distances (n, k) [m]: what is left of them beyond ``margins`` at the end of a stop."""
    kept = apart - np.asarray(margins)
    return kept + stopping_time(robot) * np.gradient(kept, interval, axis=0)


def examine(name: str, robot: str, quick: bool = False, seed: int = 1) -> Row:
    """All paths and jumps of one robot (its name or file); ``quick``: a short path and one jump."""
    model = load_robot(robot)
    fixed = {"robot": robot, "plant": "kinematic"}
    ways = list(paths(model, SHORT if quick else LENGTH))[: 1 if quick else None]
    runs = [
        run_scenario("path", track.build, PathTaskSettings.model_validate({**fixed, "path": p}), seed) for p in ways
    ]
    jumps = {"count": 1, "time_per_goal": 4.0, "distance": [0.3, 0.5]} if quick else {}
    runs.append(run_scenario("jumps", goals.build, goals.GoalsSettings.model_validate({**fixed, **jumps}), seed))
    tracked = [r.metrics["end_effector_error_mean"].value for r in runs[:-1]]
    solved, reached = [r.mpc for r in runs if r.mpc is not None], runs[-1].metrics["goals_reached"]
    return Row(
        name, model.state.size, tuple(tracked), tuple(r.reason for r in runs if not r.completed), reached.value / (reached.least or 1.0),
        runs[-1].metrics["goal_error_max"].value, float(np.median([m.solve_ms["median"] for m in solved])), sum(m.failures for m in solved),
    )  # fmt: skip


def row(name: str, quick: bool) -> Row:
    """One robot; skipped where its package is not installed, failed with the message where it cannot be loaded or run."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            return examine(name, name if name in OWN else str(packaged(name, Path(folder))), quick)
        except PackageNotFoundError:
            return Row(name, skipped=f"pip install {PACKAGED[name][0]}")
        except WbmpcError as error:
            return Row(name, failures=(str(error),))


def write_study(names: Sequence[str], folder: Path) -> None:
    """The built-in study "gallery" with those of ``names`` that it does not have and that other packages provide, beside their robot
    files. Raises :class:`WbmpcError` for one that is not installed."""
    study = load_yaml(built_in_studies()["gallery"])
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        if name in PACKAGED:
            try:
                study["robots"].append(packaged(name, folder).name)
            except PackageNotFoundError as error:
                raise WbmpcError(f"{name}: pip install {PACKAGED[name][0]}") from error
    (folder / "gallery.yaml").write_text(yaml.safe_dump(study, sort_keys=False))


def line(cells: Sequence[str]) -> str:
    """A row of a Markdown table."""
    return "| " + " | ".join(cells) + " |"


def main() -> int:
    """Print the table; 1 where a robot misses a goal."""
    known = sorted([*OWN, *PACKAGED])
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="+", choices=known, default=known)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--study", type=Path)
    given = parser.parse_args()
    if given.study is not None:
        try:
            write_study(given.robots, given.study)
        except WbmpcError as error:
            sys.exit(f"gallery: {error}")
        return 0
    rows = []
    print(line(HEAD), line(["---"] * len(HEAD)), sep="\n", flush=True)
    for name in given.robots:
        rows.append(row(name, given.quick))
        print(line(rows[-1].cells()), flush=True)
    if given.out is not None:
        given.out.write_text(json.dumps([asdict(r) for r in rows], indent=1))
    return int(any(r.missed for r in rows if not r.skipped))


if __name__ == "__main__":
    sys.exit(main())
