"""How old the tables of figures in the documents are: which packages have changed since the commit that their runs are of.

``python docs/_ext/table_age.py`` prints a line for each table; the build prints them too, and writes them below the tables. The README,
which is read without a build, says in its mark ``age`` whether its figures are older than the code: ``--write`` fills it, and a test
checks it. A change of comments, docstrings or layout is none.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
SOURCE = "src/wbmpc"
#: Folders whose parts are packages of their own.
NESTED = ("bases", "studies")
#: Packages of a plant and its controller, a solver's too, that a paper's experiments run; of ``bases`` and ``studies`` their own.
SIMULATED = frozenset(
    ("bases/common", "clearance", "control", "estimation", "kernel", "model", "mpc", "obstacles", "ocp", "robots", "runtime", "simulation", "solver",
     "stability", "tasks", "modules")
)  # fmt: skip
#: Modules that have no part in it.
NO_PART = frozenset(
    ("__init__.py", "__main__.py", "compare.py", "errors.py", "input_file.py", "interrupts.py", "logs.py", "output_file.py",
     "registry.py", "reproduce.py", "result.py", "run_files.py", "run_index.py", "settings_table.py", "tasks/joint_figures.py", "units.py",
     "yaml_file.py")
)  # fmt: skip
GALLERY = SIMULATED | {
    f"bases/{b}" for b in ("differential", "fixed", "omnidirectional", "planar_motion", "swerve", "wheels")
}
SWERVE, BALL = SIMULATED | {"bases/swerve", "studies/pankert2022"}, SIMULATED | {"bases/ball", "studies/minniti2019"}
#: What stands behind a commit in what is said of it; packages that pages name, at most.
MARK, MOST_NAMED = "; ", 4
#: Where the README says that its figures are older than the code, and how.
AGE, OLDER = re.compile(r"(<!--= age -->)(.*?)(<!--/-->)"), " (the code has changed since)"
#: One of digits alone is a number unless it stands after the word; another project's stands after its name.
COMMIT = re.compile(r"(?<![\w.])(?<!acados )(?:(?<=commit )|(?=[0-9]*[a-f]))[0-9a-f]{8,10}(?!\w)")


@dataclass(frozen=True)
class Table:
    """The text between ``first`` and ``last`` of a ``page``, whose figures depend on the packages ``of``."""

    name: str
    page: str
    first: str
    last: str
    of: frozenset[str]

    @property
    def text(self) -> str:
        """What stands there now; empty where the marks are missing."""
        return (ROOT / self.page).read_text().partition(self.first)[2].partition(self.last)[0]


def _marked(name: str, page: str, of: frozenset[str]) -> Table:
    return Table(name, page, f"<!-- {name} -->", f"<!-- end of {name} -->", of)


TABLES = (
    Table("figures", "README.md", "<!--= commit -->", "<!--/-->", SWERVE | BALL),
    _marked("swerve goals", "docs/results/swerve.md", SWERVE),
    _marked("swerve loads", "docs/results/swerve.md", SWERVE),
    _marked("ball goals", "docs/results/ball.md", BALL),
    _marked("ball loads", "docs/results/ball.md", BALL),
    _marked(
        "obstacles",
        "docs/results/obstacles.md",
        SIMULATED | {f"bases/{b}" for b in ("ball", "swerve", "planar_motion")},
    ),
    _marked("fast motion", "docs/results/motion.md", SWERVE),
    _marked("wiping", "docs/results/motion.md", SWERVE),
    _marked("touch", "docs/results/motion.md", BALL),
    _marked("slip", "docs/results/motion.md", BALL),
    _marked("legs", "docs/results/motion.md", SWERVE),
    _marked("gallery", "docs/results/robots.md", GALLERY),
    _marked("arms", "docs/results/robots.md", GALLERY),
    _marked("rooms", "docs/results/rooms.md", SIMULATED | {"bases/differential"}),
    _marked("translator", "docs/explanation/solver.md", frozenset({"kernel"})),
    _marked(
        "acados",
        "docs/explanation/solver.md",
        frozenset({"kernel", "model", "ocp", "solver", "bases/ball", "bases/swerve"}),
    ),
)


def git(root: Path, *words: str) -> str | None:
    """What git prints; None where it fails."""
    try:
        done = subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True, timeout=60)
    except (OSError, subprocess.SubprocessError):
        return None
    return None if done.returncode else done.stdout


def package(path: str) -> str:
    """The package that a file of the source belongs to: a folder, one of ``bases`` and ``studies``, or "modules" for all others."""
    folders = path.removeprefix(f"{SOURCE}/").split("/")[:-1]
    depth = 2 if folders[:1] in ([name] for name in NESTED) else 1
    return "/".join(folders[:depth]) if len(folders) >= depth else "modules"


@cache
def changed(commit: str, root: Path = ROOT) -> dict[str, list[str]] | None:
    """By package the files that differ from those of a commit; None where it is not known here."""
    names = git(root, "diff", "--name-only", "--no-renames", commit, "--", SOURCE)
    if names is None:
        return None
    found: dict[str, list[str]] = {}
    for name in names.split():
        if name.endswith((".py", ".yaml", ".urdf", ".xml")) and name.removeprefix(f"{SOURCE}/") not in NO_PART:
            found.setdefault(package(name), []).append(name)
    return found


@cache
def code_changed(commit: str, name: str, root: Path = ROOT) -> bool:
    """Whether a file differs in more than comments, docstrings and layout."""
    before, path = git(root, "show", f"{commit}:{name}"), root / name
    if before is None or not path.is_file() or not name.endswith(".py"):
        return True
    return bare(before) != bare(path.read_text())


def bare(source: str) -> str:
    """Python source without comments, docstrings and layout."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
            and ast.get_docstring(node, clean=False) is not None
        ):
            node.body = node.body[1:]
    return ast.dump(tree)


