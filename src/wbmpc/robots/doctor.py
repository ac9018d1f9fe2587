"""Everything that is wrong with a robot's file at once, or has to be known of it."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wbmpc.bases import answers, available_base_types, base_type
from wbmpc.bases.base import Proposal
from wbmpc.errors import InputError, shell_command
from wbmpc.robots.description import DATA, RobotDescription, available_robots, load_description, load_spec
from wbmpc.robots.findings import Finding
from wbmpc.robots.mechanism import read_mechanism
from wbmpc.robots.model_checks import Subject, examine
from wbmpc.robots.model_file import read_model
from wbmpc.robots.read_once import reading_once
from wbmpc.yaml_file import load_yaml

_ORDER = {"error": 0, "warning": 1, "info": 2}


@dataclass(frozen=True)
class Diagnosis:
    """``model``: the file that was checked, None where there is none; ``findings``: errors first; ``milliseconds`` of checking."""

    robot: str
    model: str | None
    findings: tuple[Finding, ...]
    milliseconds: float

    def count(self, severity: str) -> int:
        """How many findings have a severity."""
        return sum(f.severity == severity for f in self.findings)


def examine_robot(
    robot: str, packages: Mapping[str, Path] | None = None, arguments: Mapping[str, str] | None = None
) -> Diagnosis:
    """Check a robot by name, a robot's YAML, or a URDF, xacro or MJCF alone. ``packages`` and ``arguments`` are for a model alone.

    Raises :class:`InputError` where there is no such robot or file.
    """
    path = DATA / f"{robot}.yaml" if robot in available_robots() else Path(robot)
    if not path.is_file():
        raise InputError(
            f"{robot}: there is no such file; valid: a .yaml, .urdf, .xacro or .xml, {', '.join(available_robots())}"
        )
    for name in available_base_types():  # what they import is no check
        with suppress(InputError):
            base_type(name)
    began = time.perf_counter()
    with _quiet(), reading_once():
        if path.suffix in (".yaml", ".yml"):
            model, findings = _of_description(path)
        else:
            model, findings = path, _of_model(path, packages or {}, arguments or {})
    findings = sorted(findings, key=lambda f: _ORDER[f.severity])
    return Diagnosis(
        str(path), None if model is None else str(model), tuple(findings), 1e3 * (time.perf_counter() - began)
    )


@contextmanager
def _quiet() -> Iterator[None]:
    log = logging.getLogger(load_description.__module__)
    before, log.disabled = log.disabled, True
    try:
        yield
    finally:
        log.disabled = before


def _of_description(path: Path) -> tuple[Path | None, list[Finding]]:
    try:
        description = load_description(path)
    except InputError as error:
        return _of_broken(path, Finding("error", "description", "", str(error)))
    findings = examine(Subject(read_mechanism(_file(description)), description))
    return description.model, findings + _of_base(description)


def _file(description: RobotDescription) -> Any:
    return read_model(description.model, description.packages, description.xacro_arguments)


def _of_base(description: RobotDescription) -> list[Finding]:
    """What the base type says of its own: a model that it rejects, ranks and conditions of wheels."""
    plugin = base_type(description.base.type)
    try:
        return plugin.diagnose(description, plugin.model(description, load_spec(description)))
    except InputError as error:
        return [Finding("error", "base", "", str(error))]


def _of_broken(path: Path, fault: Finding) -> tuple[Path | None, list[Finding]]:
    """The fault, and what the model shows by itself where the YAML names it."""
    try:
        data = load_yaml(path)
        keys = data if isinstance(data, dict) else {}
        model = path.parent / str(keys["model"])
        packages = {str(n): path.parent / str(f) for n, f in dict(keys.get("packages") or {}).items()}
        arguments = {str(n): str(v) for n, v in dict(keys.get("xacro_arguments") or {}).items()}
        found = _of_model(model, packages, arguments) if model.is_file() else []
    except (InputError, KeyError, TypeError, ValueError):
        return None, [fault]
    return model, [fault, *(f for f in found if f.message not in fault.text)]


def _of_model(path: Path, packages: Mapping[str, Path], arguments: Mapping[str, str]) -> list[Finding]:
    try:
        subject = Subject(read_mechanism(read_model(path, packages, arguments)))
    except InputError as error:
        return [Finding("error", "model", "", str(error))]
    return examine(subject) + list(_bases(subject))


def _bases(subject: Subject) -> Iterator[Finding]:
    proposals = propose_bases(subject)
    for name, proposal in proposals.items():
        if proposal.fit >= 0.5:
            yield Finding(
                "info", "base", f"base type {name}", f"it fits: {proposal.reason}",
                shell_command("wbmpc", "new", subject.mechanism.file.path, "--base", name),
            )  # fmt: skip
    if subject.driven and not any(p.fit >= 0.5 for p in proposals.values()):
        names = ", ".join(f"'{w.joint}'" for w in subject.driven[:4])
        yield Finding(
            "warning", "base", "", f"no base type describes its wheels ({names})",
            f"valid: {', '.join(available_base_types())}",
        )  # fmt: skip


def propose_bases(subject: Subject) -> dict[str, Proposal]:
    """Proposals of all installed base types, the best first."""

    def ask(name: str) -> Proposal | None:
        proposal = base_type(name).propose(subject.mechanism, subject.driven)
        if not isinstance(proposal, Proposal | None):
            raise InputError(f"'propose' gives '{type(proposal).__name__}', no wb.Proposal")
        return proposal

    found = {name: p for name, p in answers(ask).items() if p is not None and p.fit > 0.0}
    return dict(sorted(found.items(), key=lambda item: -item[1].fit))
