"""Where the benchmark's shared libraries, which a C compiler made, are kept: what is loaded from there runs."""

from __future__ import annotations

import atexit
import logging
import shutil
import tempfile
from functools import cache
from pathlib import Path

from wbmpc.kernel.cache import UntrustedCache, trusted_folder

_LOG = logging.getLogger("wbmpc")


def library_folder() -> Path:
    """The cache's folder of libraries; one of this process alone, gone at its end, where the cache is not the user's own."""
    try:
        return trusted_folder("peers")
    except (OSError, UntrustedCache) as error:
        return _own_folder(str(error))


@cache
def _own_folder(why: str) -> Path:
    _LOG.warning("compiled libraries are not kept, for %s", why)
    folder = Path(tempfile.mkdtemp(prefix="wbmpc-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
