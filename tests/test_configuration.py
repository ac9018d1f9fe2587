"""Dotted settings: what they change, and one clear message for everything that is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from fake_experiment import FakeSettings
from wbmpc.configuration import OneOf, configure, keys
from wbmpc.errors import InputError
from wbmpc.registry import REGISTRY
from wbmpc.settings import Settings
from wbmpc.tasks.settings import SimulationSettings


class Factors(FakeSettings):
    factors: dict[str, Annotated[float, Field(gt=0)]] = Field(default={"one": 1.0})


def value_at(tree: Any, key: str) -> Any:
    """What a nested mapping has at a dotted key; None inside of a section that is left out or of another kind, the tree at no key."""
    for part in key.split(".") if key else ():
        tree = tree and (tree.get(part) if "kind" in tree else tree[part])
    return tree


def test_keys_are_all_leaves() -> None:
    assert keys(FakeSettings) == [
        "mpc.rate",
        "mpc.intervals",
        "cost.end_effector.weight",
        "plant.friction",
        "duration",
        "fall_at",
        "abort",
        "interrupt",
        "failures",
    ]


def test_without_assignments_the_defaults_hold() -> None:
    assert configure(FakeSettings, [], "fake") == FakeSettings()


def test_only_the_named_keys_change() -> None:
    given = ["mpc.rate=100", "cost.end_effector.weight=3e2", "plant.friction=[5e-1, 0.7]", "abort=true", "mpc.rate=80"]
    changed = configure(FakeSettings, given, "fake").model_dump()
    expected = FakeSettings().model_dump()
    expected["mpc"]["rate"] = 80.0  # the later one wins
    expected["cost"]["end_effector"]["weight"] = 300.0
    expected["plant"]["friction"] = (0.5, 0.7)
    expected["abort"] = True
    assert changed == expected


BAD = {
    "mpc.rat=3": ["unknown key 'mpc.rat'", "did you mean 'mpc.rate'", "valid in mpc: rate, intervals"],
    "rate=3": ["unknown key 'rate'", "did you mean 'mpc.rate'"],
    "cost.end_efector.weight=3": ["did you mean 'cost.end_effector.weight'", "valid in cost: end_effector.…"],
    "qqq=3": ["unknown key 'qqq'", "valid: mpc.…, cost.…, plant.…, duration"],
    "mpc=3": ["'mpc' is a section", "rate, intervals"],
    "mpc.rate.x=3": ["unknown key 'mpc.rate.x'", "did you mean 'mpc.rate'"],
    "mpc.rate": ["the form is key=value"],
    "mpc.rate=": ["the form is key=value"],
    "=3": ["the form is key=value"],
    "mpc.rate=[": ["mpc.rate", "not valid YAML"],
    "mpc.rate=true": ["mpc.rate=true", "not true or false"],
    "plant.friction=[true, 1]": ["not true or false"],
    "plant.friction=8e-1": ["plant.friction=0.8", "several numbers in brackets", "[0.6, 0.9]"],
    "mpc.rate=0": ["mpc.rate=0", "greater than 0"],
    "mpc.rate=fast": ["mpc.rate='fast'", "valid number"],
    "mpc.intervals=0": ["mpc.intervals=0", "greater than or equal to 1"],
    "mpc.intervals=2.5": ["mpc.intervals=2.5", "integer"],
    "mpc.rate=nan": ["mpc.rate=nan", "finite"],
    "mpc.rate=.nan": ["mpc.rate=.nan", "finite"],
    "duration=inf": ["duration=inf", "finite"],
    "plant.friction=[0.5, .inf]": ["plant.friction", "finite"],
    "plant.friction=[0.9, 0.1]": ["plant.friction=[0.9, 0.1]: needs lower ≤ upper"],
    "plant.friction=[0.9]": ["plant.friction.1: field required"],
}


@pytest.mark.parametrize("assignment", BAD)
def test_a_fault_is_one_message_with_place_key_and_choices(assignment: str) -> None:
    with pytest.raises(InputError) as caught:
        configure(FakeSettings, [assignment], "fake")
    text = str(caught.value)
    assert text.startswith("fake: --set")
    for part in BAD[assignment]:
        assert part in text
    assert "\n" not in text
    assert "http" not in text and "Value error" not in text and "validation error" not in text


def test_a_file_that_is_no_name_is_named(tmp_path: Path) -> None:
    file = tmp_path / "settings.yaml"
    file.write_text("obstacles: {pillar: {sphere: 0.1}}\n")
    with pytest.raises(InputError, match="obstacles: the name of a file is needed"):
        configure(SimulationSettings, [], "x", file)


def test_a_fault_between_settings_does_not_print_the_whole_section() -> None:
    class Pair(BaseModel):
        model_config = ConfigDict(extra="forbid")
        low: float = 0.0
        high: float = 1.0

        @model_validator(mode="after")
        def _order(self) -> Pair:
            if self.low > self.high:
                raise ValueError("low must not be above high")
            return self

    class Whole(BaseModel):
        pair: Pair = Pair()

    with pytest.raises(InputError) as caught:
        configure(Whole, ["pair.low=2"], "here")
    assert str(caught.value) == "here: --set pair: low must not be above high"


#: (experiment, section) of all sections that are left out by default.
LEFT_OUT = sorted(
    {
        (name, key.rpartition(".")[0])
        for name in REGISTRY
        for key in keys(REGISTRY[name].config_type)
        if value_at(REGISTRY[name].config_type().model_dump(), key.rpartition(".")[0]) is None
    }
)


@pytest.mark.parametrize(("name", "section"), LEFT_OUT)
def test_keys_of_a_section_that_is_left_out_by_default_can_be_given(name: str, section: str) -> None:
    model = REGISTRY[name].config_type
    own = [key for key in keys(model) if key.rpartition(".")[0] == section]
    for key in own:
        assert value_at(configure(model, [f"{key}=3"], name).model_dump(), key) == 3.0


def test_weights_of_a_push_that_are_not_given_are_those_of_the_scheme() -> None:
    """Two keys, in either order. Without the door's equation all force errors count alike and no posture does (PushCost, UNTIED)."""
    given = ["push.force=2", "scheme.contact=wrench"]
    model = REGISTRY["rezero-door"].config_type
    for order in (given, given[::-1]):
        push = configure(model, order, "rezero-door").push
        assert (push.force, push.tangential, push.arm) == (2.0, 1.0, 0.0)
    push = configure(model, given[:1], "rezero-door").push
    assert (push.force, push.tangential, push.arm) == (2.0, 0.1, 5.0)


