"""The files beside an exported object file: header, example, CMake file, README."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from enum import IntEnum

import numpy as np

from wbmpc import __version__
from wbmpc.embedded.image import Export, Group
from wbmpc.embedded.interface import CALLS, declaration
from wbmpc.kernel.codegen_target import Target
from wbmpc.model.layout import Layout
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Reference
from wbmpc.output_file import write_text
from wbmpc.solver import Solver
from wbmpc.solver.controller import Result
from wbmpc.solver.controller_data import Figure

#: What figures are.
FIGURES = {
    Figure.STATUS: "of the last solve",
    Figure.ITERATIONS: "of the last update",
    Figure.UPDATES: "so far",
    Figure.FAILURES: "updates without a plan",
    Figure.CUT: "how often feedback was cut to the limits of the inputs",
    Figure.COST: "of the active plan, as all below",
    Figure.VIOLATION: "of its constraints",
    Figure.LIMIT_VIOLATION: "of planned states' limits [their ranges]",
    Figure.INITIAL_STATE_MISMATCH: "how far it starts from the measured state",
    Figure.BEGINNING: "[s]",
    Figure.END: "[s]",
    Figure.EVENTS_WITHOUT_NODE: "of the last update's horizon: it has their modes late or not at all, or lost their jumps",
    Figure.BRAKING_PLANS: "updates whose plan was replaced by a stop",
    Figure.EXTENDED: "updates that took more than twice the iterations asked for: limits cut their steps, or a stop was planned",
    Figure.CLEARANCE: "[m] between the two parts of the robot that lack most of their margin; infinite: none are near",
}


def write_texts(done: Export, mpc: MPC, target: Target) -> None:
    """Header, example, CMake file and README into the export's directory; raises :class:`NotWritten`."""
    write_text(done.directory / f"{done.prefix}.h", header(done, mpc, target), follow=False)
    write_text(done.directory / "example.c", _example(done), follow=False)
    write_text(done.directory / "CMakeLists.txt", _cmake(done), follow=False)
    write_text(done.directory / "README.md", _readme(done, target), follow=False)


def _names(
    prefix: str, kind: str, names: Sequence[str], values: Iterable[int] | None = None, texts: Sequence[str] = ()
) -> str:
    """An enumeration in C, with ``texts`` behind its members; names that C cannot have are spelled with underscores, and distinguished
    by their numbers."""
    if not names:
        return ""
    unique = _unique([re.sub("[^A-Za-z0-9]", "_", name).upper() for name in names])
    numbers = list(range(len(names)) if values is None else values)
    said = [f" /* {text} */" if text else "" for text in (*texts, *[""] * (len(names) - len(texts)))]
    lines = [f"    {prefix}_{kind}{name} = {i},{text}" for name, i, text in zip(unique, numbers, said, strict=True)]
    return "enum {\n" + "\n".join(lines) + "\n};\n"


def _unique(spelled: Sequence[str]) -> list[str]:
    """Those that are there once as they are; others with their numbers, and underscores where that is another's name."""
    once, found = {s for s, count in Counter(spelled).items() if count == 1}, dict[str, None]()
    for i, s in enumerate(spelled):
        name = s if s in once else f"{s}_{i}"
        while name in found or (name in once and name != s):
            name += "_"
        found[name] = None
    return list(found)


def _members(prefix: str, kind: str, members: type[IntEnum]) -> str:
    return _names(prefix, kind, [m.name for m in members], [m.value for m in members])


def _plain(name: str) -> str:
    """A name may be anything, an end of a comment too."""
    return re.sub("[^A-Za-z0-9_.-]", "_", name)


