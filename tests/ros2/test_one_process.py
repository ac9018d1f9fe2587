"""One process that reads and writes a topic, while others write on it too. Truth: the process ends, and what has come is counted.

Each case in a process of its own: where two threads wait for each other with the interpreter lock held, all of Python does."""

from __future__ import annotations

import subprocess
import sys

import pytest
from needs import everything, needs_dds

from effort import some

pytestmark = needs_dds

#: Somebody else, who writes as fast as it can until it is killed.
OTHER = """
from wbmpc.ros2 import open_node
publisher = open_node("other", "dds").publisher("/count", "std_msgs/msg/Float64")
while True:
    publisher.publish({"data": 1.0})
"""

READS_AND_WRITES = """
import sys, time
from wbmpc.ros2 import Qos, open_node
one, got = open_node("one", "dds"), []
reader = one if sys.argv[1] == "one node" else open_node("two", "dds")
reader.subscribe("/count", "std_msgs/msg/Float64", lambda m: got.append(m.data), Qos(depth=5000))
publisher = one.publisher("/count", "std_msgs/msg/Float64", Qos(depth=5000))
while not got:
    time.sleep(0.01)
for _ in range(5000):
    publisher.publish({"data": 2.0})
print("other's" if 1.0 in got else "none of the other's", got.count(2.0))
"""


@pytest.mark.parametrize(("nodes", "heard"), some([("one node", 0), ("two nodes", 5000)], [1]))
def test_a_process_may_read_what_it_and_another_one_write(nodes: str, heard: int) -> None:
    """A node does not hear itself; another node of the process hears everything."""
    environment = everything()
    other = subprocess.Popen([sys.executable, "-c", OTHER], env=environment)
    try:
        run = subprocess.run(
            [sys.executable, "-c", READS_AND_WRITES, nodes],
            env=environment, timeout=100.0, capture_output=True, text=True,
        )  # fmt: skip
    finally:
        other.kill()
        other.wait()
    assert run.stdout.split("\n")[0] == f"other's {heard}", run.stderr


PING_PONG = """
import logging
from wbmpc.ros2 import open_node
logging.basicConfig(format="%(message)s")
nodes, kind = [open_node(n, "dds") for n in ("one", "two")], "std_msgs/msg/Float64"
to = [nodes[0].publisher("/ping", kind), nodes[1].publisher("/pong", kind)]
nodes[1].subscribe("/ping", kind, lambda m: to[1].publish({"data": m.data + 1}))
nodes[0].subscribe("/pong", kind, lambda m: to[0].publish({"data": m.data + 1}))
while not all(p._writer.get_matched_subscriptions() for p in to):
    pass
to[0].publish({"data": 1})
print("ended")
"""


def test_callbacks_of_two_nodes_that_answer_each_other_without_end_are_an_error() -> None:
    run = subprocess.run(
        [sys.executable, "-c", PING_PONG], env=everything(), timeout=60.0, capture_output=True, text=True
    )
    assert run.stdout.strip() == "ended", run.stderr
    assert "/ping: a callback of it, in this process, leads to another message on it" in run.stderr
