"""What a row of a study may be, whoever wrote it: one of another kind would be an error of Python's where tables are made of it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, model_validator

from wbmpc.configuration import describe
from wbmpc.errors import InputError

_Whole = Annotated[int, Field(ge=-(2**63), lt=2**63)]


class _Target(BaseModel):
    """The paper's figure, largest and smallest value of a metric's goal."""

    model_config = ConfigDict(strict=True)
    paper: float | None
    goal: float | None
    least: float | None


class _About(_Target):
    unit: str
    larger_is_better: bool


class _Row(BaseModel):
    model_config = ConfigDict(strict=True)
    key: str
    outcome: str
    experiment: str = ""
    condition: str = ""
    robot: str = ""
    reason: str = ""
    started: str = ""
    version: str = ""
    commit: str = ""
    code: str = ""
    host: str = ""
    files: str = ""
    seed: _Whole = 0
    draw: _Whole = 0
    wall_time: float = float("nan")
    cpu_time: float = float("nan")
    varied: dict[str, Any] = {}
    changes: dict[str, Any] = {}
    timing: dict[str, float] = {}
    metrics: dict[str, float] = {}
    about: dict[str, _About] = {}

    @model_validator(mode="after")
    def _units(self) -> Self:
        if missing := [name for name in self.metrics if name not in self.about]:
            raise ValueError(f"about: nothing is said of the metric '{missing[0]}'")
        return self


_TARGETS = TypeAdapter(dict[str, dict[str, _Target]])


def check_rows(path: Path, rows: list[Any]) -> None:
    """Raise :class:`InputError` for the first row of a journal at ``path`` that no study has written."""
    for number, row in enumerate(rows, start=1):
        try:
            _Row.model_validate(row)
        except ValidationError as error:
            raise InputError(f"{path}: row {number}: {describe(error)}; this was not written by a study") from error


def check_targets(path: Path, text: bytes) -> None:
    """Raise :class:`InputError` for what are no goals of metrics, as JSON by combination and metric, of a table at ``path``."""
    try:
        _TARGETS.validate_json(text)
    except ValidationError as error:
        raise InputError(f"{path}: goals of metrics: {describe(error)}; this was not written by a study") from error
