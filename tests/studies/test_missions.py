"""Missions, `swerve-unified` and parts of `swerve-drive`. Truth: derivatives of the references by differences, motions with known
errors, and what the simulated robot did."""

from __future__ import annotations

from itertools import pairwise

import mujoco
import numpy as np
import pytest

from configured import check_taken
from effort import thorough
from toys import robot
from wbmpc.bases.swerve.brake_control import BrakeControl
from wbmpc.bases.swerve.messages import SwerveMeasurement
from wbmpc.bases.swerve.perturbation import SwervePerturbation
from wbmpc.configuration import configure
from wbmpc.errors import InputError
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.registry import REGISTRY
from wbmpc.simulation.contacts import HULL
from wbmpc.studies.pankert2022 import drive_missions
from wbmpc.studies.pankert2022.drive import _baseline
from wbmpc.studies.pankert2022.drive_course import DOOR, clearance, terrain
from wbmpc.studies.pankert2022.drive_figures import recovery, speed_ratio
from wbmpc.studies.pankert2022.drive_missions import SwerveDriveSettings, straight, tour
from wbmpc.studies.pankert2022.mission import Leg, Mission, Reconfiguration, carried_poses, ramps
from wbmpc.studies.pankert2022.mission_run import MissionRun
from wbmpc.studies.pankert2022.rolling import RollingController

SWERVE = robot("swerve-ur10")


# ---------------------------------------------------------------------- references
def test_rates_are_the_derivatives_of_the_references() -> None:
    mission, duration = tour(SWERVE, 0.1)
    t, h = np.arange(0.013, duration, 0.1), 1e-5
    pose, rate = mission.base(t)
    assert rate == pytest.approx((mission.base(t + h)[0] - mission.base(t - h)[0]) / (2 * h), abs=1e-6)
    _, leg_rate = mission.leg(t)
    assert leg_rate == pytest.approx((mission.leg(t + h)[0] - mission.leg(t - h)[0]) / (2 * h), abs=1e-6)
    assert np.abs(leg_rate).max() == pytest.approx(0.2)
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    twist = mission.twist(t)
    assert c * twist[:, 0] - s * twist[:, 1] == pytest.approx(rate[:, 0], abs=1e-12)
    assert s * twist[:, 0] + c * twist[:, 1] == pytest.approx(rate[:, 1], abs=1e-12)


def test_the_tour_is_the_one_that_was_asked_for() -> None:
    mission, duration = tour(SWERVE, 0.1)
    t = np.arange(0.0, duration, 0.01)
    pose, leg = mission.base(t)[0], mission.leg(t)[0]
    at = lambda when: int(np.searchsorted(t, when))
    # the door in H with closed brakes, the turn by 180 degrees within 18 s, X and A on the way, H in the end
    door = np.argmax(pose[:, 0] > 3.0 + 0.9)
    assert t[door] < mission.brakes[0][0] and np.all(leg[: door + 1] == 0.0)
    assert pose[at(48.0), 2] - pose[at(30.0), 2] == pytest.approx(np.pi)
    assert 2.0 < pose[at(48.0), 0] - pose[at(30.0), 0] < 2.2
    assert leg[at(30.0)] == pytest.approx([np.pi / 4, -np.pi / 4, -np.pi / 4, np.pi / 4])
    assert leg[at(39.0)] == pytest.approx([-0.498, 0.498, -0.747, 0.747])
    assert leg[-1] == pytest.approx(np.zeros(4)) and pose[-1] == pytest.approx([15.0, 0.0, 0.0], abs=1e-9)
    # with closed brakes no leg is to move
    closed = [
        (when, later) for (when, is_open), (later, _) in pairwise([*mission.brakes, (duration, 0)]) if not is_open
    ]
    assert all(np.ptp(leg[at(when) : at(later)], axis=0).max() < 1e-9 for when, later in closed)


def test_brakes_wait_for_the_legs_of_a_mission_that_moves_them_with_the_baseline_too() -> None:
    mission, _ = tour(SWERVE, 0.1)
    brakes, still = BrakeControl(SWERVE), BrakeControl(SWERVE)
    mission.apply(brakes)
    straight(SWERVE, "X", True)[0].apply(still)
    assert still.arrivals is None and brakes.arrivals is not None
    close = mission.brakes[1][0]
    there = brakes.arrivals(close)
    assert there == pytest.approx([np.pi / 4, -np.pi / 4, -np.pi / 4, np.pi / 4])  # X
    part, home = SWERVE.state.split(SWERVE.home), np.zeros(4)
    goals = lambda t: ((np.zeros(3), np.zeros(3)), (there, home))
    controller = RollingController(SWERVE, np.zeros(3), 0.0025, goals, brakes=brakes)
    leg = there + [0.0, 0.0, 0.3, 0.0]
    controller.measure(SwerveMeasurement(close - 0.01, leg, part["steer"], part["wheel"], part["arm"]))
    controller.drive(close - 0.01)
    assert list(brakes.commanded(close)) == [0.0, 0.0, 1.0, 0.0]


