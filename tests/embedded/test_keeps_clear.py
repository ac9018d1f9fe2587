"""Exported controllers of robots that keep their own parts apart. Truth: the loop in Python to the last bit, and the least distance of the
robot's own file in MuJoCo along what the C code commands."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from tempfile import mkdtemp

import mujoco
import numpy as np
import pytest

import wbmpc as wb
from clearing import TrueDistance, keep_clear, reach_problem, write_arm
from effort import thorough
from exported import Controller
from wbmpc.default_problem import default_mpc_settings, default_problem, make_mpc
from wbmpc.embedded import check as checks
from wbmpc.embedded.exporter import ALLOWED
from wbmpc.embedded.image import Export
from wbmpc.errors import InputError
from wbmpc.mpc.clearance import ClearanceRows
from wbmpc.solver.controller import Result
from wbmpc.solver.controller_data import Figure

PAIRS, MARGIN, RATE = [("foot", "fore"), ("foot", "upper")], 0.02, 25.0
#: Of the end effector: within the arm's own foot.
INSIDE = wb.Reference.poses([0.0], [0.02, 0.0, 0.06], [1, 0, 0, 0])


def reaching(folder: Path, keeps: bool = True) -> wb.MPC:
    """The arm of three joints reaches for a place in its own foot."""
    robot = wb.load_robot(write_arm(folder))
    ocp = reach_problem(robot)
    if keeps:
        keep_clear(ocp, wb.residuals.SelfClearance(robot, PAIRS, margin=MARGIN))
    mpc = wb.MPC(ocp, rate=RATE)
    mpc.reference["end_effector"] = INSIDE
    mpc.reset(robot.home)
    return mpc


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Export:
    """The arm that keeps clear."""
    folder = tmp_path_factory.mktemp("arm")
    return wb.export(reaching(folder), folder, prefix="arm")


def created(done: Export, folder: Path) -> Controller:
    """A controller in a library of its own: one is loaded once."""
    made = Controller(done, Path(mkdtemp(dir=folder)))
    assert made.create() == Result.OK
    return made


def figures(made: Controller) -> np.ndarray:
    found = np.empty(len(Figure))
    assert made("figures", found) == Result.OK
    return found


@pytest.mark.parametrize("pushes", [0, 1, 6])
def test_it_does_what_python_does_to_the_last_bit(
    done: Export, tmp_path: Path, pushes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With pushes that bring the fore arm into the foot: plans that stop, searches of others, parts that are inside of each other."""
    mpc, searched = reaching(tmp_path), []
    search = ClearanceRows.search
    monkeypatch.setattr(ClearanceRows, "search", lambda *a: searched.append(search(*a)) or searched[-1])
    made, x, u = created(done, tmp_path), wb.load_robot(tmp_path / "arm.yaml").home.copy(), np.empty(3)
    active, inside, rng = 0, 0, np.random.default_rng(pushes)
    for k in range(75):
        t, failures = k / RATE, mpc.statistics.failures
        if pushes and k % 8 == 7:
            x += rng.normal(size=3) * [0.0, 0.8, 1.6]
        found = made("update", t, x)
        policy = mpc.update(wb.Observation(t, x))
        assert found == mpc.statistics.failures - failures
        at = t + 0.3 / RATE
        assert made("policy", at, x, u) == Result.OK
        np.testing.assert_array_equal(u, policy(at, x))
        given = figures(made)
        assert given[Figure.ITERATIONS] == mpc.solve_info["iterations"]
        assert given[Figure.BRAKING_PLANS] == mpc.statistics.braking_plans
        assert given[Figure.EXTENDED] == mpc.statistics.extended
        assert given[Figure.CLEARANCE] == policy.clearance.distance
        active += policy.clearance.excess < 1e-3
        inside += policy.clearance.distance < 0.0
        x = mpc.solver.simulate(x, u, 1.0 / RATE)
    assert active > 20
    assert (inside > 0) == (pushes > 0)
    assert (mpc.statistics.braking_plans > 0) == (pushes == 1)
    assert set(searched) == ({True, False} if pushes == 6 else set())


def test_without_rows_the_same_controller_runs_into_itself(done: Export, tmp_path: Path) -> None:
    least = {}
    for keeps in (False, True):
        mpc = reaching(tmp_path, keeps)
        made = created(done if keeps else wb.export(mpc, tmp_path, prefix="arm"), tmp_path)
        x, u = wb.load_robot(tmp_path / "arm.yaml").home.copy(), np.empty(3)
        foot = (mujoco.mjtGeom.mjGEOM_CYLINDER, [0.08, 0.05])  # once more
        truth = TrueDistance(wb.load_robot(tmp_path / "arm.yaml"), [foot])
        truth.own = [g for g in truth.own if truth.model.body(truth.model.geom_bodyid[g]).name == "fore"]
        least[keeps] = np.inf
        for k in range(75):
            made("update", k / RATE, x)
            made("policy", k / RATE, x, u)
            x = mpc.solver.simulate(x, u, 1.0 / RATE)
            least[keeps] = min(least[keeps], truth(x, [np.array([0.0, 0.0, 0.05])]))
    assert least[True] > 0.01 and least[False] < 0.0


