"""The table of weights in docs/experiments-swerve.md. Truth: the defaults of the experiments' settings."""

from __future__ import annotations

from pathlib import Path

import pytest

from wbmpc.registry import REGISTRY

DOCS = Path(__file__).parents[2] / "docs" / "experiments-swerve.md"


@pytest.mark.parametrize("name", ["swerve-track", "swerve-plaster", "swerve-unified", "swerve-drive", "swerve-fixed"])
def test_the_table_has_the_weights_of_the_settings(name: str) -> None:
    table = DOCS.read_text().split("## Weights of the swerve robots")[1].split("\n## ")[0]
    (row,) = [line for line in table.splitlines() if line.startswith(f"| `{name}`")]
    told = [[float(v) for v in cell.split(",")] for cell in row.split("|")[3:8]]
    c = REGISTRY[name].config_type().cost  # type: ignore[attr-defined]
    hand, state, given = c.hand, c.state, c.input
    used = [
        [hand.weight, hand.orientation],
        [state.position, state.yaw],
        [state.leg],
        [state.arm],
        [given.base, given.steer],
    ]
    assert told == used
