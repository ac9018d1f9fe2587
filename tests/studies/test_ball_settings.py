"""Settings of the ball robot's experiments. Truth: what each experiment's code reads; asking in vain is an error, not silence."""

from __future__ import annotations

from dataclasses import replace
from functools import reduce
from pathlib import Path

import numpy as np
import pytest

from configured import check_taken
from effort import some
from wbmpc.configuration import configure
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.registry import REGISTRY
from wbmpc.settings import Settings
from wbmpc.studies.minniti2019 import circle as rezero_circle
from wbmpc.studies.minniti2019 import wholebody as rezero_wholebody
from wbmpc.studies.minniti2019.baselines import regulator_weights
from wbmpc.studies.minniti2019.controller_settings import Regulator
from wbmpc.studies.minniti2019.push_settings import RezeroPushHandSettings
from wbmpc.studies.minniti2019.settings import RezeroSettings
from wbmpc.studies.minniti2019.task import BENT_ARM, Task

BALL = [n for n in REGISTRY if issubclass(REGISTRY[n].config_type, RezeroSettings)]


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("rezero-door", "controller=lqr"), ("rezero-door", "tracking=actuators"),
        ("rezero-door", "max_pushed_speed=1"),
        ("rezero-frequency", "controller=separate"), ("rezero-frequency", "actuator_dead_time=0.02"),
        ("rezero-frequency", "expected_push_time=0.1"), ("rezero-door", "expected_push_time=0.1"),
        ("rezero-taskspace", "controller=lqr"), ("rezero-taskspace", "expected_push_time=0.1"), ("rezero-steps", "cost.torque.force=2"),
        ("rezero-push-limit-hand", "forces=[8]"), ("slip", "forces=[8]"), ("touch", "door=heavy"),
    ],
)  # fmt: skip
def test_what_an_experiment_does_not_use_is_no_key(name: str, given: str) -> None:
    with pytest.raises(InputError, match=rf"{name}: --set: unknown key '{given.split('=')[0]}'.*; valid"):
        configure(REGISTRY[name].config_type, [given], name)


@pytest.mark.parametrize(("name", "given"), [("rezero-door", "cost.end_effector.turn_limit=1"), ("touch", "speed=0.2")])
def test_what_is_there_for_another_experiment_is_rejected(name: str, given: str) -> None:
    with pytest.raises(InputError, match=rf"{name}: --set {given.split('=')[0]}: this experiment does not use it"):
        configure(REGISTRY[name].config_type, [given], name)


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ("controller=lqr controller.expected_push_time=0.5", "controller.expected_push_time"),
        ("controller=lqr controller.max_pushed_speed=1", "controller.max_pushed_speed"),
        ("controller=lqr controller.estimate_payload=false", "controller.estimate_payload"),
        ("controller=lqr controller.tracking=actuators", "controller.tracking.kind"),
        ("controller=lqr controller.pace=3", "controller.pace"),
        ("controller=separate controller.actuator_dead_time=0.005", "controller.actuator_dead_time"),
        ("controller.torque=3", "controller.torque"),
        ("controller=lqr mpc.horizon=2", "mpc.horizon"),
        ("controller=scheduled-lqr mpc.limits=soft", "mpc.limits"),
        ("controller=taskspace mpc.iterations=2", "mpc.iterations"),
        ("controller=taskspace cost.end_effector.weight=10", "cost.end_effector.weight"),
        ("controller=separate cost.body.ball=5", "cost.body.ball"),
        ("controller=separate-aware cost.end_effector.twist=5", "cost.end_effector.twist"),
        ("controller=separate mpc.first_interval=0.01", "mpc.first_interval"),
        ("controller=separate estimate_disturbance=false", "estimate_disturbance"),
    ],
)
def test_what_the_controller_does_not_use_is_rejected(given: str, name: str) -> None:
    """What :func:`make_controller` does not pass on to the controller that is named."""
    with pytest.raises(InputError, match=rf"rezero-push-hand: --set {name}: nothing uses it without controller="):
        configure(RezeroPushHandSettings, given.split(), "rezero-push-hand")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("controller.torque=3", "controller.torque: nothing uses it without controller=lqr or controller=scheduled-lqr; "
         "valid in controller=mpc: expected_push_time, max_pushed_speed, estimate_payload, tracking"),
        ("controller=taskspace controller.tracking=actuators", "controller.tracking.kind: nothing uses it without controller=mpc; valid in"),
        ("controller.tracking=actuators controller.tracking.actuator_dead_time=0.005",
         "controller.tracking.actuator_dead_time: nothing uses it without controller.tracking=policy; valid in controller.tracking=actuators: "),
        ("controller=lqr cost.lean=0.5", "cost.lean: nothing uses it without controller=mpc or controller=separate or controller=sep"),
        ("controller=separate cost.torque.arm=9", "cost.torque.arm: nothing uses it without controller=mpc or controller=lqr or controller=sch"),
        ("controller=pid", "controller.kind='pid': valid: mpc, lqr, scheduled-lqr, separate, separate-integral, separate-aware, taskspace"),
        ("controller=lqr controller.torqe=3", "unknown key 'controller.torqe' (did you mean 'controller.torque'?)"),
    ],
)  # fmt: skip
def test_a_message_names_the_choices_that_read_a_setting(given: str, message: str, tmp_path: Path) -> None:
    """And the keys of the choice that is made, and the file. Truth: the models of the controllers."""
    with pytest.raises(InputError) as error:
        configure(RezeroPushHandSettings, given.split(), "rezero-push-hand")
    assert message in str(error.value) and str(error.value).startswith("rezero-push-hand: --set")
    file = tmp_path / "settings.yaml"
    file.write_text("".join(f"{a.replace('=', ': ')}\n" for a in given.split()))
    with pytest.raises(InputError) as error:
        configure(RezeroPushHandSettings, [], "rezero-push-hand", file)
    assert message in str(error.value) and str(file) in str(error.value)


