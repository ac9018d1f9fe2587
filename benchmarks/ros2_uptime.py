"""Late joiners: a node that has been up for minutes without multicast is found by processes that start then.

Usage: python benchmarks/ros2_uptime.py [--seconds 120] [--every 40] [--range LOCALHOST|SUBNET|LOCALHOST_ONLY|STATIC_PEERS] [--rclpy PYTHON]
Every so often two processes join: one that looks for peers by itself, configured as rmw_cyclonedds configures Cyclone DDS, and
one that does not, and has to be found. ``--rclpy``: an interpreter that imports rclpy of a ROS 2 installation; it joins too, with
its own RMW, and takes a message. ``LOCALHOST_ONLY`` and ``STATIC_PEERS`` set these variables, with the range SUBNET; in the range
SUBNET alone one process joins, by multicast. Each has to find the node within 10 s; one line for each, exit status 1 if one does not.
"""

from __future__ import annotations

import argparse
import os
import random
import socket
import subprocess
import sys
import time

NODE = """
import time
from wbmpc.ros2 import open_node
publisher = open_node("early", "dds").publisher("/early", "std_msgs/msg/String")
print("there", flush=True)
while True:
    publisher.publish({"data": "here"})
    time.sleep(0.1)
"""
PARTICIPANT = """
import os, sys, time
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.domain import Domain, DomainParticipant
number = int(os.environ["ROS_DOMAIN_ID"])
inner = "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
inner += '<Peers><Peer address="localhost"/></Peers>' if sys.argv[1] == "looks" else "<Peers AddLocalhost='false'/>"
own = f"<General><AllowMulticast>false</AllowMulticast></General><Discovery>{inner}</Discovery>"
own = "" if sys.argv[1] == "multicast" else own
if sys.argv[1] == "is asked":  # its multicast goes elsewhere
    own = "<Discovery><ParticipantIndex>auto</ParticipantIndex><Ports><MulticastMetaOffset>5</MulticastMetaOffset></Ports></Discovery>"
domain = Domain(number, f"<CycloneDDS><Domain>{own}</Domain></CycloneDDS>")
participant = DomainParticipant(number)
reader = BuiltinDataReader(participant, BuiltinTopicDcpsPublication)
begin = time.monotonic()
while time.monotonic() - begin < 10.0:
    if any(s.topic_name == "rt/early" for s in reader.take(N=100)):
        print(f"{time.monotonic() - begin:.1f}")
        break
    time.sleep(0.05)
"""
RCLPY = """
import time
import rclpy
from std_msgs.msg import String
rclpy.init()
node, got = rclpy.create_node("late"), []
node.create_subscription(String, "/early", got.append, 1)
begin = time.monotonic()
while time.monotonic() - begin < 10.0:
    rclpy.spin_once(node, timeout_sec=0.1)
    if got:
        print(f"{time.monotonic() - begin:.1f} ({rclpy.get_rmw_implementation_identifier()})")
        break
"""

_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
RANGES = {
    "LOCALHOST": {_RANGE: "LOCALHOST"},
    "SUBNET": {_RANGE: "SUBNET"},
    "LOCALHOST_ONLY": {_RANGE: "SUBNET", "ROS_LOCALHOST_ONLY": "1"},
    "STATIC_PEERS": {_RANGE: "SUBNET", "ROS_STATIC_PEERS": "OWN"},
}


def own_address() -> str:
    """Of this machine in its network, or loopback; a peer that multicasts takes nothing that comes by loopback."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("198.51.100.1", 1))  # sends nothing
        except OSError:
            return "127.0.0.1"
        return str(probe.getsockname()[0])


def join(command: list[str], environment: dict[str, str]) -> str:
    """What a late joiner prints: after which time [s] it has found the node; empty if it has not."""
    run = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60.0)
    return run.stdout.strip()


def parse() -> argparse.Namespace:
    """The options."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("--seconds", type=float, default=120.0, help="uptime of the node")
    parser.add_argument("--every", type=float, default=40.0, help="seconds between two rounds of joiners")
    parser.add_argument("--range", default="LOCALHOST", choices=tuple(RANGES))
    parser.add_argument("--rclpy", default="", help="an interpreter that imports rclpy")
    return parser.parse_args()


def main() -> int:
    """Run; the exit status."""
    given = parse()
    environment = {
        **os.environ,
        "ROS_DOMAIN_ID": str(random.SystemRandom().randrange(1, 100)),
        **{k: own_address() if v == "OWN" else v for k, v in RANGES[given.range].items()},
    }
    first = {"SUBNET": "multicast", "STATIC_PEERS": "is asked"}.get(given.range, "is found")
    joiners = {first: [sys.executable, "-c", PARTICIPANT, first]}
    if given.rclpy:
        joiners["rclpy"] = [given.rclpy, "-c", RCLPY]
    if given.range != "SUBNET":  # the last one: whom it has found is looked for a while, wherever that was
        joiners["looks"] = [sys.executable, "-c", PARTICIPANT, "looks"]
    node = subprocess.Popen([sys.executable, "-c", NODE], env=environment, stdout=subprocess.PIPE, text=True)
    missed = 0
    try:
        assert node.stdout is not None and node.stdout.readline() == "there\n"
        begin, due = time.monotonic(), given.every
        while due <= given.seconds:
            time.sleep(max(due - (time.monotonic() - begin), 0.0))
            for name, command in joiners.items():
                up = time.monotonic() - begin
                after = join(command, environment)
                missed += not after
                print(f"uptime {up:6.1f} s  {name:9s} {after + ' s' if after else 'NOT FOUND'}", flush=True)
            due += given.every
    finally:
        node.kill()
        node.wait()
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
