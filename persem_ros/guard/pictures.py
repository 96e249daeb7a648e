"""PNG and JPEG images from anywhere: what a decoder would trust, looked at before it does."""

WANTED = 'a whole PNG or JPEG image, as a camera driver or image_transport writes it'
PNG, JPEG = b'\x89PNG\r\n\x1a\n', b'\xff\xd8'
# Of one image; more than these many of either unpack to gigabytes or take hours.
TEXTS = 16              # compressed texts and profiles of a PNG, each up to 8 MB unpacked
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
        raise _damaged(f'a JPEG image has {scans} scans, expected {SCANS} at most')


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
            raise _damaged(f'a PNG image has more than {TEXTS} compressed texts')
    raise _damaged(f'a PNG image of {len(data)} bytes is cut off or damaged')


def _damaged(what: str) -> ValueError:
    return ValueError('damaged compressed image', f'{what}; expected {WANTED}')
