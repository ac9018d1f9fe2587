"""What an exported controller has in its memory: the caller's block as it begins, and the numbers that never change."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from wbmpc.clearance.depth_step import Hull
from wbmpc.clearance.own_pairs import Compared, Places
from wbmpc.clearance.pairs_step import Gaps
from wbmpc.embedded.keeps_clear import Guard
from wbmpc.errors import InputError
from wbmpc.kernel.ir import Parameter
from wbmpc.kernel.object_file import Symbols
from wbmpc.mpc.braking import rate_limits, rated_states
from wbmpc.mpc.clearance import BARRIER_SHARE, BRAKING_SOLVES, FIRST_BARRIER
from wbmpc.mpc.input_rows import InputRows
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import ModeSchedule, Reference
from wbmpc.ocp.parameters import mode_tables
from wbmpc.ocp.schedule import Mode
from wbmpc.ocp.symbols import FollowsLastInput
from wbmpc.solver.controller import Count, Value
from wbmpc.solver.memory_layout import ALIGN, BASE, GRID, GRID_BASE, GRID_OLD, N
from wbmpc.solver.receding import Tables, make_tables
from wbmpc.solver.workspace import ADDRESSES, POINTERS, make_workspace

#: What of a robot's own pairs is written.
_WRITTEN = frozenset((*Places._fields, *Gaps._fields, *Hull._fields))


@dataclass(frozen=True)
class OwnParts:
    """As of :class:`wbmpc.embedded.image.Image`, by the names of :mod:`wbmpc.embedded.keeps_clear`'s records and their fields."""

    areas: dict[str, np.ndarray] = field(default_factory=dict)
    constants: dict[str, np.ndarray] = field(default_factory=dict)
    numbers: dict[str, int | float] = field(default_factory=dict)
    poses: ca.Function | None = None


def own_parts(mpc: MPC) -> OwnParts:
    """Of the one term of an MPC that keeps parts of its robot apart."""
    ((name, rows),) = mpc._clear.within.items()
    (n, nu), nx = mpc.solver.ws.u.shape, mpc.solver.ws.x.shape[1]
    arrays, counts = rows.own.memory(n + 1)
    found = OwnParts(poses=rows.own.poses)
    for place in Parameter.of(Compared, "w.own", Compared, {}).places:
        part = place.rpartition(".")[2]
        if part in arrays:
            (found.areas if part in _WRITTEN else found.constants)[place] = _filled(arrays[part])
        elif part in counts:
            found.numbers[place] = counts[part]
    zeros = lambda *shape: np.zeros(int(np.prod(shape)))
    guard = zeros(len(Guard))
    guard[Guard.STOPS_AT] = guard[Guard.SEARCH_AT] = np.inf
    areas = {
        "guard": guard, "own_states": arrays["states"], "parameters": arrays["parameters"], "work": arrays["work"],
        "grids": zeros(3, n + 1), "ahead": zeros(n + 1, nx), "stop_x": zeros(n + 1, nx), "stop_u": zeros(n, nu),
        "kept_x": zeros(n + 1, nx), "kept_u": zeros(n, nu), "active": zeros(nu), "state": zeros(nx),
        "tuned": zeros(len(mpc.solver.numbers)),
    }  # fmt: skip
    dynamics, robot = mpc.ocp.dynamics, rows.geometry.robot
    rates, sources = rate_limits(dynamics, robot)
    constants = {
        "margins": arrays["margins"], "of_a": arrays["of_a"], "of_b": arrays["of_b"], "above": arrays["above"],
        "grid_table": _grid_table(n, mpc.ocp.align_events), "rates": rates, "sources": sources,
        "state_of": rated_states(dynamics), "barriers": np.array([FIRST_BARRIER * BARRIER_SHARE**k for k in range(BRAKING_SOLVES)]),
    }  # fmt: skip
    numbers = {
        "reach": counts["reach"], "limited": len(rates), "slot": list(mpc.solver.problem.references.slices).index(name),
        "balances": int(robot.base.balances),
    }  # fmt: skip
    found.areas.update({f"w.{key}": _filled(value) for key, value in areas.items()})
    found.constants.update({f"w.{key}": _filled(value) for key, value in constants.items()})
    found.numbers.update({f"w.{key}": value for key, value in numbers.items()})
    return found


def _grid_table(n: int, aligned: bool) -> np.ndarray:
    """The entries of a solver's table that :func:`wbmpc.solver.receding.align` reads, for three grids in a row."""
    table = np.zeros(max(N, GRID, GRID_BASE, GRID_OLD, ALIGN) + 1, np.int64)
    table[[N, GRID_BASE, GRID_OLD, ALIGN]] = n, n + 1, 2 * (n + 1), int(aligned)
    return table


#: What a controller needs for policies alone: the front part of the block.
PLAN = ("count", "value", "times", "states", "inputs", "gains", "active", "moving", "room")


