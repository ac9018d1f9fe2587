"""The ``base`` section of a robot whose base does not move."""

from __future__ import annotations

from typing import ClassVar, Literal

from wbmpc.bases.common.description import SpeedBaseDescription


class FixedBaseDescription(SpeedBaseDescription):
    """A base that does not move."""

    moves: ClassVar[bool] = False

    type: Literal["fixed"]
