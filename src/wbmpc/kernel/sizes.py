"""Dimensions of a problem, as compiled functions and their callers lay out their arrays."""

from __future__ import annotations

from dataclasses import dataclass

from wbmpc.kernel import dense


@dataclass(frozen=True)
class Sizes:
    """Dimensions and padded lengths. The extended node vector is [x (nx), 1, u (nu)].

    ``ng``: rows of the Riccati recursion; ``nr``, ``ne``: general rows with a state of their own, at the path and at the end; ``row_entries``:
    of the path's general rows, as :mod:`wbmpc.kernel.sparse_rows` keeps their Jacobian.
    """

    nx: int
    nu: int
    ng: int
    nr: int
    ne: int
    row_entries: int = 0

    @property
    def first(self) -> int:
        """Index of the first input in the extended node vector."""
        return self.nx + 1

    @property
    def nz(self) -> int:
        return self.nx + 1 + self.nu

    @property
    def lx(self) -> int:
        return dense.pad(self.nx + 1)

    @property
    def lz(self) -> int:
        return dense.pad(self.nz)

    @property
    def lg(self) -> int:
        return dense.pad(max(self.ng, 1))

    def scratch(self) -> dict[str, int]:
        """Offsets [doubles] of the parts of the Riccati step's scratch memory, and its total size."""
        sizes = {
            "W": (self.nx + 1) * self.lz, "M": self.nz * self.lz, "D": dense.pad(self.nu), "T": self.nu * self.lx,
            "R": self.nu * self.lg, "Z": self.ng * self.lx, "Y": self.ng * self.lx, "S": self.ng * self.lg,
            "I": self.lg,
        }  # fmt: skip
        offsets, total = {}, 0
        for name, size in sizes.items():
            offsets[name] = total
            total += dense.pad(size)
        # the forward pass and the KKT residual have a node's step and two sums there
        return {**offsets, "total": max(total, self.lz + 24)}

    def equality_buffer(self) -> int:
        """Doubles of a node's equality rows [C e D] and of Dᵀ behind them."""
        return self.ng * self.lz + self.nu * self.lg
