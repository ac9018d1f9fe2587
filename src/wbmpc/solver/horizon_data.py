"""References and modes over absolute time of a horizon, and the tables that compiled code reads."""

from __future__ import annotations

from typing import TYPE_CHECKING

from wbmpc.errors import InputError, unknown_name
from wbmpc.ocp import ModeSchedule, Reference, Transcription
from wbmpc.ocp.parameters import check_schedule, mode_tables
from wbmpc.ocp.schedule import DEFAULT

if TYPE_CHECKING:
    from wbmpc.solver.guards import Exclusive
    from wbmpc.solver.receding import Tables


class HorizonData:
    """Of a ``problem``; ``exclusive``: who may change it. ``references`` by the names of their terms, ``schedule`` of the modes."""

    def __init__(self, problem: Transcription, exclusive: Exclusive) -> None:
        self._problem, self._exclusive = problem, exclusive
        self.references: dict[str, Reference] = {}
        self.schedule = DEFAULT
        self._tables: Tables | None = None
        self._changes = 0

    def set_reference(self, name: str, reference: Reference) -> None:
        """Set the reference of the term ``name``; one of the same size is written into the tables that there are."""
        self._check_reference(name, reference)
        with self._exclusive:
            previous, tables = self.references.get(name), self._tables
            self.references[name] = reference
            self._changes += 1
            if tables is None:
                return
            if previous is None or (previous.values.shape, previous.kind) != (reference.values.shape, reference.kind):
                self._tables = None
                return
            from wbmpc.solver.receding import overwrite

            slices = self._problem.references.slices
            overwrite(tables, [n for n in slices if n in self.references].index(name), reference)

    def _check_reference(self, name: str, reference: Reference) -> None:
        slices = self._problem.references.slices
        if name not in slices:
            if name in self._problem.ocp.terms:
                raise InputError(
                    f"reference '{name}': its term compares with none; valid: {', '.join(slices) or 'none'}, "
                    "or a residual with reference=… (wb.residuals.Expression: how many numbers)"
                )
            raise unknown_name("reference", name, slices)
        if not isinstance(reference, Reference):
            raise InputError(
                f"reference '{name}': a Reference is needed, such as Reference.constant(…), got {str(reference)[:80]!r}"
            )
        width = slices[name].stop - slices[name].start
        if (given := reference.values.shape[1]) != width:
            raise InputError(f"reference '{name}': {width} numbers per sample are needed, got {given}")

    def set_schedule(self, schedule: ModeSchedule) -> None:
        """Set the modes."""
        mode_tables(self._problem, schedule)
        check_schedule(self._problem, schedule)
        with self._exclusive:
            self.schedule, self._tables, self._changes = schedule, None, self._changes + 1

    def tables(self) -> Tables:
        """References and modes as the compiled code reads them: the same object until one of another size is set. Raises
        :class:`InputError` where a reference that a term needs is not set."""
        while (tables := self._tables) is None:
            from wbmpc.solver.receding import make_tables

            for name, term in self._problem.ocp.terms.items():
                if getattr(term.residual, "reference_required", False) and name not in self.references:
                    raise InputError(f"term '{name}': its reference (a pose) is not set")
            if self.schedule is DEFAULT:
                check_schedule(self._problem, DEFAULT)
            changes = self._changes
            made = make_tables(self._problem, self.references, self.schedule)
            if changes == self._changes:  # else a signal's handler has set what they do not have
                self._tables = made
        return tables
