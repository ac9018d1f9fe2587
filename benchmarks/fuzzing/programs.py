"""Experiments that a user wrote, which give back what nobody expects."""

from __future__ import annotations

import random
from pathlib import Path

from fuzzing.case import INVALID, OPEN, VALID, Case

_PROGRAM = """
from fractions import Fraction
import numpy as np
from pydantic import BaseModel
import wbmpc as wb
class Settings(BaseModel):
    a: float = 1.0
def run(settings, seed, progress=None):
    log = wb.Log()
    log.add("hand", 0.0, [1.0, 2.0])
    part = dict(experiment="toy", seed=seed, completed=True, reason="", metrics={"m": wb.Metric(1.0, "m", goal=2.0)}, mpc=None, log=log,
                plots=[], settings={"a": 1.0})
    BODY
    return wb.RunResult(**part)
EXPERIMENT = wb.Experiment("toy", "of a user", Settings, run)
"""
_NUMBERS = (
    "np.longdouble(2)", "Fraction(5, 2)", "np.float16(1)", "np.bool_(True)", "10**400", "10**5000", "1j", "'1'", "None", "float('nan')",
    "-np.inf", "np.ones(3)", "np.array(1.0)", "[1]", "np.int64(3)", "object()",
)  # fmt: skip
_TEXTS = (
    "''", "'file'", "'a.names'", "'a.time'", "'a/b'", "'../a'", "'x' * 70000", "'\\ud800'", "'\\x1b[31m'", "'\\x00'", "'é' * 150", "5", "None",
    "'<b>'", "'hand'",
)  # fmt: skip
#: What is said and raised, and whether it is an error by itself.
_RAISES = (
    "raise SystemExit(0)", "raise BaseException('x')", "raise ValueError('\\ud800')", "raise ExceptionGroup('a', [ValueError('b')])", "return None",
    "return run", "return run(settings, seed)", "raise type('E', (Exception,), {'__str__': lambda s: 1 / 0})()", "[0] * 10**13",
)  # fmt: skip


def programs(rng: random.Random, folder: Path) -> Case:
    """Python files of ``wbmpc run``."""
    kind, expected = rng.choice(("as it is", "figure", "goal", "settings", "channel", "rows", "reason", "raises")), OPEN
    number, text, body = rng.choice(_NUMBERS), rng.choice(_TEXTS), ""
    if kind == "as it is":
        expected = VALID
    elif kind == "figure":
        body = f"part['metrics'] = {{'m': wb.Metric({number}, 'm', goal={rng.choice(_NUMBERS)})}}"
    elif kind == "goal":
        body = f"part['metrics'] = {{{text}: wb.Metric(1.0, {rng.choice(_TEXTS)}, least={number})}}"
    elif kind == "settings":
        body = f"part['settings'] = {{{text}: {rng.choice((number, text, '[{}]', f'[{number}]'))}}}"
    elif kind == "channel":
        body = f"log.add({text}, {rng.choice(('0.0', '1.0', 'np.nan'))}, [1.0])"
    elif kind == "rows":
        body = f"log.add('hand', 1.0, {rng.choice(('[1.0]', '1.0', '[[1.0]]', '[]', '[1.0, 2.0, 3.0]'))})"
    elif kind == "reason":
        body = f"part['{rng.choice(('reason', 'experiment'))}'] = {text}"
    else:
        body, expected = rng.choice(_RAISES), INVALID
    path = folder / "toy.py"
    path.write_text(_PROGRAM.replace("BODY", body), "utf-8", "surrogatepass")
    return Case(
        f"program: {kind}: {body[:80]!r}",
        expected,
        ["run", str(path), "--out", str(folder / "run"), "--json"],
        real=True,
    )
