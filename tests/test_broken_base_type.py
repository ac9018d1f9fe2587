"""A base type of another package that fails, ends the process or gives back nothing: one message that names it, and no robot of others
is concerned. Truth: the exit status and messages of the command line's reference; what is there without the package."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import Field

import user_base_type
from test_public_api import RAIL, ROBOT
from user_base_type import fail, leave, leave_at_once, nothing
from wbmpc import bases, plugins
from wbmpc.cli import main
from wbmpc.robots.doctor import propose_bases
from wbmpc.robots.mechanism import read_mechanism
from wbmpc.robots.model_checks import Subject
from wbmpc.robots.model_file import read_model
from wbmpc.simulation.any_perturbation import models
from wbmpc.simulation.perturbation import InertialUnit, Perturbation, WheelRadii

PLUGIN = user_base_type.RailBaseType
NAMED = "wbmpc: base type 'rail' of another package (user_base_type:RailBaseType)"


class Heavier(Perturbation):
    """The same setting as of all robots, with another default."""

    mass: float = Field(default=0.4, ge=0, lt=0.5)


class Crossed(WheelRadii, InertialUnit):
    """Python makes no class of it together with those of robots on wheels, which have these two in the other order."""


def forget() -> None:
    bases._locations.cache_clear()
    bases.base_type.cache_clear()


@pytest.fixture
def rail(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A robot file of the base type "rail", with an installed package that names its plug-in."""
    installed = tmp_path / "site" / "rail_bases-1.0.dist-info"
    installed.mkdir(parents=True)
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: rail-bases\nVersion: 1.0\n")
    (installed / "entry_points.txt").write_text("[wbmpc.bases]\nrail = user_base_type:RailBaseType\n")
    (tmp_path / "rail.xml").write_text(RAIL)
    (tmp_path / "rail.yaml").write_text(ROBOT)
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    monkeypatch.chdir(tmp_path)
    forget()
    yield tmp_path / "rail.yaml"
    monkeypatch.undo()
    forget()


@pytest.mark.parametrize(
    ("part", "broken", "says"),
    [
        ("check", fail, "ValueError: it is broken"),
        ("model", fail, "ValueError: it is broken"),
        ("model", leave, "SystemExit: 0"),
        ("model", leave_at_once, "SystemExit: 0"),
        ("model", nothing, "AttributeError: 'NoneType' object has no attribute"),
        ("diagnose", fail, "ValueError: it is broken"),
    ],
)
def test_its_mistake_is_one_message_and_status_2(
    part: str, broken: Callable[..., Any], says: str, rail: Path, monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setattr(PLUGIN, part, broken, raising=False)
    assert main(["doctor", str(rail)]) == 2
    message = capfd.readouterr().err
    # what it gives back fails elsewhere: whose mistake that is is not known
    named = NAMED.replace("wbmpc: ", "wbmpc: with ") if broken is nothing else NAMED
    assert message.startswith(f"{named}: {says}") and message.count("\n") == 1
    if broken in (fail, leave):  # the last line that is called
        assert f"({user_base_type.__file__}, line {broken.__code__.co_firstlineno + 1})" in message


@pytest.mark.parametrize("broken", [fail, leave, leave_at_once])
def test_a_run_that_it_ends_did_not_complete(
    broken: Callable[..., Any], rail: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(PLUGIN, "mpc", broken, raising=False)
    assert main(["run", "hold", "--set", f"robot={rail}", "--out", "out"]) == 2
    assert capfd.readouterr().err.startswith(NAMED)
    assert not Path("out/metrics.json").exists()


@pytest.mark.parametrize("broken", [fail, leave, nothing, lambda *given: "text"])
def test_a_robot_of_others_is_proposed_as_without_it(
    broken: Callable[..., Any], rail: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(PLUGIN, "propose", broken, raising=False)
    proposals = propose_bases(Subject(read_mechanism(read_model(rail.with_suffix(".xml")))))
    assert list(proposals) == ["fixed"]


@pytest.mark.parametrize("broken", [fail, leave, lambda *given: "text", lambda *given: Heavier, lambda *given: Crossed])
def test_the_plants_of_others_have_their_settings_as_without_it(
    broken: Callable[..., Any], rail: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with monkeypatch.context() as without:
        without.setattr(bases, "available_base_types", lambda: sorted(bases.TABLE))
        usual = models()
    monkeypatch.setattr(PLUGIN, "perturbation", broken)
    assert models() == usual
    assert "'rail'" in caplog.text


def test_another_command_does_not_blame_it(rail: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An error of the program itself is not hidden because a robot of another package was loaded before."""
    monkeypatch.setattr(PLUGIN, "check", fail)
    assert main(["doctor", str(rail)]) == 2
    monkeypatch.setattr("wbmpc.robots.available_robots", fail)
    with pytest.raises(ValueError, match="it is broken"):
        main(["list"])


def test_an_error_of_which_nobody_is_seen_to_be_the_cause_names_all_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two packages are in use, and neither is in the traceback. Truth: the names that were noted."""
    monkeypatch.setattr(plugins, "_IN_USE", {})
    plugins.note_use("base type 'rail'", "user_base_type:RailBaseType")
    plugins.note_use("base type 'track'", "own_bases:TrackBaseType")
    try:
        int("seven")
    except ValueError as error:
        found = str(plugins.mistake_in_use(error))
    assert found.startswith(
        "with base type 'rail' of another package (user_base_type:RailBaseType), "
        "base type 'track' of another package (own_bases:TrackBaseType): ValueError: "
    )


def test_all_parts_of_the_package_that_raised_an_error_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its code is in one folder, and which of its parts called it is not known. Truth: the names that were noted, this file's line."""
    monkeypatch.setattr(plugins, "_IN_USE", {})
    plugins.note_use("base type 'rail'", f"{__name__}:RailBaseType")
    plugins.note_use("base type 'track'", f"{__name__}:TrackBaseType")
    plugins.note_use("base type 'other'", "own_bases:OtherBaseType")
    try:
        fail()
    except ValueError as error:
        found = str(plugins.mistake_in_use(error))
    assert found.startswith(
        f"base type 'rail' of another package ({__name__}:RailBaseType), "
        f"base type 'track' of another package ({__name__}:TrackBaseType): ValueError: "
    )
