"""What settings an experiment has, and weights that a user has found with sliders."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from wbmpc.cli.terminal import console, table

if TYPE_CHECKING:
    from pydantic import BaseModel


def show_settings(model: type[BaseModel], name: str, as_json: bool, values: BaseModel | None = None) -> None:
    """Every setting of an experiment; ``values``: in place of the defaults."""

    from wbmpc.settings_table import rows

    found = list(rows(model, values=values))
    if as_json:
        typer.echo(json.dumps({"experiment": name, "settings": [asdict(row) for row in found]}))
        return
    shown = table(f"settings of {name} (--set KEY=VALUE, or a YAML file with --config)")
    of = {"of": "choice"} if any(row.choice for row in found) else {}
    value = "default" if values is None else "value"
    columns = {"setting": "key", **of, value: "default", "unit": "unit", "type and range": "kind", "meaning": "help"}
    for title in columns:
        shown.add_column(title)
    for row in found:
        shown.add_row(*(getattr(row, field).replace("`", "") for field in columns.values()))
    console().print(shown)


def write_weights(factors: Mapping[str, float], before: Mapping[str, float], directory: Path) -> dict[str, str]:
    """A settings file of the weights' ``factors`` by cost, in place of those ``before`` the run, if any was moved; its path by "weights"."""
    if not factors:
        return {}
    from wbmpc.output_file import write_text
    from wbmpc.robots.robot_yaml import write_yaml

    path = directory / "weights.yaml"
    text = "Factors of the costs' weights as the sliders were left: wbmpc run NAME --config weights.yaml"
    write_text(path, write_yaml({"weights": {**before, **factors}}, {"": text}))
    return {"weights": str(path)}