@pytest.mark.parametrize("name", REGISTRY)
def test_every_setting_of_every_experiment_can_be_given(name: str) -> None:
    """Each leaf, set to its own default as text, gives the defaults again."""
    model = REGISTRY[name].config_type
    dumped = model().model_dump(mode="json")
    for key in keys(model):
        value = value_at(dumped, key)
        if value is None and "." in key:
            continue  # a section that is not there by default, or a key of another kind
        text = "null" if value is None else str(value)
        assert configure(model, [f"{key}={text}"], name).model_dump(mode="json") == dumped


class Gains(Settings):
    first: float = 1.0
    second: float = 2.0


class Rigid(Settings):
    kind: Literal["rigid"] = "rigid"


class Elastic(Settings):
    kind: Literal["elastic"] = "elastic"
    stiffness: float = Field(40.0, gt=0)
    gains: Gains = Gains()


class Machine(Settings):
    """``drives``: one of two models."""

    drives: OneOf[Rigid | Elastic] = Rigid()
    gain: float = 1.0


def test_keys_of_a_choice_are_those_of_all_its_models() -> None:
    assert keys(Machine) == [
        "drives.kind", "drives.stiffness", "drives.gains.first", "drives.gains.second", "gain",
    ]  # fmt: skip


@pytest.mark.parametrize(
    "given",
    [
        ["drives=elastic", "drives.stiffness=3"],
        ["drives.stiffness=3", "drives.kind=elastic"],
        ["drives=rigid", "drives.stiffness=3", "drives=elastic"],
    ],
)
def test_a_kind_and_its_settings_are_given_in_any_order(given: list[str]) -> None:
    assert configure(Machine, given, "toy").drives == Elastic(stiffness=3.0)
    assert configure(Machine, [*given, "gain=2"], "toy").gain == 2.0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            ["drives.stiffness=3"],
            "drives.stiffness: nothing uses it without drives=elastic; valid in drives=rigid: nothing else",
        ),
        (["drives=stiff"], "drives.kind='stiff': valid: rigid, elastic"),
        (["drives=elastic", "drives.stiffness=-3"], "drives.stiffness=-3: input should be greater than 0"),
        (["drives=elastic", "drives.stifness=3"], "unknown key 'drives.stifness' (did you mean 'drives.stiffness'?)"),
        (
            ["drives.gains.second=3"],
            "drives.gains.second: nothing uses it without drives=elastic; valid in drives=rigid: nothing else",
        ),
    ],
)
def test_what_another_kind_reads_is_an_error(given: list[str], message: str) -> None:
    """Truth: the docstrings of the settings. The message has the whole key, and what would read it."""
    with pytest.raises(InputError) as error:
        configure(Machine, given, "toy")
    assert message in str(error.value)


