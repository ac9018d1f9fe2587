"""Generated hostile inputs: every one is accepted, or rejected with one message and exit code 2, within 10 s.

Usage: python benchmarks/fuzz.py [--cases 10000] [--seed 0] [--only KIND] [--json]

Cases are run in a process of their own, one after the other; one that hangs or takes its process down is counted, and the next
begins in a fresh one. *Nonsense*: a case whose generator knows that it is wrong was accepted, or that it is right was rejected.
Exits with 1 if there are tracebacks, hangs or nonsense.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import logging
import multiprocessing
import os
import resource
import sys
import tempfile
import time
import traceback
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).parent))

from fuzz_cases import KINDS, VALID, Accepted, Case, InputError, make, registry

#: Longest case [s]; how long a fresh process may take until it is there [s]; memory that it may have [bytes].
LIMIT, START, MEMORY = 10.0, 120.0, 6 * 1024**3
COLUMNS = ("accepted", "rejected", "tracebacks", "hangs", "nonsense")


@dataclass
class Tally:
    """Figures of one kind, and the cases that were bad."""

    cases: int = 0
    accepted: int = 0
    rejected: int = 0
    tracebacks: int = 0
    hangs: int = 0
    nonsense: int = 0
    slowest: float = 0.0
    bad: list[str] = field(default_factory=list)


def outcome(case: Case, experiments: Any) -> tuple[str, str]:
    """``accepted``, ``rejected`` or ``tracebacks``, and what was said."""
    from wbmpc.cli import main

    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if case.arguments is None:
                assert case.call is not None
                case.call()
                return "accepted", ""
            code = main([*case.arguments], experiments)
    except Accepted:
        return "accepted", ""
    except InputError as error:
        return ("rejected" if str(error).strip() else "tracebacks"), str(error)
    except BaseException:
        return "tracebacks", traceback.format_exc()[-1500:]
    text = said.getvalue().strip()
    if code == 0:
        return "accepted", text
    if code == 2 and text and "Traceback" not in text:
        return "rejected", text
    return "tracebacks", f"exit code {code}: {text[-600:]}"


def work(pipe: Any, seed: int, folder: str) -> None:
    """The process that runs cases as they are asked for."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    logging.disable(logging.CRITICAL)
    os.chdir(folder)
    with open(os.devnull, "w") as nowhere:  # what libraries in C print
        os.dup2(nowhere.fileno(), 2)
    experiments = registry()
    for kind in KINDS:  # what is loaded and cached once belongs to no case
        with contextlib.suppress(BaseException):
            outcome(make(kind, seed, -1, Path(folder)), experiments)
    pipe.send("ready")
    while True:
        kind, number = pipe.recv()
        case = make(kind, seed, number, Path(folder))
        start = time.perf_counter()
        pipe.send((*outcome(case, experiments), case.what, case.expected, time.perf_counter() - start))


class Worker:
    """A process that is begun anew after one that hung or died."""

    def __init__(self, seed: int, folder: str) -> None:
        self._seed, self._folder = seed, folder
        self._begin()

    def _begin(self) -> None:
        self._pipe, other = multiprocessing.Pipe()
        context = multiprocessing.get_context("spawn")
        self._process = context.Process(target=work, args=(other, self._seed, self._folder), daemon=True)
        self._process.start()
        other.close()
        if not self._pipe.poll(START):
            raise RuntimeError("the process that runs the cases does not begin")
        self._pipe.recv()

    def run(self, kind: str, number: int) -> tuple[str, str, str, str, float]:
        """What came of a case, what was said, what it was, what was expected, and how long it took [s]."""
        self._pipe.send((kind, number))
        try:
            if self._pipe.poll(LIMIT):
                return self._pipe.recv()  # type: ignore[no-any-return]
            how = "hangs"
        except EOFError:
            how = "tracebacks"
        self.end()
        code = self._process.exitcode
        self._begin()
        return how, f"the process ended with {code}", "", "", LIMIT

    def end(self) -> None:
        """Let go of the process."""
        self._process.kill()
        self._process.join()


def fuzz(cases: int, seed: int, only: str | None = None) -> dict[str, Tally]:
    """Run cases of all kinds, or of one; figures by kind."""
    parts = {k: share for k, (share, _) in KINDS.items() if only in (None, k)}
    tallies = {kind: Tally() for kind in parts}
    with tempfile.TemporaryDirectory() as folder:
        worker = Worker(seed, folder)
        try:
            for kind, share in parts.items():
                for number in range(max(1, round(cases * share / sum(parts.values())))):
                    _count(tallies[kind], f"{kind} {number}", *worker.run(kind, number))
        finally:
            worker.end()
    return tallies


def _count(tally: Tally, name: str, how: str, said: str, what: str, expected: str, seconds: float) -> None:
    tally.cases += 1
    setattr(tally, how, getattr(tally, how) + 1)
    tally.slowest = max(tally.slowest, seconds)
    right = {"accepted": VALID, "rejected": "invalid"}.get(how)
    if right is None:
        tally.bad.append(f"{name}: {how}: {what}: {said}")
    elif expected not in (right, "open"):
        tally.nonsense += 1
        tally.bad.append(f"{name}: {expected} but {how}: {what}: {said}")


def table(tallies: dict[str, Tally]) -> str:
    """Figures by kind, and their sums."""
    head = f"{'kind':14}{'cases':>8}" + "".join(f"{c:>12}" for c in COLUMNS) + f"{'slowest [s]':>13}"
    rows = [
        f"{kind:14}{t.cases:8d}" + "".join(f"{getattr(t, c):12d}" for c in COLUMNS) + f"{t.slowest:13.2f}"
        for kind, t in tallies.items()
    ]
    sums = [sum(getattr(t, c) for t in tallies.values()) for c in COLUMNS]
    total = sum(t.cases for t in tallies.values())
    slowest = max(t.slowest for t in tallies.values())
    return "\n".join([head, *rows, f"{'all':14}{total:8d}" + "".join(f"{s:12d}" for s in sums) + f"{slowest:13.2f}"])


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=list(KINDS))
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    tallies = fuzz(given.cases, given.seed, given.only)
    if given.json:
        print(json.dumps({kind: vars(t) for kind, t in tallies.items()}))
    else:
        for t in tallies.values():
            print(*t.bad, sep="\n", end="\n" if t.bad else "")
        print(table(tallies))
    return int(any(t.bad for t in tallies.values()))


if __name__ == "__main__":
    sys.exit(main())
