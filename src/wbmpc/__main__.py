"""``python -m wbmpc`` and the command ``wbmpc``."""

import sys


def main() -> int:
    """The exit status of a command; that of Ctrl-C too where it comes before the command line is loaded."""
    try:
        from wbmpc.cli import main as run

        return run()
    except KeyboardInterrupt:
        print("wbmpc: interrupted", file=sys.stderr)
        return 130
    finally:
        exec(
            ""
        )  # Python forgets an interrupt inside of another exec, with which it would end instead of with the status


if __name__ == "__main__":
    sys.exit(main())
