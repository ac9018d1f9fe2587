"""``python -m wbmpc`` and the command ``wbmpc``."""

import sys

#: Exit status of Ctrl-C.
_INTERRUPTED = 130


def main() -> int:
    """The exit status of a command; that of a signal too where it comes before the command line is loaded."""
    try:
        from wbmpc.interrupts import ended_by_signal, see_exits, terminable

        see_exits()  # of what a user's program does at the end of the process, too
        with terminable():  # loading takes a second
            return _run() or ended_by_signal()
    except KeyboardInterrupt:
        return _interrupted()
    finally:
        # Python forgets an interrupt inside of another exec, with which it would end instead of with the status
        exec("")


def _run() -> int:
    try:
        from wbmpc.cli import main as run

        return run()
    except KeyboardInterrupt:
        from wbmpc.interrupts import ended_by_signal

        _interrupted()
        return ended_by_signal() or _INTERRUPTED


def _interrupted() -> int:
    print("wbmpc: interrupted", file=sys.stderr)
    return _INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
