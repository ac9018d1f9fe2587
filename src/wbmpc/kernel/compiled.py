"""From a transcription to a :class:`Kernel`: machine code of the stage functions and of one Riccati step."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from wbmpc.errors import KernelError, UnsupportedOperation
from wbmpc.kernel import blocks, cache, dense
from wbmpc.kernel.box_rows import emit_add_boxes, emit_box_values
from wbmpc.kernel.codegen_target import compile_module, load_object, register_width, target_text
from wbmpc.kernel.riccati import emit_curvature_node, emit_riccati_node, emit_step_node
from wbmpc.kernel.scalar import DECLARATIONS, OutputMap, emit_function, identity_map, unsupported_operation
from wbmpc.kernel.second_derivatives import SECOND, second_maps
from wbmpc.kernel.simd_batch import emit_lanes, helpers
from wbmpc.kernel.sizes import Sizes
from wbmpc.kernel.sparse_rows import (
    RowLayout,
    added_entries,
    emit_add_gradient,
    emit_add_rows,
    emit_node_rows,
    emit_pulled_rows,
    emit_row_products,
    hessian_entry,
)
from wbmpc.ocp import Transcription
from wbmpc.ocp.stage_costs import term_values

#: Functions of one node: for roll-outs, the end of the horizon, jumps and second derivatives.
_SINGLE = (
    "dynamics", "terminal", "end_rows", "jump", "terminal_quadratic", "end_rows_jacobian", "jump_jacobian", *SECOND,
)  # fmt: skip
#: Functions of eight nodes at a time, at addresses called "lanes.…".
_EIGHT = (
    "dynamics", "cost", "equality", "rows", "dynamics_jacobian", "cost_quadratic", "equality_jacobian", "rows_jacobian",
)  # fmt: skip
_KERNELS = (
    "riccati_node", "step_node", "curvature_node", "box_values", "box_changes", "add_boxes",
    "add_rows", "add_row_gradient", "row_products", "node_rows", "pulled_rows", "chain_first", "chain_next", "pack", "unpack_ab",
    "unpack_matrix", "unpack_equalities", "unpack_rows",
)  # fmt: skip
#: Order of the addresses in :attr:`Kernel.addresses`.
ADDRESSES = (*_SINGLE, *(f"lanes.{n}" for n in _EIGHT), *_KERNELS)
#: The same functions as the module of a problem calls them.
SYMBOLS = (*(f"w_{n}" for n in _SINGLE), *(f"l_{n}" for n in _EIGHT), *_KERNELS)
#: What the nodes share among the arguments x, u, p, w, h.
_SHARED = {3}


@dataclass(frozen=True)
class Kernel:
    """Machine code of one problem. ``addresses`` are function pointers in the order of :data:`ADDRESSES`."""

    sizes: Sizes
    addresses: np.ndarray
    from_cache: bool
    _engine: Any = field(repr=False, default=None)

    def address(self, name: str) -> int:
        """The function pointer of that name."""
        return int(self.addresses[ADDRESSES.index(name)])


def output_maps(functions: dict[str, ca.Function], sizes: Sizes) -> dict[str, OutputMap]:
    """Where each function's non-zeros go in the solver's matrices."""
    nx, lx, lz, lg = sizes.nx, sizes.lx, sizes.lz, sizes.lg
    extended = lambda c: c if c < nx else c + 1

    def entries(name: str, output: int) -> list[tuple[int, int]]:
        rows, columns = functions[name].sparsity_out(output).get_triplet()
        return list(zip(rows, columns, strict=True))

    def symmetric(r: int, c: int, ld: int) -> list[int]:
        out = [extended(c) * ld + extended(r)]
        return out + [extended(r) * ld + extended(c)] if c < nx and r != c else out

    def gradient(i: int, ld: int) -> list[int]:
        out = [extended(i) * ld + nx]
        return [*out, nx * ld + i] if i < nx else out

    maps: dict[str, OutputMap] = {n: identity_map(f) for n, f in functions.items()}
    maps["dynamics_jacobian"] = [
        maps["dynamics_jacobian"][0],
        [[r * lz + extended(c)] for r, c in entries("dynamics_jacobian", 1)],
    ]
    for name, ld in (("cost_quadratic", lz), ("terminal_quadratic", lx)):
        maps[name] = [
            [[0]], [gradient(i, ld) for i, _ in entries(name, 1)], [symmetric(r, c, ld) for r, c in entries(name, 2)],
        ]  # fmt: skip
    behind = sizes.ng * lz
    maps["equality_jacobian"] = [
        [[q * lz + nx] for q, _ in entries("equality_jacobian", 0)],
        [
            [q * lz + extended(c)] + ([behind + (c - nx) * lg + q] if c >= nx else [])
            for q, c in entries("equality_jacobian", 1)
        ],
    ]
    layout, name = row_layout(functions, sizes), "rows_jacobian"
    maps[name] = [maps[name][0], [[layout.places[q, extended(c)]] for q, c in entries(name, 1)]]
    name = "end_rows_jacobian"
    maps[name] = [maps[name][0], [[q * lz + extended(c)] for q, c in entries(name, 1)]]
    maps["jump_jacobian"] = [maps["jump_jacobian"][0], [[r * lx + c] for r, c in entries("jump_jacobian", 1)]]
    return {**maps, **second_maps(functions, lz, lx, nx)}


def row_layout(functions: dict[str, ca.Function], sizes: Sizes) -> RowLayout:
    """Where the Jacobian of the general rows along the path is, by [x, 1, u]."""
    pattern: list[set[int]] = [set() for _ in range(sizes.nr)]
    for r, c in zip(*functions["rows_jacobian"].sparsity_out(1).get_triplet(), strict=True):
        pattern[r].add(c if c < sizes.nx else c + 1)
    return RowLayout.of(pattern)


def matrix_groups(functions: dict[str, ca.Function], maps: dict[str, OutputMap], sizes: Sizes) -> dict[str, list[int]]:
    """For every function of eight nodes that fills a matrix of each node: the matrix's groups with entries. The Hessian's are also those to
    which rows add: they start from zero where the cost has no entries."""
    outputs = {"cost_quadratic": (1, 2), "equality_jacobian": (0, 1)}
    found = {n: blocks.groups_of(o for i in which for nz in maps[n][i] for o in nz) for n, which in outputs.items()}
    layout = row_layout(functions, sizes)
    gradient = {hessian_entry(c, sizes.nx, sizes.lz) for c in layout.columns}
    added = blocks.groups_of(added_entries(layout, sizes.lz) | gradient)
    return found | {"cost_quadratic": sorted({*found["cost_quadratic"], *added})}


def lane_maps(maps: dict[str, OutputMap], groups: dict[str, list[int]]) -> dict[str, OutputMap]:
    """Where the functions of eight nodes put their non-zeros: those of matrices group by group, see ``matrix_groups``."""
    out = {n: maps[n] for n in _EIGHT}
    pressed = lambda name, i: blocks.compact(maps[name][i], groups[name])
    out["cost_quadratic"] = [[[0]], pressed("cost_quadratic", 1), pressed("cost_quadratic", 2)]
    out["equality_jacobian"] = [pressed("equality_jacobian", i) for i in (0, 1)]
    return out


def by_rows(function: ca.Function, outputs: OutputMap) -> tuple[ca.Function, OutputMap]:
    """A function's value and Jacobian, the latter row by row, and where they go: what only one row needs is then computed and stored at
    once, and not spilled to the stack until the columns that follow are computed."""
    inputs, pattern = function.sx_in(), function.sparsity_out(1)
    value, jacobian = function(*inputs)
    order = sorted(range(pattern.nnz()), key=pattern.row().__getitem__)
    return ca.Function(function.name(), inputs, [value, jacobian.T]), [outputs[0], [outputs[1][i] for i in order]]


def row_numbers(function: ca.Function) -> list[list[int]]:
    """The row of every non-zero of rows' values and of their Jacobian by rows."""
    return [
        function.sparsity_out(0).row(),
        *(function.sparsity_out(i).get_triplet()[1] for i in range(1, function.n_out())),
    ]


