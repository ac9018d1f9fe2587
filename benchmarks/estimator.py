"""`rezero-steps` with the estimator and with the simulator's state, with and without disturbance observer and payload.

Usage: python benchmarks/estimator.py [--seeds 200-204] [--only NAME …] [--json FILE]. Runs that are in FILE are not repeated.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from wbmpc.studies.minniti2019.steps import EXPERIMENT, RezeroStepsSettings

CASES: dict[str, dict[str, object]] = {
    "filter": {},
    "truth": {"controller": {"estimator": "truth"}},
    "filter, 1 kg": {"payload": 1.0},
    "filter, no observer": {"controller": {"disturbance": "none"}},
    "filter, 1 kg, no observer": {"payload": 1.0, "controller": {"disturbance": "none"}},
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", default="200-204", help="first-last")
    parser.add_argument("--only", nargs="*", default=list(CASES), choices=list(CASES))
    parser.add_argument("--json", type=Path, default=Path("estimator.json"))
    given = parser.parse_args()
    first, last = (int(s) for s in given.seeds.split("-"))
    done: dict[str, dict[str, float]] = json.loads(given.json.read_text()) if given.json.exists() else {}
    for name in given.only:
        for seed in range(first, last + 1):
            key = f"{name}, seed {seed}"
            if key in done:
                continue
            result = EXPERIMENT.run(RezeroStepsSettings(**CASES[name]), seed)
            done[key] = {k: m.value for k, m in result.metrics.items()}
            given.json.write_text(json.dumps(done, indent=1) + "\n")
            print(key, result.reason or "completed", flush=True)
        rows = [v for k, v in done.items() if k.rsplit(", ", 1)[0] == name]
        print(f"\n{name}, {len(rows)} runs\n{'metric':34s}{'median':>12s}{'worst':>12s}")
        for metric in rows[0]:
            values = [r[metric] for r in rows if metric in r]
            print(f"{metric:34s}{np.median(values):12.4g}{max(values):12.4g}")
        print(flush=True)


if __name__ == "__main__":
    main()
