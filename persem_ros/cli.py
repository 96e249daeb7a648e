"""The command persem: dispatch, exit status, one line for everything that goes wrong."""

from __future__ import annotations

import sys

from persem_ros import ending

if sys.argv[:1] and sys.argv[0].rpartition('/')[2] in ('persem', '__main__.py'):
    # Until main() begins. A worker of an evaluation runs this file, too, and has nothing to say.
    ending.handle(ending.silently if 'multiprocessing.spawn' in sys.modules else ending.at_once)

import argparse                                     # noqa: E402, I100
from collections.abc import Iterator                # noqa: E402
from contextlib import contextmanager, redirect_stdout, suppress    # noqa: E402
import importlib                                    # noqa: E402
import logging                                      # noqa: E402
import os                                           # noqa: E402
from typing import Any, TextIO                      # noqa: E402

from persem_ros import __version__                  # noqa: E402
from persem_ros.errors import PersemError           # noqa: E402
from persem_ros.guard.words import plain, sentence  # noqa: E402
from persem_ros.settings.config import nearest, settings    # noqa: E402

COMMANDS = ('simulate', 'convert', 'info', 'replay', 'build', 'evaluate', 'sweep', 'compare',
            'config', 'map')

# What is easily taken for each other.
MEANS = {'refine.method': ' (the map and the pictures)', '--methods': ' (rows of the table)'}
DONE, REFUSED, USAGE, INTERRUPTED, PIPE_CLOSED = 0, 1, 2, ending.INTERRUPTED, 141


def main(argv: list[str] | None = None) -> int:
    """
    Run one sub-command and return its exit status.

    Parameters
    ----------
    argv : sequence of str, optional
        The arguments after the program's name; those of the process by default.

    Returns
    -------
    int
        0 done; 1 refused or failed, with one line on standard error; 2 usage; 130 interrupted;
        141 (as for a program that SIGPIPE ends) when the reader of standard output went away.

    """
    alone = argv is None        # a process of its own, not a call
    try:
        if alone:
            ending.begin()
            _repair_streams()
        argv = list(sys.argv[1:] if argv is None else argv)
        debug = '--debug' in argv       # wherever it stands, also behind the sub-command
        argv = [word for word in argv if word != '--debug']
        with _logging(debug), redirect_stdout(_Plain(sys.stdout)):
            status = _status(argv, debug)
    except KeyboardInterrupt:
        status = INTERRUPTED
    if alone:
        try:
            ending.leave(status)
        except KeyboardInterrupt:       # as it began
            ending.leave(INTERRUPTED)
    return status


class _Plain:
    """A text stream in front of another one: names from files cannot command the terminal."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write a text, control characters escaped."""
        return self._stream.write(plain(text, lines=True))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _repair_streams() -> None:
    """Give closed streams a place to go, and let any encoding write any name."""
    handle = os.open(os.devnull, os.O_RDWR)
    while handle <= 2:          # lest a file of ours gets the number of a closed stream
        handle = os.dup(handle)
    os.close(handle)
    for name in ('stdin', 'stdout', 'stderr'):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, 'r' if name == 'stdin' else 'w'))
        elif name != 'stdin' and hasattr(stream, 'reconfigure'):
            stream.reconfigure(errors='backslashreplace')


def _status(argv: list[str], debug: bool) -> int:
    """Run *argv* and return the exit status; everything that goes wrong ends here."""
    try:
        return _run(argv, debug)
    except KeyboardInterrupt:
        pass
    except BaseException:
        if not ending.interrupted():
            raise
    _say('interrupted')
    return INTERRUPTED


def _run(argv: list[str], debug: bool) -> int:
    """Run *argv*; an interrupt comes through, also one that was taken for a fault of a file."""
    try:
        args = _parsed(argv)
        status = args.run(args)
        sys.stdout.flush()
        return DONE if status is None else status
    except SystemExit as stop:      # argparse has said what it had to say
        return stop.code if isinstance(stop.code, int) else USAGE
    except BrokenPipeError:
        # Python flushes standard output once more at exit, which must not fail as well.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return PIPE_CLOSED
    except Exception as error:
        if ending.interrupted():
            raise
        return _fault(error, debug)


def _fault(error: Exception, debug: bool) -> int:
    """Say what went wrong and return the exit status."""
    try:
        raise error
    except PersemError as error:
        return _failed(str(error), debug)
    except OSError as error:
        return _failed(': '.join(str(part) for part in (error.filename, error.strerror or error)
                                 if part is not None), debug)
    except MemoryError:
        return _failed('out of memory; larger voxels, a smaller memory.max_depth or a larger '
                       'memory.stride need less', debug)
    except Exception as error:      # a defect of ours
        return _failed(f'internal error ({type(error).__name__}: {error}), please report; '
                       'rerun with --debug for the traceback', debug)


