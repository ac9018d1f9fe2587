"""Numbers of a robot's XML that are none of a machine: not a number, infinite, or beyond everything."""

from __future__ import annotations

import re

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
_NAN, _INFINITE = re.compile(r"[+-]?nan(\(.*\))?", re.I), re.compile(r"[+-]?inf(inity)?", re.I)


def check_number(name: str, value: str) -> None:
    """Raise :class:`InputError` naming an attribute with a number that cannot be meant."""
    if name in _NAMES:
        return
    for word in value.split():
        if _NAN.fullmatch(word):
            raise InputError(f"'{name}' has '{word}', which is not a number")
        if name not in _BOUNDS and (_INFINITE.fullmatch(word) or _magnitude(word) > LARGEST_NUMBER):
            raise InputError(f"'{name}' has '{word[:40]}'; at most {LARGEST_NUMBER:g} is read")


def _magnitude(word: str) -> float:
    try:
        return abs(float(word))
    except ValueError:
        return 0.0
