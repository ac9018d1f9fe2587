"""Domains of DDS in this process: each is configured once, and stays, and so do the types of its topics.

Cyclone DDS looks through its library of types without a lock when a topic is made, while it removes the types of endpoints that were
deleted before, in a thread of its own: a node that opened soon after another one had closed could crash the process. So participants
of closed nodes are kept, with their topics, for the next node.
"""

from __future__ import annotations

import atexit
import ctypes
import re
import socket
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Protocol

from cyclonedds.core import DDSException, Policy
from cyclonedds.core import Qos as DdsQos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.internal import load_cyclonedds
from cyclonedds.topic import Topic

from wbmpc.errors import InputError
from wbmpc.ros2.network import Network

#: Fatal and other errors in the middleware's own log; its warnings are the other bit. One comes with every malformed message.
_ERRORS = 1 | 2
#: So long [s] addresses of peers are looked for.
RESOLVED = 5.0
_DOMAINS: dict[int, tuple[Network, Domain]] = {}
_LOCK = threading.Lock()


@dataclass
class Participant:
    """A participant of a domain, of one node at a time. ``topics`` of it by name in DDS and type of message: they stay."""

    entity: DomainParticipant
    topics: dict[tuple[str, str], Topic] = field(default_factory=dict)

    def topic(self, name: str, kind: str, carry: type) -> Topic:
        """The topic ``name`` for messages of the type ``kind``, as which ``carry`` stands in DDS."""
        if (name, kind) not in self.topics:
            self.topics[name, kind] = Topic(self.entity, name, carry)
        return self.topics[name, kind]


class Closes(Protocol):
    """A node."""

    def close(self) -> None:
        """Leave the bus."""


#: Nodes that are open. A reader that Python collects lives on in DDS, which then calls a listener that is gone: the
#: package takes the weak reference, which is dead by then, for a sign that the reader was deleted already.
OPEN: set[Closes] = set()
#: Of closed nodes, by domain.
_IDLE: dict[int, list[Participant]] = {}


def take_participant(domain: int) -> Participant:
    """A participant without endpoints. Raises :class:`InputError` if the domain has no room for another one."""
    with _LOCK:
        if _IDLE.get(domain):
            return _IDLE[domain].pop()
    try:
        return Participant(DomainParticipant(domain, qos=DdsQos(Policy.Userdata(b"enclave=/;"))))
    except DDSException as error:
        raise InputError(f"DDS: no participant in domain {domain} ({error})") from error


def return_participant(domain: int, participant: Participant) -> None:
    """Keep the participant of a node that has closed, and whose endpoints are deleted, for the next one."""
    with _LOCK:
        _IDLE.setdefault(domain, []).append(participant)


@atexit.register
def _leave() -> None:
    """Others see the participants go at once, not when their lease ends. Readers go before the interpreter does: its end deletes them while
    they call back, and each waits for the other."""
    for node in list(OPEN):
        with suppress(InputError):
            node.close()
    with _LOCK:
        for participant in (p for idle in _IDLE.values() for p in idle):
            participant.entity.__del__()
        _IDLE.clear()


def open_domain(network: Network) -> None:
    """Configure the network's domain, unless it is. Raises :class:`InputError` for what the middleware does not take, and if the
    domain is open with other settings."""
    with _LOCK:
        known = _DOMAINS.get(network.domain)
        if known is None:
            _DOMAINS[network.domain] = network, _opened(network)
        elif known[0] != network:
            raise InputError(f"DDS: domain {network.domain} is open in this process with other settings")


def _addresses(peers: tuple[str, ...]) -> tuple[str, ...]:
    """Peers (HOST or HOST:PORT) as ADDRESS or ADDRESS:PORT. Raises :class:`InputError` for one that has no address, for which the
    middleware would abort the process, and where name servers do not answer within :data:`RESOLVED`."""
    parts = [re.fullmatch(r"([^\s:/,]+)(?::([0-9]{1,5}))?", peer) for peer in peers]
    names = ["" if p is None or int(p[2] or 0) >= 2**16 else p[1] for p in parts]
    hosts = dict.fromkeys(filter(None, names), "")

    def resolve(host: str) -> None:
        with suppress(OSError, UnicodeError, IndexError):
            hosts[host] = str(socket.getaddrinfo(host, None, socket.AF_INET)[0][4][0])

    # neither a signal nor a time limit ends the system's own look-up: each has a thread that the process does not wait for
    looking = {host: threading.Thread(target=resolve, args=[host], daemon=True) for host in hosts}
    for thread in looking.values():
        thread.start()
    end = time.monotonic() + RESOLVED
    for thread in looking.values():
        thread.join(max(end - time.monotonic(), 0.0))
    found = []
    for peer, host in zip(peers, names, strict=True):
        if not hosts.get(host):
            waits = host in looking and looking[host].is_alive()
            why = f"was not found within {RESOLVED:g} s" if waits else "has no address that is known here"
            raise InputError(f"ROS_STATIC_PEERS: '{peer[:300]}' {why}; valid: HOST or HOST:PORT")
        found.append(hosts[host] + peer[len(host) :])
    return tuple(found)


def _opened(network: Network) -> Domain:
    """The middleware writes its log to stderr, at any rate and from its own threads: without its warnings, unless CYCLONEDDS_URI
    asks for a trace."""
    if network.reach in ("SUBNET", "LOCALHOST"):  # else they are not asked
        network = replace(network, peers=_addresses(network.peers))
    try:
        domain = Domain(network.domain, network.cyclone())
    except (DDSException, UnicodeEncodeError) as error:
        settings = " and ".join(
            n for n, v in (("ROS_STATIC_PEERS", network.peers), ("CYCLONEDDS_URI", network.extra)) if v
        )
        why = f"; look at {settings}" if settings else ""
        raise InputError(f"DDS: domain {network.domain} cannot be opened ({error}{why})") from error
    if "Tracing" not in network.extra:
        load_cyclonedds().dds_set_log_mask(ctypes.c_uint32(_ERRORS))
    return domain
