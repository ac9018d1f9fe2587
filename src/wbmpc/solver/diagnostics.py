"""Status and cause of a solve: its status, and a message that names the cause of a failure, or what is doubtful about a solution that
converged."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from wbmpc.ocp import Constraint, Transcription
from wbmpc.ocp.constraint_classification import fixed, row_names
from wbmpc.ocp.sets import Box
from wbmpc.ocp.term_rows import nonlinear_in_the_inputs, with_state
from wbmpc.solver import certificate
from wbmpc.solver.certificate import Violation, gives_way, must_hold
from wbmpc.solver.infeasibility import Finding, least_violation
from wbmpc.solver.settings import THRESHOLDS
from wbmpc.solver.solution import COLUMNS, Solution, Status

if TYPE_CHECKING:
    from wbmpc.solver.solver import Solver

#: By how much a hard limit may be missed [in its own unit, and in the variables'] before it counts as relaxed; and as a share of
#: its range, where that is less.
RELAXED, RELAXED_SHARE = 1e-5, 1e-3
#: An equality that is nonlinear in the inputs and missed by less is on its way, not infeasible.
NEARLY = 1e-2


def diagnose(solver: Solver, solution: Solution) -> Solution:
    """The solution with its violations by name, and the status and the message that these show."""
    problem, ws = solver.problem, solver.ws
    violations = solver.checks.violations(ws.x, ws.u, ws.p, ws.w)
    missed, ended = _missed(solver, violations), solution.status
    if solution.status is Status.NOT_FINITE:
        solution = replace(solution, kkt=np.nan)
        detail = _not_finite(solver)
        if detail or _violation(solver, solution, missed)[-1] < solver.settings.feasibility:
            return replace(solution, detail=detail or _no_curvature(solver))
        solution = replace(
            solution, status=Status.INFEASIBLE
        )  # the iterate is finite, the step to the constraints is not
    if solution.status in (Status.INPUT_INFEASIBLE, Status.EQUALITY_INFEASIBLE):
        return replace(solution, violations=violations)
    if solution.status is Status.CONVERGED:
        status, detail = _converged(solver, violations)
    elif solution.status is Status.DIVERGED and not (missed and _multipliers_diverged(solution)):
        status, detail = Status.DIVERGED, _diverged(solver)
    else:
        status, detail = _unfinished(solver, solution, missed, ended)
    if solution.status in (Status.DIVERGED, Status.LINE_SEARCH_FAILED) and not certificate.not_finite_trial(
        problem, ws
    ):
        detail += certificate.unstable_interval(problem, ws)
    return replace(solution, status=status, violations=violations, detail=detail or solution.detail)


def _not_finite(solver: Solver) -> str:
    found = certificate.not_finite(solver.problem, solver.ws)
    free = certificate.unweighted_inputs(solver.problem)
    return f"{found or 'the step'}; no term depends on input '{free[0]}'" if free else found


def _no_curvature(solver: Solver) -> str:
    if solver.settings.max_regularization > 0.0:
        return certificate.beyond_rounding(solver.problem, solver.ws)
    return "the step: the costs leave an input without curvature"


def _can_contradict(problem: Transcription) -> bool:
    """Whether anything that must be met depends on states. Where nothing does, a motion of the model closes all gaps."""
    terms = [t for t in problem.ocp.terms.values() if isinstance(t, Constraint) and must_hold(problem, t)]
    return any(with_state(problem, t).any() and not gives_way(problem, t) for t in terms)


def _missed(solver: Solver, violations: dict[str, Violation]) -> Violation | None:
    """The largest violation of what must hold, where it is above the tolerance; of limits with a slack only if nothing else is."""
    problem, terms = solver.problem, solver.problem.ocp.terms
    found = [
        (not gives_way(problem, terms[name]), v)
        for name, v in violations.items()
        if must_hold(problem, terms[name]) and v.value > solver.settings.feasibility
    ]
    return max(found, key=lambda f: (f[0], f[1].value), default=(False, None))[1]


def _converged(solver: Solver, violations: dict[str, Violation]) -> tuple[Status, str]:
    """Hard limits that gave way, and rows whose numbers are so small that meeting them means nothing."""
    problem, ws = solver.problem, solver.ws
    for name, found in sorted(violations.items(), key=lambda v: -v[1].value):
        term: Any = problem.ocp.terms[name]
        relaxed = _relaxed(problem, term, found)
        if not must_hold(problem, term) or found.value < min(1e-10, relaxed):
            continue
        if term.hard and found.value > relaxed:
            return Status.RELAXED, str(found)
        slope = max(solver.checks.slope(term, found, ws), 1e-300)
        if term.equality and found.value > 1e3 * solver.settings.feasibility * max(slope, 1.0):
            return Status.INFEASIBLE, f"largest violation: {found}"
        if found.value > 1e-3 * slope * (1.0 + np.abs(ws.x).max() + np.abs(ws.u).max()):
            status = Status.RELAXED if term.hard else Status.CONVERGED
            reach = f"{found.value / slope:.3g} in the variables"
            return status, f"{found}, which is {reach}: the row is too small, multiply it"
    return Status.CONVERGED, _no_minimum(solver) + certificate.unstable_interval(problem, ws).removeprefix("; ")


def _relaxed(problem: Transcription, term: Constraint, found: Violation) -> float:
    """From where on a violation of a hard limit counts as relaxed, in the residual's unit."""
    if not isinstance(term.set, Box):
        return RELAXED
    lower, upper = term.set.bounds(term.residual.size)
    i = row_names(term).index(found.row)
    share = RELAXED_SHARE * float(upper[i] - lower[i])
    same = fixed(lower, upper, ca.jacobian(problem.residual(term), problem.z))[i]
    return RELAXED if same else min(RELAXED, share)


