"""Who may use a view's server: requests that name it as it is reached, come from its own page, and know its token.

A page of any other site can make a browser send requests to this machine. The `Host` header defeats names that are made to
resolve to it (DNS rebinding), the `Origin` header pages of others, the token everything else: other users of the machine, and
the network where the view listens there. The token is part of the address's path. A cookie would not do: browsers send those of a host to
the servers at all of its ports, also to those of other users.
"""

from __future__ import annotations

import hmac
import ipaddress
import re
import secrets
import socket
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qs

from wbmpc.errors import InputError

#: Bytes of randomness in a token.
_BYTES = 32
_LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
_WILDCARD = ("0.0.0.0", "::")
_AUTHORITY = re.compile(r"(\[[0-9a-f:.]+\]|[a-z0-9._-]+)(?::([0-9]{1,5}))?")


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches an address; names other than localhost are not looked up."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


@dataclass(frozen=True)
class Access:
    """The rule of one server at ``host``; an empty ``token``: none is needed."""

    host: str
    token: str

    @classmethod
    def of(cls, host: str, with_token: bool = True) -> Access:
        """A rule with a fresh random token, or without one, which only a loopback address may be.

        Raises :class:`InputError` for another address without a token, and for what is no address of this machine.
        """
        host = _canonical(host)
        if not (with_token or is_loopback(host)):
            raise InputError(
                f"--no-token: --host {host} is reached from other machines, which needs the token; valid: leave out --no-token, "
                f"or --host 127.0.0.1"
            )
        _check_own(host)
        return cls(host, secrets.token_urlsafe(_BYTES) if with_token else "")

    @property
    def binding(self) -> str:
        """What the server binds to: asyncio takes ``::`` for IPv6 alone, and the empty string for both versions."""
        return "" if self.host == "::" else self.host

    def url(self, port: int) -> str:
        """What a browser opens. Never a name for one version of IP: with the other one it may lead to another user's server, which
        would get the token."""
        host = {"0.0.0.0": "127.0.0.1", "::": "localhost"}.get(self.host, self.host)
        name = f"[{host}]" if ":" in host else host
        return f"http://{name}:{port}" + (f"/{self.token}/" if self.token else "")

    # ------------------------------------------------------------------ requests
    def rejection(self, path: str, headers: Any, port: int) -> str:
        """Why a request for ``path`` with ``headers`` (``get_all(name)``) at ``port`` is rejected; empty if it is not."""
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or not self._serves(hosts[0], port):
            return "the Host header is not the address of this view"
        if len(origins) > 1 or any(origin.lower() != f"http://{hosts[0].lower()}" for origin in origins):
            return "the request comes from a page of another origin"
        if (
            self.inside(path) is None
        ):  # first: the comparison below, which has the token too, takes longer the more of it is right
            return "the token is missing or wrong: open the address that the command printed"
        # the page adds where its messages go; another address there would let it talk to another server
        query = parse_qs(path.partition("?")[2], keep_blank_values=True)
        if query and query != {"websocket": [f"ws://{hosts[0].lower()}/{self.token}"]}:
            return "the address has parameters that are not its own"
        return ""

    def inside(self, path: str) -> str | None:
        """What a request is for: its path without the token, which comes first where one is needed; None if it is not there."""
        path = path.partition("?")[0]
        if not self.token:
            return path
        first, _, rest = path.removeprefix("/").partition("/")
        right = hmac.compare_digest(first.encode(errors="replace"), self.token.encode())
        return f"/{rest}" if right and path.startswith("/") else None

    def _serves(self, authority: str, port: int) -> bool:
        """Whether a `Host` header names this server."""
        match = _AUTHORITY.fullmatch(authority.lower())
        if match is None or int(match[2] or 80) != port:
            return False
        name = match[1]
        if name in _LOOPBACK or name in (self.host.lower(), f"[{self.host.lower()}]"):
            return True
        own = socket.gethostname().lower()
        return self.host in _WILDCARD and (name in (own, f"{own}.local") or _is_address(name))


def _canonical(host: str) -> str:
    """An address as browsers write it in their requests, as 127.0.0.1 of 127.1; names as they are."""
    bare = host[1:-1] if host.startswith("[") and host.endswith("]") else host
    try:
        found = str(socket.getaddrinfo(bare, None, type=socket.SOCK_STREAM, flags=socket.AI_NUMERICHOST)[0][4][0])
    except (OSError, UnicodeError):
        return host  # a name
    return str(ipaddress.ip_address(found))


def _check_own(host: str) -> None:
    """Raise :class:`InputError` for what this machine cannot listen on, and for what no browser can be given."""
    if not host:
        raise InputError(
            "--host: an address is needed; valid: 127.0.0.1 (this machine alone), 0.0.0.0 or :: (every address)"
        )
    if _is_address(host) and ":" in host and ipaddress.ip_address(host).is_link_local:
        raise InputError(
            f"--host: '{host}' is a link-local address, which needs an interface, and browsers take no address with one; valid: "
            f"another address of this machine, or :: (every address)"
        )
    try:
        for family, kind, _, _, address in socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM):
            with socket.socket(family, kind) as one:
                one.bind(address)
    except (OSError, UnicodeError) as error:
        raise InputError(
            f"--host: '{host[:80]}' is no address of this machine that a browser reaches ({error}); valid: 127.0.0.1, ::1 or "
            f"localhost (this machine alone), 0.0.0.0 or :: (every address), or one of its addresses or names"
        ) from None


def _is_address(name: str) -> bool:
    """A number cannot be made to resolve to another machine."""
    try:
        ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return False
    return True
