"""``python -m wbmpc``."""

import sys

from wbmpc.cli import main

if __name__ == "__main__":
    sys.exit(main())