def _no_minimum(solver: Solver) -> str:
    """What to say where the exact Hessian is not convex at the end; the Gauss-Newton one is always convex."""
    from wbmpc.solver.termination import is_minimum

    if not solver.hessian.exact or is_minimum(solver.ws.memory, solver.ws.table):
        return ""
    return "the curvature is not positive in every direction: a saddle or a maximum, no minimum; try another guess"


def _unfinished(solver: Solver, solution: Solution, missed: Violation | None, ended: Status) -> tuple[Status, str]:
    """Infeasible, no step, the iteration limit, or multipliers without bound. ``ended``: the status of the compiled code."""
    problem, ws, feasibility = solver.problem, solver.ws, solver.settings.feasibility
    status = Status.INFEASIBLE if solution.status is Status.DIVERGED else solution.status
    outside = certificate.not_finite_trial(problem, ws) if status is Status.LINE_SEARCH_FAILED else ""
    if outside:
        return status, f"a step further {outside} is not finite"
    unmet = _unmet(solver, solution, missed)
    if not missed and unmet[-1] <= feasibility:
        step = certificate.largest_step(problem, ws)
        convex = not hasattr(ws, "dx") or bool(np.isfinite(ws.dx).all())
        said = f"largest step: {step}" if convex else "the last subproblem is not convex"
        return status, said if (step or not convex) and solver.settings.compute_kkt else ""
    gap, where = certificate.largest_gap(problem, ws, solver.x0)
    if not missed and gap <= feasibility:
        return status, certificate.unsettled(
            problem, ws
        ) or "the last step met the constraints, but nothing has settled"
    held_up = (
        not missed and (problem.softness > 0.0).any()
    )  # by soft equalities: the merit has them among the violations
    if missed and gives_way(problem, problem.ocp.terms[missed.row.split(".")[0]]):
        return (
            solution.status,
            f"largest violation: {missed}, a limit that may give way, for it has a slack: more iterations",
        )
    hint = _nonlinear_hint(solver, missed)
    only_gaps = not missed and not _can_contradict(problem)
    slow = hint != "" and (not solver.hessian.exact or (missed is not None and missed.value < NEARLY))
    stuck = _stuck(unmet, feasibility) and not only_gaps
    if not (held_up or slow) and (solution.status is Status.LINE_SEARCH_FAILED or stuck):
        status = Status.INFEASIBLE
    certified, more = _certified(solver, ended) if status is Status.INFEASIBLE else (status, "")
    if missed:
        return certified, f"largest violation: {missed}{hint}{more}"
    where += more
    if where.startswith("the start") and hasattr(ws, "x_trial"):
        there = certificate.largest_gap(problem, certificate.trial(ws), solver.x0)[1]
        where += f"; a step further: {there}" if not there.startswith("the start") else ""
    return certified, where


