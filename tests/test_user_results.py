"""What other people's experiments give back, raise and do. Truth: the documented exit statuses, and what each file was made to do wrong."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from wbmpc.cli import main

SOURCE = """
from fractions import Fraction
import numpy as np
from pydantic import BaseModel
import wbmpc as wb
from wbmpc.result import MpcStatistics

class Settings(BaseModel):
    duration: float = 1.0

class Silent(Exception):
    def __str__(self): raise RuntimeError("no text")

class SilentInput(wb.InputError, Silent):
    __str__ = Silent.__str__

def run(settings, seed, progress=None):
    log, t = wb.Log(), 0.1 * np.arange(10)
    for k in range(10):
        log.add("hand", t[k], [1.0, 2.0])
    line = lambda **more: [wb.Plot("p", "time [s]", "y [m]", [wb.Series(**{"name": "a", "x": t, "y": t, **more})])]
    part = dict(
        experiment="mine", seed=seed, completed=True, reason="", metrics={"m": wb.Metric(1.0, "m")}, mpc=None, log=log, plots=line(),
        settings={"duration": 1.0},
    )
    BODY
    return wb.RunResult(**part)

EXPERIMENT = wb.Experiment("mine", "of a user", Settings, run)
"""


def write(tmp_path: Path, body: str) -> Path:
    path = tmp_path / "mine.py"
    path.write_text(SOURCE.replace("BODY", body))
    return path


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ("part['metrics'] = {'m': wb.Metric('much', 'm')}", "metrics: 'm': value"),
        ("part['metrics'] = {'m': wb.Metric(np.ones(3), 'm')}", "metrics: 'm': value"),
        ("part['metrics'] = {'m': wb.Metric(10**400, 'm')}", "metrics: 'm': value"),
        ("part['metrics'] = {'m': wb.Metric(1.0, 'm', goal='small')}", "metrics: 'm': goal"),
        ("part['metrics'] = {'m': 1.0}", "metrics: 'm'"),
        ("part['settings'] = {'a': object()}", "settings: 'a'"),
        ("part['settings'] = settings", "settings"),
        ("part['settings']['a'] = part['settings']", "settings"),
        ("part['plots'] = ['a plot']", "plots[0]"),
        ("part['plots'] = line(y=t[1:])", "plots[0]: series[0]"),
        ("part['plots'] = line(y=np.ones((10, 2)))", "plots[0]: series[0]: y"),
        ("part['plots'] = line(y=1j * t)", "plots[0]: series[0]: y"),
        ("part['plots'] = line(limits='ab')", "plots[0]: series[0]: limits"),
        ("part['plots'] = None", "plots"),
        ("part['mpc'] = MpcStatistics(50.0, {}, 0)", "mpc: solve_ms: median"),
        ("part['log'] = None", "log"),
        ("log.add('hand', 1.0, [1.0, 2.0, 3.0])", "log: channel 'hand'"),
        ("log.add('file', 1.0, [1.0])", "log: channel 'file'"),
        ("log.names['hand'] = ('x',)", "log: names of 'hand'"),
        ("log.add('x' * 70_000, 0.0, [1.0])", "log: channel 'xxxx"),
        ("log.add('hand.names', 0.0, [1.0])", "log: channel 'hand.names'"),
        ("log.add('lap.time', 0.0, [1.0, 2.0])", "log: channel 'lap.time'"),
        ("part['settings'] = {'a': {'b': [10**5000]}}", "settings: 'a': a whole number beyond all"),
        ("part['faults'] = [ValueError('x')]", "faults[0]"),
        ("part['reason'] = None", "reason"),
        ("return 3", "RunResult is needed"),
        ("raise Silent()", "its run fails: Silent: (its text cannot be made)"),
        ("raise SilentInput()", "its run fails: SilentInput: (its text cannot be made)"),
    ],
)
def test_what_a_run_gives_back_is_one_message_with_the_part_that_is_wrong(
    body: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", str(write(tmp_path, body)), "--out", str(tmp_path / "run")]) == 2
    said = capsys.readouterr().err
    assert says in said and "mine.py" in said and said.count("\n") == 1
    assert not (tmp_path / "run" / "metrics.json").exists()


@pytest.mark.parametrize(
    "body",
    [
        "part |= dict(seed=np.int64(3), completed=np.bool_(True))",
        "part['metrics'] = {'m': wb.Metric(np.float32(2.0), 'm'), 'n': wb.Metric(np.int64(3), '1', goal=np.inf)}",
        "part['mpc'] = MpcStatistics.of(np.float64(50.0), [0.001], np.int64(3), np.int64(0))",
        "part['plots'] = line(x=list(t), y=t > 0.5)",
        "part['settings'] = {'a': np.float64(np.nan), 'b': [1, (2, None)]}",
        "part['metrics'] = {'m': wb.Metric(np.longdouble(2.0), 'm', goal=Fraction(5, 2))}",
    ],
)
def test_what_numpy_has_for_numbers_is_as_good(body: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(write(tmp_path, body)), "--out", str(tmp_path / "run"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["completed"] is True
