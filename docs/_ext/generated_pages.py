"""Pages that the build writes into docs/reference: the API by sub-package, tables of settings, the command line.

They are made of the package as it is imported: nothing in them is written by hand, and git does not keep them.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
from collections.abc import Container, Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from sphinx.application import Sphinx

from wbmpc import settings_table as table

#: Sub-packages with an API page; of ``solver`` what users hold, the other files are the compiled driver.
PACKAGES = (
    "model", "bases", "ocp", "solver", "mpc", "embedded", "runtime", "estimation", "control", "simulation", "tasks", "robots", "recording",
    "stability", "study", "ros2", "obstacles", "mapping",
)  # fmt: skip
ONLY = {
    "embedded": ("exporter",),
    "study": ("study",),
    "solver": ("settings", "solution", "solver"),
    "ros2": ("bus", "settings", "network"),
}
#: Modules beside the packages.
MODULES = ("types", "errors", "lie", "trajectory", "result", "log", "experiment", "default_problem", "settings")


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages before anything is read; docstrings' ``|`` are no substitutions."""
    app.connect("builder-inited", lambda app: write(Path(app.srcdir) / "reference"))
    app.connect("autodoc-process-docstring", _escaped)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def write(reference: Path) -> None:
    """All pages; a page that has not changed is left alone, so that it is not read again."""
    _put(reference / "_settings.md", settings_tables())
    _put(reference / "_metrics.md", metrics_tables())
    api = reference / "_api"
    api.mkdir(exist_ok=True)
    _put(api / "names.md", "# `wbmpc`: public names\n\n" + public_names())
    for package in PACKAGES:
        _put(api / f"{package}.md", package_page(f"wbmpc.{package}", ONLY.get(package)))
    _put(api / "modules.md", "# Modules\n\n" + "\n".join(_automodule(f"wbmpc.{name}", "##") for name in MODULES))
    _put(reference / "_cli.md", command_line())
    _put(reference / "_changelog.md", changelog(reference.parents[1] / "CHANGELOG.md"))


def _put(path: Path, text: str) -> None:
    if not path.exists() or path.read_text() != text:
        path.write_text(text)