def _certified(solver: Solver, ended: Status) -> tuple[Status, str]:
    """INFEASIBLE where that has a certificate, else how the solve ``ended``; and what is to be said of it. (In real time there is
    no time for one.)"""
    if not solver.settings.compute_kkt:
        return Status.INFEASIBLE, ""
    finding = least_violation(solver)
    if finding is Finding.MET:
        return ended, "; all constraints can be met: try more iterations or another guess"
    return Status.INFEASIBLE if finding is Finding.INFEASIBLE else ended, ""


def _nonlinear_hint(solver: Solver, missed: Violation | None) -> str:
    """What to do about an equality that is nonlinear in the inputs, where that is what is missed; empty for others.

    Steps on its linearization are too long, which is no sign that it cannot be met.
    """
    terms = nonlinear_in_the_inputs(solver.problem)
    if missed is None or missed.row.split(".")[0] not in terms:
        return ""
    hint = "more iterations or another guess" if solver.hessian.exact else 'hessian="exact"'
    return f", which is nonlinear in the inputs: try {hint}"


def _diverged(solver: Solver) -> str:
    """The largest state or input and term, and what the last step was to change most."""
    problem, ws = solver.problem, solver.ws
    parts = {
        "largest": certificate.largest_variable(problem, ws),
        "largest term": certificate.largest_term(problem, ws),
        "largest step": certificate.largest_step(problem, ws),
    }
    if not parts["largest term"] and hasattr(ws, "dx"):
        parts["largest term a step further"] = certificate.largest_term(
            problem, certificate.after_full_step(problem, ws)
        )
    free = certificate.unweighted_inputs(problem)
    if free:
        parts["no term depends on"] = f"input '{free[0]}'"
    causes = ", ".join(f"{name}: {text}" for name, text in parts.items() if text)
    start = np.abs(solver.x0).max()
    return f"the start has a state of {start:.3g}, {causes}" if start > THRESHOLDS.divergence else causes


def _multipliers_diverged(solution: Solution) -> bool:
    """Whether trajectories and costs are of a sane size: then it is what the constraints add that grows."""
    row = solution.log[-1]
    return max(abs(row[COLUMNS["cost"]]), row[COLUMNS["step"]], np.abs(solution.x).max()) < THRESHOLDS.divergence


def _violation(solver: Solver, solution: Solution, missed: Violation | None) -> np.ndarray:
    """Per iteration: gaps, equalities and hard rows (1-norm), without the equalities that a softness softens.

    The log has one number for all equalities. Where only some are soft, what is left is theirs unless something is ``missed``.
    """
    soft, log = solver.problem.softness > 0.0, solution.log
    of_soft = soft.any() and (soft.all() or missed is None)
    return log[:, COLUMNS["violation"]] - (log[:, COLUMNS["equality"]] if of_soft else 0.0)  # type: ignore[no-any-return]


def _unmet(solver: Solver, solution: Solution, missed: Violation | None) -> np.ndarray:
    """Per iteration: as :func:`_violation`, or the largest residual of a row with a multiplier."""
    return np.maximum(_violation(solver, solution, missed), solution.log[:, COLUMNS["inequality"]])  # type: ignore[no-any-return]


def _stuck(unmet: np.ndarray, feasibility: float) -> bool:
    """Whether a violation has not halved over the second half of the iterations; what is met is only rounding."""
    return bool(len(unmet) >= 10 and unmet[-1] > max(0.5 * unmet[len(unmet) // 2], feasibility))
