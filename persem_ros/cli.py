"""The command persem: dispatch, exit status, one line for everything that goes wrong."""

import argparse
from contextlib import contextmanager
import importlib
import logging
import os
import sys

from persem_ros import __version__
from persem_ros.errors import PersemError

COMMANDS = ('simulate', 'convert', 'info', 'replay', 'evaluate', 'sweep', 'compare', 'config',
            'map')

DONE, REFUSED, USAGE, INTERRUPTED, PIPE_CLOSED = 0, 1, 2, 130, 141


def main(argv=None):
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
    argv = list(sys.argv[1:] if argv is None else argv)
    debug = '--debug' in argv       # wherever it stands, also behind the sub-command
    argv = [word for word in argv if word != '--debug']
    with _logging(debug):
        return _status(argv, debug)


def _status(argv, debug):
    """Run *argv* and return the exit status; everything that goes wrong ends here."""
    try:
        args = _parser(argv).parse_args(argv)
        status = args.run(args)
        sys.stdout.flush()
        return DONE if status is None else status
    except SystemExit as stop:      # argparse has said what it had to say
        return USAGE if stop.code is None else stop.code
    except KeyboardInterrupt:
        _say('interrupted')
        return INTERRUPTED
    except BrokenPipeError:
        # Python flushes standard output once more at exit, which must not fail as well.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return PIPE_CLOSED
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


def _parser(argv):
    """Return the parser; only the sub-command that *argv* names is imported, or else all."""
    parser = argparse.ArgumentParser(
        prog='persem', description='Persistent semantic maps from labelled images, depth and '
                                   'poses: from a recording to a refined map.')
    parser.add_argument('--version', action='version', version=f'persem_ros {__version__}')
    parser.add_argument('--debug', action='store_true', help='show tracebacks')
    subparsers = parser.add_subparsers(metavar='COMMAND', required=True)
    chosen = argv[:1] if argv and argv[0] in COMMANDS else COMMANDS
    for name in chosen:
        importlib.import_module(f'persem_ros.commands.{name}').add_parser(subparsers)
    return parser


def _failed(sentence, debug):
    """Say *sentence* on one line, with the traceback before it under --debug; return 1."""
    if debug:
        logging.getLogger(__name__).exception('traceback')
    _say(sentence)
    return REFUSED


def _say(sentence):
    """Write one line on standard error."""
    print(f'persem: {" ".join(sentence.split())}', file=sys.stderr)


@contextmanager
def _logging(debug):
    """Show our own log records on standard error, one line each, for as long as this lasts."""
    logger = logging.getLogger('persem_ros')
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter('persem: %(message)s'))
    level = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.DEBUG if debug else logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
