"""Raw clients of a view: requests with any headers, and messages as viser's browser client packs them."""

from __future__ import annotations

import http.client
import socket
import time
from contextlib import suppress
from importlib.metadata import version
from typing import Any
from urllib.parse import urlsplit

import msgspec
import zstandard
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Subprotocol


def get(url: str, path: str | None = None, **headers: str) -> tuple[int, dict[str, str], bytes]:
    """Status, headers and body of a plain request; by default what is at ``url``."""
    parts = urlsplit(url)
    connection = http.client.HTTPConnection(parts.hostname or "", parts.port or 80, timeout=20.0)
    target = f"{parts.path or '/'}{'?' + parts.query if parts.query else ''}" if path is None else path
    connection.putrequest("GET", target, skip_host=True)
    for name, value in {"Host": parts.netloc, **headers}.items():
        connection.putheader(name.replace("_", "-"), value)
    connection.endheaders()
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer.status, dict(answer.getheaders()), body


def socket_at(url: str, origin: str | None = None, **headers: str) -> Any:
    """An open WebSocket; ``Host`` among the headers stands in the request in place of the address."""
    parts = urlsplit(url)
    host = headers.pop("Host", parts.netloc)
    address = parts._replace(scheme="ws", netloc=host).geturl()
    return connect(
        address, origin=origin, additional_headers=headers, max_size=None, compression=None,
        subprotocols=[Subprotocol(f"viser-v{version('viser')}")], proxy=None, open_timeout=20.0,
        sock=socket.create_connection((parts.hostname, parts.port)),
    )  # type: ignore[arg-type]  # fmt: skip


def upgrade(url: str, origin: str | None = None, **headers: str) -> int:
    """Status of the answer to a WebSocket's request: 101 if it opens."""
    try:
        socket_at(url, origin, **headers).close()
    except InvalidStatus as error:
        return error.response.status_code
    return 101


def unpacked(raw: bytes) -> list[dict[str, Any]]:
    """The messages of one packet of the server."""
    size, length = (int.from_bytes(raw[i : i + 8], "little") for i in (0, 8))
    packed = zstandard.ZstdDecompressor().decompress(raw[16 : 16 + length], max_output_size=size)
    return list(msgspec.msgpack.decode(packed)["messages"])


def check_access(url: str) -> None:
    """Foreign origins and hosts, no token and a wrong one get status 403, for pages and WebSockets; a page with the token gets in."""
    place, token = urlsplit(url).netloc, urlsplit(url).path.strip("/")
    port, base = str(urlsplit(url).port), f"http://{place}"
    wrong = f"{base}/{'A' * len(token)}/"
    for foreign in (
        "http://evil.example",
        f"http://evil.example:{port}",
        "http://127.0.0.1:1",
        f"https://{place}",
        "null",
    ):
        assert (get(url, Origin=foreign)[0], upgrade(url, foreign)) == (403, 403), foreign
    for host in (
        "evil.example",
        f"evil.example:{port}",
        f"127.0.0.1.evil.example:{port}",
        "127.0.0.1",
        f"{place[:-1]}{(int(place[-1]) + 1) % 10}",
    ):
        assert (get(url, Host=host)[0], upgrade(url, Host=host)) == (403, 403), host
    for address in (
        base,
        wrong,
        f"{base}//",
        f"{base}/{token[:-1]}/",
        f"{base}/?token={token}",
        f"{base}//{token}/",
        f"{url}?websocket=ws://evil.example",
    ):
        assert (get(address)[0], upgrade(address)) == (403, 403), address
    assert get(url, Host="")[0] in (400, 403) and get(base, "/index.html")[0] == 403 and get(base, "/nothing")[0] == 403
    status, answered, body = get(url)
    assert status == 200 and b"<html" in body[:2000] and answered["X-Frame-Options"] == "DENY"
    assert "Set-Cookie" not in answered  # other servers of this host would get it
    for name in (place, f"localhost:{port}"):  # the page's WebSocket is at its own address
        assert upgrade(url[:-1], f"http://{name}", Host=name) == 101
    assert upgrade(url[:-1], "http://evil.example") == 403 and upgrade(base, Cookie=f"wbmpc-{port}={token}") == 403
    assert upgrade(url) == 101
    assert get(base, f"/{token}/{'a' * 6000}")[0] == 404 and get(base, f"/{token}/%00")[0] == 404
    assert get(base, f"/{token}/../../server.py")[0] == 404 and get(base, f"/{token}/%2e%2e/%2e%2e/server.py")[0] == 404


