"""Settings of the solvers: which algorithm, how far, how hard limits are treated."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from wbmpc.checks import quoted
from wbmpc.errors import InputError, unknown_name


@dataclass(frozen=True)
class Thresholds:
    """Constants of the iteration. Steps and biases are relative to 1 + |x| and 1 + |u|.

    ``divergence``: a step [units of the variables] or a cost that is larger has diverged; times the cost at the start where that is
    above 1. ``settled``: the largest step of a solution, however small the gradient is. ``at_rest``: the same for soft equalities,
    whose residual is then theirs. ``bias``: by how much a solution may still depend on the barrier parameter; ``min_barrier``: as far
    as it falls for that; ``max_barrier``: as far as it rises where slacks cut steps to less than a tenth. ``jammed``: steps that slacks
    cut to less, with the measured state outside a limit, are replaced by a roll-out (``rollout_restart``), unless that costs more than
    ``runaway`` times what the step promises, as of an unstable system. ``raised``: in real time
    the barrier parameter rises by at most this factor where slacks cut steps to less than a tenth, and to at most ``slack_share`` of
    the weight of any slack, so that plans hardly use these. ``kept_weight``: the share of the violation's weight in the merit that is
    kept when μ or ρ changes: with weights found far away from a solution later steps would only creep along the constraints.

    ``limit_tolerance``: by how much plans may be outside a hard row [its range]; ``gives_way``: a multiplier beyond this share of its L1
    slack's weight says that the row gives way. ``short``: slacks that allow less of a step are far from where a small barrier parameter
    belongs. ``error_memory``: iterations whose errors are remembered; ``error_decrease``: the share of their largest to which it has to
    fall; ``steepest``: even products allow μ = 0 next, and this share of their power of 1.5 converges as fast. ``overshot``: what
    overshooting directions shorten a step to at least. ``corrections`` of a node's inputs at most: a circle takes five from three times its
    radius, rows at acute angles many; ``inside``: where they aim [units of the rows]. ``kept_slack``: share of a slack that a step leaves at
    least: with 0.01 slacks jam near zero. ``min_slope`` of an equality by the inputs to divide by. ``stall_window``: iterations over which
    the contraction is measured.
    """

    divergence: float = 1e10
    settled: float = 1e-3
    at_rest: float = 1e-7
    bias: float = 1e-4
    min_barrier: float = 1e-18
    max_barrier: float = 0.1
    jammed: float = 0.25
    runaway: float = 100.0
    raised: float = 3e4
    slack_share: float = 1e-3
    kept_weight: float = 0.1
    limit_tolerance: float = 1e-3
    gives_way: float = 0.9
    short: float = 0.1
    error_memory: int = 4
    error_decrease: float = 0.9
    steepest: float = 0.1
    overshot: float = 0.15
    corrections: int = 30
    inside: float = 1e-6
    kept_slack: float = 0.1
    min_slope: float = 1e-3
    stall_window: int = 25


THRESHOLDS = Thresholds()


def check_settings_type(who: str, settings: object) -> None:
    """Raise :class:`InputError` of ``who`` for what are no settings of a solver, such as their name."""
    if not isinstance(settings, SQP):
        raise InputError(
            f"{who}: settings are needed, got {quoted(settings)!r}; valid: wb.SQP(…), wb.ILQR(…), wb.SLQ(…)"
        )


def _count(value: object, minimum: int) -> bool:
    """Whether this is a whole number of at least ``minimum``."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and bool(value >= minimum)


