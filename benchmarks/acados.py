"""This solver against acados: cold starts, warm ticks at equal error of the input, real-time iterations, the QP alone.

Usage: ACADOS_INSTALL_DIR=... python benchmarks/acados.py [--json FILE] [--docs]

``--docs`` writes the table into docs/explanation/solver.md. How acados is built: benchmarks/README.md.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from whole_race.acados_race import acados_race, goals
from whole_race.acados_tables import markdown
from whole_race.qp import quadratic_race

from wbmpc.benchmark.race import one_core, race_problems
from wbmpc.output_file import write_text
from wbmpc.report import versions

PAGE = Path(__file__).parents[1] / "docs" / "explanation" / "solver.md"
START, END = "<!-- acados -->\n", "<!-- end of acados -->"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="file for all figures")
    parser.add_argument("--docs", action="store_true", help="write the table into docs/explanation/solver.md")
    parser.add_argument("--repeat", type=int, default=200, help="timed iterations per problem")
    given = parser.parse_args()
    note = lambda text: print(text, file=sys.stderr, flush=True)
    with one_core():
        figures = {"versions": versions(), **acados_race(given.repeat, note)}
        if "error" not in figures:
            figures["quadratic"] = [
                row for make in race_problems().robots for row in quadratic_race(make(limits="soft"), peers=("hpipm",))
            ]
    figures["goals"] = goals(figures)
    if given.json is not None:
        write_text(given.json, json.dumps(figures, indent=1, allow_nan=False))
    table = markdown(figures)
    print(table)
    if given.docs and "error" not in figures:
        text = PAGE.read_text()
        before, rest = text.split(START)
        write_text(PAGE, f"{before}{START}{table}\n{END}{rest.split(END)[1]}")
    return int("error" in figures)


if __name__ == "__main__":
    sys.exit(main())
