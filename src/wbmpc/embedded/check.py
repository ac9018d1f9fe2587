"""An exported controller against the loop in Python: the example is compiled, run on recorded states, and compared."""

from __future__ import annotations

import os
import platform
import shlex
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wbmpc.embedded.image import Export
from wbmpc.embedded.texts import hexadecimal
from wbmpc.errors import InputError
from wbmpc.mpc.mpc import MPC
from wbmpc.output_file import write_text
from wbmpc.types import Observation

#: For other targets, whose mathematics round differently: the largest difference of an input beside 1 + |u|, and the median's. Where
#: a plan has nothing left to gain, rounding decides whether a step is taken.
LARGEST, MEDIAN = 1e-3, 1e-9
#: Noise of the states that are recorded, beside 1 + |x|.
NOISE = 1e-3


@dataclass(frozen=True)
class Check:
    """``updates`` of both; ``largest`` and ``median`` difference of their inputs beside 1 + |u|; ``exact``: they were to be equal."""

    updates: int
    largest: float
    median: float
    exact: bool

    @property
    def passed(self) -> bool:
        """Whether they are as equal as they are to be."""
        return self.largest == 0.0 if self.exact else self.largest <= LARGEST and self.median <= MEDIAN

    def __str__(self) -> str:
        allowed = "equal to the last bit" if self.exact else f"at most {LARGEST:g}, and {MEDIAN:g} in the median"
        found = f"{self.updates} updates: inputs differ by {self.largest:.3g} at most, {self.median:.3g} in the median"
        return f"{found} (allowed: {allowed})"


def check(done: Export, mpc: MPC, updates: int = 50) -> Check:
    """Compile and run an export's example on states of a loop in Python, which starts as ``mpc`` does; leaves ``observations.txt`` and
    ``expected.txt`` beside it.

    Raises :class:`InputError` where there is no compiler or emulator for the target, or the example does not run to its end.
    """
    build, run = tools(done.target)
    observations, expected = record(mpc, updates)
    write_text(
        done.directory / "observations.txt", "".join(f"{hexadecimal(row)}\n" for row in observations), follow=False
    )
    write_text(
        done.directory / "expected.txt",
        "".join(f"{int(row[0])} {hexadecimal(row[1:])}\n" for row in expected),
        follow=False,
    )
    printed = _run_example(done, build, run).splitlines()
    found = np.array([[float(a), *map(float.fromhex, b)] for a, *b in (line.split() for line in printed)])
    if found.shape != expected.shape or (found[:, 0] != expected[:, 0]).any():
        raise InputError(
            f"export: the C example printed {len(found)} updates, Python {len(expected)}, or their values differ"
        )
    apart = np.abs(found - expected)[:, 1:] / (1.0 + np.abs(expected[:, 1:]))
    return Check(updates, float(apart.max()), float(np.median(apart)), done.target == "native")


def tools(target: str) -> tuple[list[str], list[str]]:
    """(compiler, what runs its programs) for a target. Raises :class:`InputError` where one is missing."""
    if target == "aarch64" and platform.machine() not in ("aarch64", "arm64"):
        compiler, emulator = shutil.which("aarch64-linux-gnu-gcc"), shutil.which("qemu-aarch64")
        if compiler is None or emulator is None:
            lacking = "aarch64-linux-gnu-gcc" if compiler is None else "qemu-aarch64"
            raise InputError(
                f"--check: '{lacking}' is not installed; valid: packages gcc-aarch64-linux-gnu and qemu-user on Debian and Ubuntu"
            )
        return [compiler, "-static"], [emulator]
    if target == "x86-64-v3" and platform.machine() not in ("x86_64", "AMD64"):
        raise InputError(
            f"--check: code for {target} does not run on this machine ({platform.machine()}), and there is no emulator"
        )
    chosen = (
        shlex.split(os.environ.get("CC", "")) or [name for name in ("cc", "gcc", "clang") if shutil.which(name)][:1]
    )
    if not chosen or shutil.which(chosen[0]) is None:
        name = f"'{chosen[0]}' of the variable CC" if chosen else "none of cc, gcc and clang"
        raise InputError(f"--check: there is no C compiler ({name} found); install one, or export without --check")
    return chosen, []


def record(mpc: MPC, updates: int) -> tuple[np.ndarray, np.ndarray]:
    """(times and states, what an update returns and inputs) of a loop in Python; ``mpc`` stays as it is."""
    loop = MPC(mpc.ocp, mpc.solver.settings, mpc.rate, first_iterations=mpc.first_iterations, plan_only_limits=True)
    for name, reference in mpc.solver.references.items():
        loop.reference[name] = reference
    loop.set_schedule(mpc.solver.schedule)
    for own, given in ((loop.solver.ws, mpc.solver.ws),):
        own.w[:], own.x[:], own.u[:] = given.w, given.x, given.u
    rng, x, observations, expected = np.random.default_rng(0), mpc.solver.ws.x[0].copy(), [], []
    for k in range(updates):
        t, failures = k * mpc.period, loop.statistics.failures
        policy = loop.update(Observation(t, x))
        u = policy(t + 0.5 * mpc.period, x)
        observations.append([t, *x])
        expected.append([loop.statistics.failures - failures, *u])
        x = loop.solver.simulate(x, u, mpc.period)
        x += NOISE * rng.standard_normal(x.size) * (1.0 + np.abs(x))
        for q in mpc.ocp.dynamics.unit_quaternions:
            x[q : q + 4] /= np.linalg.norm(x[q : q + 4])
    return np.array(observations), np.array(expected)


def _run_example(done: Export, build: list[str], run: list[str]) -> str:
    with tempfile.TemporaryDirectory() as folder:
        program, directory = str(Path(folder) / "example"), done.directory.resolve()
        command = [*build, "-std=c11", "example.c", f"{done.prefix}.o", "-lm", "-o", program]
        _done(command, directory, None)
        return _done([*run, program], directory, directory / "observations.txt")


def _done(command: list[str], directory: Path, given: Path | None) -> str:
    text = None if given is None else given.read_text()
    done = subprocess.run(command, cwd=directory, input=text, capture_output=True, text=True, timeout=600)
    if done.returncode:
        raise InputError(f"export: '{shlex.join(command)}' failed ({done.returncode}): {done.stderr.strip()[:400]}")
    return done.stdout
