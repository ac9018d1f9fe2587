"""``python -m wbmpc``."""

from wbmpc.cli import main

if __name__ == "__main__":
    main()
