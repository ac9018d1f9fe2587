"""Generated hostile inputs: every one is accepted, or rejected with one message and exit code 2, within 10 s.

Usage: python benchmarks/fuzz.py [--cases 10000] [--seed 0] [--kinds settings files …] [--first N] [--json] [--quiet]

Cases are run in a process of their own, one after the other; one that hangs or takes its process down is counted, and the next
begins in a fresh one. *Nonsense*: a case whose generator knows that it is wrong was accepted, or that it is right was rejected,
or a message has characters that steer a terminal. Every bad case is printed with the command that runs it alone. Cases of the
kind ``problems`` build an experiment and run it for a few ticks: they may take a minute, for some are compiled. Times are of the
processor, so that a busy machine does not count as a hang; what waits is given six times as much. What takes longer is run again
when all other cases are done, up to twice, in fresh processes and with sixty times as much: a hang is what is too slow each time.
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
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).parent))

from fuzzing.case import INVALID, OPEN, VALID, Case
from fuzzing.kinds import KINDS, Accepted, make, short, stand_ins

from wbmpc.errors import InputError

#: Longest case [s], by kind and else; by how much longer one may wait, at first and in each further try; the longest start of a
#: process [s]; its memory [bytes].
LIMITS, LIMIT, WAITS, START, MEMORY = {"problems": 60.0}, 10.0, (6.0, 60.0, 60.0), 600.0, 6 * 1024**3
COLUMNS = ("accepted", "rejected", "tracebacks", "hangs", "nonsense")
#: Exit codes of a run that was rejected, that fell, and that was ended.
_REJECTED, _ABORTED, _ENDED = 2, 1, 130


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

    def count(self, name: str, how: str, said: str, case: Case | None, seconds: float) -> bool:
        """Count a case; whether it was good. ``case``: None of one that took its process down."""
        self.cases += 1
        self.slowest = max(self.slowest, seconds)
        setattr(self, how, getattr(self, how) + 1)
        right = {"accepted": VALID, "rejected": INVALID}.get(how)
        what, expected = ("", OPEN) if case is None else (case.what, case.expected)
        if right is not None and expected not in (right, OPEN):
            self.nonsense += 1
            how = f"{expected} but {how}"
        elif right is not None:
            return True
        self.bad.append(f"{name}: {how}: {what!r}: {said}")
        return False


def outcome(case: Case, experiments: Any) -> tuple[str, str]:
    """One of the columns but ``hangs``, and what was said."""
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
        return _message(str(error).strip(), plain=False)
    except BaseException:
        return "tracebacks", traceback.format_exc()[-1500:]
    text = said.getvalue().strip()
    if code == 0 or (case.real and code in (_ABORTED, _ENDED)):
        return "accepted", text
    return _message(text, plain=True) if code == _REJECTED else ("tracebacks", f"exit code {code}: {text[-600:]}")


def _message(text: str, plain: bool) -> tuple[str, str]:
    """What a message of an error makes of a case; ``plain``: it goes to a terminal."""
    if not text or "Traceback (most" in text:
        return "tracebacks", text[-1500:]
    if plain and not all(c.isprintable() for c in text.replace("\n", "")):
        return "nonsense", f"a character that cannot be printed in {text!r}"
    return "rejected", text


def work(pipe: Any, seed: int, folder: str, kinds: list[str]) -> None:
    """The process that runs cases as they are asked for."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    logging.disable(logging.CRITICAL)
    os.chdir(folder)
    with open(os.devnull, "w") as nowhere:  # what libraries in C print
        os.dup2(nowhere.fileno(), 2)
    experiments = {False: stand_ins(), True: short()}
    for kind in kinds:  # what is loaded and cached once belongs to no case
        with contextlib.suppress(BaseException):
            outcome(make(kind, seed, -1, Path(folder)), experiments[False])
    pipe.send("ready")
    while True:
        kind, number = pipe.recv()
        shutil.rmtree(Path(folder) / "run", ignore_errors=True)
        start = time.process_time()
        try:
            case = make(kind, seed, number, Path(folder))
        except BaseException:
            pipe.send(("tracebacks", f"the generator: {traceback.format_exc()[-900:]}", None, 0.0))
            continue
        how, said = outcome(case, experiments[case.real])
        case.call = None  # what cannot be sent
        pipe.send((how, said, case, time.process_time() - start))