class _Parser(argparse.ArgumentParser):
    """
    A parser that takes options by their whole names and names the nearest choice.

    The arguments that it takes apart know it (parser): of a sub-command, the innermost.

    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        # An abbreviation of another option would be taken for it: --method for --methods.
        super().__init__(*args, **{**kwargs, 'allow_abbrev': False})

    def parse_known_args(       # type: ignore[override]
            self, args: Any = None, namespace: Any = None) -> tuple[argparse.Namespace, list[str]]:
        """Take arguments apart; return them and those that are none of ours."""
        found, strange = super().parse_known_args(args, namespace)
        if not hasattr(found, 'parser'):
            found.parser = self
        return found, strange

    def longer(self, option: str) -> list[str]:
        """Return the options that begin with another one."""
        return [name for name in self._option_string_actions if name.startswith(option)]

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        try:
            super()._check_value(action, value)
        except argparse.ArgumentError as error:
            raise argparse.ArgumentError(
                action, error.message + nearest(value, action.choices or ())) from None


def _parsed(argv: list[str]) -> argparse.Namespace:
    """Return the arguments taken apart; SystemExit where they are none of ours."""
    parser = _parser(argv)
    args, strange = parser.parse_known_args(argv)
    if strange:
        hint = _meant(strange, argv, args)
        parser.error(f'unrecognized arguments: {" ".join(strange)}{hint}')
    return args


def _meant(strange: list[str], argv: list[str], args: argparse.Namespace) -> str:
    """Return words with the --set or the option that one like --voxel-size 0.05 may have meant."""
    hints = [f'--set {name}={value}' for option, name, value in zip(argv, argv[1:], argv[2:])
             if option == '--set' and '=' not in name and value in strange]
    for option in (word for word in strange if word.startswith('--') and len(word) > 2):
        word, equals, value = option.partition('=')
        tail = word[2:].replace('-', '_')
        if not equals:
            value = (argv[argv.index(option) + 1:] or ['--'])[0]
            value = 'VALUE' if value.startswith('--') else value
        if hasattr(args, 'set_items'):
            hints += [f'--set {name}={value}{MEANS.get(name, "")}' for name, _, _ in settings()
                      if tail in (name, name.rpartition('.')[2])]
        hints += [f'{name} {value}{MEANS.get(name, "")}' if name in MEANS else name
                  for name in args.parser.longer(word)]
    return f'; did you mean {" or ".join(hints)}?' if hints else ''


def _parser(argv: list[str]) -> _Parser:
    """Return the parser; only the sub-command that *argv* names is imported, or else all."""
    parser = _Parser(
        prog='persem', description='Persistent semantic maps from labelled images, depth and '
                                   'poses: from a recording to a refined map.')
    parser.add_argument('--version', action='version', version=f'persem_ros {__version__}')
    parser.add_argument('--debug', action='store_true', help='show tracebacks')
    subparsers = parser.add_subparsers(metavar='COMMAND', required=True)
    chosen = argv[:1] if argv and argv[0] in COMMANDS else COMMANDS
    for name in chosen:
        importlib.import_module(f'persem_ros.commands.{name}').add_parser(subparsers)
    return parser


def _failed(text: str, debug: bool) -> int:
    """Say *text* on one line, with the traceback before it under --debug; return 1."""
    if debug:
        logging.getLogger(__name__).exception('traceback')
    _say(text)
    return REFUSED


def _say(text: str) -> None:
    """Write one line on standard error."""
    with suppress(OSError, ValueError):     # nobody reads it
        print(f'persem: {sentence(text)}', file=sys.stderr)


class _Formatter(logging.Formatter):
    """One line a record, control characters escaped; tracebacks keep their lines."""

    def format(self, record: logging.LogRecord) -> str:   # noqa: A003
        """Return the record as text."""
        text = super().format(record)
        return plain(text, lines=True) if record.exc_info else sentence(text)


# Not to be subscribed before Python 3.11.
class _Handler(logging.StreamHandler):      # type: ignore[type-arg]
    """Standard error, which somebody may have closed."""

    def handleError(self, record: logging.LogRecord) -> None:      # noqa: N802
        """Pass over a stream that is gone."""
        if not isinstance(sys.exc_info()[1], OSError):
            super().handleError(record)


@contextmanager
def _logging(debug: bool) -> Iterator[None]:
    """Show our own log records on standard error, one line each, for as long as this lasts."""
    logger = logging.getLogger('persem_ros')
    handler = _Handler()
    handler.setFormatter(_Formatter('persem: %(message)s'))
    level = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.DEBUG if debug else logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
