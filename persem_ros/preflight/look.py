"""All checks over one sample, and the one way in for whoever maps a recording."""

from collections.abc import Callable, Iterator, Sequence
import logging
from pathlib import Path
from shlex import quote

from persem_ros.errors import PersemError
from persem_ros.guard import limits
from persem_ros.inputs.recording.excerpt import Excerpt, WHOLE
from persem_ros.inputs.recording.recording import Recording
from persem_ros.inputs.recording.source import Source
from persem_ros.inputs.recording.topics import Choice
from persem_ros.preflight import (
    confidence, depth, frames, labels, lag, poses, recorded, stamps)
from persem_ros.preflight.files import as_one, cut
from persem_ros.preflight.findings import Finding, NOTE, of_severity, REFUSE, WARN
from persem_ros.preflight.sample import Sample
from persem_ros.settings import config_file
from persem_ros.settings.config import Config, frame_of

log = logging.getLogger(__name__)
# What a check takes holds for those after it: frames before whatever needs a pose.
CHECKS: tuple[Callable[[Sample], Iterator[Finding]], ...] = (
    labels.check, depth.check, confidence.check, frames.check, poses.check, stamps.check,
    lag.check)
# What compares frames with each other: only where nothing was refused before.
FITS: tuple[Callable[[Sample], Iterator[Finding]], ...] = (
    poses.check_reading, depth.check_fit)


def look(sample: Sample) -> list[Finding]:
    """
    Run every check; settings that one takes are in *sample.config* afterwards (not of a node).

    Returns
    -------
    list of Finding
        Each once, in the order of the checks.

    """
    found: list[Finding] = []
    for view in sample.views:
        view.given = frame_of(sample.config, view.name)
    for check in (*CHECKS, *FITS):
        if check in FITS and (of_severity(found, REFUSE) or any(map(poses.doubts, found))):
            break       # what is wrong already makes depth miss depth
        for finding in check(sample):
            if finding in found:
                continue
            found.append(finding)
            if finding.takes and not sample.live:
                items = [config_file.parse_item(f'{k}={v}') for k, v in finding.takes.items()]
                sample.config = config_file.from_values(dict(items), sample.config)
                for view in sample.views:
                    view.poses.configure(sample.config.pose, sample.config.frames.map)
    return found


def say(found: list[Finding]) -> None:
    """Log what a user should know before mapping."""
    for finding in of_severity(found, WARN, NOTE):
        log.warning(finding.text())


def takes_of(found: list[Finding]) -> dict[str, str]:
    """Return the settings that findings took over, {name: value}."""
    return {name: value for finding in found for name, value in finding.takes.items()}


def opened(path: str | Path, config: Config, quiet: bool = False,
           excerpt: Excerpt = WHOLE) -> Recording:
    """
    Open a recording, or an excerpt of it, for mapping, after a look at it.

    Warnings and what was decided are logged, unless *quiet* (somebody has said it before); the
    Recording's config holds what was taken.

    Raises
    ------
    PersemError
        Where there is no recording, a topic is missing, or a check refuses: every reason and
        what to type.

    """
    limits.use(config.inputs.max_pixels)
    source = Source(path)
    try:
        choice = Choice(source, config)
        choice.check()
        sample = recorded.sample(source, choice, config)
        if excerpt != WHOLE:
            cut(sample, excerpt)
        found = look(sample)
        refused = of_severity(found, REFUSE)
        if refused:
            raise PersemError(f'{path}: {"; ".join(f.text() for f in refused)}; "persem info '
                              f'{quote(str(path))}" shows what is there')
        if not quiet:
            say(found)
        recording = Recording(path, sample.config, source, excerpt)
        if not quiet:
            _say_of_files(recording)
            recording.said |= {finding.text() for finding in found}
        return recording
    except BaseException:
        source.close()
        raise


def opened_all(paths: Sequence[str | Path], config: Config,
               excerpt: Excerpt = WHOLE) -> list[Recording]:
    """Return the open recordings of some inputs; what is decided for one holds for the next."""
    recordings: list[Recording] = []
    try:
        for path in paths:
            recordings.append(opened(path, config, excerpt=excerpt))
            config = recordings[-1].config
    except BaseException as error:
        for recording in recordings:
            recording.close()
        if isinstance(error, PersemError) and (
                sentence := as_one(paths, config) if len(paths) > 1 else ''):
            raise PersemError(f'{error}; {sentence}') from None
        raise
    return recordings


def _say_of_files(recording: Recording) -> None:
    """Log what is known of the files before they are read, and which part is used."""
    recording.said = set(recording.notes)
    for note in recording.notes:
        log.warning('%s', note)
    if recording.excerpt != WHOLE:
        log.info('%s', recording.excerpt.sentence(recording.bounds))
