"""One process that reads and writes a topic, while others write on it too. Truth: the process ends, and what has come is counted.

Each case in a process of its own: where two threads wait for each other with the interpreter lock held, all of Python does."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable
from typing import Any

import pytest
from needs import everything, needs_dds, private, wait_until

from effort import some
from wbmpc.errors import InputError, RunAborted
from wbmpc.ros2 import open_node
from wbmpc.ros2.network import Network

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
    assert "/ping: a callback of it leads to a message on /pong, which another node of this process hears" in run.stderr


CALLBACKS_CROSS = """
import logging, threading
from wbmpc.ros2 import open_node
logging.basicConfig(format="%(message)s")
nodes, kind = [open_node(n, "dds") for n in ("one", "two")], "std_msgs/msg/Float64"
both, to = threading.Barrier(2), [nodes[i].publisher(f"/answer_{i}", kind) for i in (0, 1)]
def answer(i):
    def callback(message):
        both.wait(20.0)
        to[i].publish({"data": 1.0})
    return callback
for i in (0, 1):
    nodes[i].subscribe(f"/ask_{i}", kind, answer(i))
    nodes[1 - i].subscribe(f"/answer_{i}", kind, lambda m: None)
others = open_node("others", "dds")
ask = [others.publisher(f"/ask_{i}", kind) for i in (0, 1)]
threads = [threading.Thread(target=a.publish, args=({"data": 1.0},)) for a in ask]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
print("ended")
"""


def test_callbacks_of_two_nodes_that_write_to_each_other_at_once_are_an_error() -> None:
    """Each holds its node while it waits for the other's: no message goes round, but both would wait for ever."""
    run = subprocess.run(
        [sys.executable, "-c", CALLBACKS_CROSS], env=everything(), timeout=60.0, capture_output=True, text=True
    )
    assert run.stdout.strip() == "ended", run.stderr
    for k in (0, 1):
        assert f"/ask_{k}: a callback of it leads to a message on /answer_{k}, which another node" in run.stderr


READS_WHAT_IS_WRITTEN = """
import threading, time
from wbmpc.ros2 import open_node
one, two = (open_node(n, "dds") for n in ("one", "two"))
kind, heard, ended = "std_msgs/msg/Float64", [], threading.Event()
publisher = one.publisher("/count", kind)
def write():
    while not ended.is_set():
        publisher.publish({"data": 2.0})
thread = threading.Thread(target=write)
thread.start()
for _ in range(100):
    ends = [n.subscribe("/count", kind, lambda m: heard.append(m.data)) for n in (two, one)]
    time.sleep(0.005)
    for end in ends:
        end()
ended.set()
thread.join()
print("ended" if heard else "nothing heard")
"""


def test_readers_come_and_go_while_another_thread_writes() -> None:
    other = subprocess.Popen([sys.executable, "-c", OTHER], env=(environment := everything()))
    try:
        run = subprocess.run(
            [sys.executable, "-c", READS_WHAT_IS_WRITTEN],
            env=environment, timeout=100.0, capture_output=True, text=True,
        )  # fmt: skip
    finally:
        other.kill()
        other.wait()
    assert run.stdout.strip() == "ended", run.stderr


def test_a_callback_may_not_wait_for_callbacks(caplog: pytest.LogCaptureFixture) -> None:
    network = Network.of(private())
    one, two = (open_node(n, "dds", network) for n in ("one", "two"))
    kind, later = "rcl_interfaces/srv/ListParameters", {"prefixes": [], "depth": 0}
    one.serve("/names", kind, lambda _: {})
    actions: list[Callable[[], object]] = [lambda: two.call("/names", kind, later), two.close, lambda: end()]
    heard: list[str] = []

    def callback(_: object) -> None:
        for action in actions:
            try:
                action()
            except InputError as error:
                heard.append(str(error))

    end = two.subscribe("/topic", "std_msgs/msg/Float64", callback)
    publisher = one.publisher("/topic", "std_msgs/msg/Float64")
    assert wait_until(lambda: publisher.publish({"data": 1.0}) or len(heard) >= 3)
    what = ("calls /names", "closes node 'two'", "ends a subscription")
    assert heard[:3] == [
        f"/topic: a callback of it {w}, which waits for callbacks to end; "
        "give it deferred=True, which calls back from work()"
        for w in what
    ]
    end()
    deferred: list[object] = []
    two.subscribe("/topic", "std_msgs/msg/Float64", lambda _: deferred.append(actions[0]()), deferred=True)
    assert wait_until(lambda: publisher.publish({"data": 1.0}) or two.work() or deferred)
    one.close()
    with pytest.raises(RunAborted, match="/topic: node 'one' is closed"):
        publisher.publish({"data": 1.0})
    two.close()


READERS_END_WHILE_GARBAGE_IS_COLLECTED = """
import gc, sys, threading, time
from wbmpc.ros2 import open_node
one, kind, heard, ended = open_node("one", "dds"), "std_msgs/msg/Float64", [], threading.Event()
two = open_node("two", "dds")
publishers = [one.publisher("/count", kind) for _ in range(2)]
def write(publisher):
    while not ended.is_set():
        publisher.publish({"data": 2.0})
def collect():
    while not ended.is_set():
        gc.collect()
        time.sleep(0)
gc.freeze()
sys.setswitchinterval(1e-5)
threads = [threading.Thread(target=write, args=(p,)) for p in publishers] + [threading.Thread(target=collect)]
for thread in threads:
    thread.start()
for _ in range(60):
    ends = [two.subscribe("/count", kind, lambda m: heard.append(m.data)) for _ in range(5)]
    three = open_node("three", "dds")
    three.subscribe("/count", kind, lambda m: heard.append(m.data))
    time.sleep(0.005)
    for end in ends:
        end()
    three.close()
ended.set()
for thread in threads:
    thread.join()
print("ended" if heard else "nothing heard")
"""