def _pairs(mpc: MPC) -> str:
    """What of a robot plans keep apart."""
    rows = [
        f" * {margin:6.3f} m  {_plain(frames[a])}-{_plain(frames[b])}"
        for own in mpc._clear.within.values()
        for frames in (own.geometry.frames,)
        for (a, b), margin in zip(own.pairs, own.margins, strict=True)
    ]
    title = "/* Parts of the robot that plans keep apart, with all that is fixed to them, by at least so much: an update seeks their nearest"
    return (
        "\n".join([title, " * points itself, and plans a stop where nothing else helps.", *rows, " */"]) + "\n"
        if rows
        else ""
    )


def _layout(title: str, layout: Layout) -> str:
    rows = [f" * {i:3d} {_plain(name)}" for i, name in enumerate(layout.names)]
    return "\n".join([f"/* {title}", *rows, " */"]) + "\n"


def _groups(prefix: str, kind: str, groups: Sequence[Group]) -> str:
    numbers = _names(prefix, f"{kind}_", [g.name for g in groups], [g.index for g in groups])
    return numbers + _names(prefix, f"WIDTH_OF_{kind}_", [g.name for g in groups], [g.width for g in groups])


def header(done: Export, mpc: MPC, target: Target) -> str:
    """The C header, which C++ reads too."""
    p, upper, image = done.prefix, done.prefix.upper(), done.image
    numbers, offsets = image.numbers, image.offsets()
    front = 8 * (offsets["start"])
    define = {
        "NX": numbers["nx"], "NU": numbers["nu"], "INTERVALS": numbers["n"], "FIGURES": len(Figure), "ALIGNMENT": 64,
        "SIZE": 8 * offsets["end"], "PLAN_SIZE": front, "SAMPLES": min(image.constants["capacities"].tolist(), default=0),
        "EVENTS": numbers["max_events"], "PERIOD": repr(mpc.period),
    }  # fmt: skip
    calls = [f"/* {call.text.replace(chr(10), chr(10) + '   ')} */\n{declaration(call, p)};\n" for call in CALLS]
    return f"""/* A receding-horizon controller, written by wbmpc {__version__} for {target.cpu} ({target.triple}).
 * One thread at a time may be in a block. No function allocates memory or blocks; {done.stack // 1024} KiB of stack are enough. */
#ifndef {upper}_H
#define {upper}_H
#include <stddef.h>
#include <stdint.h>

{chr(10).join(f"#define {upper}_{name} {value}" for name, value in define.items())}
/* SIZE, PLAN_SIZE [bytes], PERIOD [s]; SAMPLES: of every reference, EVENTS: of the schedule, there is room for. */

{_enumerations(done, mpc)}
#ifdef __cplusplus
extern "C" {{
#define {upper}_ALIGNED alignas({upper}_ALIGNMENT)
#else
#define {upper}_ALIGNED _Alignas({upper}_ALIGNMENT)
#endif

/* All that a controller knows. A copy of a block works too; so does, for policy, planned and figures, one of the first PLAN_SIZE
   bytes, aligned in the same way, e.g. for a control thread beside the one that updates. */
typedef struct {p} {{
    {upper}_ALIGNED unsigned char bytes[{upper}_SIZE];
}} {p};

/* Make a block a controller; size: sizeof({p}). WRONG_PROCESSOR: this one lacks what the code needs. */
int {p}_create({p} *controller, size_t size);
{chr(10).join(calls)}
#ifdef __cplusplus
}}
#endif
#endif
"""


