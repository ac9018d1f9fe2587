"""A small study for tests, and how it is started from the shell."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
SOURCE = HERE.parents[1] / "src"
TEXT = """
title: a valley
experiments: {VALLEY: {fall_from: 308}}
seeds: 300-309
conditions:
  near: {settings: {control.gain: 2.5}}
  far: {settings: {control.gain: 5}}
metrics: [error]
"""


def study(tmp_path: Path, text: str = TEXT, name: str = "study.yaml") -> Path:
    file = tmp_path / name
    file.write_text(text.replace("VALLEY", str(HERE / "valley.py")))
    return file


def traces(page: Path) -> list[dict[str, Any]]:
    """What all plots of a page draw."""
    calls = page.read_text().split("Plotly.newPlot(")[1:]
    found = (json.JSONDecoder().raw_decode(c[c.index("[") :])[0] for c in calls if c.lstrip().startswith('"'))
    return [trace for data in found for trace in data]


def command(*words: object) -> list[str]:
    return [sys.executable, "-m", "wbmpc", *map(str, words)]


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(SOURCE)}
