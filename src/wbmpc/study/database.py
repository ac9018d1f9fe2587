"""The database of a search, a file that may be damaged, locked by another program, or on a full disk: what Optuna and the drivers of
databases say of it becomes one message, and trials are checked before they are believed."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from wbmpc.errors import InputError, NotWritten, WbmpcError
from wbmpc.study.definition import Search, Tuning

if TYPE_CHECKING:
    import optuna

#: What SQLite says of a disk that takes no more.
FULL = ("disk is full", "disk I/O error")


@contextmanager
def using_database(place: str) -> Iterator[None]:
    """Something is done with the database at ``place``, a file or an address. Raises :class:`NotWritten` where its disk is full, and
    :class:`InputError` for whatever else is wrong with it."""
    try:
        yield
    except WbmpcError:
        raise
    except Exception as error:  # of Optuna, of SQLAlchemy, of any driver, of what is read from a damaged file
        why = _reason(error)
        if any(text in why for text in FULL):
            raise NotWritten(f"{place}: cannot be written ({why}); the same command continues") from error
        raise InputError(
            f"{place}: cannot be used as the database of a search ({why}); if it is damaged, give another one or another --out"
        ) from error


def _reason(error: BaseException) -> str:
    """The first line of the error that another one was raised from: of the system, not of what stands on it."""
    causes = [error]
    while (cause := causes[-1].__cause__) is not None:
        causes.append(cause)
    found = next((e for e in causes if any(text in str(e) for text in FULL)), causes[-1])
    return str(found).splitlines()[0] if str(found) else type(found).__name__


def check_trial(trial: optuna.trial.FrozenTrial, tuning: Tuning) -> None:
    """Raise :class:`ValueError` unless an ended trial has a setting within its range for everything that is searched, and, unless it was
    pruned, the values of its objectives."""
    if trial.params.keys() != tuning.search.keys():
        raise ValueError(f"trial {trial.number} has no settings of this search")
    for key, search in tuning.search.items():
        if not _within(search, trial.params[key]):
            raise ValueError(
                f"trial {trial.number}: {key}={trial.params[key]!r:.60} is none of the values that are searched"
            )
    values = trial.values or ()
    expected = 0 if trial.state.name == "PRUNED" else len(tuning.minimize) if tuning.pareto else 1
    if len(values) < expected or any(map(math.isnan, values)):
        raise ValueError(f"trial {trial.number} has no values of its objectives")


def _within(search: Any, value: Any) -> bool:
    if not isinstance(search, Search):
        return value in [json.dumps(v) for v in search]
    return isinstance(value, int | float) and search.low <= value <= search.high
