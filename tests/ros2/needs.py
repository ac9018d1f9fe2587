"""What the ROS 2 tests share: they need the extra, and run on a bus that nobody else is on."""

from __future__ import annotations

import os
import random
import time
import uuid
from collections.abc import Callable
from importlib.util import find_spec

import pytest

MISSING = [p for p in ("cyclonedds", "rosbags") if find_spec(p) is None]
needs_dds = pytest.mark.skipif(bool(MISSING), reason=f"{' and '.join(MISSING)} not installed (extra 'ros2')")


#: Domains whose ports are outside of those that Linux gives to programs at will (32768 to 60999).
_FREE = [*range(60, 101), *range(215, 232)]
_DOMAINS = iter(random.SystemRandom().sample(_FREE, len(_FREE)))


def private() -> dict[str, str]:
    """Environment of a bus of its own: this machine only, a domain by chance, and a tag that nobody else has.

    A process configures a domain once: domains up to 59 are those that a test names, the others never come twice.
    """
    tag = f"<CycloneDDS><Domain><Discovery><Tag>{uuid.uuid4()}</Tag></Discovery></Domain></CycloneDDS>"
    return {
        "ROS_DOMAIN_ID": str(next(_DOMAINS)),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOCALHOST_ONLY": "",
        "ROS_STATIC_PEERS": "",
        "ROS_DISTRO": "",
        "CYCLONEDDS_URI": tag,
    }


def everything() -> dict[str, str]:
    """The environment of a process on a private bus."""
    return {**os.environ, **private()}


def wait_until(condition: Callable[[], object], seconds: float = 180.0) -> bool:
    """Whether a condition came true within ``seconds``: long, for the machine may be busy."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.005)
    return bool(condition())
