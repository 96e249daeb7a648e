"""What metadata.yaml says of a recording: which files, and how many messages of which topic."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from persem_ros.errors import PersemError
from persem_ros.guard import yaml_text

NAME = 'metadata.yaml'
LONGEST = 16 << 20          # bytes; some thousand split files make one


@dataclass
class Metadata:
    """
    The content of a metadata.yaml, as far as it can be read.

    Attributes
    ----------
    files : list of str
        Names in the folder, in order.
    counts : Counter of str
        Messages by topic.
    by_file : dict of str to int
        Messages by file, where it says so.
    fault : str
        Why it cannot be read, '' where it can.

    """

    files: list[str] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)
    by_file: dict[str, int] = field(default_factory=dict)
    fault: str = ''


def read(path: Path) -> Metadata:
    """Return the content of a metadata.yaml; its fault where there is none."""
    found = Metadata()
    try:
        if path.stat().st_size > LONGEST:
            raise ValueError(f'larger than {LONGEST >> 20} MB')
        content = yaml_text.load(path.read_text(encoding='utf-8'), NAME, yaml_text.RECORDING)
        info = content['rosbag2_bagfile_information']
        # The first versions of rosbag2 put the folder's name before the file's.
        found.files = [_name(path) for path in info['relative_file_paths']]
        for row in info['topics_with_message_count']:
            found.counts[str(row['topic_metadata']['name'])] += int(row['message_count'])
        for row in info.get('files') or []:
            found.by_file[_name(row['path'])] = int(row['message_count'])
    except OSError as error:
        found.fault = error.strerror or 'cannot be read'
    except PersemError as error:
        found.fault = str(error).partition(': ')[2][:120]
    except ValueError as error:
        found.fault = ' '.join(str(error).split())[:120]
    except (KeyError, TypeError, AttributeError, OverflowError):
        found.fault = 'it has not the form of rosbag2'
    return found


def _name(path: object) -> str:
    """Return the name in a path, which a recorder on Windows writes with backslashes."""
    return PurePosixPath(str(path).replace('\\', '/')).name
