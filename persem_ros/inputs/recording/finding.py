"""What a path means: the storage files of a recording, or the sentence that says what to give."""

from contextlib import suppress
from dataclasses import dataclass, field
from itertools import chain, islice
from pathlib import Path
from shlex import quote

from persem_ros.errors import PersemError
from persem_ros.inputs.recording import metadata
from persem_ros.inputs.recording.metadata import Metadata
from persem_ros.inputs.recording.packing import SUFFIXES as PACKED, ZSTD

IMAGES = ('.png', '.jpg', '.jpeg', '.tif', '.tiff', '.pgm', '.npy', '.exr')
LOOKED_AT = 10_000      # files, to see whether there are images or recordings
SHOWN = 8               # recordings in a sentence
STORED = ('.mcap', '.db3')
BESIDE = ('-wal', '-shm', '-journal')
MCAP, SQLITE, ROS1 = b'\x89MCAP0\r\n', b'SQLite format 3\0', b'#ROSBAG V'
ARCHIVES = ('.zip', '.tar', '.gz', '.tgz', '.bz2', '.xz', '.7z', '.rar', '.lz4')
WANTED = 'expected a rosbag2 folder, .mcap or .db3 file'


@dataclass
class Found:
    """
    The files of one recording.

    Attributes
    ----------
    path : Path
        Its folder or file.
    files : list of Path
        Storage files in order, compressed as a whole or not.
    metadata : Metadata or None
        None where there is none.
    missing : list of str
        Files that metadata.yaml lists and that are not there.
    notes : list of str
        What the user should know.

    """

    path: Path
    files: list[Path]
    metadata: Metadata | None = None
    missing: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def split(path: str | Path) -> list[Path]:
    """
    Return the recordings of one input: 'drive+labels' is two of them.

    A plus sign in the name of a file or folder that exists parts nothing.

    """
    whole = str(path)
    if Path(whole).exists():
        return [Path(whole)]
    for i in (i for i, c in enumerate(whole) if c == '+'):
        if 0 < i < len(whole) - 1 and Path(whole[:i]).exists():
            rest = split(whole[i + 1:])
            if len(rest) > 1 or rest[0].exists():
                return [Path(whole[:i]), *rest]
    pieces = whole.split('+')
    return [Path(piece) for piece in pieces] if all(pieces) and any(
        Path(piece).exists() for piece in pieces) else [Path(whole)]


def found(path: Path) -> Found:
    """
    Return the files of a recording.

    Parameters
    ----------
    path : Path
        A rosbag2 folder, its metadata.yaml, a folder with one recording in it, or a .mcap or
        .db3 file, which may be compressed.

    Raises
    ------
    PersemError
        Where it is something else: what it is, and what to give.

    """
    if not path.exists():
        raise PersemError(f'{path} does not exist; {WANTED}')
    if path.is_dir():
        return _in_folder(path)
    if path.name == metadata.NAME:
        return _in_folder(path.parent)
    for tail in BESIDE:
        if path.name.endswith(tail) and path.with_name(path.name[:-len(tail)]).exists():
            return found(path.with_name(path.name[:-len(tail)]))
    check_file(path)
    return Found(path, [path])


def is_stored(file: Path) -> bool:
    """Return whether a file's name is that of a storage file, compressed or not."""
    name = file.with_suffix('') if file.suffix in PACKED else file
    return name.suffix in STORED


def in_order(files: list[Path]) -> list[Path]:
    """Return files in the order of their numbers: name_2 before name_10."""
    return sorted(files, key=lambda f: (len(f.name), f.name))


def _in_folder(folder: Path) -> Found:
    there = [f for f in folder.iterdir() if is_stored(f) and f.is_file()]
    # Both, where somebody decompressed a file and kept the other.
    there = [f for f in there if f.suffix not in PACKED or f.with_suffix('') not in there]
    if (folder / metadata.NAME).exists():
        return _listed(folder, there)
    if there:
        return Found(folder, in_order(there), notes=[
            f'{folder.name} has no {metadata.NAME} (the recorder was interrupted?): its files '
            'were read without'])
    return _below(folder)


