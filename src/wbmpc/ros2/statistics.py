"""What the controller's node counts and rejects, for its diagnostics."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wbmpc.ros2.control import ControlNode


def collect_statistics(controller: ControlNode) -> dict[str, Any]:
    """Values by name (times in ms, unless the name says otherwise), for diagnostics; without a runner what is known before."""
    c = controller
    values: dict[str, Any] = {"backend": c.node.backend, "age of the joint states [ms]": _ms(c.robot_io.age())}
    values["watchdog"] = f"{'armed' if c.running else 'not armed'}, {_ms(c.settings.safety.watchdog)} ms"
    values.update(rejections(c))
    if c.runner is None:
        return values
    r = c.runner.report()
    return {
        **values, **c.health.diagnostics(),
        "commands sent": c.robot_io.sent,
        "began at [s]": f"{c.stamp_of(0.0):.4f}",
        "task": c.task,
        "solve: median [ms]": _ms(r.solve.median), "solve: 95 % [ms]": _ms(r.solve.p95), "solve: max [ms]": _ms(r.solve.max),
        "missed deadlines of the MPC": r.mpc_misses, "missed deadlines of the controller": r.misses,
        **c.orders.counts(),
        **plan_clearance(c), "constraint violation": f"{c.adapter.mpc.solve_info['violation']:.2e}",
        "updates": r.updates, "failed solves": r.failures, "late policies": r.late,
        "observation to active policy: median [ms]": _ms(r.latency.median), "clamped ticks": r.clamped,
        "tick begins late: 99 % [ms]": _ms(r.jitter.p99), "tick takes: median [ms]": _ms(r.tick.median),
        "tick takes: 99 % [ms]": _ms(r.tick.p99), "command after its tick's time: median [ms]": _ms(r.sent.median),
        "command after its tick's time: 99 % [ms]": _ms(r.sent.p99),
        **{f"late commands: {part}": count for part, count in r.late_commands.items()},
    }  # fmt: skip


def plan_clearance(controller: ControlNode) -> dict[str, Any]:
    """The pair of the plan that lacks most of its margin, and how many plans were replaced by a stop, of a node that hears of obstacles."""
    mpc = controller.adapter.mpc
    if mpc.obstacles is None:
        return {}
    return {"clearance of the plan": str(mpc.clearance), "plans that stop at obstacles": mpc.statistics.braking_plans}


def rejections(controller: ControlNode) -> dict[str, str]:
    """What was rejected, and why: goals, orders to the base, poses; until one is taken again. And speeds that are limited."""
    c = controller
    reasons = {
        "rejected": c.request_queue.rejected,
        **c.orders.rejections(),
        "rejected pose": c.source.fault,
        "rejected obstacles": c.obstacles.fault,
        "limited speed": c.request_queue.limited,
    }
    return {key: why for key, why in reasons.items() if why}


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3f}"