def test_the_arm_is_folded_while_the_robot_is_in_the_door() -> None:
    """The door is 0.9 m wide, at x = 3 m; at home the end effector is 0.65 m to the left."""
    mission, _ = tour(SWERVE, 0.1)
    t = np.arange(0.0, 25.0, 0.05)
    x, arm = mission.base(t)[0][:, 0], ramps(SWERVE.home[SWERVE.state["arm"]], mission.arm, t)[0]
    states = np.tile(SWERVE.home, (t.size, 1))
    states[:, SWERVE.state["arm"]] = arm
    place = np.array([SWERVE.pose(state)[0] for state in states])
    through = (x > 3.0 - 0.85) & (x < 3.0 + 0.6)
    assert place[0, 1] > 0.6 and np.abs(place[through, 1]).max() < 0.01 and place[-1, 1] > 0.6


def test_a_riding_hand_keeps_its_place_on_the_base() -> None:
    poses = np.array([[0.0, 0.0, 0.0], [1.0, -2.0, 0.7]])
    points, turns = carried_poses(SWERVE, SWERVE.home, poses)
    x = SWERVE.home.copy()
    x[SWERVE.state["base"]] = poses[1]
    place, quaternion = SWERVE.pose(x)
    assert points[1] == pytest.approx(place, abs=1e-9)
    assert abs(float(turns[1] @ quaternion)) == pytest.approx(1.0)


# ---------------------------------------------------------------------- figures
def test_recovery_is_the_time_until_an_error_stays_small() -> None:
    t = np.arange(0.0, 10.0, 0.01)
    error = np.radians(5.0) * np.exp(-(t - 4.0)) * (t >= 4.0)
    assert recovery(t, error, 4.0) == pytest.approx(np.log(5.0), abs=0.02)
    assert recovery(t, 0.0 * error, 4.0) == 0.0
    assert recovery(t, 0.0 * error + 0.1, 4.0) == np.inf


@pytest.mark.parametrize("factor", [1.0, 0.5])
def test_speeds_are_compared_with_the_limits_of_the_robot_that_drives(factor: float) -> None:
    own = SWERVE.description.limits
    limits = own.model_copy(update={"velocity": {n: factor * v for n, v in own.velocity.items()}})
    slower = RobotModel(SWERVE.description.model_copy(update={"limits": limits}))
    log = Log()
    # of the paper's robot: hinges 0.5 rad/s, steering 5.76, wheels 11.52
    log.add("tour.drive_speed", 0.0, np.repeat([-0.25, 0.0, 0.0], 4))
    log.add("tour.drive_speed", 0.1, np.repeat([0.0, 0.0, 1.152], 4))
    assert speed_ratio(log, slower) == pytest.approx(0.5 / factor)
    log.add("tour.drive_speed", 0.2, np.repeat([0.0, -5.76, 0.0], 4))
    assert speed_ratio(log, slower) == pytest.approx(1.0 / factor)


def test_clearance_at_the_door() -> None:
    way = np.stack([np.linspace(0.0, 6.0, 601), np.zeros(601), np.zeros(601)], axis=1)
    legs = np.zeros((601, 4))
    assert clearance(SWERVE, way, legs) == pytest.approx(0.45 - 0.40, abs=1e-9)  # the body is 0.80 m wide
    assert clearance(SWERVE, way + [0.0, 0.03, 0.0], legs) == pytest.approx(0.02, abs=1e-9)
    out = legs + 0.5 * np.array([1.0, -1.0, -1.0, 1.0])
    assert clearance(SWERVE, way, out) < 0.0  # legs turned outwards do not pass


# ---------------------------------------------------------------------- runs
QUIET = SwerveDriveSettings(settle_time=1.0, calibration="none", plant=SwervePerturbation.none(encoder_counts=2**14))


def run_straight(name: str, is_open: bool, knock: float | None = None):  # type: ignore[no-untyped-def]
    bench = MissionRun.of(QUIET, SWERVE, 0)
    outcome, hit = bench.planned("way", *straight(SWERVE, name, is_open), knock=knock)
    assert not outcome.ending.reason and outcome.faults == []
    return bench.log, hit


@thorough
@pytest.mark.parametrize(("name", "is_open"), [("H", False), ("A", False), ("X", True)])
def test_driving_straight_with_brakes_closed_and_open(name: str, is_open: bool) -> None:
    log, _ = run_straight(name, is_open)
    assert log.array("way.base")[-1] == pytest.approx([1.5, 0.2, 0.3], abs=0.015)
    assert np.abs(log.array("way.leg") - log.array("way.leg")[0]).max() < (0.03 if is_open else 2e-3)
    assert log.array("way.brake").max() == float(is_open)