@pytest.mark.parametrize(
    ("name", "given", "unread", "other"),
    [
        ("rezero-steps", "estimator=truth plant.gyro_noise=1e-3", "plant.gyro_noise", "estimator=filter"),
        ("rezero-steps", "estimator=truth plant.accel_bias=0.1", "plant.accel_bias", "estimator=filter"),
        ("rezero-steps", "plant.position_noise=0.1", "plant.position_noise", "estimator=truth"),
        ("rezero-frequency", "plant.rate_noise=0.1", "plant.rate_noise", "estimator=truth"),
        ("rezero-steps", "mpc.limits=soft cost.speed_slack=3", "cost.speed_slack", "mpc.limits=hard"),
        (
            "rezero-steps",
            "estimate_disturbance=false controller.estimate_payload=false",
            "controller.estimate_payload",
            "estimate_disturbance=true",
        ),
        (
            "rezero-door",
            "estimate_disturbance=false estimate_payload=false",
            "estimate_payload",
            "estimate_disturbance=true",
        ),
        (
            "rezero-door",
            "scheme.contact=wrench scheme.contact.max_rate=0.1",
            "scheme.contact.max_rate",
            "scheme.contact=door",
        ),
        (
            "rezero-door",
            "scheme.contact=wrench scheme.contact.baumgarte=3",
            "scheme.contact.baumgarte",
            "scheme.contact=door",
        ),
        ("rezero-door", "scheme.cone=none scheme.cone.friction=0.9", "scheme.cone.friction", "scheme.cone=cone"),
        ("rezero-door", "scheme.cone=none scheme.cone.min_push=2", "scheme.cone.min_push", "scheme.cone=cone"),
        ("rezero-door", "cost.lean=0 lean_share=0.9", "lean_share", "cost.lean > 0"),
        ("rezero-frequency", "variants=['plain'] filters.arm_zero=30", "filters.arm_zero", "variants=shaped"),
        ("rezero-circle", "yaw=free cost.body.yaw=3", "cost.body.yaw", "yaw=held"),
    ],
)
def test_what_another_setting_makes_idle_is_rejected(name: str, given: str, unread: str, other: str) -> None:
    """Each of the two alone is taken."""
    kind, (*first, last) = REGISTRY[name].config_type, given.split()
    with pytest.raises(InputError, match=f"{name}: --set {unread}: nothing uses it without {other}"):
        configure(kind, given.split(), name)
    configure(kind, first, name)
    configure(kind, [last] if first else ["estimator=truth", last], name)


def leaves(part: Settings, name: str = "cost") -> list[str]:
    """Names of all numbers in settings."""
    inside = [(f"{name}.{key}", getattr(part, key)) for key in type(part).model_fields]
    return [leaf for n, v in inside for leaf in (leaves(v, n) if isinstance(v, Settings) else [n])]


