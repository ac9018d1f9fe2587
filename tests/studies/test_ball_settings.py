"""Settings of the ball robot's experiments. Truth: what each experiment's code reads; asking in vain is an error, not silence."""

from __future__ import annotations

from dataclasses import replace
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
from wbmpc.studies.minniti2019.controller_settings import Regulator, Separate
from wbmpc.studies.minniti2019.push_settings import RezeroPushHandSettings
from wbmpc.studies.minniti2019.settings import RezeroSettings
from wbmpc.studies.minniti2019.task import BENT_ARM, Task

BALL = [n for n in REGISTRY if issubclass(REGISTRY[n].config_type, RezeroSettings)]


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("rezero-door", "controller.tracking=actuators"), ("rezero-door", "controller.disturbance.max_pushed_speed=1"),
        ("rezero-door", "controller.cost.end_effector.turn_limit=1"),
        ("rezero-frequency", "controller.pace=3"), ("rezero-frequency", "controller.actuator_dead_time=0.02"),
        ("rezero-frequency", "controller.disturbance.estimate_payload=false"), ("rezero-frequency", "plant.rate_noise=0.1"),
        ("rezero-frequency", "controller.estimator.expected_push_time=0.1"),
        ("rezero-door", "controller.estimator.expected_push_time=0.1"), ("rezero-steps", "controller.cost.torque.force=2"),
        ("rezero-taskspace", "controller.estimator.expected_push_time=0.1"), ("rezero-steps", "mpc.horizon=2"),
        ("rezero-push-limit-hand", "forces=[8]"), ("slip", "forces=[8]"), ("touch", "door=heavy"), ("touch", "speed=0.2"),
    ],
)  # fmt: skip
def test_what_an_experiment_does_not_use_is_no_key(name: str, given: str) -> None:
    with pytest.raises(InputError, match=rf"{name}: --set: unknown key '{given.split('=')[0]}'.*; valid"):
        configure(REGISTRY[name].config_type, [given], name)


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ("controller=lqr controller.estimator.expected_push_time=0.5", "controller.estimator.expected_push_time"),
        ("controller=lqr controller.disturbance.max_pushed_speed=1", "controller.disturbance.max_pushed_speed"),
        ("controller=lqr controller.disturbance.estimate_payload=false", "controller.disturbance.estimate_payload"),
        ("controller=lqr controller.tracking=actuators", "controller.tracking.kind"),
        ("controller=lqr controller.pace=3", "controller.pace"),
        ("controller=separate controller.actuator_dead_time=0.005", "controller.actuator_dead_time"),
        ("controller.torque=3", "controller.torque"),
        ("controller=lqr controller.plan.horizon=2", "controller.plan.horizon"),
        ("controller=scheduled-lqr controller.limits=soft", "controller.limits.kind"),
        ("controller=taskspace controller.plan.iterations=2", "controller.plan.iterations"),
        ("controller=taskspace controller.cost.end_effector.weight=10", "controller.cost.end_effector.weight"),
        ("controller=separate controller.cost.body.ball=5", "controller.cost.body.ball"),
        ("controller=separate-aware controller.cost.end_effector.twist=5", "controller.cost.end_effector.twist"),
        ("controller=separate controller.plan.first_interval=0.01", "controller.plan.first_interval"),
        ("controller=separate controller.disturbance=none", "controller.disturbance.kind"),
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
         "valid in controller=mpc: estimator, disturbance, plan, limits, cost, tracking"),
        ("controller=taskspace controller.tracking=actuators", "controller.tracking.kind: nothing uses it without controller=mpc; valid in"),
        ("controller.tracking=actuators controller.tracking.actuator_dead_time=0.005",
         "controller.tracking.actuator_dead_time: nothing uses it without controller.tracking=policy; valid in controller.tracking=actuators: "),
        ("controller=lqr controller.cost.lean=0.5", "controller.cost.lean: nothing uses it without controller=mpc or controller=separate or "),
        ("controller=separate controller.cost.torque.arm=9", "controller.cost.torque.arm: nothing uses it without controller=mpc or controller=lqr"),
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
    ("name", "choice", "key", "value", "other"),
    [
        ("rezero-steps", "controller.estimator=filter", "controller.estimator.position_noise", "0.1", "truth"),
        ("rezero-steps", "controller.estimator=truth", "controller.estimator.expected_push_time", "0.5", "filter"),
        ("rezero-steps", "controller.limits=soft", "controller.limits.speed_slack", "3", "hard"),
        ("rezero-steps", "controller.disturbance=none", "controller.disturbance.max_pushed_speed", "1", "estimated"),
        ("rezero-door", "controller.disturbance=none", "controller.disturbance.estimate_payload", "false", "estimated"),
        ("rezero-door", "scheme.contact=wrench", "scheme.contact.max_rate", "0.1", "door"),
        ("rezero-door", "scheme.contact=wrench", "scheme.contact.approach.kind", "limited", "door"),
        ("rezero-door", "scheme.cone=none", "scheme.cone.friction", "0.9", "cone"),
        ("rezero-frequency", "shaped=none", "shaped.arm_zero", "30", "filters"),
    ],
)
def test_what_a_choice_does_not_read_is_rejected(name: str, choice: str, key: str, value: str, other: str) -> None:
    """Each of the two alone is taken."""
    kind, (section, _, _) = REGISTRY[name].config_type, choice.partition("=")
    with pytest.raises(InputError, match=f"{name}: --set {key}: nothing uses it without {section}={other}"):
        configure(kind, [choice, f"{key}={value}"], name)
    configure(kind, [choice], name)
    configure(kind, [f"{section}={other}", f"{key}={value}"], name)