def step_pattern(transcription: Transcription, jacobian: ca.Sparsity, sizes: Sizes) -> np.ndarray:
    """Where [A b B; 0 1 0] of a step (nx + 1, nz) can differ from zero: everywhere where a jump may follow, which mixes rows."""
    pattern = np.zeros((sizes.nx + 1, sizes.nz), dtype=bool)
    pattern[:, sizes.nx] = True
    if transcription.jumps:
        pattern[: sizes.nx] = True
        return pattern
    pattern[: sizes.nx] |= _sensitivity(transcription, jacobian, sizes)
    return pattern


def _sensitivity(transcription: Transcription, jacobian: ca.Sparsity, sizes: Sizes) -> np.ndarray:
    """Where the derivative of a Runge-Kutta step (nx, nz) can differ from zero."""
    quaternions = transcription.ocp.dynamics.unit_quaternions
    return blocks.sensitivity_pattern(extended_pattern(jacobian, sizes), _stages(transcription), quaternions)


def _stages(transcription: Transcription) -> int:
    return 4 if transcription.ocp.integrator == "rk4" else 2


def extended_pattern(jacobian: ca.Sparsity, sizes: Sizes) -> np.ndarray:
    """Entries of a Jacobian by [x; u] in the columns [x, 1, u]."""
    pattern = np.zeros((jacobian.shape[0], sizes.nz), dtype=bool)
    for r, c in zip(*jacobian.get_triplet(), strict=True):
        pattern[r, c if c < sizes.nx else c + 1] = True
    return pattern


