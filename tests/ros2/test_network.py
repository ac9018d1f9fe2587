"""Which bus. Truth: rcl's documentation of the variables; two nodes that do or do not hear each other."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
import threading
import time
from typing import Any

import pytest
from needs import everything, needs_dds, private, wait_until

from effort import thorough
from wbmpc.errors import InputError
from wbmpc.ros2.bus import LATCHED
from wbmpc.ros2.network import Network
from wbmpc.ros2.opening import open_node


def test_nothing_set_is_the_default_of_ros() -> None:
    network = Network.of({})
    assert (network.domain, network.reach, network.peers, network.distribution) == (0, "SUBNET", (), "jazzy")
    assert "AllowMulticast" not in network.cyclone() and "Peer " not in network.cyclone()


def test_the_older_variable_wins_when_it_is_on() -> None:
    both = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_STATIC_PEERS": "192.0.2.1"}
    assert Network.of({**both, "ROS_LOCALHOST_ONLY": "1"}) == Network(reach="LOCALHOST")
    assert Network.of({**both, "ROS_LOCALHOST_ONLY": "0"}) == Network(peers=("192.0.2.1",))


def test_ranges_become_settings_of_the_middleware() -> None:
    local = Network(reach="LOCALHOST").cyclone()
    assert "<AllowMulticast>false<" in local and '<Peer address="localhost"/>' in local
    # "InitialLocatorPruneDelay" in Cyclone's documentation: how long peers are asked that do not answer
    assert "<InitialLocatorPruneDelay>inf</InitialLocatorPruneDelay>" in local
    off = Network(reach="OFF").cyclone()
    assert "<Tag>ros_discovery_off_" in off and "Peer " not in off
    assert "<LeaseDuration>3 s</LeaseDuration><SPDPInterval>0.5 s</SPDPInterval>" in off
    assert Network(reach="SYSTEM_DEFAULT", extra="file:///x.xml").cyclone() == "file:///x.xml"
    assert Network(peers=("192.0.2.7",), extra="<X/>").cyclone().endswith("</CycloneDDS>,<X/>")


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("ROS_DOMAIN_ID", "233", "from 0 to 232"),
        ("ROS_DOMAIN_ID", "-1", "from 0 to 232"),
        ("ROS_DOMAIN_ID", "home", "'home'"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "HOUSE", "SUBNET, LOCALHOST, OFF"),
        ("ROS_LOCALHOST_ONLY", "yes", "valid: 0, 1"),
        ("ROS_DISTRO", "noetic", "jazzy"),
    ],
)
def test_a_wrong_variable_is_named(name: str, value: str, says: str) -> None:
    with pytest.raises(InputError, match=rf"{name}.*{re.escape(says)}"):
        Network.of({name: value})


@needs_dds
@pytest.mark.parametrize("peer", ["nobody", "::1", "127.0.0.1:70000", "127.0.0.1,127.0.0.1", "a b", "<x>"])
def test_a_peer_without_an_address_is_named(peer: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The middleware aborted the process."""

    def resolve(host: str, *given: object) -> list[Any]:
        if host != "127.0.0.1":
            raise OSError("unknown")
        return [(socket.AF_INET, socket.SOCK_DGRAM, 17, "", (host, 0))]

    from wbmpc.ros2 import dds_domain

    monkeypatch.setattr(dds_domain.socket, "getaddrinfo", resolve)
    monkeypatch.setattr(dds_domain, "Domain", lambda *given: pytest.fail("the middleware got it"))
    with pytest.raises(InputError, match=f"ROS_STATIC_PEERS: '{re.escape(peer)}' has no address"):
        dds_domain._opened(Network(peers=("127.0.0.1:7410", peer)))


@needs_dds
def test_names_of_peers_are_looked_up_once_and_not_forever(monkeypatch: pytest.MonkeyPatch) -> None:
    """A name server that does not answer kept the node from starting, deaf to Ctrl-C, for as long as the system's resolver likes. And the
    middleware, which aborts the process where a name has no address, looked up again what had been found before."""
    from wbmpc.ros2 import dds_domain

    answered, configurations = threading.Event(), []

    def resolve(host: str, *given: object) -> list[Any]:
        if host == "slow":
            answered.wait(60.0)
        return [(socket.AF_INET, socket.SOCK_DGRAM, 17, "", ("192.0.2.7", 0))]

    monkeypatch.setattr(dds_domain.socket, "getaddrinfo", resolve)
    monkeypatch.setattr(dds_domain, "RESOLVED", 0.2)
    monkeypatch.setattr(dds_domain, "Domain", lambda domain, given: configurations.append(given))
    dds_domain._opened(Network(peers=("robot:7410", "robot")))
    (configuration,) = configurations
    assert re.findall('Peer address="([^"]*)"', configuration) == ["192.0.2.7:7410", "192.0.2.7"]
    begin = time.monotonic()
    with pytest.raises(InputError, match="ROS_STATIC_PEERS: 'slow' was not found within"):
        dds_domain._opened(Network(peers=("robot", "slow")))
    assert time.monotonic() - begin < 20.0
    answered.set()


