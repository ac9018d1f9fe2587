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


def _unit(q: tuple[float, ...]) -> tuple[float, ...]:
    if not 0.99 < sum(v * v for v in q) < 1.01:
        raise ValueError("a unit quaternion (w, x, y, z) is needed")
    return q


class SphereDescription(Section):
    """A sphere fixed to a ``frame`` (body or site), in its axes [m]."""

    kind: Literal["sphere"]
    frame: str
    radius: _Size
    center: _Point = (0.0, 0.0, 0.0)


class RoundDescription(Section):
    """A capsule or cylinder fixed to a ``frame``, in its axes [m]: ``radius`` about the line from ``a`` to ``b``."""

    kind: Literal["capsule", "cylinder"]
    frame: str
    radius: _Size
    a: _Point
    b: _Point

    @model_validator(mode="after")
    def _long(self) -> Self:
        if self.a == self.b and self.kind == "cylinder":
            raise ValueError("a cylinder needs two points that differ, 'a' and 'b'")
        return self


class BoxDescription(Section):
    """A box fixed to a ``frame``, in its axes [m]: ``half`` its edges, ``orientation`` (w, x, y, z)."""

    kind: Literal["box"]
    frame: str
    half: tuple[_Size, _Size, _Size]
    center: _Point = (0.0, 0.0, 0.0)
    orientation: Annotated[tuple[_Unit, _Unit, _Unit, _Unit], AfterValidator(_unit)] = (1.0, 0.0, 0.0, 0.0)


ShapeDescription = SphereDescription | RoundDescription | BoxDescription


class SelfCollisionDescription(Section):
    """Bodies of the robot, each with all that is fixed to it, that keep ``margin`` [m] from each other: ``pairs`` of them, or those that
    sampling proposes (``auto``). Pairs in ``ignore`` may overlap: neither plans nor the simulation keep them apart."""

    margin: _Margin = 0.02
    pairs: Annotated[tuple[Pair, ...] | None, _Auto] = None
    ignore: tuple[Pair, ...] = ()


class CollisionDescription(Section):
    """``shapes``: of the model's file (``auto``), or by hand; ``margin`` [m]: distance to obstacles that is kept; ``floor``: whether there is
    a floor at the robot's feet that its arm keeps clear of; ``self``: see :class:`SelfCollisionDescription`."""

    shapes: Annotated[tuple[Annotated[ShapeDescription, Field(discriminator="kind")], ...] | None, _Auto] = None
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
