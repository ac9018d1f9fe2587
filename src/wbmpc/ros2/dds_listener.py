"""Callbacks of DDS entities, and how they end."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from cyclonedds.core import Listener
from cyclonedds.sub import DataReader

Take = Callable[[DataReader], None]


class Watch(Listener):  # type: ignore[misc]
    """``take`` for new data; ``mismatch`` with the number of the policy in which two endpoints do not agree; ``come`` when a
    reader has one more writer, or one less."""

    def __init__(
        self, mismatch: Callable[[int], None] | None, take: Take | None = None, come: Take | None = None
    ) -> None:
        super().__init__()
        if come is not None:
            self.set_on_subscription_matched(lambda reader, _: come(reader))
        if take is not None:
            self.set_on_data_available(take)
        if mismatch is not None:
            notice = lambda _, status: mismatch(int(status.last_policy_id))
            (self.set_on_offered_incompatible_qos if take is None else self.set_on_requested_incompatible_qos)(notice)


def silence(entity: Any) -> None:
    """End an entity's callbacks; none runs when this returns.

    The package forgets its listener before DDS does: a thread that is about to enter a callback, and waits for the interpreter,
    would enter machine code that a garbage collection of another thread has freed meanwhile. So it is kept until DDS has let go.
    """
    kept = entity._listener
    entity.set_listener(None)  # returns when the callbacks that have begun have ended
    del kept
