"""Compressed chunks, messages and files: the three places where rosbag2 compresses."""

from pathlib import Path

from persem_ros.errors import PersemError
# With the library for Zstandard that rosbags itself reads with: it has two names, by Python.
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS, zstd

ZSTD = b'\x28\xb5\x2f\xfd'
KINDS = frozenset(DECOMPRESSORS)    # '' among them: stored as it is
PIECE = 1 << 20         # bytes that are decompressed at once
SUFFIXES = ('.zstd', '.zst')        # of files that are compressed as a whole


def unpacked(kind: str, data: bytes, size: int) -> bytes:
    """Return the content of a chunk of *size* bytes that is compressed as *kind* says."""
    return DECOMPRESSORS[kind](data, size)


def message(data: bytes) -> bytes:
    """
    Return a serialized message, decompressed where it is.

    metadata.yaml would say so, but it may be lost or of another recording; no message in CDR
    begins as Zstandard does.

    """
    return zstd.decompress(data) if data[:4] == ZSTD else data


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
    try:
        with packed.open('rb') as source, target.open('wb') as out:
            state, piece = zstd.ZstdDecompressor(), b''
            while piece or (piece := source.read(PIECE)):
                if state.eof:           # some write one frame after another
                    state = zstd.ZstdDecompressor()
                out.write(state.decompress(piece, PIECE))
                while not state.eof and not state.needs_input:
                    out.write(state.decompress(b'', PIECE))
                piece = state.unused_data if state.eof else b''
            if not state.eof:
                raise EOFError('the file ends too early')
    except OSError as error:
        raise PersemError(f'{packed} cannot be decompressed into {target.parent} '
                          f'({error.strerror or error}); TMPDIR=FOLDER names another place') \
            from error
