"""Every exception of the library; the messages name what was given and the valid choices."""

from __future__ import annotations

import difflib
import shlex
from collections.abc import Iterable
from pathlib import Path


def printable(text: str, kept: str = "") -> str:
    """``text`` with what would steer a terminal (escape sequences, reversed writing, line feeds) written out, but for characters that
    are ``kept``: names in files are not trusted."""
    return "".join(c if c.isprintable() or c in kept else c.encode("unicode_escape").decode() for c in text)


def shell_command(*words: object) -> str:
    """A command line that a user may paste, whatever its words are: names of files are not trusted. A path that would pass for an option
    begins with ``./``."""
    return printable(shlex.join(f"./{w}" if isinstance(w, Path) and str(w).startswith("-") else str(w) for w in words))


#: What is said in place of an error whose text cannot be made.
NO_TEXT = "(its text cannot be made)"


def text_of(error: BaseException) -> str:
    """What an error of other people's code says; its ``__str__`` may fail as well."""
    try:
        return str(error)
    except Exception:
        return NO_TEXT


def described(error: BaseException) -> str:
    """``ValueError: what it says``."""
    return f"{type(error).__name__}: {text_of(error)}"


class WbmpcError(Exception):
    """Base class of all errors raised on purpose by this library. Messages quote what comes from outside; they print safely."""

    def __str__(self) -> str:
        return printable(super().__str__(), kept="\n")


class InputError(WbmpcError, ValueError):
    """Bad input of the user: one clear message (file, key, valid choices). The command line exits with 2."""


class ProgramError(WbmpcError):
    """A user's program failed while it ran: the message names its file and line. The command line exits with 2; a study repeats it."""


class NotFinite(InputError):
    """A number that is not finite where a finite one is needed. In a running loop it ends the run, which exits with 1."""


class RunAborted(WbmpcError):
    """A run was stopped on purpose (the robot fell, the solver failed). The command line exits with 1."""


class EndedByUser(RunAborted):
    """The user ended a run: with Ctrl-C, or in a view. Nothing more of it follows. The command line exits with 130."""


class NotWritten(RunAborted):
    """Files of a run could not be written: the message names them, and where its figures are instead. Exits with 1."""


class FallPredicted(RunAborted):
    """A robot that balances will fall whatever it does: the motors are switched off before it does."""


class RobotStuck(RunAborted):
    """The robot stands away from its goal, and its plans do not lead there."""


class WayDeclined(RobotStuck):
    """The robot stands in front of what it does not get through, and can turn back: it reported that before it entered."""


class NoRoute(WbmpcError):
    """No route from the start to the goal was found."""


class DisturbanceTooLarge(RunAborted):
    """A force that no lean can hold drives a robot that balances ever faster: the motors are switched off."""


class SensorFailure(RunAborted):
    """What a robot must know is not seen any more: of its own state (encoders stand still) or of what is around it. It is stopped, or its
    motors are switched off."""


class SolveFailed(WbmpcError):
    """A solve that was asked to ``throw`` ended without a solution; the message is the solution's message."""


class SolverBusy(WbmpcError, RuntimeError):
    """A solver or an MPC was called from a second thread while it works for another one, or from within its own call: an MPC by
    its guess, either by a signal's handler."""


class KernelError(WbmpcError):
    """Generated code could not be built or loaded."""


class UnsupportedOperation(KernelError):
    """A term or the dynamics have an operation for which no code can be generated; the message names both."""


def did_you_mean(name: str, choices: Iterable[str]) -> str:
    """A hint ``(did you mean 'x'?)`` with a leading blank, or an empty string."""
    known = list(choices)
    same = [c for c in known if c.casefold() == name.casefold()]  # wheel_lf is wheel_LF, not wheel_RF
    near = same or difflib.get_close_matches(name, known, n=1, cutoff=0.6)
    return f" (did you mean '{near[0]}'?)" if near else ""


def unknown_name(kind: str, name: str, choices: Iterable[str], where: str = "") -> InputError:
    """An :class:`InputError` for a name that is not among ``choices``."""
    known, name = list(choices), printable(str(name))
    place = f"{where}: " if where else ""
    return InputError(
        f"{place}unknown {kind} '{name}'{did_you_mean(name, known)}; valid: {', '.join(known) if known else 'none'}"
    )
