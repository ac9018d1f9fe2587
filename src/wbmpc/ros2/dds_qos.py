"""QoS and type names of ROS 2 as DDS has them, and back."""

from __future__ import annotations

from cyclonedds.core import Policy
from cyclonedds.core import Qos as DdsQos
from cyclonedds.util import duration

from wbmpc.ros2.bus import Qos

#: Numbers of the policies in DDS's notices of a mismatch (DDS 1.4, section 2.2.3; DDS-XTypes 1.3, section 7.6.3).
POLICIES = {2: "durability", 4: "deadline", 8: "liveliness", 11: "reliability", 23: "data representation", 24: "type"}


def dds_qos(qos: Qos, user_data: str, *, local: bool) -> DdsQos:
    """QoS of an endpoint with ``user_data``; ``local``: it hears endpoints of its own node too."""
    reliable = Policy.Reliability.Reliable(duration(milliseconds=100))
    return DdsQos(
        reliable if qos.reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if qos.latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(qos.depth),
        # how many of a latched topic's messages late joiners get; one, unless it is said
        Policy.DurabilityService(0, Policy.History.KeepLast(qos.depth), -1, -1, -1),
        Policy.DataRepresentation(use_cdrv0_representation=True),
        # a write of this node would wait for a callback of its own; services have one anyway, see `write`
        Policy.IgnoreLocal.Nothing if local else Policy.IgnoreLocal.Participant,
        Policy.Userdata(user_data.encode()),
    )


def ros_type(name: str) -> str:
    """A ROS 2 type by its name in DDS; other names as they are."""
    parts = name.split("::")
    return "/".join([*parts[:-2], parts[-1].removesuffix("_")]) if "dds_" in parts else name


def ros_qos(qos: DdsQos) -> Qos:
    """What of an endpoint's QoS this package shows."""
    reliability, durability, history = (qos[p] for p in (Policy.Reliability, Policy.Durability, Policy.History))
    latched = durability not in (None, Policy.Durability.Volatile)
    return Qos(reliability != Policy.Reliability.BestEffort, latched, int(getattr(history, "depth", 0)))
