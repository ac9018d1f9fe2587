"""Texts on the pictures of a clip: title and time below, above what its lines are."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

Array = np.ndarray
Color = tuple[int, int, int]
#: What lines are, by their names in a snapshot.
NAMES = {
    "reference": "reference", "trail": "way", "end_effector_plan": "predicted end effector", "base_plan": "predicted base",
}  # fmt: skip
#: Height of letters over the height of a picture; the lowest that can be read [pixels].
_LETTERS, _LOWEST = 1.0 / 24.0, 10
_INK = (35, 45, 55)
#: How much of the picture a label's ground hides.
_GROUND = 0.6


class Labels:
    """Of pictures of ``size`` (width, height) of the run ``title``."""

    def __init__(self, size: tuple[int, int], title: str) -> None:
        self._height, self._title = max(_LOWEST, round(size[1] * _LETTERS)), title

    def on(self, picture: Array, t: float, lines: Mapping[str, Color]) -> Array:
        """The picture (height, width, 3) with them, at the time t [s]; ``lines``: colors by their names in a snapshot."""
        left = edge = self._height // 2
        for name, color in lines.items():
            left += _put(picture, strip(NAMES[name], self._height, color), left, edge) + edge
        # the title stays, so that only the time is written anew
        left = edge
        for text in (self._title, f"{t:.1f} s"):
            below = strip(text, self._height, _INK)
            left += _put(picture, below, left, picture.shape[0] - below[1].shape[0] - edge)
        return picture


@lru_cache(maxsize=32)
def strip(text: str, height: int, color: Color) -> tuple[Array, Array]:
    """A text with letters of a height [pixels] on a white ground: its colors (rows, columns, 3) times its share of each pixel, and the
    share that is left of the picture there (rows, columns, 3), both times 256 in 16 bits."""
    from PIL import Image, ImageDraw

    font = _font(height)
    right = int(font.getbbox(text)[2])
    sheet = Image.new("L", (right + height, height * 3 // 2), 0)
    ImageDraw.Draw(sheet).text((height // 2, height // 8), text, fill=255, font=font)
    ink = np.asarray(sheet, float)[..., None] / 255.0
    share = np.maximum(ink, _GROUND)
    left_over = np.repeat(np.round(256.0 * (1.0 - share)), 3, axis=2)
    colors = (256.0 - left_over) * (ink * np.array(color) + (1.0 - ink) * 255.0)
    return np.round(colors).astype(np.uint16), left_over.astype(np.uint16)


@lru_cache(maxsize=4)
def _font(height: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(height)


def _put(picture: Array, label: tuple[Array, Array], left: int, top: int) -> int:
    """Write a label into a picture, as far as there is room; its width [pixels]."""
    colors, left_over = label
    part = picture[max(top, 0) :, left:][: colors.shape[0], : colors.shape[1]]
    rows, columns = part.shape[:2]
    part[:] = (colors[:rows, :columns] + left_over[:rows, :columns] * part) >> 8
    return int(colors.shape[1])