class Client:
    """A browser's stand-in: what the page has on it, and messages of any kind."""

    def __init__(self, url: str) -> None:
        self.url, self.socket = url, socket_at(url)
        self.controls: dict[str, str] = {}  # label: identifier
        self.texts: dict[str, str] = {}  # identifier of a text: its content
        self.history: list[str] = []
        self.send(CAMERA)  # only then the server takes it for a browser
        self.listen(1.0)

    def listen(self, seconds: float) -> None:
        """Take in what comes for a while."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0.0:
            self._receive(left)

    def _receive(self, seconds: float) -> None:
        """Take in the next packet, if one comes in time."""
        with suppress(TimeoutError):
            for message in unpacked(self.socket.recv(timeout=seconds)):
                self._take(message)

    def _take(self, message: dict[str, Any]) -> None:
        found = {**(message.get("props") or {}), **(message.get("updates") or {})}
        uuid = message.get("uuid")
        if uuid and found.get("label"):
            self.controls.setdefault(str(found["label"]), uuid)
        if uuid and "_markdown" in found:
            self.texts[uuid] = found["_markdown"]
            self.history.append(found["_markdown"])

    def hears(self, part: str, seconds: float = 20.0) -> bool:
        """Whether a text of the page comes to contain something."""
        deadline = time.monotonic() + seconds
        while not any(part in text for text in self.history):
            if (left := deadline - time.monotonic()) <= 0.0:
                return False
            self._receive(left)
        return True

    def send(self, message: Any) -> None:
        """A message; bytes and text go as they are."""
        self.socket.send(message if isinstance(message, bytes | str) else msgspec.msgpack.encode(message))

    def set(self, label: str, value: Any) -> None:
        """The value of a control by its label."""
        self.send({"type": "GuiUpdateMessage", "uuid": self.controls[label], "updates": {"value": value}})

    def move(self, name: str, position: Any, wxyz: Any) -> None:
        """A goal's handle."""
        self.send({"type": "TransformControlsUpdateMessage", "name": name, "wxyz": wxyz, "position": position})

    @property
    def alive(self) -> bool:
        """Whether the server still answers on this connection. What came before the answer is taken in: a client that reads nothing hears
        no answer either."""
        deadline = time.monotonic() + 20.0
        try:
            answered = self.socket.ping()
            while not answered.is_set() and time.monotonic() < deadline:
                self._receive(0.05)
        except ConnectionClosed:
            return False
        return answered.is_set()

    def drop(self) -> None:
        """End the connection without a word, as a browser that is killed: one that reads nothing more would be waited for."""
        with suppress(OSError):
            self.socket.socket.shutdown(socket.SHUT_RDWR)


CAMERA: dict[str, Any] = {
    "type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (3.0, 3.0, 3.0), "fov": 1.3, "near": 0.01,
    "far": 1000.0, "image_height": 700, "image_width": 1000, "look_at": (0.0, 0.0, 0.0), "up_direction": (0.0, 0.0, 1.0),
}  # fmt: skip
_NAN, _UPRIGHT = float("nan"), (1.0, 0.0, 0.0, 0.0)
#: Messages that no browser sends.
MALFORMED: tuple[Any, ...] = (
    "text", b"", b"\xc1\xff\x00", b"\x91" * 5000, b"\xdd\xff\xff\xff\xff", {"type": "Nothing"}, {"no": "type"}, [], 5,
    {"type": "GuiUpdateMessage", "uuid": "nobody", "updates": {"value": 1}},
    {"type": "GuiUpdateMessage", "uuid": 5, "updates": []},
    {**CAMERA, "position": (_NAN, 0.0, 0.0)}, {**CAMERA, "wxyz": (0.0, 0.0, 0.0, 0.0)}, {**CAMERA, "look_at": (0.0,)},
    {**CAMERA, "look_at": CAMERA["position"]}, {**CAMERA, "up_direction": (0.0, 0.0, 0.0)},
    {**CAMERA, "position": (1e9, 0.0, 0.0), "look_at": (1e9, 0.0, 1e-3)},
    {"type": "TransformControlsUpdateMessage", "name": "/goal", "wxyz": _UPRIGHT, "position": "here"},
    {"type": "TransformControlsUpdateMessage", "name": 7, "wxyz": _UPRIGHT, "position": (0.0, 0.0, 0.0)},
    {"type": "ShareUrlRequest"}, {"type": "FileTransferStartUpload", "source_component_uuid": "x", "transfer_uuid": "y"},
    {"type": "ResetSceneMessage"},
)  # fmt: skip
#: What a goal may not be: position, quaternion, and what the page says of it.
BAD_GOALS: tuple[tuple[Any, Any, str], ...] = (
    ((_NAN, 0.0, 1.0), _UPRIGHT, "numbers must be finite"),
    ((0.0, float("inf"), 1.0), _UPRIGHT, "numbers must be finite"),
    ((1e9, 0.0, 1.0), _UPRIGHT, "at most 1000, got 1e+09"),
    ((40.0, 0.0, 1.0), _UPRIGHT, "must be at most 5 m from the robot"),
    ((0.5, 0.0, 90.0), _UPRIGHT, r"height \[m\]: must be -0.5 to 3, got 90"),
    ((0.5, 0.0, 1.0), (0.0, 0.0, 0.0, 0.0), "must have the length 1, got 0"),
    ((0.5, 0.0, 1.0), (_NAN, 0.0, 0.0, 1.0), "must have the length 1, got nan"),
    ((0.5, 0.0, 1.0), (3.0, 0.0, 0.0, 0.0), "must have the length 1, got 3"),
)  # fmt: skip
