"""A browser that draws nothing: connects to a view as Chromium does, unpacks every message, and moves its camera.

    python benchmarks/view_client.py URL [--seconds 10]

Prints how many messages came and what they weighed. It costs what a view has to serve, without the cost of drawing.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from importlib.metadata import version

import msgspec.msgpack
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

#: How often a camera that is being turned reports where it is [Hz].
CAMERA = 20.0


def camera(angle: float) -> bytes:
    """A camera on a circle around the robot, as the viewer reports it."""
    message = {
        "type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "fov": 1.3, "near": 0.01, "far": 1000.0,
        "position": (3.0 * math.cos(angle), 3.0 * math.sin(angle), 1.5), "image_height": 700, "image_width": 1000,
        "look_at": (0.0, 0.0, 0.5), "up_direction": (0.0, 0.0, 1.0),
    }  # fmt: skip
    return msgspec.msgpack.encode(message)


def unpack(data: bytes) -> list[dict[str, object]]:
    """Messages of one packet: two lengths of 8 bytes, compressed MessagePack, arrays."""
    length, packed = (int.from_bytes(data[k : k + 8], "little") for k in (0, 8))
    inner = zstandard.ZstdDecompressor().decompress(data[16 : 16 + packed], max_output_size=length)
    found: list[dict[str, object]] = msgspec.msgpack.decode(inner)["messages"]
    return found


def main() -> None:
    """Read until the time is over or the view is gone."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("url")
    parser.add_argument("--seconds", type=float, default=10.0)
    given = parser.parse_args()
    address = given.url.replace("http://", "ws://")
    count = size = 0
    end, due = time.monotonic() + given.seconds, 0.0
    with connect(address, subprotocols=[f"viser-v{version('viser')}"], max_size=None) as socket:
        while (now := time.monotonic()) < end:
            if now >= due:
                due = now + 1.0 / CAMERA
                socket.send(camera(now))
            try:
                data = socket.recv(timeout=1.0 / CAMERA)
            except TimeoutError:
                continue
            except ConnectionClosed:
                break
            assert isinstance(data, bytes)
            size, count = size + len(data), count + len(unpack(data))
    print(json.dumps({"messages": count, "megabytes": size / 1e6}))


if __name__ == "__main__":
    main()
