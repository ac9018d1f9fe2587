"""Every number that a file or a command line gives has a least and a largest value: a run takes in nothing that no robot has.
Truth: the JSON schemas of the models that read settings, robot files, bus files and studies."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from pydantic import BaseModel

from wbmpc.bases import available_base_types, base_type
from wbmpc.registry import REGISTRY
from wbmpc.robots import RobotDescription
from wbmpc.robots.collision import CollisionDescription
from wbmpc.ros2 import settings as bus
from wbmpc.study.definition import Definition

MODELS: dict[str, type[BaseModel]] = {
    **{name: REGISTRY[name].config_type for name in REGISTRY},
    **{f"base type {name}": base_type(name).Description for name in available_base_types()},
    **{f"bus {name}": kind for name, kind in vars(bus).items() if isinstance(kind, type) and issubclass(kind, BaseModel)},
    "robot": RobotDescription, "collision": CollisionDescription, "study": Definition,
}  # fmt: skip
#: Seeds are read by a function of their own, which limits them.
ELSEWHERE = {"seeds"}


def unbounded(schema: Any, place: str = "") -> Iterator[str]:
    """Where a schema has numbers without a least or a largest value."""
    if isinstance(schema, list):
        for part in schema:
            yield from unbounded(part, place)
    if not isinstance(schema, dict):
        return
    ends = [{"minimum", "exclusiveMinimum"}, {"maximum", "exclusiveMaximum"}]
    if schema.get("type") in ("number", "integer") and not {"const", "enum"} & schema.keys():
        if not all(schema.keys() & end for end in ends):
            yield place
        return
    for key, part in schema.items():
        if key in ("properties", "$defs"):
            for name, inner in part.items():
                yield from () if name in ELSEWHERE else unbounded(inner, f"{place}.{name}".lstrip("."))
        elif key not in ("default", "discriminator"):
            yield from unbounded(part, place)


@pytest.mark.filterwarnings("ignore::pydantic.json_schema.PydanticJsonSchemaWarning")
@pytest.mark.parametrize("name", MODELS)
def test_every_number_has_a_least_and_a_largest_value(name: str) -> None:
    assert list(unbounded(MODELS[name].model_json_schema())) == []


def test_the_search_finds_numbers_without_bounds() -> None:
    class Inner(BaseModel):
        pair: tuple[float, float] = (0.0, 0.0)

    class Outer(BaseModel):
        inner: Inner | None = None
        many: dict[str, int] = {}

    assert sorted(unbounded(Outer.model_json_schema())) == ["Inner.pair", "Inner.pair", "many"]
