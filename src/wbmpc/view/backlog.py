"""What a new browser is given of what a server has said before it came: the messages that still hold, at the cost of these alone."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from typing import Any


def skip_replaced(buffer: Any) -> None:
    """Let a server's buffer of messages pass over those that later ones have replaced.

    viser looks at the numbers of all messages that there ever were, one by one, for every new browser, and serves nobody meanwhile: after a
    day of pictures that are tens of millions.
    """

    def window_generator(client_id: int, backlog_done_message: Any = None) -> AsyncGenerator[list[Any], None]:
        return _windows(buffer, client_id, buffer.message_counter - 1, backlog_done_message)

    buffer.window_generator = window_generator


async def _windows(buffer: Any, client: int, backlog: int, end: Any) -> AsyncGenerator[list[Any], None]:
    """The messages for one browser, several at a time; ``end`` comes after the last one up to the number ``backlog``."""
    buffer.generator_cursors[client] = sent = -1  # what none of them still needs may be forgotten
    try:
        while not buffer.done:
            window, sent = _next(buffer, client, sent, buffer.message_counter - 1 if end is None else backlog)
            buffer.generator_cursors[client] = sent
            if end is not None and sent >= backlog:
                window.append(end)
                end = None
            if window:
                yield window
            else:
                await buffer.message_event.wait()
                buffer.message_event.clear()
            if not window or sent >= buffer.message_counter - 1:
                await asyncio.sleep(buffer.window_duration_sec)  # what comes together is sent together
    finally:
        buffer.generator_cursors.pop(client, None)


def _next(buffer: Any, client: int, sent: int, last: int) -> tuple[list[Any], int]:
    """The next messages after the number ``sent`` up to ``last`` for a browser, and the number up to which there are none left out."""
    with buffer.buffer_lock:  # any thread adds and removes messages
        if buffer.atomic_counter:  # they are of one picture, which is not complete
            return [], sent
        found: list[tuple[int, Any]] = []
        for number in reversed(buffer.message_from_id):  # they are in order
            if number <= sent:
                break
            message = buffer.message_from_id[number]
            if number <= last and message.excluded_self_client != client:
                found.append((number, message))
    size = buffer.max_window_size
    if len(found) > size:
        found = found[-size:]
        last = found[0][0]
    return [message for _, message in reversed(found)], last