def equality_inputs(jacobian: ca.Sparsity, sizes: Sizes) -> list[list[int]]:
    """Of every equality row the inputs that it holds."""
    inputs: list[list[int]] = [[] for _ in range(sizes.ng)]
    for q, c in zip(*jacobian.get_triplet(), strict=True):
        if c >= sizes.nx:
            inputs[q].append(c - sizes.nx)
    return inputs


def _emit_blocks(
    transcription: Transcription, functions: dict[str, ca.Function], maps: dict[str, OutputMap], sizes: Sizes
) -> list[str]:
    """Everything that takes eight nodes at a time."""
    width, jacobian = register_width(), functions["dynamics_jacobian"].sparsity_out(1)
    groups = matrix_groups(functions, maps, sizes)
    step = [r * sizes.lz + c for r, c in np.argwhere(step_pattern(transcription, jacobian, sizes)[: sizes.nx])]
    lanes = lane_maps(maps, groups)
    made = {n: (functions[n], lanes[n]) for n in _EIGHT}
    made["rows_jacobian"] = by_rows(*made["rows_jacobian"])
    evaluations = "\n".join(
        emit_lanes(f, f"l_{n}", width, to, _SHARED, row_numbers(f) if n in ("rows", "rows_jacobian") else None)
        for n, (f, to) in made.items()
    )
    own, found, stages = (
        extended_pattern(jacobian, sizes),
        _sensitivity(transcription, jacobian, sizes),
        _stages(transcription),
    )
    chain = partial(blocks.chain, jacobian=own, step=found, stages=stages, ld=sizes.lz, width=width)
    return [
        helpers(evaluations, width),
        evaluations,
        blocks.declarations(width),
        chain("chain_first", start=0.5 if stages == 4 else 0.0),
        chain("chain_next", start=None),
        blocks.pack(),
        blocks.unpack("unpack_ab", blocks.groups_of(map(int, step)), whole=True),
        blocks.unpack("unpack_matrix", groups["cost_quadratic"]),
        blocks.unpack("unpack_equalities", groups["equality_jacobian"]),
        blocks.unpack_values("unpack_rows", sizes.nr),
        *_emit_rows(row_layout(functions, sizes), groups["cost_quadratic"], lanes["cost_quadratic"], sizes, width),
    ]


def _emit_rows(layout: RowLayout, groups: list[int], cost: OutputMap, sizes: Sizes, width: int) -> list[str]:
    """What works on the Jacobian of general rows; ``groups``: those of a node's Hessian, ``cost``: where the cost writes in them."""
    entries = sorted(added_entries(layout, sizes.lz))
    place = {e: at for e, (at,) in zip(entries, blocks.compact([[e] for e in entries], groups), strict=True)}
    return [
        emit_add_rows(layout, place, {at for output in cost[1:] for nz in output for at in nz}, sizes.lz, width),
        emit_add_gradient(layout, sizes.nx, sizes.lz),
        emit_row_products(layout, sizes.nx, width),
        emit_node_rows(layout, sizes.lz),
        emit_pulled_rows(layout),
    ]


def _row_variables(transcription: Transcription) -> list[int]:
    """The variables in [x; u] of the rows of one variable along the path."""
    return [row.variable for row in transcription.path.boxes]