def test_the_default_problem_of_a_robot_that_lists_pairs_passes_the_check(tmp_path: Path) -> None:
    robot, settings = wb.load_robot("ur5"), default_mpc_settings()
    mpc = make_mpc(default_problem(robot, settings), settings)
    position, orientation = robot.pose(robot.home)
    mpc.reference["end_effector"] = wb.Reference.poses([0.0], position - [0.0, 0.0, 0.3], orientation)
    mpc.reset(robot.home)
    assert "self_clearance" in mpc.ocp.terms
    done = wb.export(mpc, tmp_path, prefix="ur5")
    found = checks.check(done, mpc, updates=20)
    assert found.passed and found.exact
    text = subprocess.run(["nm", "-u", str(tmp_path / "ur5.o")], capture_output=True, text=True, check=True).stdout
    assert {line.split()[-1] for line in text.splitlines()} <= {*ALLOWED, "_GLOBAL_OFFSET_TABLE_"}
    header = (tmp_path / "ur5.h").read_text()
    assert "REFERENCE_SELF_CLEARANCE" not in header.upper()  # they are set in every update
    assert re.search(r"UR5_FIGURE_CLEARANCE = 13,? /\* \[m\].*\*/", header)
    assert re.search(r"0.020 m +forearm_link-wrist_3_link", header)


def test_rows_around_obstacles_are_an_error_that_names_them(tmp_path: Path) -> None:
    robot = wb.load_robot(write_arm(tmp_path))
    ocp = reach_problem(robot)
    keep_clear(ocp, wb.residuals.Clearance(robot), "around")
    with pytest.raises(
        InputError, match="term 'around' keeps clear of obstacles, whose nearest points are sought in Python"
    ):
        wb.export(wb.MPC(ocp, obstacles=wb.Obstacles()), tmp_path / "out")
    ocp = reach_problem(robot)
    for name, pair in zip(("one", "two"), PAIRS, strict=True):
        keep_clear(ocp, wb.residuals.SelfClearance(robot, [pair], margin=MARGIN), name)
    with pytest.raises(InputError, match="terms one, two keep parts of the robot apart; valid: one SelfClearance"):
        wb.export(wb.MPC(ocp), tmp_path / "out")
    assert not (tmp_path / "out").exists()


STACK = """#include "bot.h"
#include <pthread.h>
#include <stdio.h>
#include <string.h>
static bot b;
static unsigned char stack[1 << 20] __attribute__((aligned(4096)));
static double x[BOT_NX], u[BOT_NU];
static void *nothing(void *a) { return a; }
static void *run(void *a)
{
    int k;
    for (k = 0; k < 5; k++) {
        x[0] += 0.05;
        bot_update(&b, 0.02 * k, x);
        bot_policy(&b, 0.02 * k, x, u);
    }
    return a;
}
static long used(void *(*what)(void *))
{
    pthread_attr_t how;
    pthread_t thread;
    long i = 0;
    memset(stack, 0xA5, sizeof stack);
    pthread_attr_init(&how);
    pthread_attr_setstack(&how, stack, sizeof stack);
    pthread_create(&thread, &how, what, 0);
    pthread_join(thread, 0);
    while (stack[i] == 0xA5) i++;
    return (long)sizeof stack - i;
}
int main(void)
{
    int i;
    bot_create(&b, sizeof b);
    for (i = 0; i < BOT_NX && scanf("%lf", &x[i]) == 1; i++) {}
    printf("%ld %ld\\n", used(nothing), used(run));
    return 0;
}
"""


@pytest.mark.parametrize("name", ["swerve-ur10", pytest.param("pr2", marks=thorough)])
def test_the_header_says_how_much_stack_is_needed(name: str, tmp_path: Path) -> None:
    """Truth: what a thread writes to of a stack that is filled with a pattern, less what one takes that does nothing."""
    robot, settings = wb.load_robot(name), default_mpc_settings()
    mpc = make_mpc(default_problem(robot, settings), settings)
    mpc.reference["end_effector"] = wb.Reference.poses([0.0], *robot.pose(robot.home))
    mpc.reset(robot.home)
    done = wb.export(mpc, tmp_path, prefix="bot")
    (tmp_path / "stack.c").write_text(STACK)
    subprocess.run(["cc", "stack.c", "bot.o", "-lm", "-lpthread", "-o", "stack"], cwd=tmp_path, check=True)
    given = " ".join(map(repr, robot.home.tolist()))
    found = subprocess.run([str(tmp_path / "stack")], input=given, capture_output=True, text=True, check=True).stdout
    idle, used = map(int, found.split())
    assert 65536 < used - idle < done.stack < 1.5 * used
    assert f"{done.stack // 1024} KiB of stack are enough" in (tmp_path / "bot.h").read_text()
