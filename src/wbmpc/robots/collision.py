"""The ``collision`` section of a robot file: which shapes keep clear of obstacles and of each other, and by how much."""

from __future__ import annotations

from typing import Annotated, Literal, Self

import mujoco
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from wbmpc.bases.base import Section
from wbmpc.errors import unknown_name

#: Lengths of shapes [m]: what is smaller is nothing, what is larger no robot.
_Size = Annotated[float, Field(ge=1e-4, le=100.0)]
_Place = Annotated[float, Field(ge=-100.0, le=100.0)]
_Unit = Annotated[float, Field(ge=-1.01, le=1.01)]
_Point = tuple[_Place, _Place, _Place]
#: Distances that are kept [m].
_Margin = Annotated[float, Field(ge=0.0, le=10.0)]


def _two(pair: tuple[str, str]) -> tuple[str, str]:
    if pair[0] == pair[1]:
        raise ValueError(f"a pair needs two bodies that differ, got '{pair[0]}' twice")
    return pair


Pair = Annotated[tuple[str, str], AfterValidator(_two)]
#: ``auto`` in a file is None.
_Auto = BeforeValidator(lambda value: None if value == "auto" else value)
#: Keys of each kind of shape.
_NEEDED: dict[str, tuple[str, ...]] = {
    "sphere": ("radius", "center"), "capsule": ("radius", "a", "b"), "cylinder": ("radius", "a", "b"),
    "box": ("half", "center"),
}  # fmt: skip


class ShapeDescription(Section):
    """A shape fixed to a ``frame`` (body or site), in its axes [m]: sphere (``radius``, ``center``), capsule or cylinder (``radius``,
    ``a``, ``b``), box (``half``, ``center``, ``orientation`` w, x, y, z)."""

    frame: str
    kind: Literal["sphere", "capsule", "cylinder", "box"]
    radius: _Size | None = None
    center: _Point | None = None
    a: _Point | None = None
    b: _Point | None = None
    half: tuple[_Size, _Size, _Size] | None = None
    orientation: tuple[_Unit, _Unit, _Unit, _Unit] | None = None

    @model_validator(mode="after")
    def _complete(self) -> Self:
        needed = _NEEDED[self.kind]
        allowed = {"frame", "kind", *needed, *(("orientation",) if self.kind == "box" else ())}
        for key in needed:
            if getattr(self, key) is None and key != "center":
                raise ValueError(f"a {self.kind} needs '{key}'")
        for key in self.model_fields_set - allowed:
            raise ValueError(f"a {self.kind} does not read '{key}'; valid: {', '.join(needed)}")
        if self.a is not None and self.a == self.b and self.kind == "cylinder":
            raise ValueError("a cylinder needs two points that differ, 'a' and 'b'")
        if self.orientation is not None and not 0.99 < sum(v * v for v in self.orientation) < 1.01:
            raise ValueError("'orientation' needs a unit quaternion (w, x, y, z)")
        return self


class SelfCollisionDescription(Section):
    """Bodies of the robot, each with all that is fixed to it, that keep ``margin`` [m] from each other: ``pairs`` of them, or those that
    sampling proposes (``auto``). Pairs in ``ignore`` may overlap: neither plans nor the simulation keep them apart."""

    margin: _Margin = 0.02
    pairs: Annotated[tuple[Pair, ...] | None, _Auto] = None
    ignore: tuple[Pair, ...] = ()


class CollisionDescription(Section):
    """``shapes``: of the model's file (``auto``), or by hand; ``margin`` [m]: distance to obstacles that is kept; ``floor``: whether there is
    a floor at the robot's feet that its arm keeps clear of; ``self``: see :class:`SelfCollisionDescription`."""

    shapes: Annotated[tuple[ShapeDescription, ...] | None, _Auto] = None
    margin: _Margin = 0.03
    floor: bool = True
    self: SelfCollisionDescription = SelfCollisionDescription()


def check_frames(collision: CollisionDescription, spec: mujoco.MjSpec, source: str) -> None:
    """Raise :class:`wbmpc.errors.InputError` naming file and key for a frame or body that the model does not have."""
    bodies = [b.name for b in spec.bodies[1:]]
    frames = [*(s.name for s in spec.sites), *bodies]
    for k, shape in enumerate(collision.shapes or ()):
        if shape.frame not in frames:
            raise unknown_name(f"frame (key 'collision.shapes.{k}.frame')", shape.frame, frames, where=source)
    own = collision.self
    known = bodies if collision.shapes is None else [s.frame for s in collision.shapes]
    for key, pairs in (("pairs", own.pairs or ()), ("ignore", own.ignore)):
        for name in (n for pair in pairs for n in pair):
            if name not in known:
                raise unknown_name(f"body (key 'collision.self.{key}')", name, known, where=source)
