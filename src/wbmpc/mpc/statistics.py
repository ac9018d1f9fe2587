"""What an MPC counts over all its updates."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class Statistics:
    """Solve times [s] of all updates but the first; how many solves there were, and how many did not help.

    ``failures``: solves without a usable plan (the last one stayed active); ``no_step``: solves in which no step length
    was accepted, so that the plan is the last one moved on; ``limit_violations``: active plans whose states are outside
    hard limits by more than 0.1 % of the range, ``worst_limit_violation``: by how much at most, as a share of it, and
    ``worst_limit_violation_message``: which row; ``initial_state_mismatches``: plans that start elsewhere than in the
    observed state, ``worst_initial_state_mismatch``: by how much at most (:attr:`Solver.initial_state_mismatch`); ``braking_plans``:
    plans that were replaced by one that stops, before an obstacle; ``extended``: updates beside the first one that took more than twice
    the iterations asked for, because limits cut their steps (``max_extra_iterations``) or a stop was planned.
    """

    solve_times: list[float] = field(default_factory=list, repr=False)
    solves: int = 0
    failures: int = 0
    no_step: int = 0
    limit_violations: int = 0
    worst_limit_violation: float = 0.0
    worst_limit_violation_message: str = ""
    initial_state_mismatches: int = 0
    worst_initial_state_mismatch: float = 0.0
    braking_plans: int = 0
    extended: int = 0

    def count_limit_violation(self, share: float, where: str) -> None:
        """Count a plan whose states are outside hard limits by ``share`` of the range."""
        self.limit_violations += 1
        if share > self.worst_limit_violation:
            self.worst_limit_violation, self.worst_limit_violation_message = share, where

    def count_initial_state_mismatch(self, share: float) -> None:
        """Count a plan that starts elsewhere."""
        self.initial_state_mismatches += 1
        self.worst_initial_state_mismatch = max(self.worst_initial_state_mismatch, share)

    @property
    def failed_share(self) -> float:
        """Solves without a new plan over all solves (0 before the first)."""
        return (self.failures + self.no_step) / max(self.solves, 1)
