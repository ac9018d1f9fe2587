"""How experiments are found: built-in ones, those of other installed packages, files of a user; who may import the studies."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from command_line import shell
from wbmpc import bases, registry
from wbmpc.benchmark.problems import race_problems
from wbmpc.cli import main
from wbmpc.cli.study import built_in_studies
from wbmpc.errors import InputError
from wbmpc.registry import REGISTRY
from wbmpc.studies.race.robots import RACE
from wbmpc.tasks import EXPERIMENTS as GENERAL

ROOT = Path(__file__).parents[1]
ENTRY_POINTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]
EXPERIMENTS = ENTRY_POINTS["wbmpc.experiments"]
SOURCE = ROOT / "src" / "wbmpc"
OWN = """
from pydantic import BaseModel
from wbmpc.experiment import Experiment
from wbmpc.log import Log
from wbmpc.result import Metric, RunResult

class Mine(BaseModel):
    mass: float = 2.0

def run(settings, seed, progress=None):
    return RunResult("NAME", seed, True, "", {"weight": Metric(9.81 * settings.mass, "N")}, None, Log(), settings=settings.model_dump())

EXPERIMENT = Experiment("NAME", "weighs", Mine, run)
"""

#: A check of settings that fails in another way than by saying what is wrong.
CHECKED = """mass: float = 2.0

    def model_post_init(self, context):
        1.0 / 0.0
"""


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str, str], None]]:
    """Installs a package ``their_lab`` of some source that offers one experiment, as pip does: metadata beside the code."""

    def install(name: str, source: str) -> None:
        (tmp_path / "their_lab.py").write_text(source)
        metadata = tmp_path / "their_lab-1.0.dist-info"
        metadata.mkdir(exist_ok=True)
        (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: their-lab\nVersion: 1.0\n")
        (metadata / "entry_points.txt").write_text(f"[wbmpc.experiments]\n{name} = their_lab:EXPERIMENT\n")
        monkeypatch.syspath_prepend(str(tmp_path))
        sys.modules.pop("their_lab", None)
        registry.locations.cache_clear()
        registry.load.cache_clear()

    yield install
    monkeypatch.undo()
    sys.modules.pop("their_lab", None)
    registry.locations.cache_clear()
    registry.load.cache_clear()


def test_entry_points_are_the_table_of_general_experiments_and_those_of_studies() -> None:
    studies = {name: value for name, value in EXPERIMENTS.items() if value.startswith("wbmpc.studies.")}
    assert studies and {**GENERAL, **studies} == EXPERIMENTS
    assert ENTRY_POINTS["wbmpc.demo"].items() <= studies.items()


def test_general_experiments_come_first_then_those_of_studies_by_name() -> None:
    assert list(REGISTRY) == [*GENERAL, *sorted(EXPERIMENTS.keys() - GENERAL.keys())]


#: Blocks what ``PREFIXES`` names as if it were not there, then calls the command line.
WITHOUT = """
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.startswith(PREFIXES):
            raise ModuleNotFoundError(f"No module named '{name}'", name=name)
