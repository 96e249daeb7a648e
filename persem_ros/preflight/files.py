"""Files: which part of a recording is used, and that there is something in it."""

from persem_ros.errors import PersemError
from persem_ros.inputs.recording.excerpt import Excerpt
from persem_ros.inputs.recording.recording import Recording
from persem_ros.inputs.recording.source import Source
from persem_ros.preflight.findings import Finding, NOTE, REFUSE
from persem_ros.settings.config import Config


def part(source: Source, config: Config, excerpt: Excerpt) -> Finding:
    """Return how --start, --end and --every were understood, refused where nothing is left."""
    try:
        recording = Recording(source.path, config, source, excerpt)
        sentence, count = excerpt.sentence(recording.bounds), recording.expected
    except PersemError as error:
        return Finding(REFUSE, str(error))
    if not count:
        return Finding(REFUSE, recording.nothing())
    return Finding(NOTE, f'{sentence}: {count} label images')
