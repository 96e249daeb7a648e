"""
How the process ends: a signal stops what it does, cleaning up follows, then it leaves with 130.

Imported first of all by the command line, for an interrupt may come while the rest is imported.
Python's own way would write a traceback then, and lose the interrupt where it strikes inside of a
callback or while the interpreter takes itself apart.

"""

import os
import signal
import sys

# Everything else is imported when it is needed: until handle() was called, which the command line
# does right after this, an interrupt ends in a traceback.

INTERRUPTED = 130
PATIENCE = 5.0          # s for cleaning up, where a long call does not end
SIGNALS = tuple(getattr(signal, name) for name in ('SIGINT', 'SIGTERM', 'SIGHUP')
                if hasattr(signal, name))
_first = [0]            # the signal that ended the run, 0: none


def interrupted() -> bool:
    """Return whether a signal has come, whatever became of the exception that it raised."""
    return _first[0] != 0


def at_once(*_: object) -> None:
    """Leave: nothing has begun yet, or all is done and written."""
    try:
        os.write(2, b'persem: interrupted\n')
    finally:
        os._exit(INTERRUPTED)


def silently(*_: object) -> None:
    """Leave without a word."""
    os._exit(INTERRUPTED)


def handle(handler: object) -> None:
    """Have *handler* called for every signal that ends a run, unless it was to be ignored."""
    for number in SIGNALS:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, handler)      # type: ignore[arg-type]


def begin() -> None:
    """Let a signal stop the run that begins as Ctrl-C does, from any place in it."""
    import threading
    read, write = os.pipe()
    os.set_blocking(write, False)
    signal.set_wakeup_fd(write, warn_on_full_buffer=False)
    threading.Thread(target=_wait, args=(read,), name='signals', daemon=True).start()
    os.register_at_fork(after_in_child=lambda: signal.set_wakeup_fd(-1))
    sys.unraisablehook = _unraisable
    signal.signal(signal.SIGALRM, _again)
    handle(_once)


def leave(status: int) -> None:
    """End the process with *status*, or 130 where a signal has come; there is no way back."""
    handle(at_once)
    finish()
    # Not by sys.exit: an interrupt while Python ends would give a traceback and another status.
    os._exit(INTERRUPTED if interrupted() else status)


def leave_deaf(status: int) -> None:
    """End the process with *status*; whoever ignores signals by now goes on to do so."""
    finish()
    os._exit(status)        # Python taking itself apart would give signals back to the system


def finish() -> None:
    """Do what Python does before it ends a process."""
    import atexit
    from contextlib import suppress
    for stream in (sys.stdout, sys.stderr):
        with suppress(Exception):       # a reader that went away, a full disk
            stream.flush()
    with suppress(Exception):
        atexit._run_exitfuncs()


def _once(number: int, _: object) -> None:
    """Stop the run; what comes later changes nothing, for cleaning up must not be stopped."""
    if not interrupted():
        _first[0] = number
        raise KeyboardInterrupt


def _again(*_: object) -> None:
    raise KeyboardInterrupt


def _unraisable(info: 'sys.UnraisableHookArgs') -> None:
    """Raise an interrupt anew that struck where exceptions are lost; pass on anything else."""
    if issubclass(info.exc_type, KeyboardInterrupt):
        signal.setitimer(signal.ITIMER_REAL, 0.01)
    elif not interrupted():
        sys.__unraisablehook__(info)


def _wait(pipe: int) -> None:
    """Leave for good where the main thread is held up in a call that no signal ends."""
    while True:
        got = os.read(pipe, 1)
        if not got or got[0] in SIGNALS:
            break
    import time
    time.sleep(PATIENCE)
    at_once()
