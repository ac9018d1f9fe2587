"""Who gets into a view. Truth: the rules of browsers for `Origin`, `Host` and cookies, and raw clients that break them."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from filmed import copy_film
from hostile import check_access, get, upgrade
from test_live import free_port
from websockets.datastructures import Headers

from wbmpc.cli import main
from wbmpc.errors import InputError
from wbmpc.view.access import Access, is_loopback

pytest.importorskip("viser")


def headers(*pairs: tuple[str, str]) -> Headers:
    found = Headers()
    for name, value in pairs:
        found[name] = value
    return found


def ipv6() -> bool:
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        return False
    return True


def rejected(access: Access, *pairs: tuple[str, str], path: str = "/") -> bool:
    return access.rejection(path, headers(*pairs), 8080) != ""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("film")
    copy_film(folder)
    return folder


def started(*command: str) -> tuple[subprocess.Popen[str], str]:
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2] / "src")}
    process = subprocess.Popen(
        [sys.executable, "-m", "wbmpc", *command, "--json", "--port", str(free_port())],
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout is not None
    return process, json.loads(process.stdout.readline())["url"]


def test_only_the_page_with_the_token_gets_in(recording: Path) -> None:
    """A replay; ``test_hostile_page`` has the views of runs. SIGTERM ends with 143."""
    process, url = started("replay", str(recording))
    try:
        check_access(url)
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=60)
    finally:
        process.kill()
        process.communicate()
    assert process.returncode == 143 and "Traceback" not in err and "a" * 100 not in err
    assert (
        len([line for line in err.splitlines() if "rejected" in line]) <= 5 + 2
    )  # one of each cause, not one of each request


def test_requests_of_other_sites_are_rejected() -> None:
    access = Access("127.0.0.1", "")
    assert not rejected(access, ("Host", "127.0.0.1:8080")) and not rejected(access, ("Host", "LOCALHOST:8080"))
    assert not rejected(access, ("Host", "[::1]:8080"), ("Origin", "http://[::1]:8080"))
    assert rejected(access) and rejected(access, ("Host", "127.0.0.1:8080"), ("Host", "evil.example:8080"))
    same = ("Host", "localhost:8080")
    assert not rejected(access, same, ("Origin", "http://localhost:8080"))
    for origin in ("http://127.0.0.1:8080", "http://localhost:8081", "http://localhost", "null", "", "file://"):
        assert rejected(access, same, ("Origin", origin)), origin
    assert rejected(access, same, ("Origin", "http://localhost:8080"), ("Origin", "http://evil.example"))
    assert rejected(Access("127.0.0.1", ""), ("Host", "localhost:8080"), path="/?websocket=ws://evil.example")
    secret = Access("127.0.0.1", "secret")
    for server in ("ws://localhost:8080/secret", "ws://localhost:8080/other", "ws://evil.example/secret", ""):
        path = f"/secret/?websocket={server}"  # the page itself adds the first one to its address
        assert rejected(secret, same, path=path) == (server != "ws://localhost:8080/secret"), server
    assert rejected(secret, same, path="/secret/?websocket=ws://localhost:8080/secret&websocket=ws://evil.example")
    inside = {"/secret": "/", "/secret/": "/", "/secret/a/b": "/a/b", "/secret?a/b": "/"}
    outside = (
        "",
        "/",
        "/secre",
        "/secrets",
        "secret",
        "secret/",
        "//secret/",
        "/?token=secret",
        "http://evil.example/secret/",
        "/sécret",
    )
    assert {path: secret.inside(path) for path in (*inside, *outside)} == {**inside, **dict.fromkeys(outside)}
    assert Access("127.0.0.1", "").rejection("/", headers(("Host", "localhost")), 80) == ""


def test_who_does_not_know_the_token_learns_nothing_by_asking_with_parts_of_it() -> None:
    """The token stands in the page's own parameter, too: what that is is looked at only where the path is right."""
    access, same = Access("127.0.0.1", "secret"), ("Host", "localhost:8080")
    guesses = ("", "s", "secre", "secret", "secret2")
    answers = {access.rejection(f"/wrong/?websocket=ws://localhost:8080/{g}", headers(same), 8080) for g in guesses}
    assert len(answers) == 1 and "the token is missing or wrong" in answers.pop()