class Vehicle(Settings):
    kind: Literal["vehicle"] = "vehicle"
    drives: OneOf[Rigid | Elastic] = Elastic()


class Stand(Settings):
    """``base``: a choice with a choice inside."""

    base: OneOf[Vehicle | Rigid] = Rigid()


@pytest.mark.parametrize("order", [1, -1])
def test_a_choice_inside_of_a_choice_is_given_in_any_order(order: int) -> None:
    """The other settings of both are the defaults of the models that are chosen."""
    given = ["base.drives.stiffness=3", "base=vehicle"]
    assert configure(Stand, given[::order], "toy").base == Vehicle(drives=Elastic(stiffness=3.0))
    given = ["base.drives=rigid", "base=vehicle"]
    assert configure(Stand, given[::order], "toy").base == Vehicle(drives=Rigid())
    with pytest.raises(InputError, match=r"base\.drives\.stiffness: nothing uses it without base=vehicle; valid in"):
        configure(Stand, ["base.drives.stiffness=3"], "toy")


@pytest.mark.parametrize("name", REGISTRY)
def test_a_name_is_that_of_a_section_in_all_choices_or_in_none(name: str) -> None:
    """What is a value in one choice and a section in another could not be distinguished on the command line."""
    found = keys(REGISTRY[name].config_type)
    assert not [key for key in found if any(other.startswith(f"{key}.") for other in found)]


class Stiff(Elastic):
    """The same kind with another default, and one setting more."""

    stiffness: float = Field(90.0, gt=0)
    damping: float = 1.0


class Crane(Settings):
    kind: Literal["crane"] = "crane"
    drives: OneOf[Rigid | Stiff] = Rigid()


class Yard(Settings):
    """Two kinds whose section of one name is one of different models."""

    base: OneOf[Vehicle | Crane] = Vehicle()


def test_a_kind_inside_of_a_choice_is_that_of_the_choice() -> None:
    assert configure(Yard, ["base=crane", "base.drives=elastic"], "toy").base == Crane(drives=Stiff())
    assert configure(Yard, ["base.drives=rigid", "base.drives=elastic"], "toy").base == Vehicle(drives=Elastic())
    with pytest.raises(
        InputError, match=r"base\.drives\.damping: nothing uses it without base=crane; valid in base=vehicle: drives"
    ):
        configure(Yard, ["base.drives.damping=3"], "toy")


