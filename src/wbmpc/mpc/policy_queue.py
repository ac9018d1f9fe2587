"""The active policy and those that become active later."""

from __future__ import annotations

from collections import deque

from wbmpc.mpc.policy import Policy


class PolicyQueue:
    """Policies and the times at which each becomes active (several when computing takes long). ``current``: the active policy; None before
    the first."""

    def __init__(self) -> None:
        self.current: Policy | None = None
        self._queue: deque[tuple[float, Policy]] = deque()

    def add(self, t: float, policy: Policy) -> None:
        """``policy`` becomes active at time ``t`` [s]; the very first one at once."""
        if self.current is None:
            self.current = policy
        else:
            self._queue.append((t, policy))

    def activate(self, t: float) -> None:
        """Make the newest policy that is due at time ``t`` [s] the current one."""
        while self._queue and self._queue[0][0] <= t + 1e-9:
            self.current = self._queue.popleft()[1]

    def at(self, t: float) -> Policy | None:
        """The policy that will be active at time ``t`` [s]."""
        found = self.current
        for start, policy in self._queue:
            if start <= t + 1e-9:
                found = policy
        return found
