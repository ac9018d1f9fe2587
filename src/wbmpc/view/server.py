"""The server behind every view: viser's, with a guard before its requests and its messages.

What a new browser is given of what a server has said before it came: the messages that still hold, at the cost of these alone.
"""

from __future__ import annotations

import asyncio
import logging
import math
import threading
import time
from collections.abc import AsyncGenerator, Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from http import HTTPStatus
from typing import Any

import viser
from websockets.asyncio import server as websockets_server
from websockets.datastructures import Headers
from websockets.frames import Frame, Opcode
from websockets.http11 import Response
from websockets.protocol import State

from wbmpc.errors import InputError, printable
from wbmpc.logs import RateLimitFilter
from wbmpc.view.access import Access
from wbmpc.view.frames import LARGEST, checked


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


_PATCH = threading.Lock()
#: Rejected messages that cost their senders no time, and how many more of them are read in a second, of all pages together; also
#: what else than whole messages (pings, parts) one connection may send.
_FREE, _REJECTED_RATE = 200, 500.0
#: How many messages of one page are read in a second: a drag sends some 60, and moves the camera.
_RATE = 500.0
#: Connections at a time, of all clients together: each is an open file, and the run that is shown needs files too.
MAX_CONNECTIONS = 100
#: Of every answer: no other page may frame this one (clicks would be the user's), learn its address, or keep a copy.
_HEADERS = {
    "X-Frame-Options": "DENY", "Content-Security-Policy": "frame-ancestors 'none'", "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store", "X-Content-Type-Options": "nosniff", "Cross-Origin-Resource-Policy": "same-origin",
}  # fmt: skip


class Throttle:
    """How long who sent a message that was rejected waits before the next one is read: a flood of them must not keep the server
    from others. ``free`` messages cost nothing, then there are ``rate`` in a second of ``clock``."""

    def __init__(self, free: int, rate: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._free, self._rate, self._clock, self._until = free, rate, clock, -math.inf

    def wait(self) -> float:
        """Count a message; how long to wait [s]."""
        now = self._clock()
        self._until = max(self._until, now - self._free / self._rate) + 1.0 / self._rate
        return max(self._until - now, 0.0)


class Wakeup:
    """An :class:`asyncio.Event` that any thread may set, for viser does so: it sets the event of a message's buffer in the thread that
    sends, and then lets the server's thread set it, too. Only the latter wakes who waits. Made in the server's thread."""

    def __init__(self) -> None:
        self._event, self._set, self._thread = asyncio.Event(), False, threading.get_ident()

    def set(self) -> None:
        """There is something new."""
        self._set = True
        if threading.get_ident() == self._thread:
            self._event.set()

    def clear(self) -> None:
        """It is taken in; in the server's thread."""
        self._set = False
        self._event.clear()

    async def wait(self) -> None:
        """Until there is something new; in the server's thread."""
        if not self._set:
            await self._event.wait()


class Guard:
    """Stands before a server: rejects requests by ``access`` with status 403, and messages that are not as they should be.

    ``rejected(reason)`` is called, in the server's thread, for messages of a page that were left out.
    """

    def __init__(self, access: Access) -> None:
        self.access = access
        self.rejected: Callable[[str], None] = lambda reason: None
        self._throttle = Throttle(_FREE, _REJECTED_RATE)
        self.server: viser.ViserServer | None = None
        #: The oldest first, with their transports.
        self.connections: dict[Any, Any] = {}
        self.installed = False
        # not one of the registered loggers: their filters would add up over several servers
        self.log = logging.Logger("wbmpc.view")
        self.log.parent = parent = logging.getLogger("wbmpc")
        self.log.addFilter(RateLimitFilter(brief=True))
        # below INFO, every request is logged as it came: with the token, and cookies of other servers
        self.log.setLevel(max(logging.INFO, parent.getEffectiveLevel()))

    # ------------------------------------------------------------------ requests
    def answer(self, connection: Any, request: Any, serve: Callable[..., Any]) -> Any:
        """The answer to a request; None lets a WebSocket begin."""
        port = int(connection.local_address[1])
        reason = self.access.rejection(request.path, request.headers, port) or _other_version(request.headers)
        if not reason and self.server is None:  # what browsers may find is still being made
            response = _text(HTTPStatus.SERVICE_UNAVAILABLE)
        elif reason:
            self.log.warning("view: a request was rejected: %s", reason)
            response = _text(HTTPStatus.FORBIDDEN, reason)
        elif not _plain(request.headers):  # the library would fail at it while it answers
            response = _text(HTTPStatus.BAD_REQUEST)
        else:
            try:
                response = serve(connection, replace(request, path=self.access.inside(request.path)))
            except (OSError, ValueError):  # no name of a file
                response = _text(HTTPStatus.NOT_FOUND)
            except LookupError:  # a header that may come once came again
                response = _text(HTTPStatus.BAD_REQUEST)
        if response is not None:
            for name, value in _HEADERS.items():
                response.headers[name] = value
        return response

    # ------------------------------------------------------------------ messages
    def take(self, raw: bytes | str) -> bytes | None:
        """A message as the server may have it; None if it is left out."""
        try:
            return checked(raw, self._input)
        except InputError as error:
            reason = printable(str(error))  # it quotes the message, whose lines must not pass for others of the log
            self.log.warning("view: %s", reason)
            self.rejected(reason)
            return None

    def admit(self, connection: Any, transport: Any) -> bool:
        """Count a connection; False, and it is closed, if there are too many. Instead of it the oldest one is closed that has not
        yet made its request: many idle connections do not lock out a client with the token."""
        if len(self.connections) >= MAX_CONNECTIONS:
            self.log.warning("view: a connection was closed: there are %d, the most that are served", MAX_CONNECTIONS)
            silent = next((c for c in self.connections if c.state is State.CONNECTING), None)
            if silent is None:
                transport.abort()
                return False
            self.connections.pop(silent).abort()
        self.connections[connection] = transport
        return True

    def close_connection(self, transport: Any) -> None:
        """End the connection of a client that floods."""
        reason = "a connection was closed: it sent too many pings or parts of messages"
        if not transport.is_closing():
            self.log.warning("view: %s", reason)
            self.rejected(reason)
        transport.abort()

    def _input(self, uuid: str) -> Any:
        return None if self.server is None else self.server.gui._gui_input_handle_from_uuid.get(uuid)

    # ------------------------------------------------------------------ installation
    @contextmanager
    def guard_new_server(self) -> Iterator[None]:
        """While this holds, a server that is started gets the guard: viser has no way to hand it over."""
        serve = websockets_server.serve
        guard = self

        class Connection(websockets_server.ServerConnection):
            admitted = False
            throttle: Throttle | None = None
            good: Throttle | None = None

            def connection_made(self, transport: asyncio.BaseTransport) -> None:
                self.admitted = guard.admit(self, transport)
                if self.admitted:
                    super().connection_made(transport)

            def connection_lost(self, exc: Exception | None) -> None:
                guard.connections.pop(self, None)
                if self.admitted:
                    super().connection_lost(exc)

            def process_event(self, event: Any) -> None:
                """Pings are answered, and parts of a message kept, as they come: who sends many of them would fill the memory."""
                if isinstance(event, Frame) and not (event.fin and event.opcode in (Opcode.TEXT, Opcode.BINARY)):
                    self.throttle = self.throttle or Throttle(_FREE, _REJECTED_RATE)
                    if self.throttle.wait() > 0.0:
                        guard.close_connection(self.transport)
                        return
                super().process_event(event)

            async def recv(self, decode: bool | None = None) -> Any:
                self.good = self.good or Throttle(_FREE, _RATE)
                while True:
                    message = guard.take(await super().recv(decode))
                    if message is not None:
                        await asyncio.sleep(self.good.wait())  # what a page may send, it may not send at any rate
                        return message
                    await asyncio.sleep(guard._throttle.wait())

        def guarded(handler: Any, *place: Any, process_request: Any, **options: Any) -> Any:
            guard.installed = True
            asyncio.get_running_loop().set_exception_handler(guard._failed)
            options |= {"create_connection": Connection, "max_size": LARGEST, "logger": self.log}
            answer = lambda connection, request: guard.answer(connection, request, process_request)
            return serve(handler, *place, process_request=answer, **options)

        with _PATCH:
            websockets_server.serve = guarded  # type: ignore[misc,assignment]
            try:
                yield
            finally:
                websockets_server.serve = serve  # type: ignore[misc]

    def _failed(self, loop: Any, context: dict[str, Any]) -> None:
        self.log.warning("view: %s", context.get("message", "an error"), exc_info=context.get("exception"))


def _text(status: HTTPStatus, reason: str = "") -> Response:
    text = f"{status.value}: {reason or status.phrase}\n".encode()
    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(text))})
    return Response(status.value, status.phrase, headers, text)