def test_a_knocked_leg_comes_back() -> None:
    log, hit = run_straight("X", True, knock=4.0)
    error = (log.array("way.leg") - log.array("way.leg_reference"))[:, 0]
    assert np.abs(error).max() > 0.9 * drive_missions.KNOCK
    assert 0.1 < recovery(log.times("way.leg"), error, hit.done) < 2.0
    assert log.array("way.base")[-1] == pytest.approx([1.5, 0.2, 0.3], abs=0.03)
    assert log.array("way.brake").max() == 1.0


def test_the_report_of_a_tour_shows_every_joint_with_its_limits() -> None:
    """Truth: joints and limits of the robot's own file."""
    bench = MissionRun.of(QUIET, SWERVE, 0)
    mission, _ = straight(SWERVE, "X", True)
    bench.planned("tour", mission, 0.5)
    limits = SWERVE.limits
    arm = [name.removesuffix("_joint") for name in SWERVE.description.arm.joints]
    wheels = [f"{what}_{where}" for what in ("steer", "wheel") for where in ("LF", "RF", "LB", "RB")]
    legs = [name.replace("steer", "leg") for name in wheels[:4]]
    lines: dict[str, dict[str, tuple[float, float] | None]] = {}
    for plot in bench.joint_plots():
        lines.setdefault(plot.title.split(":")[0], {}).update({s.name: s.limits for s in plot.series})
    for shown in (lines["Speeds"], lines["Joint positions"]):
        assert set(shown) == {f"{name}{end}" for name in (*legs, *wheels, *arm) for end in ("", ", planned")}
    assert lines["Speeds"]["leg_LF"] == pytest.approx(np.degrees([limits.input_lower[3], limits.input_upper[3]]))
    assert lines["Drives"] == {
        **{n: (-20.0, 20.0) for n in wheels[:4]}, **{n: (-40.0, 40.0) for n in wheels[4:]},
        **{n.removesuffix("_joint"): (-most, most) for n, most in SWERVE.description.limits.effort.items()},
    }  # fmt: skip


@thorough
def test_the_baseline_drives_and_reconfigures() -> None:
    bench = MissionRun.of(QUIET, SWERVE, 0)
    legs = drive_missions.configuration_positions(SWERVE, "X")
    out = legs + 0.2 * np.sign(legs)
    mission = Mission((Leg(1.0, 8.0, (1.5, 0.0, 0.0)),), legs, (Reconfiguration(3.0, out),), ((2.0, 1.0), (8.0, 0.0)))
    _baseline(bench, QUIET, mission, 10.0)
    assert bench.log.array("baseline.base")[-1] == pytest.approx([1.5, 0.0, 0.0], abs=0.02)
    assert bench.log.array("baseline.leg")[-1] == pytest.approx(out, abs=0.02)


@thorough
@pytest.mark.parametrize("legs", ["targets", "support"])
def test_the_hand_holds_still_while_the_robot_reconfigures(legs: str) -> None:
    experiment = REGISTRY["swerve-unified"]
    result = experiment.run(experiment.config_type(settle_time=2.0, calibration="none", legs={"kind": legs}), 1, None)
    m = {name: metric.value for name, metric in result.metrics.items()}
    assert result.completed, result.reason
    assert 1e-4 < m["hand_error_rms"] < 0.005
    assert m["base_travel"] == pytest.approx(2.0, abs=0.25)
    end = result.log.array("base")[-1]
    assert end == pytest.approx([2.0, 0.0, np.pi / 2], abs=0.06)
    moved = np.abs(result.log.array("leg")[-1] - result.log.array("leg")[0])
    closed = result.log.array("brake").max(axis=1) < 0.5
    assert closed[0] and closed[-1] and not closed.all()
    # by targets the front legs turn from 45 degrees outwards to 28.5 inwards; left to the support they turn inwards as well
    assert (
        moved[:2] == pytest.approx(np.full(2, np.pi / 4 + 0.498), abs=0.02) if legs == "targets" else moved.max() > 0.2
    )
    start, margin = result.log.array("support_margin")[0, 0], m["support_margin_end"]
    assert {"Speeds: wheel", "Joint positions: leg", "Drives: arm"} <= {plot.title for plot in result.plots}
    assert margin > start + 0.05


@pytest.mark.parametrize(
    ("legs", "given"), [("support", "legs.goal=X"), ("targets", "legs.weight=0.1"), ("targets", "legs.reserve=0.1")]
)
def test_what_the_way_of_the_legs_does_not_read_is_rejected(legs: str, given: str) -> None:
    settings, other = REGISTRY["swerve-unified"].config_type, {"support": "targets", "targets": "support"}[legs]
    with pytest.raises(InputError, match=rf"{given.partition('=')[0]}: nothing uses it without legs={other}; valid in"):
        configure(settings, [f"legs={legs}", given], "swerve-unified")
    configure(settings, [f"legs={other}", given], "swerve-unified")


