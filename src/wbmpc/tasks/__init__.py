"""General experiments: any robot follows a path, holds still, goes to goals, or follows velocity commands. They belong to no paper.

:func:`wbmpc.tasks.loop.closed_loop` makes a closed loop of a robot and an MPC of one's own, and :func:`wbmpc.tasks.simulation.simulate`
runs it in one call.
"""

from __future__ import annotations

#: Name -> "module:attribute", in the order of 'wbmpc list'. Entry points name the same.
EXPERIMENTS: dict[str, str] = {
    "end-effector-track": "wbmpc.tasks.track:EXPERIMENT",
    "hold": "wbmpc.tasks.hold:EXPERIMENT",
    "goals": "wbmpc.tasks.goals:EXPERIMENT",
    "cmd-vel": "wbmpc.tasks.cmd_vel:EXPERIMENT",
    "two-arms": "wbmpc.tasks.two_arms:EXPERIMENT",
    "obstacles-static": "wbmpc.tasks.obstacles:STATIC",
    "obstacles-moving": "wbmpc.tasks.obstacles:MOVING",
    "obstacles-sudden": "wbmpc.tasks.obstacles:SUDDEN",
    "corridor": "wbmpc.tasks.obstacles:CORRIDOR",
    "clutter": "wbmpc.tasks.obstacles:CLUTTER",
    "rooms": "wbmpc.tasks.rooms:EXPERIMENT",
    "pick-from-shelf": "wbmpc.tasks.pick:EXPERIMENT",
    "tip-over": "wbmpc.tasks.tip_over:EXPERIMENT",
}
