"""Work in a child process with a time limit: a peer may hang or crash."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable
from queue import Empty
from time import monotonic
from typing import Any


def _child(queue: Any, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    silence = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):  # some peers print whatever they are reported
        os.dup2(silence, stream)
    try:
        queue.put(function(*arguments))
    except Exception as error:  # the parent reports it
        lines = str(error).splitlines() or [type(error).__name__]
        queue.put(lines[-1][:200])


def within(seconds: float, function: Callable[..., Any], *arguments: Any) -> Any:
    """``function(*arguments)`` in a child process; a message (str) when it fails, dies or takes too long."""
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=_child, args=(queue, function, arguments), daemon=True)
    child.start()
    end = monotonic() + seconds
    try:
        while True:
            try:
                return queue.get(timeout=min(0.5, max(end - monotonic(), 0.01)))
            except Empty:
                if monotonic() >= end:
                    return f"no answer in {seconds:.0f} s"
                if not child.is_alive() and queue.empty():
                    return f"ended with exit status {child.exitcode}"
    finally:
        child.kill()
        child.join()