class Worker:
    """A process that is restarted after one that hung or died."""

    def __init__(self, seed: int, folder: str, kinds: list[str]) -> None:
        self._seed, self._folder, self._kinds = seed, folder, kinds
        self._begin()

    def _begin(self) -> None:
        self._pipe, other = multiprocessing.Pipe()
        context = multiprocessing.get_context("spawn")
        arguments = (other, self._seed, self._folder, self._kinds)
        self._process = context.Process(target=work, args=arguments, daemon=False)
        self._process.start()
        other.close()
        if not self._pipe.poll(START):
            raise RuntimeError("the process that runs the cases does not begin")
        self._pipe.recv()

    def run(self, kind: str, number: int, wait: float) -> tuple[str, str, Case | None, float]:
        """What came of a case, what was said, the case, and how long it took [s]; ``wait``: how many limits it may wait."""
        limit = LIMITS.get(kind, LIMIT)
        answer, busy = self._answer(kind, number, limit, wait * limit)
        if answer is not None:
            return answer
        self.restart()
        return "hangs", f"no answer after {busy:.1f} s of the processor", None, limit

    def restart(self) -> None:
        """A fresh process."""
        self.end()
        self._begin()

    def _answer(
        self, kind: str, number: int, limit: float, wait: float
    ) -> tuple[tuple[str, str, Case | None, float] | None, float]:
        """What the process says of a case within ``limit`` [s] of the processor and ``wait`` [s], and the processor's time [s]."""
        self._pipe.send((kind, number))
        start, begun, busy = self._processor_time(), time.monotonic(), 0.0
        try:
            while busy < limit and time.monotonic() - begun < wait:
                if self._pipe.poll(0.5):
                    return self._pipe.recv(), busy
                busy = self._processor_time() - start
        except EOFError:
            self.end()
            code = self._process.exitcode
            self._begin()
            return ("tracebacks", f"the process ended with {code}", None, limit), busy
        return None, busy

    def _processor_time(self) -> float:
        """Of the process until now [s]; 0 when it is gone."""
        try:
            fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return 0.0
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def end(self) -> None:
        """Let go of the process."""
        self._process.kill()
        self._process.join()


def fuzz(given: argparse.Namespace) -> dict[str, Tally]:
    """Run the cases; figures by kind."""
    parts = {k: share for k, (share, _) in KINDS.items() if k in (given.kinds or KINDS)}
    tallies = {kind: Tally() for kind in parts}
    with tempfile.TemporaryDirectory() as folder:
        worker = Worker(given.seed, folder, list(parts))
        slow: list[tuple[str, int]] = []
        try:
            for done, (kind, number) in enumerate(order(parts, given.cases, given.first), 1):
                found = worker.run(kind, number, WAITS[0])
                if found[0] == "hangs":
                    slow.append((kind, number))
                else:
                    _count(tallies[kind], kind, number, found, given.seed)
                if done % 500 == 0 and not given.quiet:
                    bad = sum(len(t.bad) for t in tallies.values())
                    print(
                        f"{done} of {given.cases} cases, {bad} bad, {len(slow)} to run again",
                        file=sys.stderr,
                        flush=True,
                    )
            while slow:
                kind, number = slow[-1]
                for wait in WAITS[1:]:
                    worker.restart()
                    found = worker.run(kind, number, wait)
                    if found[0] != "hangs":
                        break
                slow.pop()
                _count(tallies[kind], kind, number, found, given.seed)
        except KeyboardInterrupt:
            print("interrupted: figures of what was run", file=sys.stderr)
            for kind, number in slow:
                _count(
                    tallies[kind], kind, number, ("hangs", "not run again", None, LIMITS.get(kind, LIMIT)), given.seed
                )
        finally:
            worker.end()
    return tallies


def _count(tally: Tally, kind: str, number: int, found: tuple[str, str, Case | None, float], seed: int) -> None:
    """Count a case, and print it if it was bad."""
    if not tally.count(f"{kind} {number}", *found):
        tally.bad[-1] += f"\n    {command(kind, number, seed)}"
        print(tally.bad[-1], file=sys.stderr, flush=True)


def order(parts: dict[str, int], cases: int, first: int = 0) -> list[tuple[str, int]]:
    """Kind and number of each case, from number ``first``: all kinds side by side, so that a part of the run says something about all of them."""
    counts = {kind: max(1, round(cases * share / sum(parts.values()))) for kind, share in parts.items()}
    found = [(number / count, kind, first + number) for kind, count in counts.items() for number in range(count)]
    return [(kind, number) for _, kind, number in sorted(found)]


def command(kind: str, number: int, seed: int) -> str:
    """What runs one case alone."""
    return f"python benchmarks/fuzz.py --kinds {kind} --seed {seed} --first {number} --cases 1"


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


def commit() -> str:
    """The commit of this file's repository, with a plus sign if files differ from it; empty without one."""
    git = ["git", "-C", str(Path(__file__).parent)]
    found = subprocess.run([*git, "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    changed = subprocess.run([*git, "status", "--porcelain", "-uno"], capture_output=True, text=True, check=False)
    return found.stdout.strip() + "+" * bool(changed.stdout.strip())


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), help="default: all")
    parser.add_argument("--first", type=int, default=0, help="number of the first case of each kind")
    parser.add_argument("--quiet", action="store_true", help="no progress, bad cases alone")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    tallies = fuzz(given)
    about = {"commit": commit(), "seed": given.seed}
    if given.json:
        print(json.dumps({**about, "kinds": {kind: vars(t) for kind, t in tallies.items()}}))
    else:
        print(f"commit {about['commit']}, seed {given.seed}", table(tallies), sep="\n")
    return int(any(t.bad for t in tallies.values()))


if __name__ == "__main__":
    sys.exit(main())
