"""Commands to the controllers of ros2_control."""

from __future__ import annotations

import numpy as np

from wbmpc.model import RobotModel
from wbmpc.ros2.bus import DEFAULT, Node
from wbmpc.ros2.settings import GROUPS, RosSettings

Place = tuple[str, int]


class Sender:
    """One controller that takes numbers: those at ``places`` of the groups, in its order."""

    def __init__(self, node: Node, topic: str, kind: str, places: list[Place]) -> None:
        self._to, self._places = node.publisher(topic, kind, DEFAULT), places

    def send(self, values: dict[str, np.ndarray]) -> None:
        """A command by groups."""
        self._to.publish({"data": [values[g][i] for g, i in self._places]})


def places_of(robot: RobotModel) -> dict[str, Place]:
    """Group and number of every drive by its name."""
    given = robot.input.groups
    names = {g: list(given.get(g, ())) for g in GROUPS} | {"brake": [f"brake/{n}" for n in given.get("leg", ())]}
    return {n: (g, i) for g, part in names.items() for i, n in enumerate(part)}


def senders(node: Node, robot: RobotModel, settings: RosSettings) -> list[Sender]:
    """One for each controller that takes numbers."""
    places = places_of(robot)
    return [
        Sender(node, c.topic, c.type, [places[j] for j in c.joints])
        for c in settings.command_topics(robot).values()
        if c.takes == "numbers"
    ]
