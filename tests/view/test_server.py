"""What a view's server gives browsers: the messages that hold, in order; nothing of other versions; no links. Truth: viser's own order of
messages, and GitHub's rules of what is a link."""

from __future__ import annotations

import asyncio
import logging
import re
import time
from types import SimpleNamespace
from typing import Any

import pytest
from hostile import Client, get, upgrade
from test_live import free_port

from wbmpc.view.access import Access
from wbmpc.view.snapshot import plain

viser = pytest.importorskip("viser")

from viser import _messages as messages  # noqa: E402 - they come with viser
from viser.infra._async_message_buffer import AsyncMessageBuffer  # noqa: E402

from wbmpc.view.server import open_server, skip_replaced  # noqa: E402

#: Of https://github.github.com/gfm/#autolinks-extension-, as the page's Markdown looks for them in text that is no longer escaped.
LINKS = re.compile(r"(https?://|www(?=\.))([-.\w]+)|[-.\w+]+@[-\w]+(\.[-\w]+)+", re.IGNORECASE | re.ASCII)


def test_a_browser_that_comes_late_keeps_nobody_waiting() -> None:
    """After 100 million messages, some days of pictures. Each number was looked at: 25 s in which no page was served."""
    server, guard = open_server(Access.of("127.0.0.1"), free_port())
    try:
        text, url = server.gui.add_markdown("before"), guard.access.url(server.get_port())
        page = Client(url)
        server._websock_server._broadcast_buffer.message_counter += 100_000_000
        text.content = "after"
        start = time.monotonic()
        assert Client(url).hears("after") and page.hears("after")
        assert time.monotonic() - start < 10.0
    finally:
        server.stop()


def test_a_browser_is_given_the_same_as_by_viser() -> None:
    """Messages that others have replaced or removed, or that came from this browser, in several windows, and the end of the backlog."""

    async def given(own: bool) -> list[Any]:
        buffer = AsyncMessageBuffer(asyncio.get_running_loop(), persistent_messages=True, max_window_size=4)
        if own:
            skip_replaced(buffer)
        name = lambda k: messages.SetPositionMessage(f"/{k % 20}", (float(k), 0.0, 0.0))
        for k in range(57):
            message = name(k)
            message.excluded_self_client = 3 if 20 < k < 50 else None
            buffer.push(message)
        buffer.remove_from_buffer(lambda message: message.name == "/7")
        end, found = SimpleNamespace(name="end"), []
        windows = buffer.window_generator(3, backlog_done_message=end)
        for k in (58, 59):
            buffer.push(name(k))

        async def collect() -> None:
            async for window in windows:
                assert 0 < len(window) <= 5
                found.extend((m.name, getattr(m, "position", None)) for m in window)
                if len(found) == 9:
                    buffer.atomic_start()
                    buffer.push(name(5))
                    asyncio.get_running_loop().call_later(0.1, buffer.atomic_end)

        with pytest.raises(TimeoutError):
            await asyncio.wait_for(collect(), 1.0)
        await windows.aclose()
        assert not buffer.generator_cursors
        return found

    own, others = (asyncio.run(given(own)) for own in (True, False))
    assert own == others and [name for name, _ in own].count("end") == 1 and len(own) > 9


def test_the_log_has_no_token_and_no_lines_of_pages(caplog: pytest.LogCaptureFixture) -> None:
    """In full detail, of a request with a cookie of another server, and of a message that quotes itself."""
    caplog.set_level(logging.DEBUG, "wbmpc")
    access = Access.of("127.0.0.1")
    server, guard = open_server(access, free_port())
    said: list[str] = []
    guard.rejected = said.append
    try:
        url = access.url(server.get_port())
        assert get(url, Cookie="session=of-another-server")[0] == 200
        client = Client(url)
        client.send({"type": "GuiUpdateMessage", "uuid": "x", "updates": {}, "field\nERROR: forged \x1b[31m": 1})
        client.listen(0.5)
        client.drop()
    finally:
        server.stop()
    lines = [record.getMessage() for record in caplog.records]
    assert said and any("forged" in line for line in lines)
    assert not [line for line in [*lines, *said] if access.token in line or "of-another-server" in line]
    assert not [line for line in [*lines, *said] if not line.isprintable()]