def unsupported(transcription: Transcription) -> str:
    """Which term, or the dynamics, has an operation that cannot be compiled, in a message; empty if none has."""
    stages = (("path", "term"), ("terminal", "terminal term"))
    pieces = {"the dynamics": transcription.rates, "the jump": transcription.jump}
    for stage, kind in stages:
        pieces |= {f"{kind} '{name}'": value for name, value in term_values(transcription, stage).items()}
    symbols = [transcription.x, transcription.u, transcription.p, transcription.w]
    for name, expression in pieces.items():
        bad = unsupported_operation(ca.Function("piece", symbols, [expression]))
        if bad:
            return f"{name}: the SX operation {bad} cannot be compiled"
    return ""


def emit_problem(transcription: Transcription) -> tuple[str, Sizes]:
    """The whole LLVM module of a problem."""
    functions = {**transcription.values, **transcription.derivatives}
    own = (len(transcription.path.general), len(transcription.end.general))
    sizes = Sizes(transcription.nx, transcription.nu, transcription.equality.shape[0], *own)
    sizes = replace(sizes, row_entries=len(row_layout(functions, sizes).entries))
    maps = output_maps(functions, sizes)
    parts = [DECLARATIONS, dense.FMA, dense.ABSOLUTE]
    parts += [emit_function(functions[n], f"w_{n}", maps[n]) for n in _SINGLE]
    parts += _emit_blocks(transcription, functions, maps, sizes)
    jacobian, equality = functions["dynamics_jacobian"].sparsity_out(1), functions["equality_jacobian"].sparsity_out(1)
    step, held = step_pattern(transcription, jacobian, sizes), equality_inputs(equality, sizes)
    parts += [
        emit_riccati_node(sizes, step, held),
        emit_step_node(sizes, step),
        emit_curvature_node(sizes),
    ]
    variables = [v if v < sizes.nx else v + 1 for v in _row_variables(transcription)]
    parts += [emit_box_values(f"box_{n}", sizes.nx, variables, n == "values") for n in ("values", "changes")]
    parts.append(emit_add_boxes("add_boxes", sizes.nx, variables, sizes.lz))
    return "\n".join(parts), sizes


def problem_key(transcription: Transcription) -> str:
    """Hash of the problem before differentiation, of the generator and of the target."""
    digest = hashlib.sha256()
    for name, function in transcription.values.items():
        digest.update(name.encode())
        digest.update(function.serialize().encode())
    # Gauss-Newton curvature is not visible in the values: the norms say which one is meant.
    terms = transcription.ocp.terms.values()
    digest.update(repr([repr(getattr(t, "norm", None)) + repr(getattr(t, "penalty", None)) for t in terms]).encode())
    # nor are the entries that a step's derivative can have, and the variables of rows
    ocp = transcription.ocp
    digest.update(repr([ocp.integrator, list(ocp.dynamics.unit_quaternions), _row_variables(transcription)]).encode())
    text = [target_text(), transcription.exact, getattr(ca, "__version__", ""), cache.source_fingerprint()]
    digest.update(json.dumps(text).encode())
    return digest.hexdigest()


def _cached_sizes(found: tuple[bytes, dict] | None) -> Sizes | None:
    """The sizes that a cache entry states; None for an entry of another format, which is rebuilt."""
    try:
        sizes = Sizes(**found[1]["sizes"]) if found else None
    except (KeyError, TypeError):
        return None
    return sizes if sizes is not None and all(type(n) is int and n >= 0 for n in asdict(sizes).values()) else None


def build_kernel(transcription: Transcription, use_cache: bool = True) -> Kernel:
    """Compile a problem, or load it from the cache.

    Raises :class:`UnsupportedOperation` naming the term and the operation that cannot be compiled.
    """
    key = problem_key(transcription)
    found = cache.load(key, target=target_text()) if use_cache else None
    sizes = _cached_sizes(found)
    if found is not None and sizes is None:
        cache.report_damaged(key)
    if found is None or sizes is None:
        try:
            ir, sizes = emit_problem(transcription)
        except UnsupportedOperation as error:
            raise UnsupportedOperation(unsupported(transcription) or str(error)) from None
        code, found = compile_module(ir), None
        if use_cache:
            cache.save(key, code, {"target": target_text(), "sizes": asdict(sizes)})
    else:
        code = found[0]
    engine = load_object(code)
    addresses = np.array([engine.get_function_address(n) for n in SYMBOLS], dtype=np.int64)
    if np.any(addresses == 0):
        raise KernelError("the compiled code lacks a function")
    return Kernel(sizes, addresses, found is not None, engine)
