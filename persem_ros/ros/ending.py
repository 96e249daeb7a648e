"""How the node ends: SIGINT, SIGTERM and SIGHUP are one wish, and asking twice changes nothing."""

from contextlib import suppress
import os
import signal
import sys
from types import FrameType

from persem_ros.ending import silently

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Ending:
    """
    The wish that the process end.

    rclpy's own handlers shut ROS down under whoever still publishes, and a second Ctrl-C then
    meets a half-ended process. Here a signal only says that the end is wanted; ROS lives until
    the map is saved.

    Parameters
    ----------
    begun : bool
        False: a signal leaves at once, until this is True. Imports have nothing to clean up, and
        libraries that are interrupted while they load print tracebacks of their own.

    Attributes
    ----------
    begun : bool
        The same.
    patient : bool
        False (at the start): a signal raises KeyboardInterrupt in the main thread, so that
        imports, loading and compiling end at once. True: it only ends `wait()`.

    """

    def __init__(self, begun: bool = True) -> None:
        """Take the signals over; the main thread only."""
        self.begun, self.patient = begun, False
        # No threading.Event: a signal that strikes while the main thread is inside of its wait()
        # would wait for a lock that this thread holds.
        self._wanted = False
        self._read, self._write = os.pipe()
        os.set_blocking(self._write, False)
        # Written to as a signal comes: its handler runs at the next look only, and a main thread
        # that waited for the interpreter's lock before it began to read would not look again.
        signal.set_wakeup_fd(self._write, warn_on_full_buffer=False)
        for number in SIGNALS:
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:  # nohup
                signal.signal(number, self._take)
        signal.signal(signal.SIGALRM, self._again)
        sys.unraisablehook = self._unraisable

    @property
    def wanted(self) -> bool:
        """Return whether the end is wanted."""
        return self._wanted

    def want(self) -> None:
        """Want it without a signal; from any thread."""
        self._wanted = True
        with suppress(BlockingIOError):
            os.write(self._write, b'.')

    def wait(self) -> None:
        """Wait until the end is wanted; the main thread only."""
        while not self._wanted:
            os.read(self._read, 1)

    def over(self) -> None:
        """Let signals pass: there is nothing left to interrupt but Python's own end."""
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)

    def _take(self, number: int, frame: FrameType | None) -> None:
        if not self.begun:
            silently()
        first = not self._wanted
        self.want()
        if first and not self.patient:
            raise KeyboardInterrupt

    def _unraisable(self, info: 'sys.UnraisableHookArgs') -> None:
        """Raise an interrupt anew that struck where exceptions are lost; pass on anything else."""
        if issubclass(info.exc_type, KeyboardInterrupt):
            signal.setitimer(signal.ITIMER_REAL, 0.01)
        elif not self._wanted:      # destructors of what compiling left when it was stopped
            sys.__unraisablehook__(info)

    def _again(self, number: int, frame: FrameType | None) -> None:
        if not self.patient:
            raise KeyboardInterrupt