sys.meta_path.insert(0, Missing())
from wbmpc.cli import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.parametrize(
    "missing", [("wbmpc.studies.pankert2022", "wbmpc.studies.minniti2019"), ("wbmpc.studies",)], ids=["papers", "all"]
)
def test_the_product_runs_without_the_studies(missing: tuple[str, ...]) -> None:
    def call(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", WITHOUT.replace("PREFIXES", repr(missing)), *arguments]
        return subprocess.run(command, capture_output=True, text=True, timeout=300)

    listed = call("list", "--json")
    assert (listed.returncode, listed.stderr) == (0, "")
    summaries = {e["name"]: e["summary"] for e in json.loads(listed.stdout)["experiments"]}
    lost = {name for name, summary in summaries.items() if "cannot be imported" in summary}
    assert lost == EXPERIMENTS.keys() - GENERAL.keys() and summaries.keys() == EXPERIMENTS.keys()
    settings = call("run", "hold", "--settings", "--json")
    assert (settings.returncode, settings.stderr) == (0, "") and json.loads(settings.stdout)["settings"]
    unknown = call("run", "swerve-track")
    assert unknown.returncode == 2 and "cannot be imported" in unknown.stderr


def test_demo_and_race_say_that_no_package_offers_something(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wbmpc.plugins.entry_points", lambda group: ())
    with pytest.raises(InputError, match=r"'wbmpc demo' \(entry-point group 'wbmpc\.demo'\)"):
        registry.demonstrated()
    with pytest.raises(InputError, match=r"problems for the race \(entry-point group 'wbmpc\.race'\)"):
        race_problems.__wrapped__()
    assert built_in_studies() == {}


def test_the_race_has_the_problems_of_all_that_offer_some(monkeypatch: pytest.MonkeyPatch) -> None:
    """Truth: what the module of the entry point lists, once for each of two."""
    target = ENTRY_POINTS["wbmpc.race"]["robots"]
    points = tuple(EntryPoint(name, target, "wbmpc.race") for name in ("a", "b"))
    monkeypatch.setattr("wbmpc.plugins.entry_points", lambda group: points)
    found = race_problems.__wrapped__()
    assert found.robots == [*RACE.robots, *RACE.robots]
    assert (found.limited, found.sizes) == (RACE.limited, RACE.sizes)


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_built_in_experiment_is_found_by_its_name(name: str) -> None:
    found = REGISTRY[name]
    assert found.name == name and found.summary
    found.config_type()  # defaults are valid


def test_nothing_outside_of_the_studies_imports_them() -> None:
    users = []
    for path in sorted(SOURCE.rglob("*.py")):
        if "studies" in path.relative_to(SOURCE).parts:
            continue
        if "studies" not in (text := path.read_text()):
            continue
        for node in ast.walk(ast.parse(text)):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                names = [f"{'.' * node.level}{node.module or ''}.{a.name}" for a in node.names]
            elif isinstance(node, ast.Constant) and str(node.value).startswith("wbmpc.studies"):
                names = [str(node.value)]  # what import_module would be given
            users += [f"{path.name}:{node.lineno}" for name in names if "studies" in re.split("[.:]", name)]  # type: ignore[attr-defined]
    assert users == []


def test_an_installed_package_offers_an_experiment(
    package: Callable[[str, str], None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    package("their-task", OWN.replace("NAME", "their-task"))
    assert list(REGISTRY)[-1] == "their-task"
    out = str(tmp_path / "run")
    assert main(["run", "their-task", "--set", "mass=3", "--out", out, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["metrics"]["weight"]["value"] == pytest.approx(29.43)


def test_a_built_in_name_cannot_be_taken(package: Callable[[str, str], None]) -> None:
    package("swerve-stability", OWN.replace("NAME", "swerve-stability"))
    assert REGISTRY["swerve-stability"].config_type.__module__ == "wbmpc.studies.pankert2022.stability"


def test_a_package_that_cannot_be_imported_does_not_hide_the_others(
    package: Callable[[str, str], None], capsys: pytest.CaptureFixture[str]
) -> None:
    package("their-task", "import a_module_that_is_nowhere\n")
    with pytest.raises(
        InputError, match=r"their-task.*their_lab:EXPERIMENT cannot be imported.*a_module_that_is_nowhere"
    ):
        REGISTRY["their-task"]
    assert main(["list"]) == 0
    listed = capsys.readouterr().out
    assert "a_module_that_is_nowhere" in listed and "swerve-track" in listed


@pytest.mark.parametrize(
    "source",
    [
        "raise RuntimeError('red \\x1b[31m')",
        "raise SystemExit(0)",
        "x = = 1",
        "class Odd(BaseException): ...\nraise Odd",
    ],
)
def test_whatever_a_package_does_when_it_is_imported_is_one_message(
    source: str,
    package: Callable[[str, str], None],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A package that is broken takes no command that does not need it: experiments, studies and base types of others stay."""
    package("their-task", f"{source}\n")
    assert main(["run", "their-task"]) == 2
    assert "their_lab:EXPERIMENT cannot be imported" in (said := capsys.readouterr().err) and "\x1b" not in said
    assert main(["list"]) == 0 and "swerve-track" in capsys.readouterr().out
    point = EntryPoint("theirs", "their_lab.inside", "any")
    monkeypatch.setattr("wbmpc.plugins.entry_points", lambda group: (point,))
    assert built_in_studies() == {}
    bases._locations.cache_clear()
    try:
        assert main(["doctor", "swerve-ur10"]) == 0
        with pytest.raises(InputError, match=r"base type 'theirs': its plug-in their_lab\.inside cannot be imported"):
            bases.base_type("theirs")
    finally:
        bases._locations.cache_clear()


def test_a_file_is_an_experiment(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Run from where it stands, with a module beside it; its files are named after the experiment."""
    (tmp_path / "beside.py").write_text("GRAVITY = 1.62\n")
    (tmp_path / "moon.py").write_text(
        "from beside import GRAVITY\n" + OWN.replace("NAME", "moon").replace("9.81", "GRAVITY")
    )
    monkeypatch.chdir(tmp_path)
    assert main(["run", "moon.py", "--seed", "4", "--set", "mass=10", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["experiment"] == "moon" and found["metrics"]["weight"]["value"] == pytest.approx(16.2)
    assert Path(found["files"]["report"]).parent.name.startswith("moon-seed4")


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (None, "there is no file 'mine.py'"),
        ("x = 1\n", "mine.py: EXPERIMENT: a wbmpc.experiment.Experiment is needed, got NoneType"),
        ("EXPERIMENT = 3\n", "mine.py: EXPERIMENT: a wbmpc.experiment.Experiment is needed, got int"),
        ("x = 1\ny = = 2\n", "mine.py, line 2: cannot be imported: SyntaxError"),
        ("import a_module_that_is_nowhere\n", "mine.py, line 1: cannot be imported: ModuleNotFoundError"),
        ("x = 1\n1 / 0\n", "mine.py, line 2: cannot be imported: ZeroDivisionError"),
        ("raise SystemExit(7)\n", "mine.py, line 1: cannot be imported: SystemExit: 7"),
        ("x = 1\0\n", "mine.py: cannot be imported: SyntaxError"),
        (
            "import sys\nsys.path.pop(0)\n",
            "mine.py: EXPERIMENT: a wbmpc.experiment.Experiment is needed, got NoneType",
        ),
        (OWN.replace("NAME", "../mine"), "experiment '../mine': valid in a name: letters"),
        (OWN.replace("Mine, run)", "dict, run)"), "experiment 'NAME': a pydantic model of its settings"),
        (OWN.replace("mass: float = 2.0", "mass: float"), "NAME: its settings: ValidationError: 1 validation error"),
        (
            OWN.replace("mass: float", "mass: 'Unknown'"),
            "NAME: its settings: PydanticUserError: `Mine` is not fully",
        ),
        (
            OWN.replace("mass: float = 2.0", "mass: object = type"),
            "NAME: its settings: PydanticSerializationError: ",
        ),
        (OWN.replace("mass: float = 2.0", CHECKED), "NAME: its settings: ZeroDivisionError: float division by zero"),
        (OWN.replace('"weighs"', "None"), "experiment 'NAME': a text is needed that says what it is about"),
        (OWN.replace("9.81", "0 / 0"), "mine.py, line 11: its run fails: ZeroDivisionError"),
        (
            OWN.replace("return RunResult", "raise SystemExit(0); RunResult"),
            "mine.py, line 11: its run fails: SystemExit: 0",
        ),
        (
            OWN.replace("return RunResult", "RunResult"),
            "mine.py: the result of its run: RunResult is needed, got NoneType",
        ),
    ],
)
def test_a_file_that_is_none_is_bad_input(
    source: str | None,
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if source is not None:
        (tmp_path / "mine.py").write_text(source)
    monkeypatch.chdir(tmp_path)
    assert main(["run", "mine.py"]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("where", ["import", "run", "thread", "child"])
def test_a_program_that_ends_the_process_is_no_success(where: str, tmp_path: Path) -> None:
    """Truth: a process of its own; what the operating system has of it, not what the library says. A child's status is its own."""
    leaving = {
        "import": "os._exit(0)",
        "run": "os._exit(0)",
        "thread": "import threading, time; threading.Thread(target=os._exit, args=(0,)).start(); time.sleep(5)",
        "child": "import sys; child = os.fork(); child or os._exit(0); sys.exit(7 + os.waitpid(child, 0)[1])",
    }[where]
    source = OWN.replace("NAME", "mine").replace("    return RunResult", f"    {leaving}\n    return RunResult")
    (tmp_path / "mine.py").write_text("import os\n" + (leaving if where == "import" else "") + source)
    run = shell("run", str(tmp_path / "mine.py"), "--out", str(tmp_path / "run"))
    assert run.returncode == (1 if where == "thread" else 2)
    assert f"SystemExit: {7 if where == 'child' else 0}" in run.stderr or where == "thread"


def test_what_a_run_says_of_itself_steers_no_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Faults and reasons quote names of a robot's model, which may have any character."""
    source = OWN.replace('"NAME", seed, True, ""', '"mine", seed, False, "\\x9b31m"').replace("NAME", "mine")
    source = source.replace('"weight"', '"we\\x1b[2Jight"').replace("Log(),", 'Log(), faults=["\\x1b[31mred"],')
    (tmp_path / "mine.py").write_text(source)
    assert main(["run", str(tmp_path / "mine.py"), "--out", str(tmp_path / "run")]) == 1
    said = capsys.readouterr().out
    assert all(c.isprintable() or c == "\n" for c in said) and r"\x9b31m" in said and r"\x1b[31mred" in said


def test_what_a_package_says_of_its_experiment_steers_no_terminal(
    package: Callable[[str, str], None], capsys: pytest.CaptureFixture[str]
) -> None:
    """Nor does it make lines of its own. Truth: ISO/IEC 6429, and the lines without it."""
    assert main(["list"]) == 0
    usual = capsys.readouterr().out.splitlines()
    package("their-task", OWN.replace("NAME", "their-task").replace("weighs", "\\x1b[2J\\nrobots:"))
    assert main(["list"]) == 0
    listed = capsys.readouterr().out
    assert "\x1b" not in listed and len(listed.splitlines()) == len(usual) + 1


@pytest.mark.parametrize("place", ["import", "run"])
def test_a_program_that_changes_the_directory_does_not_move_the_files(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Truth: --out is meant from where the command was given. The program's own paths are meant from where it has gone."""
    (tmp_path / "here").mkdir()
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "mass").write_text("3.0")
    go = f"os.chdir({str(tmp_path / 'there')!r})"
    first = "\n    ".join(
        [go] * (place == "run") + ["import pathlib", "settings.mass = float(pathlib.Path('mass').read_text())", ""]
    )
    source = OWN.replace("NAME", "mine").replace("    return RunResult", f"    {first}return RunResult")
    (tmp_path / "mine.py").write_text("import os\n" + (go if place == "import" else "") + source)
    monkeypatch.chdir(tmp_path / "here")
    assert main(["run", "../mine.py", "--out", "run"]) == 0
    assert Path.cwd() == tmp_path / "here"
    assert json.loads(Path("run/metrics.json").read_text())["metrics"]["weight"]["value"] == pytest.approx(29.43)
    assert [p.name for p in (tmp_path / "there").iterdir()] == ["mass"]


def test_a_mistake_in_a_run_is_no_outcome_of_a_study(tmp_path: Path) -> None:
    """It is no settings that were rejected, and the run is done again when the file is mended."""
    (tmp_path / "mine.py").write_text(
        OWN.replace("NAME", "mine").replace("return RunResult", "raise SystemExit(0); RunResult")
    )
    (tmp_path / "study.yaml").write_text("experiments: mine.py\nseeds: 1-2\n")
    assert main(["study", str(tmp_path / "study.yaml"), "--workers", "0", "--out", str(tmp_path / "out")]) == 1
    (tmp_path / "mine.py").write_text(OWN.replace("NAME", "mine"))
    assert main(["study", str(tmp_path / "study.yaml"), "--workers", "0", "--out", str(tmp_path / "out")]) == 0
    (tmp_path / "study.yaml").write_text("experiments: mine.py\nseeds: 0-999999\nvary: {mass: [1, 2]}\n")
    assert main(["study", str(tmp_path / "study.yaml"), "--out", str(tmp_path / "out")]) == 2
