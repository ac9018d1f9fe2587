"""Log lines of this library on /rosout, where ROS's tools collect those of all nodes."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from typing import Any

from wbmpc.logs import PlaceLimit, message_of
from wbmpc.ros2.bus import Node, Qos
from wbmpc.ros2.convert import stamp

#: As ROS's own publishers of it: late joiners get the last lines too.
_QOS = Qos(latched=True, depth=100)
#: Lines that wait to be sent; of more the oldest are dropped.
_MAXIMUM = 100
#: The greatest number of a line that a message can hold.
_LAST_LINE = 2**32 - 1


def _text(words: str) -> str:
    """As UTF-8 has it, for names of files may be none, and without NUL, where texts in C end."""
    return words.encode("utf-8", "backslashreplace").decode().replace("\0", "\\x00")


class Rosout(logging.Handler):
    """Takes log records in any thread; :meth:`send` publishes them in the node's own, ``yield_to_controller()`` before each.

    Levels are those of Python, which are ROS's too (debug 10, info 20, warning 30, error 40, fatal 50).
    """

    def __init__(
        self, node: Node, name: str, now: Callable[[], float], yield_to_controller: Callable[[], None]
    ) -> None:
        super().__init__()
        self.addFilter(PlaceLimit())
        self._to = node.publisher("/rosout", "rcl_interfaces/msg/Log", _QOS)
        self._node_name, self._now, self._yield_to_controller = name, now, yield_to_controller
        self._waiting: deque[dict[str, Any]] = deque(maxlen=_MAXIMUM)
        self._log = logging.getLogger("wbmpc")
        self._log.addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a record until it is sent."""
        self._waiting.append({
            "stamp": stamp(self._now()), "level": int(min(max(record.levelno // 10, 1), 5)) * 10, "name": self._node_name,
            "msg": _text(message_of(record)), "file": _text(record.pathname), "function": _text(record.funcName or ""),
            "line": min(max(record.lineno or 0, 0), _LAST_LINE),
        })  # fmt: skip

    def send(self) -> None:
        """Publish what has come since."""
        while self._waiting:
            self._yield_to_controller()
            self._to.publish(self._waiting.popleft())

    def close(self) -> None:
        """Send the rest, and take no more."""
        self._log.removeHandler(self)
        self.send()
        super().close()