def test_a_view_for_the_network_is_reached_by_numbers_and_its_own_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """A name that somebody else owns may be made to resolve to this machine; a number cannot."""
    monkeypatch.setattr("socket.gethostname", lambda: "robot7")
    everywhere, one = Access("0.0.0.0", ""), Access("192.168.1.7", "")
    for name, at_everywhere, at_one in (
        ("192.168.1.7", False, False), ("192.168.1.8", False, True), ("robot7", False, True), ("robot7.local", False, True),
        ("evil.example", True, True), ("192.168.1.7.evil.example", True, True), ("localhost", False, False),
    ):  # fmt: skip
        host = ("Host", f"{name}:8080")
        assert (rejected(everywhere, host), rejected(one, host)) == (at_everywhere, at_one), name


def test_tokens_are_random_and_needed_beyond_this_machine(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    tokens = {Access.of("127.0.0.1").token for _ in range(20)}
    assert len(tokens) == 20 and min(map(len, tokens)) >= 43  # 256 bits
    assert all(map(is_loopback, ("127.0.0.1", "localhost", "::1", "127.3.2.1")))
    assert Access.of("127.0.0.1", with_token=False).url(80) == "http://127.0.0.1:80"
    for host in ("0.0.0.0", "::", "192.168.1.7", "robot7", "127.0.0.1.evil.example"):
        with pytest.raises(InputError, match="which needs the token"):
            Access.of(host, with_token=False)
    for command in (
        ("run", "swerve-track", "--view"),
        ("view", "rezero"),
        ("view", "rezero", "--realtime"),
        ("replay", "x"),
    ):
        assert main([*command, "--host", "0.0.0.0", "--no-token"]) == 2
        assert "--no-token: --host 0.0.0.0 is reached from other machines" in capsys.readouterr().err


@pytest.mark.parametrize(
    "host", ["203.0.113.9", "no.such.host.invalid", "a b", "127.0.0.1:80", "x" * 300, "fd00::bad:1"]
)
def test_an_address_of_another_machine_is_an_error_at_once(
    host: str, recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """viser tries a thousand ports at it, and then waits forever. 203.0.113.0/24 is nobody's (RFC 5737)."""
    assert main(["replay", str(recording), "--host", host]) == 2
    err = capsys.readouterr().err
    assert f"--host: '{host[:80]}' is no address of this machine" in err and "valid: 127.0.0.1, ::1 or localhost" in err


@pytest.mark.parametrize("host", ["fe80::1", "fe80::1%lo", "[fe80::1%eth0]"])
def test_a_link_local_address_is_none_for_browsers(host: str) -> None:
    """WHATWG's URLs have no zone, without which such an address leads nowhere."""
    with pytest.raises(
        InputError, match=r"--host: .* is a link-local address, which needs an interface, and browsers take no address"
    ):
        Access.of(host)


def test_no_host_is_not_every_address() -> None:
    """``--host "$HOST"`` with a variable that is not set must not open the view to the network."""
    with pytest.raises(InputError, match="--host: an address is needed"):
        Access.of("")


def test_addresses_are_written_as_browsers_write_them() -> None:
    """A browser that is given 127.1 asks for 127.0.0.1; and `localhost` may be another user's server for the other version of IP."""
    for host, url in {
        "127.1": "http://127.0.0.1:80", "[127.0.0.1]": "http://127.0.0.1:80", "0": "http://127.0.0.1:80",
        "0.0.0.0": "http://127.0.0.1:80", "localhost": "http://localhost:80",
    }.items():  # fmt: skip
        access = Access.of(host)
        assert access.url(80) == f"{url}/{access.token}/"
        assert not rejected(Access(access.host, ""), ("Host", f"{url[7:-3]}:8080"))


@pytest.mark.skipif(not ipv6(), reason="this machine has no IPv6")
def test_ipv6_gets_in_with_the_token() -> None:
    """``::`` is every address, those of IPv4 too."""
    from wbmpc.view.server import open_server

    for host in ("::1", "[::1]", "0:0:0:0:0:0:0:1", "::"):
        server, guard = open_server(Access.of(host), free_port())
        try:
            url = guard.access.url(server.get_port()).replace("localhost", "[::1]")
            assert url.startswith("http://[::1]:")
            check_access(url)
            if host == "::":
                check_access(url.replace("[::1]", "127.0.0.1"))
        finally:
            server.stop()


def test_without_a_token_other_sites_stay_outside(recording: Path) -> None:
    process, url = started("replay", str(recording), "--no-token")
    try:
        assert url.count("/") == 2 and get(url)[0] == 200 and upgrade(url) == 101 and upgrade(url, url) == 101
        assert upgrade(url, "http://evil.example") == 403 and get(url, Host="evil.example")[0] == 403
    finally:
        process.kill()
        process.communicate()