def age(table: Table, root: Path = ROOT) -> Iterator[str]:
    """For each commit of a table what has changed since."""
    for commit in dict.fromkeys(COMMIT.findall(table.text)):
        files = changed(commit, root)
        if files is None:
            yield f"of commit {commit}{MARK}it is not known here"
            continue
        newer = [p for p in sorted(table.of & files.keys()) if any(code_changed(commit, n, root) for n in files[p])]
        said = f"changed since: {', '.join(newer)}" if newer else "nothing that it depends on has changed since"
        yield f"of commit {commit}{MARK}{said}"


def is_old(table: Table, root: Path = ROOT) -> bool | None:
    """Whether code that a table depends on has changed since one of its commits; None where one is not known here."""
    found = list(age(table, root))
    return None if any("not known" in text for text in found) else any("changed since:" in text for text in found)


def with_age(readme: str, old: bool) -> str:
    """The README with its mark ``age`` filled."""
    return AGE.sub(lambda m: f"{m[1]}{OLDER if old else ''}{m[3]}", readme)


def lines() -> Iterator[str]:
    """One for each table and commit."""
    for table in TABLES:
        for text in age(table):
            yield f"table '{table.name}' in {table.page} is {text}"


def setup(app: Any) -> dict[str, bool]:
    """Sphinx: a note below each table, and a line for each in the build's output."""
    from sphinx.util import logging

    app.connect("source-read", lambda app, name, source: _noted(name, source))
    app.connect("builder-inited", lambda app: [logging.getLogger(__name__).info(line) for line in lines()])
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _noted(name: str, source: list[str]) -> None:
    for table in TABLES:
        if table.page == f"docs/{name}.md":
            source[0] = source[0].replace(table.last, f"{table.last}\n\n{note(table)}\n")


def note(table: Table, root: Path = ROOT) -> str:
    """What stands below a table: a line for all of its commits of which the same is to be said, with few names of packages."""
    commits: dict[str, list[str]] = {}
    for text in age(table, root):
        commit, _, said = text.removeprefix("of commit ").partition(MARK)
        packages = said.removeprefix("changed since: ").split(", ")
        if len(packages) > MOST_NAMED:
            said = f"older than the code: {len(packages)} packages have changed since"
        commits.setdefault(said, []).append(commit)
    lines = (f"*Of commit{'s' * (len(c) > 1)} {', '.join(c)}: {said}.*" for said, c in commits.items())
    return "\n\n".join(lines) if table.text.strip() else "*No runs are published here at present.*"


if __name__ == "__main__":
    print("\n".join(lines()))
    known = is_old(TABLES[0])
    if sys.argv[1:] == ["--write"] and known is not None:
        (ROOT / TABLES[0].page).write_text(with_age((ROOT / TABLES[0].page).read_text(), known))