def test_callbacks_end_while_garbage_is_collected() -> None:
    """A callback that has begun in C and waits for the interpreter is not freed under its feet."""
    run = subprocess.run(
        [sys.executable, "-X", "faulthandler", "-c", READERS_END_WHILE_GARBAGE_IS_COLLECTED],
        env=everything(), timeout=100.0, capture_output=True, text=True,
    )  # fmt: skip
    assert (run.returncode, run.stdout.strip(), run.stderr) == (0, "ended", "")


def test_a_callback_does_not_wait_for_a_writer_that_waits_for_it() -> None:
    """Another thread writes the topic and has the writer's turn until this callback ends."""
    from wbmpc.ros2.dds_writing import LOCAL, write

    where, turn, heard = (0, "rt/topic"), threading.RLock(), list[str]()
    forget = LOCAL.add(where, "its node")

    def callback() -> None:
        with LOCAL.callback(where, "its node"):
            try:
                write(None, b"", where, "another node", turn)  # type: ignore[arg-type]
            except InputError as error:
                heard.append(str(error))

    with turn:
        thread = threading.Thread(target=callback, daemon=True)
        thread.start()
        thread.join(20.0)
    forget()
    assert heard and "leads to a message on /topic" in heard[0]


def test_a_server_may_join_while_peers_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """The package asks how many readers a writer has and then for their handles: here another one comes in between."""
    from cyclonedds.pub import DataWriter

    network, kind = Network.of(private()), "std_srvs/srv/SetBool"
    asks, serves, joins = (open_node(name, "dds", network) for name in ("asks", "serves", "joins"))
    answer = lambda request: {"success": request.data}
    serves.serve("/switch", kind, answer)
    counts = DataWriter._get_matched_subscriptions

    def counted(writer: DataWriter, *given: object) -> int:
        found: int = counts(writer, *given)
        if found == 1 and given[1] is None:  # only the count
            joins.serve("/switch", kind, answer)
            assert wait_until(lambda: counts(writer, *given) == 2)
        return found

    monkeypatch.setattr(DataWriter, "_get_matched_subscriptions", counted)
    try:
        assert asks.call("/switch", kind, {"data": True}, timeout=60.0).success
    finally:
        for node in (asks, serves, joins):
            node.close()


def test_the_next_node_goes_on_with_the_participant_of_a_closed_one() -> None:
    """Types of topics stay: the middleware removes them in a thread of its own, and looks them up without a lock when a topic is made
    (a node that opened soon after others had closed crashed once in a thousand times). Truth: what another node sees of the two."""
    network = Network.of(private())
    first, other = open_node("first", "dds", network), open_node("other", "dds", network)
    first.publisher("/count", "std_msgs/msg/Float64")
    assert wait_until(lambda: other.publishers("/count"))
    before = other.publishers("/count")[0]
    assert other.owner(before) == "first"
    first.close()
    first.close()  # once is enough: nobody shares a participant
    assert wait_until(lambda: not other.publishers("/count"))
    after = [open_node(name, "dds", network) for name in ("next", "last")]
    for node in after:
        node.publisher("/count", "std_msgs/msg/Float64")
    assert wait_until(lambda: len(other.publishers("/count")) == 2)
    found = {other.owner(e): e.node for e in other.publishers("/count")}
    assert found.keys() == {"next", "last"}
    assert found["next"] == before.node != found["last"]
    for node in (*after, other):
        node.close()


def test_a_node_that_closes_waits_for_who_uses_it_and_who_waits_there_ends() -> None:
    """A thread waits for an answer, another one is within the making of an endpoint: on entities that are being deleted Cyclone DDS crashes.
    Truth: what ends when, by events."""
    node, ended, making, go_on = (
        open_node("closes", "dds", Network.of(private())),
        [],
        threading.Event(),
        threading.Event(),
    )
    make = node._own

    def slow(*given: Any) -> None:
        making.set()
        assert go_on.wait(60.0)
        make(*given)

    def run(what: str, call: Callable[[], object]) -> None:
        try:
            call()
            ended.append(what)
        except Exception as error:
            ended.append(f"{what}: {type(error).__name__}: {error}")

    asks = threading.Thread(target=run, args=("asks", lambda: node.call("/nobody", "std_srvs/srv/Trigger", {}, 60.0)))
    asks.start()
    assert wait_until(lambda: len(node._writers) == 1)
    node._own = slow  # type: ignore[method-assign]
    makes = threading.Thread(target=run, args=("makes", lambda: node.publisher("/late", "std_msgs/msg/Float64")))
    makes.start()
    assert making.wait(60.0)
    closes = threading.Thread(target=run, args=("closes", node.close))
    closes.start()
    asks.join(60.0)
    closes.join(0.2)
    assert ended == ["asks: RunAborted: node 'closes' is closed"]
    go_on.set()
    closes.join(60.0)
    makes.join(60.0)
    assert sorted(ended[1:]) == ["closes", "makes"]
    for use in (lambda: node.publisher("/t", "std_msgs/msg/Float64"), lambda: node.publishers("/t")):
        with pytest.raises(RunAborted, match="node 'closes' is closed"):
            use()