@pytest.mark.parametrize(
    ("experiment", "given", "words"),
    [
        (
            "swerve-track",
            ["variant=peaks", "variant.amplitude=0.1"],
            "variant.amplitude: nothing uses it without variant=horizontal or variant=vertical",
        ),
        (
            "swerve-track",
            ["localization=none", "localization.position=0.5"],
            "localization.position: nothing uses it without localization=lidar",
        ),
        (
            "swerve-plaster",
            ["calibration=file", "calibration.lidar.rate=5"],
            "calibration.lidar.rate: nothing uses it without calibration=drive",
        ),
        ("swerve-fixed", ["ik=none", "ik.base_gain=3"], "ik.base_gain: nothing uses it without ik=gains"),
        ("swerve-fixed", ["planned=false", "ik=none", "four_wheel=none"], "one controller at least is needed"),
        ("swerve-fixed", ["motions=[]", "random_time=0"], "motions: none is left, and random_time is 0"),
        (
            "swerve-fixed",
            ["random_time=10", "motions=[forward,turning,forward]"],
            "motions: 'forward' appears twice",
        ),
    ],
)
def test_what_nothing_reads_or_nobody_can_follow_is_rejected(experiment: str, given: list[str], words: str) -> None:
    settings = REGISTRY[experiment].config_type
    with pytest.raises(InputError, match=words):
        configure(settings, given, experiment)
    configure(settings, given[:1], experiment)  # read


@pytest.mark.parametrize(
    ("experiment", "given"),
    [
        ("swerve-track", ["calibration.lidar.position=0.5"]),
        ("swerve-track", ["calibration=file", "localization=lidar", "localization.position=0.5"]),
        ("swerve-plaster", ["calibration=none", "localization.rate=5"]),
    ],
)
def test_a_localization_that_the_run_or_its_reference_drive_has_is_taken(experiment: str, given: list[str]) -> None:
    check_taken(experiment, given)


def test_fixed_legs_are_rejected() -> None:
    for name in ("swerve-unified", "swerve-drive"):
        experiment = REGISTRY[name]
        with pytest.raises(InputError, match="fixed legs"):
            experiment.run(experiment.config_type(robot="swerve-fixed-ur10"), 0, None)


def test_steering_branches_are_those_of_a_search_over_all() -> None:
    """Few samples, every sequence of half turns tried: the same cost within the limits."""
    from itertools import product

    from wbmpc.studies.pankert2022.mission import STANDS, TURN_SHARE, branches

    rng, limit = np.random.default_rng(4), 3.14
    for _ in range(20):
        angle, speed = np.cumsum(rng.normal(0.0, 1.0, 6)), rng.uniform(0.011, 0.2, 6)

        def cost(path: np.ndarray, speed: np.ndarray = speed) -> float:
            near = np.clip(0.3 - (limit - np.abs(path)), 0.0, None)
            turns = np.abs(np.diff(path)) * (0.1 + speed[1:] / STANDS)
            return float(0.1 * abs(path[0]) + near[0] + turns.sum() + TURN_SHARE * near[1:].sum())

        options = [[a + k * np.pi for k in range(-12, 13) if abs(a + k * np.pi) <= limit] for a in angle]
        best = min(cost(np.array(path)) for path in product(*options))
        found = branches(angle, speed, -limit, limit)
        assert np.abs(found).max() <= limit
        assert np.abs(np.sin(found - angle)).max() < 1e-9  # up to half turns
        assert cost(found) == pytest.approx(best, rel=1e-9)
    assert np.all(branches(np.ones(5), np.zeros(5), -limit, limit) == 0.0)  # a wheel that stands
    # without a range, or with one of very many turns, a wheel that turns on and on never turns about
    around = np.linspace(0.3, 25.0, 200)
    for end in (np.inf, 1e16):
        assert branches((around + np.pi) % (2 * np.pi) - np.pi, np.ones(200), -end, end) == pytest.approx(around)


def test_the_door_s_posts_are_in_the_way_of_the_robot() -> None:
    """Its posts stand beside the gap that the clearance is measured in, and collide with the robot's hull."""
    spec = mujoco.MjSpec()
    terrain(spec)
    model = spec.compile()
    posts = [g for g in range(model.ngeom) if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_BOX]
    inner = sorted(float(abs(model.geom_pos[g, 1]) - model.geom_size[g, 1]) for g in posts)
    assert inner == pytest.approx([0.45, 0.45]) and {float(model.geom_pos[g, 0]) for g in posts} == {DOOR}
    assert (model.geom_contype[posts] & HULL["conaffinity"]).all()
