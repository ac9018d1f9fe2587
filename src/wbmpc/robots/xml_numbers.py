"""Numbers of a robot's XML that are none of a machine: not a number, infinite, or beyond everything."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from wbmpc.checks import parse_number
from wbmpc.errors import InputError

#: Of any unit of a model: MuJoCo takes a larger value for the end of a simulation.
LARGEST_NUMBER = 1e10
#: Attributes that are names or texts.
_TEXTS = """name class childclass dclass model modelname file filename link parent child type body body1 body2 bodyname joint joint1 joint2
    jointinparent geom geom1 geom2 site site1 site2 sidesite refsite cranksite slidersite mesh meshname material texture hfield
    target objname objtype refname reftype tendon tendon1 tendon2 actuator base prefix plugin instance key flex skin element node
    frame package text data sensor"""
#: Attributes of limits: what is infinite is none.
_LIMITS = """range ctrlrange forcerange actfrcrange actrange lengthrange lower upper velocity effort soft_lower_limit soft_upper_limit"""
_NAMES, _BOUNDS = frozenset(_TEXTS.split()), frozenset(_LIMITS.split())
_NAN = re.compile(r"(?<!\S)[+-]?nan(\(\S*\))?(?!\S)", re.IGNORECASE)
_INFINITE = re.compile(r"(?<!\S)[+-]?inf(inity)?(?!\S)", re.IGNORECASE)
#: So many words of an attribute are checked one by one, where not all of them are numbers.
_FEW = 1000


def check_number(name: str, value: str) -> None:
    """Raise :class:`InputError` naming an attribute with a number that cannot be meant."""
    if name in _NAMES:
        return
    if found := _NAN.search(value):
        raise InputError(f"'{name}' has '{found[0]}', which is not a number")
    if name in _BOUNDS:
        return
    if found := _INFINITE.search(value):
        raise InputError(f"'{name}' has '{found[0]}'; at most {LARGEST_NUMBER:g} is read")
    words = value.split()
    too_large = np.abs(_numbers(words)) > LARGEST_NUMBER
    if too_large.any():
        raise InputError(f"'{name}' has '{words[int(np.argmax(too_large))][:40]}'; at most {LARGEST_NUMBER:g} is read")


def _numbers(words: list[str]) -> NDArray[np.float64]:
    """Of each word (n), 0 where it is none."""
    try:
        return np.array(words, float)
    except ValueError:
        return np.array([_number(word) for word in words[:_FEW]])


def _number(word: str) -> float:
    try:
        return parse_number(word)
    except ValueError:
        return 0.0
