"""How the node ends: SIGINT, SIGTERM and SIGHUP are one wish, and asking twice changes nothing."""

import signal
import sys
import threading
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Ending:
    """
    The wish that the process end.

    rclpy's own handlers shut ROS down under whoever still publishes, and a second Ctrl-C then
    meets a half-ended process. Here a signal only says that the end is wanted; ROS lives until
    the map is saved.

    Attributes
    ----------
    patient : bool
        False (at the start): a signal raises KeyboardInterrupt in the main thread, so that
        imports, loading and compiling end at once. True: it only ends `wait()`.

    """

    def __init__(self) -> None:
        """Take the signals over; the main thread only."""
        self.patient = False
        self._wanted = threading.Event()
        for number in SIGNALS:
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:  # nohup
                signal.signal(number, self._take)
        signal.signal(signal.SIGALRM, self._again)
        sys.unraisablehook = self._unraisable

    @property
    def wanted(self) -> bool:
        """Return whether the end is wanted."""
        return self._wanted.is_set()

    def want(self) -> None:
        """Want it without a signal; from any thread."""
        self._wanted.set()

    def wait(self) -> None:
        """Wait until the end is wanted."""
        self._wanted.wait()

    def over(self) -> None:
        """Let signals pass: there is nothing left to interrupt but Python's own end."""
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)

    def _take(self, number: int, frame: FrameType | None) -> None:
        first = not self._wanted.is_set()
        self._wanted.set()
        if first and not self.patient:
            raise KeyboardInterrupt

    def _unraisable(self, info: 'sys.UnraisableHookArgs') -> None:
        """Raise an interrupt anew that struck where exceptions are lost; pass on anything else."""
        if issubclass(info.exc_type, KeyboardInterrupt):
            signal.setitimer(signal.ITIMER_REAL, 0.01)
        else:
            sys.__unraisablehook__(info)

    def _again(self, number: int, frame: FrameType | None) -> None:
        if not self.patient:
            raise KeyboardInterrupt
