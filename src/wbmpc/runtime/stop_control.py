"""How a robot is stopped in real time: on request, after an error, and by a watchdog while a tick hangs."""

from __future__ import annotations

import logging
import threading
from typing import Any, Protocol, TypeVar

from wbmpc.errors import described
from wbmpc.runtime.clock import Clock
from wbmpc.runtime.safety import RealTimeSettings

_LOG = logging.getLogger("wbmpc")


class Timed(Protocol):
    """What has a ``time`` [s]."""

    @property
    def time(self) -> float: ...


#: Messages of one robot: what it measures and what it is commanded.
MeasurementT = TypeVar("MeasurementT", covariant=True, bound=Timed)
CommandT = TypeVar("CommandT", contravariant=True)


class RobotInterface(Protocol[MeasurementT, CommandT]):
    """A robot. None of the calls may block for long; ``stop`` may come from another thread while ``read`` hangs.

    ``read`` returns a measurement with its ``time`` [s] on the runner's clock: numbers, arrays or a dataclass of them.
    """

    def read(self) -> MeasurementT:
        """The newest measurement. What it raises stops the robot."""

    def write(self, command: CommandT) -> None:
        """Send the controller's ``command`` to the drives."""

    def stop(self) -> None:
        """Bring the robot to rest; may be called again, and from another thread."""


class StopControl:
    """Stops a ``robot`` for good. ``state`` says what it does, or why it stopped; ``error``: the exception behind that;
    ``ticking``: whether a tick is under way, which a stop from another thread does not end."""

    def __init__(self, robot: RobotInterface[Any, Any], settings: RealTimeSettings, clock: Clock) -> None:
        self.robot, self.settings, self.clock = robot, settings, clock
        self.state, self.error = "not started", None  # type: str, BaseException | None
        self._stopped, self._ended = threading.Event(), threading.Event()
        self._stop_error: BaseException | None = None
        self._halt_lock = threading.Lock()
        #: when the last tick began [s]
        self._beat = 0.0
        #: set before the tick asks whether it may run
        self.ticking = False

    @property
    def overdue(self) -> bool:
        """Whether a tick has been due for longer than the watchdog waits: of a process that was held up other threads may go on first."""
        return self.clock.now() - self._beat > self.settings.watchdog

    def halt(self, reason: str, error: BaseException | None = None) -> None:
        """Stop the robot for good; the first reason stays. May be called from any thread."""
        with self._halt_lock:
            if self._stopped.is_set():
                return
            self.state = f"stopped at {self.clock.now():.3f} s: {reason}"
            self.error = error or self.error
            self._stopped.set()
        _LOG.error("%s", self.state, exc_info=self.error)

    def _raised(self, error: BaseException) -> None:
        self.halt(f"the controller raised {described(error)}", error)

    def _stop_robot(self) -> None:
        try:
            self.robot.stop()
        except (Exception, SystemExit) as error:
            if self._stop_error is not None:
                return
            self._stop_error = error
            message = f"the robot's stop() raised {described(error)}"
            if self._stopped.is_set():
                self.state += f"; {message}"
                _LOG.error("%s", message, exc_info=error)
            else:
                self.halt(message, error)

    def _watch(self) -> None:
        """Stop the robot from here while a tick hangs."""
        limit, last, worst, beat = self.settings.watchdog, self.clock.now(), 0.0, self._beat
        while not self._ended.wait(0.2 * limit):
            now = self.clock.now()
            worst = max(worst, now - last) if self._beat == beat else now - last
            silent, beat, last = now - self._beat, self._beat, now
            if silent > limit:
                why = ": the machine is too busy, the watchdog was held up too" if worst > 0.5 * limit else ""
                self.halt(f"a tick of the controller has not ended for {silent:.3f} s, the limit is {limit:g} s{why}")
                self._stop_robot()