@dataclass(frozen=True)
class Group:
    """Numbers of one name: a reference in its slot, or a group of constants."""

    name: str
    index: int
    width: int


@dataclass(frozen=True)
class Image:
    """``areas`` are in the caller's block, in this order, each at a multiple of 64 bytes; ``constants`` are in the object file;
    ``numbers`` are arguments of the compiled functions, by their names."""

    areas: dict[str, np.ndarray]
    constants: dict[str, np.ndarray]
    numbers: dict[str, int | float]
    references: list[Group]
    weights: list[Group]
    modes: list[str]
    #: of robots that keep their own parts apart: the poses of their frames
    poses: ca.Function | None = None

    def offsets(self) -> dict[str, int]:
        """Where the areas begin [8 bytes]; behind them, under the name "end", the size of the block. The first word says whose it is."""
        found, at = {}, 8
        for name, content in self.areas.items():
            found[name] = at
            at += -(-content.size // 8) * 8
        return {**found, "end": at}

    def words(self) -> np.ndarray:
        """The block as integers of 64 bits."""
        offsets = self.offsets()
        block = np.zeros(offsets["end"], dtype=np.int64)
        for name, content in self.areas.items():
            block[offsets[name] : offsets[name] + content.size] = content.ravel().view(np.int64)
        return block


@dataclass(frozen=True)
class Export:
    """What :func:`wbmpc.embedded.exporter.export` wrote: the object file, what it defines and needs, and what it has room for."""

    directory: Path
    prefix: str
    target: str
    object_size: int
    symbols: Symbols
    image: Image
    #: of the calling thread [bytes]
    stack: int

    @property
    def block_size(self) -> int:
        """Of the memory that the caller gives [bytes]."""
        return 8 * self.image.offsets()["end"]


def make_image(mpc: MPC, samples: int) -> Image:
    """The controller of an MPC as it is now: weights, references, schedule, and trajectories to start from. ``samples``: how many of
    a reference, and how many events, there is room for; more where there are more now."""
    solver, problem = mpc.solver, mpc.solver.problem
    assert solver.kernel is not None  # see check_exportable
    workspace = make_workspace(solver.kernel, problem)
    workspace.w[:], workspace.x[:], workspace.u[:] = solver.ws.w, solver.ws.x, solver.ws.u
    workspace.table[BASE], workspace.table[ADDRESSES:POINTERS] = 0, 0
    modes = [m for i, m in enumerate(solver.schedule.modes) if m not in solver.schedule.modes[:i]]
    tables = _tables(mpc, samples, modes)
    (n, nu), nx = workspace.u.shape, workspace.x.shape[1]
    rows = InputRows(solver)
    r, planes = rows.limits.offset.size, rows.planes
    zeros = lambda *shape: np.zeros(max(int(np.prod(shape)), 1))
    areas: dict[str, np.ndarray] = {
        "count": np.zeros(len(Count), dtype=np.int64), "value": zeros(len(Value)), "times": zeros(n + 1),
        "states": zeros(n + 1, nx), "inputs": zeros(n, nu), "gains": zeros(n, nu, nx), "active": zeros(n, r),
        "moving": zeros(n, 2, r), "room": zeros(3 * nu + r + planes.by_node.shape[1]), "start": zeros(nx),
        "o": workspace.table, "numbers": tables.numbers, "integers": tables.integers, "log": zeros(solver.log.size),
        "m": workspace.memory,
    }  # fmt: skip
    areas["value"][Value.CLEARANCE] = np.inf
    apart = own_parts(mpc) if mpc._clear.within else OwnParts()
    groups = [(name, part) for name, part in problem.constant.slices.items() if part.stop > part.start]
    follow = _follow(mpc)
    slots = list(problem.references.slices)
    widths = [part.stop - part.start for part in problem.references.slices.values()]
    constants = {
        "settings": solver.numbers, "limits": rows.limits.table, "rows": rows.table, "switches": rows.switches,
        "follow": follow, "modes": _filled(mode_tables(problem, ModeSchedule(tuple(modes), tuple(range(len(modes) - 1))))),
        "groups": _filled(np.array([(p.start, p.stop - p.start) for _, p in groups], dtype=np.int64)),
        "capacities": _filled(np.array([_capacity(mpc, name, samples) for name in slots], dtype=np.int64)),
    }  # fmt: skip
    numbers: dict[str, int | float] = {
        "n": n, "nx": nx, "nu": nu, "r": r, "moves": int(planes.move), "by_node": planes.by_node.shape[1],
        "by_constant": planes.by_constant.shape[1], "first": mpc.first_iterations, "period": mpc.period,
        "slots": len(slots), "known_modes": len(modes), "known_groups": len(groups),
        "max_events": max(samples, len(solver.schedule.events)),
    }  # fmt: skip
    own = [Group(name, i, width) for i, (name, width) in enumerate(zip(slots, widths, strict=True))]
    set_here = {*_followed(mpc), *mpc._clear.within}
    return Image(
        areas | apart.areas, constants | apart.constants, numbers | apart.numbers, [g for g in own if g.name not in set_here],
        [Group(name, i, part.stop - part.start) for i, (name, part) in enumerate(groups)], [m.name for m in modes], apart.poses,
    )  # fmt: skip


def _filled(table: np.ndarray) -> np.ndarray:
    """One entry at least."""
    return np.ascontiguousarray(table).ravel() if table.size else np.zeros(1, dtype=table.dtype)


def _followed(mpc: MPC) -> dict[str, list[int]]:
    """Inputs of the terms whose reference is what was commanded last."""
    terms = {t.name: t.residual for t in mpc.ocp.terms.values()}
    return {name: list(r.last_inputs) for name, r in terms.items() if isinstance(r, FollowsLastInput)}


def _follow(mpc: MPC) -> np.ndarray:
    """See :func:`wbmpc.solver.controller.follow_last`."""
    slots, found = list(mpc.solver.problem.references.slices), _followed(mpc)
    table = [len(found)]
    for name, inputs in found.items():
        table += [slots.index(name), len(inputs), *inputs]
    return np.array(table, dtype=np.int64)


def _capacity(mpc: MPC, name: str, samples: int) -> int:
    known = mpc.solver.references.get(name)
    if name in mpc._clear.within:
        return len(mpc.ocp.grid)
    return max(samples, 2, 0 if known is None else known.times.size)


def _tables(mpc: MPC, samples: int, modes: list[Mode]) -> Tables:
    """Tables of references and modes as :func:`make_tables` makes them, with room for more. References that are not set are zero,
    as their parameters then are in the solver's memory."""
    solver, room = mpc.solver, {}
    solver.data.tables()  # raises where a reference that is needed is not set
    for name, part in solver.problem.references.slices.items():
        capacity = _capacity(mpc, name, samples)
        room[name] = Reference(np.zeros(capacity), np.zeros((capacity, part.stop - part.start)))
    events = max(samples, len(solver.schedule.events))
    most = ModeSchedule((modes[0],) * (events + 1), tuple(range(events)))
    tables = make_tables(solver.problem, room, most)
    own = solver.schedule
    head = np.concatenate([own.events, mode_tables(solver.problem, own).ravel()])
    tables.numbers[: head.size], tables.integers[1] = head, len(own.events)
    for slot, name in enumerate(room):
        known: Any = solver.references.get(name, Reference.constant(np.zeros(room[name].values.shape[1])))
        times, _, values, _ = tables.integers[4 + 6 * slot : 8 + 6 * slot]
        tables.numbers[times : times + known.times.size] = known.times
        tables.numbers[values : values + known.values.size] = known.values.ravel()
        tables.integers[5 + 6 * slot], tables.integers[8 + 6 * slot] = (
            known.times.size,
            Reference.KINDS.index(known.kind),
        )
    return tables


def _overridden(mpc: MPC) -> str:
    """What of :class:`MPC` a subclass, or this object, does in its own way; empty for none. The package's own subclasses convert
    states of another kind; of the problem's states they make the problem's plans."""
    own: list[str] = [name for name in vars(mpc) if callable(vars(mpc)[name])]
    for kind in type(mpc).__mro__[: type(mpc).__mro__.index(MPC)]:
        own += [name for name in vars(kind) if not kind.__module__.startswith("wbmpc.")]
    return next((name for name in own if not name.startswith("__") and hasattr(MPC, name)), "")


def check_exportable(mpc: object) -> None:
    """Raise :class:`InputError` naming what of an MPC runs in Python alone."""
    if not isinstance(mpc, MPC):
        raise InputError(f"export: an MPC is needed, got {type(mpc).__name__}")
    if changed := _overridden(mpc):
        raise InputError(
            f"export: {type(mpc).__name__} has a '{changed}' of its own, which is Python and cannot be exported; valid: wbmpc.MPC itself"
        )
    if mpc.guess is not None:
        raise InputError(
            f"export: the MPC's guess ({type(mpc.guess).__name__}) is Python and cannot be exported; valid: mpc.guess = None"
        )
    if mpc.path.active:
        raise InputError(
            "export: paths are expanded in Python before every solve; valid: problems without wbmpc.WithPath"
        )
    if mpc._clear.around:
        raise InputError(
            f"export: term '{next(iter(mpc._clear.around))}' keeps clear of obstacles, whose nearest points are sought in Python before every"
            " solve; valid: problems without Clearance (SelfClearance, FloorClearance and rows of your own are exported)"
        )
    if len(mpc._clear.within) > 1:
        raise InputError(
            f"export: the terms {', '.join(mpc._clear.within)} keep parts of the robot apart; valid: one SelfClearance with all pairs"
        )
    if mpc.solver.kernel is None:
        raise InputError(
            "export: this problem runs in CasADi's interpreter (backend='interpreted', or an operation that cannot be compiled);"
            " valid: problems that run with backend='compiled'"
        )