def _plain(headers: Headers) -> bool:
    """Whether what asks for a WebSocket is ASCII, as it has to be: other bytes come as halves of surrogates, which no text that is sent
    may have."""
    asks = ("connection", "upgrade", "sec-websocket-")
    return all(value.isascii() for name, value in headers.raw_items() if name.lower().startswith(asks))


def _other_version(headers: Headers) -> str:
    """Why a WebSocket is rejected that was asked for by a page of another version; empty if it was not. viser itself prints a line on the
    standard output for each of them."""
    if "websocket" not in headers.get_all("Upgrade"):
        return ""
    asked = [name.strip() for value in headers.get_all("Sec-WebSocket-Protocol") for name in value.split(",")]
    known = asked == [f"viser-v{viser.__version__}"]
    return "" if known else "the page is of another version: load it again"


def open_server(access: Access, port: int, label: str = "wbmpc") -> tuple[viser.ViserServer, Guard]:
    """A server at the address of ``access``, and its guard. A busy ``port`` is passed over."""
    guard = Guard(access)
    with guard.guard_new_server():
        server = viser.ViserServer(host=access.binding, port=port, label=label, verbose=False)
    if not guard.installed:  # another version of viser starts its server in another way: no client would be rejected
        server.stop()
        raise InputError("view: this version of viser cannot be guarded; valid: viser 1.1")
    websocket = server._websock_server
    skip_replaced(websocket._broadcast_buffer)

    async def connected(client: Any) -> None:
        for buffer in (websocket._broadcast_buffer, client._state.message_buffer):
            if not isinstance(buffer.message_event, Wakeup):  # before anything waits for it
                buffer.message_event = Wakeup()

    websocket.on_client_connect(connected)
    guard.server = server  # only now requests are answered
    return server, guard
