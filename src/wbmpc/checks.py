"""Numbers that come from outside, checked before anything of them is taken in: one that is not finite stays for good."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.errors import InputError, NotFinite

#: More units than this in one period or delay are a mistake in the settings.
_MAXIMUM = 1_000_000
_FEW = 16
#: Absolute times [s] beyond have no milliseconds as floats.
LATEST = 1e10
#: By how much the length of a quaternion may be off, which is that of tf2.
_LENGTH = 0.01
_FLOAT = np.dtype(float)

#: As MJCF, URDF, JSON and YAML write them: Python also takes 1_0 and digits of other scripts.
_NUMBER = re.compile(
    r"[+-]?([0-9]+\.?[0-9]*([eE][+-]?[0-9]+)?|\.[0-9]+([eE][+-]?[0-9]+)?|nan|inf(inity)?)", re.IGNORECASE
)


def quoted(value: Any) -> str:
    """The beginning of a value from outside, for a message."""
    try:
        return str(value)[:80]
    except ValueError:  # Python writes no whole numbers of thousands of digits
        return "a number of thousands of digits"


def parse_number(text: str) -> float:
    """The number that a text from outside is, with nothing around it but blanks; raises ValueError for every other text."""
    if not _NUMBER.fullmatch(text.strip(" \t\r\n")):
        raise ValueError(f"'{text[:40]}' is no number")
    return float(text)


def real_numbers(who: str, values: Any) -> NDArray[np.float64]:
    """``values`` as an array of floats, itself where it is one; :class:`InputError` of ``who`` for what is masked, complex, text or
    anything else that NumPy would make numbers of, or raise its own errors for."""
    if type(values) is np.ndarray and values.dtype is _FLOAT:
        return values
    if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values):
        raise InputError(f"{who}: numbers are needed, got masked ones")
    try:
        array = np.asarray(values)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{who}: numbers are needed ({error})") from error
    if array.dtype.kind not in "biuf":
        raise InputError(f"{who}: numbers are needed, got {quoted(values)!r} ({array.dtype})")
    return array.astype(float)


def real_number(who: str, value: Any, largest: float = math.inf) -> float:
    """``value`` as a float; :class:`InputError` of ``who`` for what is no real number or beyond ``largest``, :class:`NotFinite`."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise InputError(f"{who}: a number is needed, got {quoted(value)!r}")
    try:
        number = float(value)
    except OverflowError:  # a whole number beyond all floats
        number = math.inf
    if not math.isfinite(number):
        raise NotFinite(f"{who} must be finite, got {number}")
    if abs(number) > largest:
        raise InputError(f"{who} must be at most {largest:g}, got {number:g}")
    return number


def whole_number(who: str, value: Any, minimum: int, largest: float = math.inf) -> int:
    """``value`` as an int; :class:`InputError` of ``who`` for what is no whole number from ``minimum`` to ``largest``."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not minimum <= value <= largest:
        upper = "on" if largest == math.inf else f"to {largest:g}"
        raise InputError(f"{who}: a whole number from {minimum} {upper} is needed, got {quoted(value)}")
    return int(value)


def absolute_time(who: str, value: Any) -> float:
    """A time [s]; raises as :func:`real_number`."""
    return real_number(f"{who}: the time", value, LATEST)


def unit_quaternion(who: str, name: str, value: ArrayLike) -> NDArray[np.float64]:
    """A quaternion (4) of length 1. Raises :class:`InputError` naming what it is of."""
    q = numbers(who, name, value, 4)
    at_most(who, 2.0, **{name: q})
    length = float(np.linalg.norm(q))
    if not 0.99 < length < 1.01:
        raise InputError(f"{who}: '{name}' needs a unit quaternion (w, x, y, z), got {q.tolist()}")
    return q / length


def unit_quaternions(who: str, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quaternions (n, 4) or one (4,), scaled to unit length; :class:`InputError` of ``who`` for a length that is not rounding."""
    lengths = np.linalg.norm(values, axis=-1, keepdims=True)
    if not (np.abs(lengths - 1.0) <= _LENGTH).all():
        wrong = lengths.flat[int(np.argmax(np.abs(lengths - 1.0)))]
        raise InputError(f"{who}: the quaternion has length {wrong:.3g}, 1 is needed")
    return np.asarray(values / lengths)


def numbers(who: str, name: str, values: ArrayLike, size: int) -> NDArray[np.float64]:
    """``values`` as an array of ``size`` finite numbers, or :class:`InputError`, :class:`NotFinite` of ``who`` by ``name``."""
    # what is infinite or no number stays so in a sum; a sum that is not finite may be of large numbers: those are asked one by one below
    if (
        type(values) is np.ndarray
        and values.dtype is _FLOAT
        and values.shape == (size,)
        and size <= _FEW
        and math.isfinite(sum(values.tolist()))
    ):
        return values
    try:
        value = real_numbers(who, values)
    except InputError:
        raise InputError(f"{who}: '{name}' needs {size} finite numbers, got {quoted(values)}") from None
    if value.shape != (size,):
        raise InputError(f"{who}: '{name}' needs {size} finite numbers, got {value}")
    # few numbers are checked several times as fast one by one
    if not (all(map(math.isfinite, value.tolist())) if size <= _FEW else np.isfinite(value).all()):
        raise NotFinite(f"{who}: '{name}' needs {size} finite numbers, got {value}")
    return value