def leaves(part: Settings, name: str = "cost") -> list[str]:
    """Names of all numbers in settings."""
    inside = [(f"{name}.{key}", getattr(part, key)) for key in type(part).model_fields]
    return [leaf for n, v in inside for leaf in (leaves(v, n) if isinstance(v, Settings) else [n])]


def changed(settings: Settings, name: str) -> Settings:
    """The same with another number in a dotted place."""
    first, _, rest = name.partition(".")
    value = getattr(settings, first)
    return settings.model_copy(update={first: changed(value, rest) if rest else 0.5 * value + 0.07})


def test_a_regulator_reads_every_weight_that_it_has() -> None:
    """Truth: whether its weights are other ones when a number of the costs is."""
    robot, usual = load_robot("rezero"), Regulator()
    previous = regulator_weights(robot, usual)
    names = leaves(usual.cost)
    for name in names:
        after = regulator_weights(robot, changed(usual, name))  # type: ignore[arg-type]
        fields = ("end_effector", "twist", "state", "torque")
        assert any(not np.array_equal(getattr(previous, f), getattr(after, f)) for f in fields), name
    assert len(names) == 14


def test_separate_control_reads_every_weight_of_its_base() -> None:
    """Truth: whether the problem of the base is another one. Weights of the end effector and the arm's posture are of the arm's inverse."""
    usual = Separate()
    names = set(leaves(usual.cost))
    of_arm = {"cost.body.arm", *(n for n in names if "end_effector" in n)}
    for name in names - of_arm:
        assert changed(usual, name).weights != usual.weights, name  # type: ignore[attr-defined]
    assert len(names) == 8 and len(of_arm) == 4
    own = {n: v for n, v in usual.weights.model_dump().items() if n in ("terminal", "lean")}
    assert own == {"terminal": usual.cost.terminal, "lean": usual.cost.lean}


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("rezero-push-hand", "controller=scheduled-lqr controller.torque=3 controller.actuator_dead_time=0.005"),
        ("rezero-push-hand", "controller.tracking=actuators controller.tracking.wheel_damping=0.1"),
        (
            "rezero-push-hand",
            "controller.estimator.expected_push_time=0.5 controller.disturbance.estimate_payload=false "
            "controller.tracking.actuator_dead_time=0.005",
        ),
        ("rezero-taskspace", "taskspace.end_effector=4 controller.tracking.actuator_dead_time=0.005"),
        ("rezero-taskspace", "controller.plan.horizon=2 controller.cost.end_effector.weight=10"),
        (
            "rezero-push-hand",
            "controller=separate-integral controller.plan.horizon=1 controller.limits=soft controller.cost.lean=0.5 "
            "controller.disturbance=none",
        ),
        (
            "rezero-push-hand",
            "controller=separate controller.cost.end_effector.weight=10 controller.cost.body.arm=2 controller.cost.terminal=3",
        ),
        ("rezero-push-hand", "controller=lqr control.rate=200 mpc.rate=50"),
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
        ("rezero-frequency", ["plain=false", "shaped=none"], "one variant at least"),
        ("rezero-frequency", ["step=[0,0,0]"], "a step of 0.01 to 1 m is needed"),
        ("rezero-frequency", ["settle_time=1"], "seen 1.3 s ahead"),
        ("rezero-frequency", ["settle_time=0.5", "controller.plan.horizon=1"], "preview=false"),
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
        kind,
        ["controller.disturbance=none", "controller.cost.torque.wheel=0.3", "plant.actuator_dead_time=0.008"],
        name,
    )
    assert usual.controller.cost.torque.wheel == 0.3
    if name not in ("rezero-door", "rezero-frequency", "rezero-taskspace", "touch", "slip"):
        assert configure(kind, ["controller=lqr", "controller.cost.body.ball_speed=0.5"], name).controller.kind == "lqr"


def test_factors_of_a_regulator_are_of_the_weights_that_they_name() -> None:
    robot = load_robot("rezero")
    usual = regulator_weights(robot, Regulator())
    of = lambda **factors: regulator_weights(robot, Regulator(**factors))
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
