"""Images from anywhere: what a decoder would trust, looked at before it does."""

import struct

WANTED = 'a whole PNG or JPEG image, as a camera driver or image_transport writes it'
FILES = 'PNG, JPEG, TIFF, BMP, PGM, PPM, PFM or .npy'
PNG, JPEG = b'\x89PNG\r\n\x1a\n', b'\xff\xd8'
# Of one image; more than these many of either unpack to gigabytes or take hours.
TEXTS = 16              # compressed texts and profiles of a PNG, each up to 8 MB unpacked
ENTRIES = 1000          # of a directory of a TIFF
TIFF_SIZES = (256, 257, 322, 323)   # width and height of the image and of a tile
SCANS = 100             # of a progressive JPEG, each of which goes over all pixels


def pixels_of(data: memoryview) -> tuple[int, int]:
    """
    Return (width, height) as the header of a PNG or JPEG says.

    What does not begin as one of these is refused: OpenCV would try a dozen other decoders.

    Raises
    ------
    ValueError
        (reason, sentence).

    """
    if data[:8] == PNG:
        return int.from_bytes(data[16:20], 'big'), int.from_bytes(data[20:24], 'big')
    if data[:2] != JPEG:
        raise _damaged('a compressed image is neither PNG nor JPEG')
    at = 2
    while at + 9 <= len(data) and data[at] == 0xff:     # segments up to the frame header
        if 0xc0 <= data[at + 1] <= 0xcf and data[at + 1] not in (0xc4, 0xc8, 0xcc):
            return int.from_bytes(data[at + 7:at + 9], 'big'), \
                int.from_bytes(data[at + 5:at + 7], 'big')
        at += 1 if data[at + 1] == 0xff else 2 + int.from_bytes(data[at + 2:at + 4], 'big')
    raise _damaged('a JPEG image says nothing of its size')


def pixels_of_file(data: memoryview) -> tuple[int, int]:
    """
    Return (width, height) as pixels_of() does, also of a TIFF, BMP or netpbm file.

    Of a TIFF that is the largest of its images, tiles and strips, each of which is decoded into
    memory of its own.

    Raises
    ------
    ValueError
        (reason, sentence).

    """
    head = bytes(data[:4])
    if head[:3] in (b'II*', b'II+', b'MM\0'):
        return _pixels_of_tiff(data)
    try:
        if head[:2] == b'BM':
            width, height = struct.unpack_from('<ii', data, 18)
            return abs(width), abs(height)
        if head[:1] == b'P' and head[1:2] in b'123456fF' and len(head) > 1:
            return _pixels_of_netpbm(bytes(data[2:300]))
    except (struct.error, ValueError):
        raise _damaged('a BMP or netpbm image says nothing of its size') from None
    if data[:8] != PNG and data[:2] != JPEG:
        raise ValueError('damaged compressed image', f'not an image of a kind that is read, '
                         f'expected {FILES}')
    return pixels_of(data)


def _pixels_of_netpbm(text: bytes) -> tuple[int, int]:
    """Return the first two numbers behind a netpbm magic; ValueError where there are none."""
    words = [word for line in text.split(b'\n') for word in line.split(b'#')[0].split()]
    width, height, *_ = words
    return max(0, int(width[:10])), max(0, int(height[:10]))


def _pixels_of_tiff(data: memoryview) -> tuple[int, int]:
    """Return the largest (width, height) that the first directory of a TIFF speaks of."""
    order = '<' if data[:1].tobytes() == b'I' else '>'
    big = data[2:4].tobytes() in (b'+\0', b'\0+')
    # Offset of the directory; width of its count; of an entry: size, place of the value.
    at, count, step, place = (8, 'Q', 20, 12) if big else (4, 'H', 12, 8)
    found = {}
    try:
        first = struct.unpack_from(f'{order}{"Q" if big else "I"}', data, at)[0]
        entries = struct.unpack_from(f'{order}{count}', data, first)[0]
        first += struct.calcsize(f'{order}{count}')
        for k in range(min(entries, ENTRIES)):
            tag, kind = struct.unpack_from(f'{order}HH', data, first + k * step)
            if tag in TIFF_SIZES and kind in (3, 4, 16):
                form = {3: 'H', 4: 'I', 16: 'Q'}[kind]
                found[tag] = struct.unpack_from(f'{order}{form}', data,
                                                first + k * step + place)[0]
    except struct.error:
        raise _damaged('a TIFF image is cut off or damaged') from None
    if 256 not in found or 257 not in found:
        raise _damaged('a TIFF image says nothing of its size')
    whole, tile = (found[256], found[257]), (found.get(322, 0), found.get(323, 0))
    return max(whole, tile, key=lambda size: size[0] * size[1])


def check_parts(data: memoryview) -> None:
    """
    Refuse, as pixels_of() does, an image whose parts no honest one has, before it is decoded.

    OpenCV 5 takes memory for a chunk of a PNG as its length field says, up to 4 GiB, before it
    reads it: 87 bytes took 12 s.

    """
    if data[:8] == PNG:
        _check_chunks(data)
        return
    scans = bytes(data).count(b'\xff\xda')
    if scans > SCANS:
        raise _damaged(f'a JPEG image has {scans} scans, {SCANS} are read at most; save it '
                       'anew')


def _check_chunks(data: memoryview) -> None:
    at, texts = 8, 0
    while at < len(data):
        length, kind = int.from_bytes(data[at:at + 4], 'big'), bytes(data[at + 4:at + 8])
        if at == 8 and (kind, length) != (b'IHDR', 13):
            raise _damaged('a PNG image does not begin with its size')
        at += 12 + length
        if at > len(data):
            raise _damaged(f'a PNG image of {len(data)} bytes is cut off or damaged')
        if kind == b'IEND':
            return
        texts += kind in (b'zTXt', b'iTXt', b'iCCP')
        if texts > TEXTS:
            raise _damaged(f'a PNG image has more than {TEXTS} compressed texts, the most that '
                           'are read; save it anew without')
    raise _damaged(f'a PNG image of {len(data)} bytes is cut off or damaged')


def _damaged(what: str) -> ValueError:
    return ValueError('damaged compressed image', f'{what}; expected {WANTED}')