@dataclass(frozen=True)
class InteriorPoint:
    """How hard inequalities are treated.

    ``mode``: "converge" drives μ from ``initial_barrier`` to ``barrier`` (by default the solver's tolerance times 1e-4,
    and further down where the plan still depends on it, as with costs in tiny units); "real_time" keeps
    it at ``barrier``, but where slacks cut steps to nearly nothing, as after a jump of a reference: μ then rises until steps are long
    again, and falls afterwards. It starts every solve from slacks t = max(h, ``min_slack``) with the multipliers kept, so that one
    iteration per solve is enough. Rows are in units of their range. ``fraction_to_boundary``: the share of the way to zero that slacks
    and multipliers may go in one step. ``max_extra_iterations``: at most so many more iterations while the step is cut below
    0.9 of the longest that is tried (docs/explanation/solver.md).
    ``rollout_restart``: in real time, if a state outside a limit cuts steps to almost zero, the iterate is replaced by a roll-out from
    there. False is for unstable systems, whose motion without feedback diverges within the horizon.
    ``reset=False``: keep the slacks of the last solve too (for comparison: docs/results/limits-and-race.md).
    """

    mode: Literal["converge", "real_time"] = "converge"
    barrier: float | None = None
    initial_barrier: float = 0.01
    min_slack: float | None = None
    fraction_to_boundary: float = 0.995
    max_extra_iterations: int = 10
    rollout_restart: bool = True
    reset: bool = True

    def __post_init__(self) -> None:
        if self.mode not in ("converge", "real_time"):
            raise unknown_name("interior point mode", self.mode, ("converge", "real_time"))
        for name in ("barrier", "initial_barrier", "min_slack"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < np.inf:
                raise InputError(f"interior point: {name} must be positive and finite, got {value}")
        if not _count(self.max_extra_iterations, 0):
            raise InputError(
                f"interior point: max_extra_iterations must be a whole number, at least 0, got {self.max_extra_iterations}"
            )
        if not 0.0 < self.fraction_to_boundary < 1.0:
            raise InputError(
                f"interior point: fraction_to_boundary must be between 0 and 1, got {self.fraction_to_boundary}"
            )

    def numbers(self, tolerance: float) -> dict[str, float]:
        """The numbers that the compiled code reads; ``tolerance`` of the solver's KKT residual."""
        real_time = self.mode == "real_time"
        # beside a row that is only just active the solution moves by the square root of μ
        mu = self.barrier if self.barrier is not None else (1e-3 if real_time else 1e-4 * tolerance)
        min_slack = self.min_slack if self.min_slack is not None else (1e-3 if real_time else 1e-2)
        return {
            "initial_barrier": mu if real_time else max(self.initial_barrier, mu),
            "max_barrier": THRESHOLDS.raised * mu
            if real_time
            else max(self.initial_barrier, THRESHOLDS.max_barrier, mu),
            "barrier": mu,
            "keep_multipliers": float(real_time),
            "min_slack": min_slack,
            "fraction_to_boundary": 0.99 if real_time else self.fraction_to_boundary,
            "max_extra_iterations": float(self.max_extra_iterations if real_time else 0),
            "keep_slacks": float(real_time and not self.reset),
            "rollout_restart": float(self.rollout_restart),
            "min_barrier": mu if real_time or self.barrier is not None else min(THRESHOLDS.min_barrier, mu),
        }


class Effort(NamedTuple):
    """What a solve costs, counted: ``directions`` (linearization, factorization and step) and ``trial_points`` of line searches
    (cost and constraints without derivatives)."""

    directions: int
    trial_points: int


@dataclass(frozen=True)
class SQP:
    """Sequential quadratic programming by multiple shooting: states and inputs are unknowns, gaps close with the steps.

    ``iterations``: at most this many; ``tolerance``: on the KKT residual, ``feasibility``: on the violation (both with
    ``compute_kkt`` only); ``min_step``: the line search gives up below it, and then takes the full step if
    ``accept_min_step``; ``line_search``: an ℓ1 merit with Armijo's rule, or a filter; ``max_regularization``: of the Hessian's diagonal
    (Levenberg-Marquardt), grown when a step fails or the subproblem is not convex; ``hessian``: "exact" has the second
    derivatives of everything, as far as the subproblem stays convex (without jumps and quaternions, compiled only); "auto"
    begins with "gauss_newton", and where that would not converge within the iterations left, :meth:`Solver.solve` compiles the exact
    one and goes on with it;
    ``equality_bound``: in real time a plan fails whose first input misses an equality by more than this share of what the row
    makes of inputs, |D| + Σ |D_i u_i|; those that contradict each other do so at every solve;
    ``interior_point``: how hard inequalities are solved; ``backend``: machine code, or the interpreted twin.
    """

    iterations: int = 300
    tolerance: float = 1e-8
    feasibility: float = 1e-6
    min_step: float = 1e-3
    compute_kkt: bool = True
    accept_min_step: bool = False
    line_search: Literal["merit", "filter"] = "merit"
    max_regularization: float = 1e6
    hessian: Literal["auto", "gauss_newton", "exact"] = "auto"
    equality_bound: float = 0.05
    interior_point: InteriorPoint = field(default_factory=InteriorPoint)
    backend: Literal["compiled", "interpreted"] = "compiled"

    single_shooting = False

    def __post_init__(self) -> None:
        name = type(self).__name__
        if not _count(self.iterations, 1):
            raise InputError(f"{name}: iterations must be a whole number, at least 1, got {self.iterations}")
        if self.backend not in ("compiled", "interpreted"):
            raise unknown_name("backend", self.backend, ("compiled", "interpreted"))
        if self.line_search not in ("merit", "filter"):
            raise unknown_name("line search", self.line_search, ("merit", "filter"))
        if self.hessian not in ("auto", "gauss_newton", "exact"):
            raise unknown_name("hessian", self.hessian, ("auto", "gauss_newton", "exact"))
        for key in ("tolerance", "feasibility", "min_step"):
            if not 0.0 < getattr(self, key) < np.inf:
                raise InputError(f"{name}: {key} must be positive and finite, got {getattr(self, key)}")
        if not self.equality_bound > 0.0:
            raise InputError(f"{name}: equality_bound must be positive, got {self.equality_bound}")
        if not self.min_step <= 1.0:
            raise InputError(f"{name}: min_step must be at most 1, got {self.min_step}")
        if not self.max_regularization >= 0.0:
            raise InputError(f"{name}: max_regularization must not be negative, got {self.max_regularization}")

    @classmethod
    def real_time(cls, iterations: int = 1, **more: object) -> SQP:
        """One iteration (or a few) per solve from the shifted last solution, hard limits included: for use in an MPC."""
        interior = InteriorPoint("real_time")
        options = {
            "compute_kkt": False,
            "min_step": 0.2,
            "accept_min_step": True,
            "max_regularization": 0.0,
            "interior_point": interior,
        }
        return cls(iterations=iterations, **(options | more))  # type: ignore[arg-type]

    @property
    def max_iterations(self) -> int:
        """Rows that the iteration log needs: a restart, and a last time with inputs held within rows, come on top."""
        return self.iterations + max(int(self.interior_point.max_extra_iterations), 0) + 2

    @property
    def max_effort(self) -> Effort:
        """What one :meth:`Solver.solve` costs at most, whatever happens: in real time by default 13 directions and 56 trial points.

        ``iterations``, extra ones while steps are cut, a restart from a roll-out, and one with inputs held within rows; each tries the
        step halved down to ``min_step``, and once more as a whole with ``accept_min_step``; four points for roll-outs."""
        trials = int(np.floor(np.log2(1.0 / self.min_step))) + 1 + int(self.accept_min_step)
        return Effort(self.max_iterations, self.max_iterations * trials + 4)

    def numbers(self) -> np.ndarray:
        """The settings in the order of :data:`wbmpc.solver.memory_layout.SETTINGS`."""
        from wbmpc.solver.memory_layout import SETTINGS

        own = {
            "iterations": self.iterations, "tolerance": self.tolerance, "feasibility": self.feasibility,
            "min_step": self.min_step, "compute_kkt": self.compute_kkt, "accept_min_step": self.accept_min_step,
            "single_shooting": self.single_shooting, "use_filter": self.line_search == "filter",
            "max_regularization": self.max_regularization, "equality_bound": self.equality_bound, "detect_stall": False,
            **self.interior_point.numbers(self.tolerance),
        }  # fmt: skip
        return np.array([float(own[name]) for name in SETTINGS])


@dataclass(frozen=True)
class ILQR(SQP):
    """Single shooting: the policy is rolled out, feedback included, so that every iterate is a motion of the model.

    All settings are those of :class:`SQP`. Source: Tassa, Erez and Todorov 2012; Gauss-Newton instead of second derivatives.
    """

    single_shooting = True


@dataclass(frozen=True)
class SLQ(ILQR):
    """ILQR on a refined grid, close to its limit in continuous time: no interval is longer than ``step`` [s]. Other settings: :class:`SQP`.

    Source: Farshidian et al. 2017, "An efficient optimal planning and control framework for quadrupedal locomotion".
    """

    step: float = 0.01

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.step > 0.0:
            raise InputError(f"SLQ: step must be positive, got {self.step}")
