"""A stand-in for robot_state_publisher and tf2: the tree of frames from a URDF and transforms."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any
from xml.etree import ElementTree

import numpy as np

from wbmpc import lie


def of_urdf(text: str, states: Collection[str] | None = None) -> tuple[set[str], dict[str, str]]:
    """Links, and parents by child as robot_state_publisher sends them: it leaves floating joints to others, and sends those that move
    when joint states have them, or the joint that they mimic. ``states``: names that joint states have; all by default."""
    root = ElementTree.fromstring(text)
    links = [str(link.get("name")) for link in root.findall("link")]
    assert len(set(links)) == len(links), links
    parents = {}
    for joint in root.findall("joint"):
        parent, child = (joint.find(tag).get("link") for tag in ("parent", "child"))  # type: ignore[union-attr]
        assert parent in links and child in links and child not in parents, (parent, child)
        mimic = joint.find("mimic")
        followed = joint.get("name") if mimic is None else mimic.get("joint")
        heard = states is None or joint.get("type") == "fixed" or followed in states
        if joint.get("type") != "floating" and heard:
            parents[child] = parent
    return set(links), parents  # type: ignore[return-value]


def joined(*more: dict[str, str]) -> dict[str, str]:
    """One tree of several sources: nobody gives a frame another parent, there is one root, and no circle."""
    parents: dict[str, str] = {}
    for source in more:
        for child, parent in source.items():
            assert parents.setdefault(child, parent) == parent, (child, parent, parents[child])
    roots = {root(parents, child) for child in parents}
    assert len(roots) == 1, roots
    return parents


def root(parents: dict[str, str], frame: str) -> str:
    """Where the way up from a frame ends."""
    for _ in range(len(parents) + 1):
        if frame not in parents:
            return frame
        frame = parents[frame]
    raise AssertionError(f"{frame} is its own ancestor")


def of_transforms(messages: Iterable[Any]) -> dict[str, str]:
    """Parents by child of TFMessages, in which no frame changes its parent."""
    parents: dict[str, str] = {}
    for message in messages:
        for t in message.transforms:
            assert parents.setdefault(t.child_frame_id, t.header.frame_id) == t.header.frame_id, t.child_frame_id
    return parents


def place(transform: Any) -> tuple[np.ndarray, np.ndarray]:
    """Position and rotation matrix."""
    t, q = transform.translation, transform.rotation
    return np.array([t.x, t.y, t.z]), lie.quaternion_to_rotation(np.array([q.w, q.x, q.y, q.z]))