def _enumerations(done: Export, mpc: MPC) -> str:
    from wbmpc.solver.termination import EQUALITY_INFEASIBLE

    upper, image, d = done.prefix.upper(), done.image, mpc.ocp.dynamics
    parts = {
        "Results of all functions: below zero nothing was done.": _members(upper, "", Result),
        "Status of a solve, in FIGURE_STATUS.": _names(
            upper, "STATUS_", [Solver.status(i).name for i in range(EQUALITY_INFEASIBLE + 1)]
        ),
        "What figures reports.": _names(
            upper, "FIGURE_", [f.name for f in Figure], [f.value for f in Figure], [FIGURES[f] for f in Figure]
        ),
        "How a reference runs between its samples; POSE: position, unit quaternion w x y z.": _names(
            upper, "KIND_", Reference.KINDS
        ),
        "References, and their numbers per sample.": _groups(upper, "REFERENCE", image.references),
        "Constants (the model's parameters, weights), and their numbers.": _groups(upper, "CONSTANTS", image.weights),
        "Modes.": _names(upper, "MODE_", image.modes),
    }
    lists = "".join(f"/* {title} */\n{text}" for title, text in parts.items() if text)
    return lists + _pairs(mpc) + _layout("State", d.state) + _layout("Input", d.input)


def _example(done: Export) -> str:
    p, upper = done.prefix, done.prefix.upper()
    return f"""/* Reads times [s] and states, updates the controller, writes what each function returned and the input half a period later.
   cc -std=c11 example.c {p}.o -lm -o example && ./example < observations.txt */
#include "{p}.h"
#include <stdio.h>

static {p} the_{p};

int main(void)
{{
    double t, x[{upper}_NX], u[{upper}_NU];
    int i, updated, given, result = {p}_create(&the_{p}, sizeof the_{p});
    if (result != {upper}_OK) {{
        fprintf(stderr, "create: %d\\n", result);
        return 1;
    }}
    while (scanf("%lf", &t) == 1) {{
        for (i = 0; i < {upper}_NX; i++)
            if (scanf("%lf", &x[i]) != 1)
                return 1;
        updated = {p}_update(&the_{p}, t, x);
        given = {p}_policy(&the_{p}, t + 0.5 * {upper}_PERIOD, x, u);
        if (given != {upper}_OK) {{
            fprintf(stderr, "at %g s: update %d, policy %d\\n", t, updated, given);
            return 1;
        }}
        printf("%d", updated);
        for (i = 0; i < {upper}_NU; i++)
            printf(" %a", u[i]);
        printf("\\n");
    }}
    return 0;
}}
"""


def _cmake(done: Export) -> str:
    p = done.prefix
    return f"""# add_subdirectory(this directory), then target_link_libraries(your_program {p})
cmake_minimum_required(VERSION 3.16)
project({p} LANGUAGES C)
add_library({p} INTERFACE)
target_include_directories({p} INTERFACE ${{CMAKE_CURRENT_LIST_DIR}})
target_link_libraries({p} INTERFACE ${{CMAKE_CURRENT_LIST_DIR}}/{p}.o m)
if(CMAKE_SOURCE_DIR STREQUAL CMAKE_CURRENT_SOURCE_DIR)
  add_executable(example example.c)
  set_target_properties(example PROPERTIES C_STANDARD 11)
  target_link_libraries(example {p})
endif()
"""


def _readme(done: Export, target: Target) -> str:
    p, needs = done.prefix, ", ".join(done.symbols.undefined)
    return f"""# {p}: an exported controller

| | |
| --- | --- |
| object file | `{p}.o`, {done.object_size / 1000:.0f} kB, for `{target.cpu}` ({target.triple}), position-independent |
| block | {done.block_size / 1000:.0f} kB at a multiple of 64 bytes, `sizeof({p})` |
| stack | {done.stack // 1024} KiB |
| from elsewhere | {needs} (libm and the C library's copies of memory) |

`{p}_create`, then in every period `{p}_update` with the measured state, and `{p}_policy` as often as inputs are needed. A result
below zero means that nothing was done; `KEPT` that the last plan stays active, whose time runs out at `FIGURE_END`. What a robot
does then is for the program to decide: stop it safely.

`cmake -B build . && cmake --build build`, or what stands at the top of `example.c`. `wbmpc export … --check` compares the example's
output with the loop in Python.
"""


def hexadecimal(values: np.ndarray) -> str:
    """Numbers as C reads them, exactly."""
    return " ".join(float(v).hex() for v in values)