def test_weights_that_a_regulator_takes_are_taken_and_no_others() -> None:
    """Truth: whether its weights are other ones when a number of the costs is."""
    robot, usual = load_robot("rezero"), RezeroPushHandSettings()
    previous = regulator_weights(robot, usual, Regulator())
    names = set(leaves(usual.cost))
    for name in names:
        given = {"cost": usual.cost.model_copy(deep=True)}
        *path, key = name.split(".")[1:]
        part = reduce(getattr, path, given["cost"])
        changed = 0.5 * getattr(part, key) + 0.07
        object.__setattr__(part, key, changed)  # settings are frozen
        after = regulator_weights(robot, usual.model_copy(update=given), Regulator())
        reads = any(
            not np.array_equal(getattr(previous, f), getattr(after, f))
            for f in ("end_effector", "twist", "state", "torque")
        )
        for controller in ("lqr", "scheduled-lqr"):
            asked = [f"controller={controller}", f"{name}={changed}"]
            try:
                configure(RezeroPushHandSettings, asked, "")
            except InputError as error:
                assert not reads and f"{name}: nothing uses it without controller=" in str(error)
            else:
                assert reads, name
    assert len(names) == 19


@pytest.mark.parametrize(
    ("without", "needed"), [("estimator=truth", "estimator=filter"), ("cost.lean=0", "cost.lean > 0")]
)
def test_room_for_pushes_needs_a_limit_and_an_estimate(without: str, needed: str) -> None:
    with pytest.raises(InputError, match=f"expected_push_time: nothing uses it without {needed}"):
        configure(RezeroPushHandSettings, ["controller.expected_push_time=0.5", without], "rezero-push-hand")
    configure(RezeroPushHandSettings, ["controller.expected_push_time=0", without], "rezero-push-hand")
    configure(RezeroPushHandSettings, [without], "rezero-push-hand")


def test_the_speed_at_which_learned_forces_end_a_run_needs_some_that_are_learned() -> None:
    with pytest.raises(
        InputError,
        match=r"rezero-push-hand: --set controller\.max_pushed_speed: nothing uses it without estimate_disturbance=true",
    ):
        configure(
            RezeroPushHandSettings, ["estimate_disturbance=false", "controller.max_pushed_speed=1"], "rezero-push-hand"
        )
    configure(
        RezeroPushHandSettings, ["estimate_disturbance=true", "controller.max_pushed_speed=1"], "rezero-push-hand"
    )


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("rezero-push-hand", "controller=scheduled-lqr controller.torque=3 controller.actuator_dead_time=0.005"),
        ("rezero-push-hand", "controller.tracking=actuators controller.tracking.wheel_damping=0.1"),
        (
            "rezero-push-hand",
            "controller.expected_push_time=0.5 controller.estimate_payload=false controller.tracking.actuator_dead_time=0.005",
        ),
        ("rezero-taskspace", "taskspace.end_effector=4 tracking.actuator_dead_time=0.005"),
        ("rezero-taskspace", "mpc.horizon=2 cost.end_effector.weight=10"),
        (
            "rezero-push-hand",
            "controller=separate-integral mpc.horizon=1 mpc.limits=soft cost.lean=0.5 estimate_disturbance=false",
        ),
        ("rezero-push-hand", "controller=separate cost.end_effector.weight=10 cost.body.arm=2 cost.body.yaw=3"),
        ("rezero-push-hand", "controller=lqr control.rate=200 mpc.rate=50"),
        ("rezero-steps", "controller=lqr mpc.horizon=1 preview=true"),
    ],
)
def test_what_the_controller_uses_is_taken(name: str, given: str) -> None:
    check_taken(name, given.split())


@pytest.mark.parametrize(
    ("name", "given", "words"),
    [
        ("rezero-push-hand", ["forces=[]"], "forces"),
        ("rezero-push-ball", ["forces=[-50]"], "forces"),
        ("rezero-push-hand", ["push_duration=5", "pause=2"], "at least 5.5 s are needed"),
        ("rezero-push-hand", ["push_duration=0.003"], "valid: e.g. 0.0025 or 0.005 s"),
        ("rezero-push-ball", ["push_duration=0.0025", "control.rate=200"], "of 5 ms; valid: e.g. 0.005 s"),
        ("rezero-door", ["forces=[0]"], "forces"),
        ("rezero-door", ["forces=[-8]"], "forces"),
        (
            "rezero-frequency",
            ["plant.drives=rigid", "plant.drives.wheel_rotor=0.1"],
            "wheel_rotor: nothing uses it without",
        ),
        ("rezero-frequency", ["variants=['plain', 'plain']"], "each once"),
        ("rezero-frequency", ["step=[0,0,0]"], "a step of 0.01 to 1 m is needed"),
        ("rezero-frequency", ["settle_time=1"], "seen 1.3 s ahead"),
        ("rezero-frequency", ["settle_time=0.5", "mpc.horizon=1"], "preview=false"),
    ],
)
def test_what_cannot_be_judged_is_rejected(name: str, given: list[str], words: str) -> None:
    """No pushes, pushes into each other, no step, a step that begins before the run."""
    with pytest.raises(InputError) as error:
        configure(REGISTRY[name].config_type, given, name)
    assert words in str(error.value) and "\n" not in str(error.value)