def _escaped(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """``|`` outside of literals is text: "|u|² ≤ r²" is no substitution."""
    for i, line in enumerate(lines):
        parts = re.split(r"(``[^`]*``|`[^`]*`)", line)
        text = "".join(p if p.startswith("`") else re.sub(r"\|", r"\\|", p) for p in parts)
        # ``spread``² : a literal must end before a space or punctuation
        lines[i] = re.sub(r"(``[^`]+``)(?=[^\s`\-.,:;!?'\")\]}>/\\])", r"\1\\ ", text)


def public_names() -> str:
    """``wbmpc.NAME`` with the first sentence of its docstring."""
    import wbmpc

    rows = []
    for name in sorted(n for n in wbmpc.__all__ if not n.startswith("_")):
        thing = getattr(wbmpc, name)
        module = getattr(thing, "__module__", thing.__name__ if hasattr(thing, "__name__") else "")
        rows.append(f"| `wb.{name}` | `{module}` | {_first(thing.__doc__ or '')} |")
    return "| name | defined in | |\n| --- | --- | --- |\n" + "\n".join(rows) + "\n"


def _first(text: str) -> str:
    """First sentence, as text for a Markdown cell."""
    text = " ".join(text.split())
    text = re.sub(r":\w+:`~?([^`]*)`", r"`\1`", text).replace("``", "`")
    return re.split(r"(?<=[.:])\s", text, maxsplit=1)[0].rstrip(":").replace("|", "\\|")


def package_page(package: str, only: tuple[str, ...] | None) -> str:
    """One page: the package's docstring and every public module of it."""
    body = "\n".join(_automodule(name, "##") for name in modules(package, only))
    return f"# `{package}`\n\n{_prose(importlib.import_module(package).__doc__ or '')}\n\n{body}"


def modules(package: str, only: tuple[str, ...] | None) -> Iterator[str]:
    """Public modules of a package and of packages inside it."""
    for found in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
        leaf = found.name.rpartition(".")[2]
        if not found.ispkg and not leaf.startswith("_") and (only is None or leaf in only):
            yield found.name


def _prose(text: str) -> str:
    return "```{eval-rst}\n" + inspect.cleandoc(text) + "\n```"


def _automodule(name: str, level: str) -> str:
    return f"{level} `{name}`\n\n```{{eval-rst}}\n.. automodule:: {name}\n```\n"


def settings_tables() -> str:
    """A table for each settings model: what experiments share first, then each experiment, the runner, ROS 2, a robot's file."""
    experiments = _experiments()
    from wbmpc.bases.swerve.ros_settings import SwerveRosSettings
    from wbmpc.robots.description import RobotDescription
    from wbmpc.ros2.settings import RosSettings
    from wbmpc.settings import ControlSettings, MpcSettings
    from wbmpc.simulation.any_perturbation import AnyPerturbation

    shared = (("`mpc.…` of experiments", MpcSettings), ("`control.…` of experiments", ControlSettings),
              ("`plant.…` of experiments: the perturbation", AnyPerturbation))  # fmt: skip
    parts = [_section(title, model) for title, model in shared]
    sections = (("mpc.", MpcSettings), ("control.", ControlSettings), ("plant.", AnyPerturbation))
    usual = {row for prefix, model in sections for row in _rows(model, prefix)}
    # where the robot may be kinematic too, these are MuJoCo's
    usual |= {(f"{key} of `plant=mujoco`", *rest) for key, *rest in usual if key.startswith("`plant.")}
    for name, experiment in experiments.items():
        parts.append(_section(f"`{name}`", experiment.config_type, usual))
    shared_keys = set(_rows(RosSettings))
    parts += [
        _section("A ROS 2 node's file", RosSettings),
        _section("A ROS 2 node's file, swerve base", SwerveRosSettings, shared_keys),
    ]
    parts += [_section("A robot's file", RobotDescription)]
    return "\n".join(parts)


def metrics_tables() -> str:
    """A table of metrics for each experiment of a paper, and one for the others."""
    from wbmpc.experiment import COMMON
    from wbmpc.tasks.definitions import DEFINITIONS

    found = {
        name: e.definitions for name, e in _experiments().items() if e.definitions and e.definitions is not DEFINITIONS
    }
    tables = {"All experiments": COMMON, "Any robot": DEFINITIONS} | {f"`{name}`": of for name, of in found.items()}
    return "\n".join(f"## {title}\n\n{_definitions(of)}" for title, of in tables.items())


def _definitions(of: Mapping[str, tuple[str, str]]) -> str:
    text = "".join(
        f"| `{name}`{'' if unit == '1' else f' [{unit}]'} | {about} |\n" for name, (unit, about) in of.items()
    )
    return f"| metric | definition |\n| --- | --- |\n{text}"


def _experiments() -> dict[str, Any]:
    try:
        registry = importlib.import_module("wbmpc.registry")
    except ModuleNotFoundError:
        registry = importlib.import_module("wbmpc.studies")
    return dict(registry.REGISTRY)


def _section(title: str, model: type[BaseModel], usual: Container[tuple[str, ...]] = ()) -> str:
    """A model's table, without the rows that are as ``usual``."""
    rows = "\n".join("| {} | {} | {} | {} |".format(*row) for row in _rows(model) if row not in usual)
    prose = _prose((model.__doc__ or "").replace("|", "\\|"))
    return f"## {title}\n\n{prose}\n\n| key | type and range | default | meaning |\n| --- | --- | --- | --- |\n{rows}\n"


def _rows(model: type[BaseModel], prefix: str = "") -> list[tuple[str, ...]]:
    """Key with the choice that it is of, type, default and meaning of every field."""
    return [
        (
            f"`{r.key}`" + (f" of `{r.choice}`" if r.choice else ""), r.kind, r.default,
            (f"[{r.unit}] " if r.unit else "") + r.help.replace("|", "\\|"),
        )
        for r in table.rows(model, prefix)
    ]  # fmt: skip


def changelog(path: Path) -> str:
    """The changelog with links into this repository as text: pages of past versions may be gone."""
    return re.sub(r"\[([^\]]*)\]\((?![a-z]+:)[^)]*\)", r"\1", path.read_text())


def command_line() -> str:
    """Every command with its options, by Typer."""
    import typer
    from typer.cli import get_docs_for_click

    from wbmpc.cli import app

    command = typer.main.get_command(app)
    text = get_docs_for_click(obj=command, ctx=typer.Context(command), name="wbmpc")
    # the page has its own title
    return re.sub(r"(?m)^(#+ )", r"#\1", text.partition("\n")[2])
