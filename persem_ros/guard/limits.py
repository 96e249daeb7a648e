"""
How large an image, a message or a chunk may become: one bound, which a setting raises.

A few hundred bytes unpack to gigabytes; what an image says of its size before it is decoded, and
what a message or chunk says before it is unpacked, is held against this. The bound belongs to the
process, because what decodes knows no settings.

"""

DEFAULT = 64_000_000        # pixels: 8 000 x 8 000
BYTES_A_PIXEL = 16          # RGBA of 32 bits; also what a chunk of a recording may unpack to
_most = [DEFAULT]


def use(max_pixels: int) -> None:
    """Set the bound, inputs.max_pixels."""
    _most[0] = max_pixels


def max_pixels() -> int:
    """Return the largest number of pixels of an image."""
    return _most[0]


def max_bytes() -> int:
    """Return the largest number of bytes that a message or a chunk may unpack to."""
    return _most[0] * BYTES_A_PIXEL


def too_many_pixels(width: int, height: int) -> str:
    """Return the sentence about an image that is too large, '' for one that is not."""
    if width * height <= _most[0]:
        return ''
    return (f'an image of {width} x {height} pixels is larger than inputs.max_pixels allows '
            f'({_most[0]}); if it is meant to be, --set inputs.max_pixels={width * height}')


def too_many_bytes(what: str, size: int) -> str:
    """Return the sentence about a message or chunk (*what*) of more bytes than allowed, or ''."""
    if size <= max_bytes():
        return ''
    return (f'{what} unpacks to more than {max_bytes()} bytes ({BYTES_A_PIXEL} for each of '
            f'inputs.max_pixels); if it is meant to, raise inputs.max_pixels')