def test_a_bad_entry_is_reported_once() -> None:
    """Not that a tuple without its only entry is too short as well."""
    for name, force in (("rezero-push-hand", -10), ("rezero-door", 0)):
        with pytest.raises(InputError) as error:
            configure(REGISTRY[name].config_type, [f"forces=[{force}]"], name)
        assert "forces.0=" in str(error.value) and "at least 1 item" not in str(error.value)
    with pytest.raises(InputError, match=r"forces=.*at least 1 item"):
        configure(RezeroPushHandSettings, ["forces=[]"], "rezero-push-hand")


@pytest.mark.parametrize("name", BALL)
def test_defaults_and_what_is_used_are_taken(name: str) -> None:
    kind = REGISTRY[name].config_type
    configure(kind, [], name)
    usual = configure(
        kind, ["estimate_disturbance=false", "cost.torque.wheel=0.3", "plant.actuator_dead_time=0.008"], name
    )
    assert usual.cost.torque.wheel == 0.3
    if name not in ("rezero-door", "rezero-frequency", "rezero-taskspace", "touch", "slip"):
        assert configure(kind, ["controller=lqr", "cost.body.ball_speed=0.5"], name).controller.kind == "lqr"


def test_factors_of_a_regulator_are_of_the_weights_that_they_name() -> None:
    robot, settings = load_robot("rezero"), RezeroPushHandSettings()
    usual = regulator_weights(robot, settings, Regulator())
    of = lambda **factors: regulator_weights(robot, settings, Regulator(**factors))
    wheels, arm = robot.input["wheel"], robot.input["arm"]
    torque = usual.torque.copy()
    torque[wheels], torque[arm] = 3.0 * torque[wheels], 6.0 * torque[arm]
    assert of(torque=3.0, arm=2.0).torque == pytest.approx(torque)
    state, held = usual.state.copy(), of(posture=5.0)
    for group in ("arm", "arm_velocity"):
        assert state[robot.state[group]].min() > 0.0
        state[robot.state[group]] *= 5.0
    assert held.state == pytest.approx(state)
    assert np.array_equal(replace(held, state=usual.state).torque, usual.torque)
    assert of(end_effector=0.1).end_effector == pytest.approx(0.1 * usual.end_effector)


@pytest.mark.parametrize("name", some(["rezero-wholebody", "rezero-circle"], [1]))
def test_regulators_are_reported_where_the_hand_goes(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """They follow the body alone: their states must carry the end effector along its path (forward kinematics say where it is)."""
    given: list[Task] = []
    module = {"rezero-wholebody": rezero_wholebody, "rezero-circle": rezero_circle}[name]
    monkeypatch.setattr(module, "task_scenario", lambda settings, seed, task, *more: given.append(task))
    short = {
        "rezero-wholebody": ["settle_time=0.5", "move_time=0.5", "hold_time=1"],
        "rezero-circle": ["settle_time=0.5", "lap_time=1", "rounds=1"],
    }
    settings = configure(REGISTRY[name].config_type, ["controller=lqr", *short[name]], name)
    module.build(settings, 0)
    robot, body = load_robot("rezero"), given[0].references["body"]
    home = robot.pose(robot.base.numeric.equilibrium(BENT_ARM)[0])[0]
    for t in (0.0, 0.75, 1.0, 1.7):
        x = body.at(t)
        ball, end_effector = np.zeros(2), home
        if name == "rezero-circle":
            ball = rezero_circle.ball_path(settings, np.array([t]))[0]
        else:
            times, places = rezero_wholebody.end_effector_path(settings, home)
            end_effector = np.array([np.interp(t, times, places[:, i]) for i in range(3)])
        assert robot.pose(x)[0] == pytest.approx(end_effector, abs=1e-3)
        assert x[:2] == pytest.approx(ball, abs=2e-3) and abs(x[2]) < 1e-9
        # it leans as it balances, and its speeds are those of its way
        lean = robot.base.numeric.equilibrium(x[robot.state["arm"]])[0][3:5]
        assert x[3:5] == pytest.approx(lean, abs=1e-3)
        n = robot.base.nq
        assert (
            x[n:] == pytest.approx((body.at(t + 0.05)[:n] - body.at(max(t - 0.05, 0.0))[:n]) / 0.1, abs=0.05)
            or t == 0.0
        )
