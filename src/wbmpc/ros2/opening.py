"""Opening a node with one of the two back ends."""

from __future__ import annotations

from importlib.util import find_spec

from wbmpc.errors import InputError
from wbmpc.ros2.bus import BACK_ENDS, Node
from wbmpc.ros2.network import Network


def open_node(name: str, backend: str = "auto", network: Network | None = None) -> Node:
    """A node called ``name``. ``backend``: "rclpy", "dds" (extra ``ros2``), or "auto": rclpy where it can be imported (ROS 2 is sourced), else
    DDS alone, on a ``network`` (None: as the environment says).

    Raises :class:`InputError` if neither is there.
    """
    if backend not in BACK_ENDS:
        raise InputError(f"backend: '{backend}' is not known; valid: {', '.join(BACK_ENDS)}")
    if backend == "rclpy" or (backend == "auto" and find_spec("rclpy") is not None):
        if find_spec("rclpy") is None:
            raise InputError("backend: rclpy cannot be imported: source ROS 2 (setup.bash) first")
        from wbmpc.ros2.ros import RosNode

        return RosNode(name)
    missing = [p for p in ("cyclonedds", "rosbags") if find_spec(p) is None]
    if missing:
        raise InputError(
            f"ROS 2: {' and '.join(missing)} cannot be imported: source ROS 2 (setup.bash), or install 'wbmpc[ros2]'"
        )
    from wbmpc.ros2.dds import DdsNode

    return DdsNode(name, network or Network.of())