@pytest.mark.parametrize(("level", "lines"), [(logging.WARNING, False), (logging.INFO, True)])
def test_pages_that_open_are_lines_of_the_log_on_request_alone(
    level: int, lines: bool, caplog: pytest.LogCaptureFixture
) -> None:
    """As of any part of the package: what "wbmpc" logs is set by the command line (--verbose)."""
    caplog.set_level(level, "wbmpc")
    caplog.handler.setLevel(logging.DEBUG)
    access = Access.of("127.0.0.1")
    server, _ = open_server(access, free_port())
    try:
        Client(access.url(server.get_port())).drop()
    finally:
        server.stop()
    assert bool(caplog.records) is lines


def test_pages_of_another_version_are_rejected(capfd: pytest.CaptureFixture[str]) -> None:
    """viser wrote a line on the standard output for each of them, where a replay prints one JSON object."""
    server, guard = open_server(Access.of("127.0.0.1"), free_port())
    try:
        url, key = guard.access.url(server.get_port()), "Sec_WebSocket_Protocol"
        capfd.readouterr()
        asking = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec_WebSocket_Version": "13"}
        asking["Sec_WebSocket_Key"] = "dGhlIHNhbXBsZSBub25jZQ=="
        for asked in ("viser-v0.0.1", f"viser-v0.0.1, viser-v{viser.__version__}", "other", ""):
            status, _, body = get(url, **asking, **{key: asked})
            assert status == 403 and b"another version" in body, asked
        assert upgrade(url) == 101 and get(url)[0] == 200
        assert "ersion" not in capfd.readouterr().out
    finally:
        server.stop()


@pytest.mark.parametrize(
    "text",
    [
        "see http://evil.example/x",
        "HTTPS://evil.example",
        "www.evil.example",
        "WWW.Evil.example",
        "me@evil.example",
        "[a](http://b.example)",
    ],
)
def test_no_text_becomes_a_link(text: str) -> None:
    """The page looks for addresses after it has taken the backslashes away."""
    shown = re.sub(r"\\(.)", r"\1", plain(text))
    assert LINKS.search(text) and not LINKS.search(shown)
    assert shown.replace("\u2060", "") == text


def test_a_header_that_comes_twice_is_a_bad_request() -> None:
    """Truth: RFC 9110, 15.5.1: the mistake is the client's, not the server's (status 500)."""
    server, guard = open_server(Access.of("127.0.0.1"), free_port())
    try:
        url = guard.access.url(server.get_port())
        for name in ("Accept-Encoding", "Upgrade"):
            twice = {name: "websocket", name.lower(): "websocket"}
            assert get(url, Sec_WebSocket_Protocol=f"viser-v{viser.__version__}", **twice)[0] == 400
        assert get(url)[0] == 200
    finally:
        server.stop()


@pytest.mark.parametrize(
    "name", ["Sec-WebSocket-Key", "Connection", "Upgrade", "Sec-WebSocket-Extensions", "Sec-WebSocket-Version"]
)
def test_a_websocket_that_is_not_asked_for_in_ascii_is_a_bad_request(name: str) -> None:
    """Truth: RFC 6455, 4.1 and 4.2.1: the fields are of ASCII, and the server answers others with 400. Cookies may be anything: those of
    another program on this machine come too."""
    server, guard = open_server(Access.of("127.0.0.1"), free_port())
    try:
        url = guard.access.url(server.get_port())
        asking = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13"}
        asking |= {
            "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
            "Sec-WebSocket-Protocol": f"viser-v{viser.__version__}",
        }
        assert get(url, **(asking | {name: asking.get(name, "") + "\xff"}))[0] == 400
        assert get(url, Cookie="caf\xe9=1")[0] == 200
    finally:
        server.stop()
