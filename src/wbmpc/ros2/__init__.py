"""ROS 2: a node with or without a ROS installation, the controller and a simulated robot on its bus."""

from wbmpc.ros2.bus import DEFAULT, LATCHED, SENSOR, Node, Publisher, Qos
from wbmpc.ros2.network import Network
from wbmpc.ros2.opening import open_node

__all__ = ["DEFAULT", "LATCHED", "SENSOR", "Network", "Node", "Publisher", "Qos", "open_node"]
