"""Domains of DDS in this process: each is configured once, and stays."""

from __future__ import annotations

import ctypes
import threading

from cyclonedds.core import DDSException
from cyclonedds.domain import Domain
from cyclonedds.internal import load_cyclonedds

from wbmpc.errors import InputError
from wbmpc.ros2.network import Network

#: Fatal and other errors in the middleware's own log; its warnings are the other bit. One comes with every malformed message.
_ERRORS = 1 | 2
_DOMAINS: dict[int, tuple[Network, Domain]] = {}
_LOCK = threading.Lock()


def open_domain(network: Network) -> None:
    """Configure the network's domain, unless it is. Raises :class:`InputError` for what the middleware does not take, and if the
    domain is open with other settings."""
    with _LOCK:
        known = _DOMAINS.get(network.domain)
        if known is None:
            _DOMAINS[network.domain] = network, _opened(network)
        elif known[0] != network:
            raise InputError(f"DDS: domain {network.domain} is open in this process with other settings")


def _opened(network: Network) -> Domain:
    """The middleware writes its log to stderr, at any rate and from its own threads: without its warnings, unless CYCLONEDDS_URI
    asks for a trace."""
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
