"""Compressed chunks, messages and files: the three places where rosbag2 compresses."""

from pathlib import Path

import lz4.frame
from persem_ros.errors import PersemError
from persem_ros.guard.limits import max_bytes, too_many_bytes
# With the library for Zstandard that rosbags itself reads with: it has two names, by Python.
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS, zstd    # type: ignore[attr-defined]

ZSTD = b'\x28\xb5\x2f\xfd'
KINDS = frozenset(DECOMPRESSORS)    # '' among them: stored as it is
PIECE = 1 << 20         # bytes of a file that are decompressed at once
PART = 1 << 22          # and of a message or chunk: most are less
SMALL = 1 << 30         # bytes that any file may unpack to
RATIO = 200             # and how many times its size a larger one may
SUFFIXES = ('.zstd', '.zst')        # of files that are compressed as a whole


class TooLarge(ValueError):
    """What unpacks to more than it may: a sentence that names the limit."""


def unpacked(kind: str, data: bytes, size: int) -> bytes:
    """
    Return the content of a chunk of *size* bytes that is compressed as *kind* says.

    Never more than it says of itself, and never more than inputs.max_pixels allows: TooLarge.

    """
    if sentence := too_many_bytes('a chunk', size):
        raise TooLarge(sentence)
    if kind == '':
        return data
    return _bounded(kind, data, size,
                    f'a chunk unpacks to more than the {size} bytes that it speaks of')


def message(data: bytes) -> bytes:
    """
    Return a serialized message, decompressed where it is.

    metadata.yaml would say so, but it may be lost or of another recording; no message in CDR
    begins as Zstandard does.

    """
    if data[:4] != ZSTD:
        return data
    return _bounded('zstd', data, max_bytes(), too_many_bytes('a message', max_bytes() + 1))


def _bounded(kind: str, data: bytes, most: int, sentence: str) -> bytes:
    """Return what data unpack to; EOFError where they are cut off, TooLarge beyond *most*."""
    parts, size = [], 0
    while data:         # some write one frame after another
        state = zstd.ZstdDecompressor() if kind == 'zstd' else lz4.frame.LZ4FrameDecompressor()
        piece = data
        while not state.eof:            # in parts: what is too much is not put together
            parts.append(state.decompress(piece, PART))
            size, piece = size + len(parts[-1]), b''
            if size > most:
                raise TooLarge(sentence)
            if not state.eof and state.needs_input:
                raise EOFError('the data end too early')
        data = state.unused_data or b'' if state.eof else b''
    return parts[0] if len(parts) == 1 else b''.join(parts)


def unpack_file(packed: Path, target: Path) -> None:
    """
    Decompress a file that was compressed as a whole, as far as it goes.

    Raises
    ------
    EOFError, zstd.ZstdError
        Where it is cut off or damaged; what came before lies in *target*.
    PersemError
        Where there is no room for it.

    """
    room = max(SMALL, RATIO * packed.stat().st_size)

    def write(piece: bytes) -> None:
        if out.tell() + len(piece) > room:
            raise PersemError(
                f'{packed} unpacks to more than {room} bytes, {RATIO} times its size; if it is '
                f'meant to, unpack it (zstd -d) and give the folder without {packed.name}')
        out.write(piece)

    try:
        with packed.open('rb') as source, target.open('wb') as out:
            state, piece = zstd.ZstdDecompressor(), b''
            while piece or (piece := source.read(PIECE)):
                if state.eof:           # some write one frame after another
                    state = zstd.ZstdDecompressor()
                write(state.decompress(piece, PIECE))
                while not state.eof and not state.needs_input:
                    write(state.decompress(b'', PIECE))
                piece = state.unused_data if state.eof else b''
            if not state.eof:
                raise EOFError('the file ends too early')
    except OSError as error:
        raise PersemError(f'{packed} cannot be decompressed into {target.parent} '
                          f'({error.strerror or error}); TMPDIR=FOLDER names another place') \
            from error
