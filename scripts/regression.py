"""Metrics of every experiment and its variants, recorded once and compared after a change, to the last digit.

    python scripts/regression.py record FILE.json [--only NAME ...] [--seeds 0 1] [--fast]
    python scripts/regression.py compare FILE.json [--only NAME ...] [--seeds 0 1] [--fast]

Each case is a process of its own, ``wbmpc run NAME --seed S --set KEY=VALUE ... --json``; what FILE already holds is not recorded
again. ``compare`` runs the cases that FILE holds and prints every metric that differs: exit status 1 if one does. ``--fast``
keeps to the shortened cases. FILE is made of the code before a change and thrown away after it: digits depend on the processor (its
vector width) and on the versions of the libraries. Both are noted in FILE, and ``compare`` says when they are not this machine's, and of
which commit and day FILE is.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from wbmpc.registry import locations
from wbmpc.report.provenance import commit

#: (experiment, settings): short runs that pass through all of the code of their robot.
FAST: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("swerve-stability", ()),
    ("swerve-track", ("periods=1", "settle_time=2")),
    ("rezero-circle", ("rounds=1",)),
    ("rezero-push-hand", ("forces=[100]",)),
)
#: The protocol's runs, then the variants that the protocol names. All other experiments follow with their defaults.
FULL: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("rezero-steps", ()),
    ("swerve-unified", ()),
    ("rezero-door", ()),
    ("swerve-drive", ()),
    ("swerve-brakes", ()),
    ("rezero-wholebody", ()),
    ("swerve-track", ()),
    ("swerve-fixed", ()),
    ("rezero-circle", ()),
    ("rezero-push-ball", ()),
    ("rezero-push-hand", ()),
    ("swerve-wobble", ()),
    ("rezero-frequency", ()),
    ("rezero-taskspace", ()),
    ("swerve-calibrate", ()),
    ("swerve-plaster", ()),
    ("swerve-track", ("variant=vertical",)),
    ("swerve-track", ("variant=peaks",)),
    ("swerve-track", ("plant.wheel_radius=0.002",)),
    ("swerve-track", ("plant.joint_offset=0",)),
    ("swerve-unified", ("legs=support",)),
    ("swerve-plaster", ("localization=none",)),
    ("rezero-steps", ("preview=true",)),
    ("rezero-steps", ("payload=1.0",)),
    ("rezero-circle", ("controller.cost.body.yaw=0",)),
    ("rezero-door", ("door=heavy",)),
    ("rezero-door", ("door=sticking",)),
    ("rezero-door", ("door=light",)),
    ("rezero-door", ("door=locked",)),
)


def all_cases() -> list[tuple[str, tuple[str, ...]]]:
    """Every experiment that is installed, with its variants."""
    listed = [*FAST, *FULL]
    return listed + [(name, ()) for name in locations() if (name, ()) not in listed]


def key(name: str, settings: tuple[str, ...], seed: int) -> str:
    return " ".join((name, *settings, f"seed={seed}"))


def run(name: str, settings: tuple[str, ...], seed: int) -> dict[str, Any]:
    """Metrics, outcome and the exit status of one run."""
    with tempfile.TemporaryDirectory() as directory:
        out = ["--seed", str(seed), "--out", str(Path(directory) / "run"), "--json", "--quiet"]
        words = [word for setting in settings for word in ("--set", setting)]
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        done = subprocess.run(
            [sys.executable, "-m", "wbmpc", "run", name, *words, *out], capture_output=True, text=True, env=environment
        )
    try:
        result = json.loads(done.stdout)
    except ValueError:
        return {"exit": done.returncode, "error": done.stderr[-500:]}
    metrics = {n: m["value"] for n, m in result["metrics"].items()}
    return {"exit": done.returncode, "completed": result["completed"], "reason": result["reason"], "metrics": metrics}


def machine() -> dict[str, str]:
    """What the digits depend on besides the code."""
    cpu = next((line for line in Path("/proc/cpuinfo").read_text().splitlines() if "model name" in line), ":?")
    libraries = {n: version(n) for n in ("casadi", "llvmlite", "mujoco", "numpy", "scipy")}
    return {"cpu": cpu.split(":")[1].strip(), "python": platform.python_version(), **libraries}


def differences(recorded: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """Lines that say what is not the same, to the last digit."""
    lines = [
        f"{n}: {recorded.get(n)!r} -> {now.get(n)!r}"
        for n in ("exit", "completed", "reason")
        if recorded.get(n) != now.get(n)
    ]
    previous, after = recorded.get("metrics", {}), now.get("metrics", {})
    for n in sorted(previous.keys() | after.keys()):
        same = previous.get(n) == after.get(n) or (previous.get(n) != previous.get(n) and after.get(n) != after.get(n))
        if not same:
            lines.append(f"{n}: {previous.get(n)!r} -> {after.get(n)!r}")
    return lines


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=("record", "compare"))
    parser.add_argument("file", type=Path)
    parser.add_argument("--only", nargs="+", help="names of experiments")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1])
    parser.add_argument("--fast", action="store_true", help="the shortened cases alone")
    options = parser.parse_args(arguments)
    data: dict[str, Any] = json.loads(options.file.read_text()) if options.file.exists() else {}
    data.setdefault("machine", machine())
    begun_at = data.setdefault("begun", {"commit": commit(), "day": datetime.now(UTC).date().isoformat()})
    if options.action == "compare":
        print(f"compared with commit {begun_at['commit']}, recorded on {begun_at['day']}", flush=True)
    cases = data.setdefault("cases", {})
    if data["machine"] != machine():
        print(f"recorded with {data['machine']}, this is {machine()}: digits may differ", file=sys.stderr)
    target = [
        (n, s, seed)
        for seed in options.seeds
        for n, s in (FAST if options.fast else all_cases())
        if not options.only or n in options.only
    ]
    different = 0
    for name, settings, seed in target:
        case = key(name, settings, seed)
        if (options.action == "record") == (case in cases):
            continue
        begun = time.monotonic()
        result = run(name, settings, seed)
        took = f"{time.monotonic() - begun:.0f} s"
        if options.action == "record":
            cases[case] = result
            options.file.write_text(json.dumps(data, indent=1, sort_keys=True) + "\n")
            print(f"{case}: exit {result['exit']}, {took}", flush=True)
            continue
        lines = differences(cases[case], result)
        different += bool(lines)
        print(f"{case}: {'differs' if lines else 'same'}, {took}", *lines, sep="\n  ", flush=True)
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