def _listed(folder: Path, there: list[Path]) -> Found:
    """Return what metadata.yaml lists, and what is there in place of it."""
    content = metadata.read(folder / metadata.NAME)
    if content.fault:
        if not there:
            raise PersemError(f'{folder / metadata.NAME} cannot be read as a recording '
                              f'({content.fault}), and no .mcap or .db3 file is beside it')
        return Found(folder, in_order(there), notes=[
            f'{folder / metadata.NAME} cannot be used ({content.fault}): the files beside it '
            'were read without'])
    names = {_plain(f.name): f for f in there}
    files = [names[_plain(name)] for name in content.files if _plain(name) in names]
    missing = [name for name in content.files if _plain(name) not in names]
    result = Found(folder, files, content, missing)
    others = in_order([f for f in there if f not in files])
    if missing and len(others) == len(missing) and not files:   # renamed, all of them
        result.notes.append(f'{folder / metadata.NAME} lists {_few(missing)}, which is not '
                            f'there: {_few([f.name for f in others])} was read instead')
        result.files, result.missing = others, []
    elif others:
        verb = 'is' if len(others) == 1 else 'are'
        result.notes.append(
            f'{_few([f.name for f in others])} {verb} beside {folder.name}/{metadata.NAME} but '
            f'not listed there and {"was" if len(others) == 1 else "were"} not read; to use both: '
            f'{quote(f"{folder}+{others[0]}")}')
    if not result.files:
        raise PersemError(f'{folder / metadata.NAME} lists {_few(missing)}, none of which is '
                          'there; copy the files into the folder, or give the one that holds '
                          'them')
    return result


def _below(folder: Path) -> Found:
    """Return the one recording inside of a folder that is none itself."""
    inside: dict[Path, None] = {}
    with suppress(OSError):
        for file in islice(chain(folder.glob('*/*'), folder.glob('*/*/*'), folder.glob('*/*/*/*')),
                           LOOKED_AT):
            if file.name == metadata.NAME or is_stored(file):
                inside[file.parent] = None
    recordings = sorted(inside)
    if len(recordings) == 1:
        result = _in_folder(recordings[0])
        result.notes.insert(0, f'{folder} holds one recording, {recordings[0]}: it was used')
        return result
    if recordings:
        shown = ', '.join(quote(str(path)) for path in recordings[:SHOWN])
        raise PersemError(f'{folder} is no recording but holds {len(recordings)} of them: '
                          f'{shown}{", …" if len(recordings) > SHOWN else ""}; give one, A+B for '
                          'one input in several recordings, or A B for one after the other')
    old = next(iter(sorted(folder.glob('*.bag'))), None)
    if old is not None:
        check_file(old)
    what = f'{folder} is no recording: it is a folder without {metadata.NAME}, .mcap or .db3 files'
    raise PersemError(f'{what}; {WANTED}{_to_make_one(folder)}')


def check_file(path: Path) -> None:
    """Refuse a file that is no storage file, by what it begins with; let pass what may be one."""
    with path.open('rb') as stream:
        head = stream.read(64)
    if head.startswith(ROS1) and path.suffix == '.active':
        raise PersemError(f'{path} is a ROS 1 recording that was not closed; rename it to '
                          f"{path.stem}, repair it with 'rosbag reindex {path.stem}', then "
                          f"'rosbags-convert --src {path.stem} --dst NAME' makes a rosbag2 one")
    if head.startswith(ROS1):
        raise PersemError(f'{path} is a ROS 1 recording, expected a rosbag2 one; '
                          f"'rosbags-convert --src {quote(str(path))} --dst "
                          f"{quote(str(path.with_suffix('')))}' makes one")
    if head.startswith(SQLITE) and path.suffix == '.persem':
        raise PersemError(f"{path} is a map, no recording: 'persem map info {quote(str(path))}' "
                          f'shows it; {WANTED}')
    if head.startswith((MCAP, SQLITE)) or head.startswith(ZSTD) and (
            is_stored(path) or path.suffix in PACKED):
        return
    if head.startswith(b'version https://git-lfs'):
        raise PersemError(f"{path} is a Git LFS pointer, not the recording: 'git lfs pull' "
                          'fetches it')
    if path.suffix == '.bag':
        raise PersemError(f'{path} is no recording that can be read: its name is that of a ROS 1 '
                          f'recording, its content is not; {WANTED}')
    if path.suffix in ARCHIVES:
        raise PersemError(f'{path} is an archive: unpack it and give what is in it; {WANTED}')
    if not is_stored(path):
        raise PersemError(f'{path} is no recording: it is a file of type {path.suffix!r}; '
                          f'{WANTED}{_of_folder(path)}')


def _of_folder(path: Path) -> str:
    """Return what to type for a file that lies in the folder of a recording."""
    if (path.parent / metadata.NAME).exists():
        return f', for example its folder {quote(str(path.parent))}'
    return ''


def _plain(name: str) -> str:
    """Return the name of a file without the suffix of its compression."""
    return name.rpartition('.')[0] if name.endswith(PACKED) else name


def _few(names: list[str]) -> str:
    return ', '.join(names[:SHOWN]) + (', …' if len(names) > SHOWN else '')


def _to_make_one(path: Path) -> str:
    """Return what to type where a folder, or one in it, holds images; '' where none does."""
    with suppress(OSError):
        files = chain(path.iterdir(), path.glob('*/*'), path.glob('*/*/*'))
        if any(file.suffix.lower() in IMAGES for file in islice(files, LOOKED_AT)):
            return f'; to make one of its images: persem convert frames {quote(str(path))} OUT'
    return ''
