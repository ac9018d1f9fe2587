"""Which bus: the environment variables by which ROS 2 processes find each other, read as rcl and rmw_cyclonedds read them."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass

from wbmpc.errors import InputError

RANGES = ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT")
DISTRIBUTIONS = ("humble", "iron", "jazzy", "kilted")
#: Largest domain whose ports exist (DDSI-RTPS 2.5, section 9.6.2: 7400 + 250 domain + offsets up to 65535).
LARGEST_DOMAIN = 232
#: How many processes of one machine find each other without multicast (as in rmw_cyclonedds).
PARTICIPANTS = 32
#: Who has been silent for so long [s] has left the bus, as after a SIGKILL (DDS's default is 10 s); who lives says so six times in
#: that time.
LEASE = 3.0


@dataclass(frozen=True)
class Network:
    """``domain``: processes of other domains are not seen; ``reach``: one of :data:`RANGES`; ``peers``: addresses to ask besides.

    ``extra``: what CYCLONEDDS_URI says; ``distribution`` of ROS 2 whose message definitions hold.
    """

    domain: int = 0
    reach: str = "SUBNET"
    peers: tuple[str, ...] = ()
    extra: str = ""
    distribution: str = "jazzy"

    @classmethod
    def of(cls, environment: Mapping[str, str] | None = None) -> Network:
        """ROS_DOMAIN_ID, ROS_AUTOMATIC_DISCOVERY_RANGE, ROS_LOCALHOST_ONLY, ROS_STATIC_PEERS, ROS_DISTRO, CYCLONEDDS_URI of an
        ``environment`` (left out: the process's own).

        Raises :class:`InputError` naming the variable and what is valid.
        """
        environment = os.environ if environment is None else environment
        reach = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() or "SUBNET"
        if reach not in RANGES:
            raise InputError(f"ROS_AUTOMATIC_DISCOVERY_RANGE: '{reach}' is not known; valid: {', '.join(RANGES)}")
        peers = tuple(p.strip() for p in environment.get("ROS_STATIC_PEERS", "").split(";") if p.strip())
        only = environment.get("ROS_LOCALHOST_ONLY", "")
        if only not in ("", "0", "1"):
            raise InputError(f"ROS_LOCALHOST_ONLY: '{only}' is not known; valid: 0, 1")
        if only == "1":  # the older variable wins, as in rcl
            reach, peers = "LOCALHOST", ()
        distribution = environment.get("ROS_DISTRO", "") or "jazzy"
        if distribution not in DISTRIBUTIONS:
            raise InputError(f"ROS_DISTRO: '{distribution}' is not known; valid: {', '.join(DISTRIBUTIONS)}")
        domain = _domain(environment.get("ROS_DOMAIN_ID", ""))
        return cls(domain, reach, peers, environment.get("CYCLONEDDS_URI", ""), distribution)

    def cyclone(self) -> str:
        """Configuration of Cyclone DDS: what rmw_cyclonedds makes, so that both find each other, and besides a shorter lease and
        peers that are asked forever."""
        if self.reach == "SYSTEM_DEFAULT":
            return self.extra
        multicast = "" if self.reach == "SUBNET" else "<General><AllowMulticast>false</AllowMulticast></General>"
        if self.reach == "OFF":
            # a tag of its own: no other process can have it
            inner = f"<ParticipantIndex>none</ParticipantIndex><Tag>ros_discovery_off_{os.getpid()}</Tag>"
        else:
            peers = (("localhost",) if self.reach == "LOCALHOST" else ()) + self.peers
            listed = "".join(f'<Peer address="{p}"/>' for p in peers)
            inner = f"<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>{PARTICIPANTS}</MaxAutoParticipantIndex>"
            if listed:  # asked as long as the node lives: by default who starts 30 s later than we do is never found
                inner += f"<Peers>{listed}</Peers><InitialLocatorPruneDelay>inf</InitialLocatorPruneDelay>"
        inner += f"<LeaseDuration>{LEASE:g} s</LeaseDuration><SPDPInterval>{LEASE / 6.0:g} s</SPDPInterval>"
        own = f"<CycloneDDS><Domain>{multicast}<Discovery>{inner}</Discovery></Domain></CycloneDDS>"
        return f"{own},{self.extra}" if self.extra else own


def _domain(text: str) -> int:
    if not text:
        return 0
    if not re.fullmatch("[0-9]{1,9}", text) or int(text) > LARGEST_DOMAIN:
        raise InputError(f"ROS_DOMAIN_ID: a whole number from 0 to {LARGEST_DOMAIN} is needed, got '{text}'")
    return int(text)