def each(who: str, name: str, values: ArrayLike, size: int) -> NDArray[np.float64]:
    """``values`` as :func:`numbers`, or one number for all ``size``."""
    return numbers(who, name, np.full(size, values) if np.ndim(values) == 0 else values, size)


def at_most(who: str, largest: float, **values: ArrayLike) -> None:
    """Raise :class:`InputError` of ``who`` for finite numbers of a magnitude beyond ``largest``, by their name."""
    for name, value in values.items():
        if (np.abs(np.asarray(value, float)) > largest).any():
            raise InputError(f"{who}: '{name}' must be at most {largest:g}, got {quoted(value)}")


def finite(who: str, **values: float) -> None:
    """Raise :class:`NotFinite` for the first number that is not finite, :class:`InputError` for what is none, by its name."""
    for name, value in values.items():
        if type(value) is float and math.isfinite(value):
            continue
        try:
            good = math.isfinite(value)
        except OverflowError:  # a whole number beyond all floats
            raise NotFinite(f"{who}: '{name}' must be finite, got {quoted(value)}") from None
        except TypeError:
            good = None
        if good is None or isinstance(value, bool | np.bool_):
            raise InputError(f"{who}: '{name}' needs one finite number, got {value!r:.80}")
        if not good:
            raise NotFinite(f"{who}: '{name}' must be finite, got {value}")


def not_negative(who: str, **values: float) -> None:
    """Raise :class:`InputError` (:class:`NotFinite`) for the first number that is not finite or below 0, by its name."""
    finite(who, **values)
    for name, value in values.items():
        if value < 0.0:
            raise InputError(f"{who}: '{name}' must not be negative, got {value}")


def positive(who: str, **values: float) -> None:
    """Raise :class:`InputError` (:class:`NotFinite`) for the first number that is not finite or not above 0, by its name."""
    finite(who, **values)
    for name, value in values.items():
        if value <= 0.0:
            raise InputError(f"{who}: '{name}' must be positive, got {value}")


def scales(who: str, name: str, values: ArrayLike) -> NDArray[np.float64]:
    """``values`` as an array of positive numbers, of which some may be infinite; else :class:`InputError` of ``who`` by ``name``."""
    value = np.asarray(values, float)
    if not (value > 0.0).all():
        raise InputError(f"{who}: '{name}' needs positive numbers, got {value.tolist()}")
    return value


def positive_time(who: str, interval: float) -> None:
    """Raise :class:`InputError` (:class:`NotFinite`) for an ``interval`` [s] in which no time has passed."""
    finite(who, interval=interval)
    if interval <= 0.0:
        raise InputError(f"{who}: 'interval' must be positive, got {interval} s")


def is_covariance(matrix: ArrayLike) -> bool:
    """Whether a matrix of finite numbers can be a covariance: no variance is negative, in no direction."""
    values = np.linalg.eigvalsh(0.5 * (np.asarray(matrix) + np.asarray(matrix).T))
    return bool(values[0] >= -1e-9 * max(values[-1], 0.0))


#: Smallest eigenvalue of a matrix of correlations that has an inverse.
_CERTAIN = 1e-12


def is_certain(covariance: ArrayLike) -> bool:
    """Whether what has a covariance is certain in some direction. Units do not count: a yaw that is not known at all (1e9 rad²) is
    none."""
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return not spread.all() or bool(np.linalg.eigvalsh(covariance / np.outer(spread, spread))[0] < _CERTAIN)


def covariance(who: str, values: ArrayLike) -> NDArray[np.float64]:
    """``values`` as a covariance (3, 3), or :class:`InputError` (:class:`NotFinite`) of ``who``."""
    value = np.asarray(values, float)
    if value.shape != (3, 3):
        raise InputError(f"{who}: a covariance of 3 by 3 finite numbers is needed, got shape {value.shape}")
    if not np.isfinite(value).all():
        raise NotFinite(f"{who}: a covariance of 3 by 3 finite numbers is needed, got {value.tolist()}")
    if not is_covariance(value):
        raise InputError(f"{who}: a covariance is needed, a variance of this one is negative")
    return value


def whole(key: str, length: float, unit: float, name: str, minimum: int = 1, rate: float | None = None) -> int:
    """``length`` [s] of ``key`` in units of ``unit`` [s] called ``name``; ``rate`` [Hz]: what was given instead of the length.
    Raises :class:`InputError` for what is no whole number of them, or fewer than ``minimum``."""
    if length != math.inf:
        finite(key, time=length)
    if length / unit >= _MAXIMUM:
        raise InputError(f"{key}: {length:g} s is too long, more than a million {name} of {unit * 1e3:g} ms")
    count = round(length / unit)
    if count < minimum or abs(length - count * unit) > 1e-9:
        below, above = max(math.floor(length / unit), minimum), max(math.ceil(length / unit), minimum)
        if rate is None:
            valid = " or ".join(dict.fromkeys(f"{n * unit:g}" for n in (below, above))) + " s"
        else:
            valid = " or ".join(dict.fromkeys(f"{1.0 / (n * unit):.6g}" for n in (above, below))) + " Hz"
        text = f"{length:g} s" if rate is None else f"{rate:g} Hz ({length * 1e3:g} ms)"
        raise InputError(f"{key}: {text} is not a whole number of {name} of {unit * 1e3:g} ms; valid: e.g. {valid}")
    return count
