"""A program of its own: expands a file of macros, for :mod:`wbmpc.robots.xacro_file`, which limits its time and memory.

Reads ``{path, packages, arguments}`` as JSON from its input, writes ``{text}`` or ``{error}`` to its output.
"""

from __future__ import annotations

import io
import json
import resource
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

#: Of the program's memory [bytes].
MEMORY = 2 * 1024**3


def main() -> None:
    order = json.load(sys.stdin)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    import xacrodoc  # it also replaces the search for ROS packages of the module below
    import xacro  # isort: skip

    xacrodoc.packages.reset()
    xacrodoc.packages.walk_up_from(Path(order["path"]))
    xacrodoc.packages.update_package_cache({name: Path(folder) for name, folder in order["packages"].items()})
    said = io.StringIO()
    try:
        with redirect_stdout(said), redirect_stderr(said):
            answer = {"text": str(xacro.process_file(order["path"], mappings=order["arguments"]).toxml())}
    except (Exception, SystemExit) as error:  # whatever its expressions raise
        answer = {"error": f"{type(error).__name__}: {error} {said.getvalue()}"}
    json.dump(answer, sys.stdout)


if __name__ == "__main__":
    main()