def heard(one: dict[str, str], other: dict[str, str], seconds: float = 0.7) -> bool:
    """Whether a latched message of a node gets to another one in that time [s]. Domains differ: a process configures one once."""
    nodes = [open_node(f"n{i}", "dds", Network.of(e)) for i, e in enumerate((one, other))]
    got: list[object] = []
    nodes[0].publisher("/hello", "std_msgs/msg/String", LATCHED).publish({"data": "there"})
    nodes[1].subscribe("/hello", "std_msgs/msg/String", got.append, LATCHED)
    there = wait_until(lambda: got, seconds)
    for node in nodes:
        node.close()
    return there


@needs_dds
def test_domains_do_not_hear_each_other() -> None:
    one = {**private(), "ROS_DOMAIN_ID": "41"}
    assert heard(one, one, 60.0)
    assert not heard(one, {**one, "ROS_DOMAIN_ID": "42"})


@needs_dds
def test_one_process_has_one_configuration_of_a_domain() -> None:
    one = {**private(), "ROS_DOMAIN_ID": "43"}
    open_node("first", "dds", Network.of(one)).close()
    with pytest.raises(InputError, match="domain 43 is open in this process with other settings"):
        open_node("second", "dds", Network.of({**one, "ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}))


VICTIM = """
import time
from typing import Any
from wbmpc.ros2 import open_node
node = open_node("victim", "dds")
publisher = node.publisher("/victim", "std_msgs/msg/String")
time.sleep(600.0)
"""


@needs_dds
def test_a_killed_process_leaves_the_bus_soon() -> None:
    """SIGKILL: nobody says goodbye. DDS's own default is 10 s; by the wall clock, so with room for a busy machine."""
    environment = everything()
    node = open_node("looks", "dds", Network.of(environment))
    victim = subprocess.Popen([sys.executable, "-c", VICTIM], env=environment)
    try:
        assert wait_until(lambda: node.publishers("/victim"))
        time.sleep(1.0)
        victim.kill()
        begin = time.monotonic()
        assert wait_until(lambda: not node.publishers("/victim"))
        assert time.monotonic() - begin < 9.5
    finally:
        victim.kill()
        victim.wait()
        node.close()


#: A participant that asks nobody: it is found, and finds others, only if these go on looking for it.
LATE = """
import os, sys, time
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.domain import Domain, DomainParticipant
number = int(os.environ["ROS_DOMAIN_ID"])
own = "<General><AllowMulticast>false</AllowMulticast></General>"
own += "<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
own += "<Peers AddLocalhost='false'/></Discovery>"
domain = Domain(number, f"<CycloneDDS><Domain>{own}</Domain></CycloneDDS>,{os.environ['CYCLONEDDS_URI']}")
participant = DomainParticipant(number)
reader = BuiltinDataReader(participant, BuiltinTopicDcpsPublication)
end = time.monotonic() + 60.0
while time.monotonic() < end and not any(s.topic_name == "rt/early" for s in reader.take(N=100)):
    time.sleep(0.05)
print("found" if time.monotonic() < end else "not found")
"""
EARLY = """
import time
from typing import Any
from wbmpc.ros2 import open_node
publisher = open_node("early", "dds").publisher("/early", "std_msgs/msg/String")
print("there", flush=True)
time.sleep(600.0)
"""


@thorough
@needs_dds
def test_who_starts_half_a_minute_later_finds_us() -> None:
    """Without multicast. By default Cyclone DDS looks for peers in the first 30 s of its life only."""
    environment = everything()
    early = subprocess.Popen([sys.executable, "-c", EARLY], env=environment, stdout=subprocess.PIPE, text=True)
    try:
        assert early.stdout is not None and early.stdout.readline() == "there\n"
        time.sleep(36.0)
        run = subprocess.run(
            [sys.executable, "-c", LATE], env=environment, timeout=120.0, capture_output=True, text=True
        )
    finally:
        early.kill()
        early.communicate()
    assert run.stdout == "found\n", run.stderr