class Yards(Settings):
    """The default has other numbers than its kind."""

    base: OneOf[Vehicle | Crane] = Vehicle(drives=Elastic(stiffness=7.0))


def test_a_kind_that_is_chosen_again_is_as_by_default() -> None:
    assert configure(Yards, ["base=crane"], "toy").base == Crane()
    for given in (["base=crane", "base=vehicle"], ["base.drives=rigid", "base.drives=elastic"]):
        assert configure(Yards, given, "toy").base == Yards().base


def test_what_is_left_out_of_a_choice_is_of_the_kind_by_default() -> None:
    assert Yard(base={"drives": {"stiffness": 3.0}}).base == Vehicle(drives=Elastic(stiffness=3.0))
    with pytest.raises(ValidationError, match=r"base\.vehicle\.cable"):
        Yard(base={"cable": 3.0})


@pytest.mark.parametrize(
    ("name", "given", "message"),
    [
        ("swerve-track", "cost.end_effector.weight=1e12", "less than or equal to 1000000000"),
        ("swerve-track", "cost.terminal=2e9", "less than or equal to 1000000000"),
        ("rezero-steps", "controller.cost.end_effector.limit=1e12", "less than or equal to 1000000000"),
        ("rezero-steps", "controller.limits.speed_slack=1e-300", "greater than or equal to"),
        ("rezero-steps", "controller.disturbance.max_pushed_speed=1e12", "less than or equal to 100"),
    ],
)
def test_weights_and_thresholds_have_limits(name: str, given: str, message: str) -> None:
    """Squares of large numbers are no numbers any more, and products with 1e-300 are 0."""
    with pytest.raises(InputError) as error:
        configure(REGISTRY[name].config_type, [given], name)
    assert f"{name}: --set {given.partition('=')[0]}=" in str(error.value) and message in str(error.value)


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("mpc: {rate: 50}\nmpc.rate: 60\n", "mpc.rate"),
        ("mpc.rate: 50\nmpc: {rate: 50}\n", "mpc.rate"),
        ("cost: {end_effector.weight: 1}\ncost.end_effector: {weight: 2}\n", "cost.end_effector.weight"),
        ("factors: {one: 1}\nfactors.two: 2\n", "factors.two"),
        ("factors.two: 2\nfactors: {one: 1}\n", "factors"),
    ],
)
def test_a_key_of_a_file_is_there_once_however_it_is_written(text: str, key: str, tmp_path: Path) -> None:
    (tmp_path / "settings.yaml").write_text(text)
    with pytest.raises(InputError, match=f"settings.yaml: key '{key}' appears twice"):
        configure(Factors, [], "fake", tmp_path / "settings.yaml")


def test_entries_of_a_mapping_are_given_one_by_one(tmp_path: Path) -> None:
    """So that a study varies one of them; those that are not named stay."""
    (tmp_path / "settings.yaml").write_text("factors.two: 2\n")
    given = configure(Factors, ["factors={one: 3}", "factors.three=1e-1"], "fake", tmp_path / "settings.yaml")
    assert given.factors == {"one": 3.0, "three": 0.1}
    given = configure(Factors, ["factors.three=4"], "fake", tmp_path / "settings.yaml")
    assert given.factors == {"one": 1.0, "two": 2.0, "three": 4.0}
    for wrong in ("factors.=1", "factors.one.two=1", "factor.one=1", "factors.one=true", "factors.one=-1"):
        with pytest.raises(InputError, match="fake: --set"):
            configure(Factors, [wrong], "fake")


def test_a_kind_of_a_file_is_there_once_however_it_is_written(tmp_path: Path) -> None:
    (tmp_path / "settings.yaml").write_text("stability: support_margin\nstability.kind: wheel_loads\n")
    with pytest.raises(InputError, match=r"settings.yaml: key 'stability.kind' appears twice"):
        configure(REGISTRY["hold"].config_type, [], "hold", tmp_path / "settings.yaml")
