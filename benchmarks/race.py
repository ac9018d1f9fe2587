"""The whole race: ``python benchmarks/race.py [--out DIR] [--json] [--repeat N]``; ``wbmpc bench`` is its small part."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from whole_race.figure import write
from whole_race.race import run_whole_race
from whole_race.tables import text


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="directory for race.json, race.txt and race.html (plots)")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    parser.add_argument("--repeat", type=int, default=200, help="timed iterations per problem")
    options = parser.parse_args(arguments)
    figures = run_whole_race(options.repeat, lambda share, note: print(f"{100 * share:3.0f} % {note}", file=sys.stderr))
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        figures["files"] = write(figures, options.out)
    print(json.dumps(figures, allow_nan=False) if options.json else text(figures))
    return 0


if __name__ == "__main__":
    sys.exit(main())
