"""Label images to ids: plain, in one channel of a colour image, or as the legend's colours."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import cached
from persem_ros.inputs.decode import image_messages
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.settings.config import Labels
from persem_ros.settings.legend import Legend
from persem_ros.settings.legend_files import load_legend, shipped_legends

CHANNELS = 'rgba'
LEGEND = 'legend'
FITS = 0.9              # share of a legend's own colours that makes it the one that was meant
NEAREST = 0.5           # … from which on the nearest ones may be meant by the others
SHOWN = 4               # colours in a sentence
OFF = 1 << 15           # in the table of colours: this one is none of the legend's


class LabelReader:
    """
    Reads the label images of one topic, spec section 8 and the settings labels.*.

    Parameters
    ----------
    settings : persem_ros.settings.config.Labels
        channel and divisor.

    Attributes
    ----------
    channel : str
        What colour images were found to hold: one of CHANNELS, LEGEND, or '' while none has
        told.
    pixels, off : int
        Pixels of images in the legend's colours, and those whose colour is none of them: they
        got the nearest.

    """

    def __init__(self, settings: Labels) -> None:
        """Start without an image."""
        self.channel = settings.channel
        self.pixels = self.off = 0
        self._told = bool(settings.channel)
        self._divisor = settings.divisor
        self._palette: tuple[object, Palette] | None = None
        self._checked, self._fault = settings.channel in ('', LEGEND), ''

    def __call__(self, msg: Any, legend: Legend | None = None) -> tuple[NDArray[np.int32], str]:
        """
        Read a label image.

        Parameters
        ----------
        msg : sensor_msgs/Image or CompressedImage
            Of rclpy or of rosbags.
        legend : Legend, optional
            Whose colours the image may have.

        Returns
        -------
        ndarray, shape (H, W), int32
            Class ids; negative ones and those above 65534 are no classes.
        str
            An encoding that can hold them: that of the image, or mono8 or mono16 of colours.

        Raises
        ------
        BadMessage
            An encoding that holds no labels, damage, or colours of which nobody says what they
            mean.

        """
        planes, encoding = image_messages.label_planes(msg, self.channel == LEGEND)
        if planes.ndim == 3:
            ids, encoding = self._of_colors(planes, encoding, legend)
        else:
            ids = planes.astype(np.int32)
        return (ids // self._divisor if self._divisor > 1 else ids), encoding

    @property
    def note(self) -> str:
        """Return what the user should know of how colours were read, '' for nothing."""
        if self.pixels and self.off:
            return (f'{100 * self.off / self.pixels:.2g} % of the label pixels have a colour that '
                    "is none of the legend's: they got the class with the nearest one")
        if self.channel and self.channel != LEGEND and not self._told:
            return (f'label images are colours: their channel {self.channel} was read as ids, '
                    f'which --set labels.channel={self.channel} says, too')
        return ''

    def _of_colors(self, planes: NDArray[np.uint8], encoding: str,
                   legend: Legend | None) -> tuple[NDArray[np.int32], str]:
        palette = self._palette_of(legend)
        channel = self.channel or self._found(planes, encoding, palette, legend)
        if channel == LEGEND:
            if palette is None:
                raise BadMessage('colours without a legend', 'labels.channel=legend needs a '
                                 'legend with colours: --set labels.legend=FILE')
            ids, off = palette.ids(planes)
            self.pixels += ids.size
            self.off += off
            return ids, palette.encoding
        self._check(planes, palette)
        number = CHANNELS.index(channel)
        if number >= planes.shape[2]:
            raise BadMessage('no such channel', f'a label image has the encoding {encoding!r} '
                             f'without channel {channel}, expected labels.channel one of '
                             f'{", ".join(CHANNELS[:planes.shape[2]])}, legend')
        return planes[..., number].astype(np.int32), 'mono8'

    def _found(self, planes: NDArray[np.uint8], encoding: str, palette: 'Palette | None',
               legend: Legend | None) -> str:
        """Return the channel that an image shows itself to have; later ones have the same."""
        if palette is not None and palette.share(planes) >= FITS:
            if planes[..., :3].any():
                self.channel = LEGEND
            return LEGEND
        if grey(planes):
            if planes[..., 0].any():
                self.channel = 'r'      # three equal ones
            return 'r'
        filled = [i for i in range(3) if planes[..., i].any()]
        if len(filled) == 1:
            self.channel = CHANNELS[filled[0]]
            return self.channel
        raise BadMessage('colours instead of ids', f'a label image has the encoding {encoding!r} '
                         'and several channels that differ; ' + (
                             _other_colours(planes, palette, legend)
                             if palette is not None and legend is not None else
                             'say what they hold with --set labels.legend='
                             f'{shipped(planes) or "FILE"} (colours of classes: a legend with '
                             'these colours), or with --set labels.channel=r, g or b (ids in one '
                             'channel)'))

    def _check(self, planes: NDArray[np.uint8], palette: 'Palette | None') -> None:
        """Refuse (BadMessage) one channel of a legend's colours, by the first image with any."""
        if not self._checked and planes[..., :3].any() and not grey(planes):
            fits = palette is not None and palette.share(planes) >= FITS
            name = '' if fits else shipped(planes)
            if fits or name:
                also = f' --set labels.legend={name}' if name else ''
                self._fault = (f'a label image has the colours of the legend{" " if name else ""}'
                               f'{name}; its channel {self.channel} alone is no id: --set '
                               f'labels.channel={LEGEND}{also}')
            self._checked = True
        if self._fault:
            raise BadMessage('channel of colours', self._fault)

    def _palette_of(self, legend: Legend | None) -> 'Palette | None':
        if legend is None or not legend.classes:
            return None
        if self._palette is None or self._palette[0] is not legend:
            self._palette = legend, Palette(legend)
        return self._palette[1]


class Palette:
    """
    The ids of colours.

    Parameters
    ----------
    legend : Legend
        With one class at least; of two classes with one colour the first counts.

    """

    def __init__(self, legend: Legend) -> None:
        """Make the tables."""
        colors: dict[tuple[int, ...], int] = {}
        for item in legend.classes:
            colors.setdefault(tuple(item.color), item.id)
        self._colors = np.array(list(colors), np.int32).reshape(-1, 3)
        self._ids = np.array(list(colors.values()), np.int32)
        self.encoding = 'mono16' if self._ids.max() > 255 else 'mono8'
        self._table = np.zeros(1 << 24, np.uint16)     # 1 + place, | OFF; pages come when used
        for place, (r, g, b) in enumerate(self._colors.tolist()):
            self._table[r << 16 | g << 8 | b] = place + 1

    def ids(self, planes: NDArray[np.uint8]) -> tuple[NDArray[np.int32], int]:
        """Return the ids, (H, W), of colours, and how many of these are none of the legend."""
        ids = np.empty(planes.shape[:2], np.int32)
        off = _look_up(planes, self._table, self._colors, self._ids, ids)
        return ids, int(off)

    def share(self, planes: NDArray[np.uint8]) -> float:
        """Return the share of pixels, of those that are not black, in colours of the legend."""
        planes = planes[..., :3].reshape(-1, 3)
        painted = planes[planes.any(axis=1)]
        planes = painted if len(painted) else planes
        packed = planes[..., :3].astype(np.int32) @ np.array([1 << 16, 1 << 8, 1], np.int32)
        return float(np.mean((self._table[packed] & (OFF - 1) > 0)
                             & (self._table[packed] < OFF)))


def grey(planes: NDArray[np.uint8]) -> bool:
    """Return whether red, green and blue of an image (H, W, 3 or 4) are the same."""
    return all((planes[..., i] == planes[..., 0]).all() for i in (1, 2))


def shipped(planes: NDArray[np.uint8]) -> str:
    """Return the name of the shipped legend that has the colours of an image, '' for none."""
    legends = {name: load_legend(name) for name in shipped_legends()}
    shares = {name: Palette(legend).share(planes) for name, legend in legends.items() if legend}
    best = max(shares, key=lambda name: shares[name])
    return best if shares[best] >= FITS else ''


def _other_colours(planes: NDArray[np.uint8], palette: Palette, legend: Legend) -> str:
    """Return what a legend and an image that do not fit each other have."""
    packed = planes[..., :3].astype(np.int32) @ np.array([1 << 16, 1 << 8, 1], np.int32)
    values, counts = np.unique(packed, return_counts=True)
    most = values[np.argsort(-counts, kind='stable')][:SHOWN].tolist()
    seen = ', '.join(str((c >> 16, c >> 8 & 255, c & 255)) for c in most)
    own = ', '.join(f'{tuple(item.color)} {item.name}' for item in legend.classes[:SHOWN])
    share = palette.share(planes)
    swapped = palette.share(planes[..., [2, 1, 0]]) >= FITS
    other = shipped(planes)
    alone = [CHANNELS[i] for i in range(3)
             if planes[..., i].any() and np.isin(planes[..., i], legend.ids).all()]
    return (f'{100 * share:.2g} % of the pixels have a colour of the legend: the most frequent of '
            f'{len(values)} colours are {seen}, the legend has {own}'
            f'{", …" if len(legend.classes) > SHOWN else ""}'
            + ('; with red and blue in the other order they fit, so the encoding is the other '
               'one of rgb8 and bgr8: whoever publishes them has to say so' if swapped else
               f'; they are those of --set labels.legend={other}' if other else
               f'; channel {alone[0]} holds ids of the legend alone: --set '
               f'labels.channel={alone[0]}' if alone else
               '; give the legend with these colours by --set labels.legend=FILE'
               + (', or take the nearest ones by --set labels.channel=legend'
                  if share >= NEAREST else '')))


@cached
def _look_up(planes, table, colors, ids, out):
    """Write the id of each pixel's colour, exact or nearest; return how many were not exact."""
    off = 0
    for v in range(planes.shape[0]):
        for u in range(planes.shape[1]):
            r, g, b = np.int64(planes[v, u, 0]), np.int64(planes[v, u, 1]), \
                np.int64(planes[v, u, 2])
            key = r << 16 | g << 8 | b
            entry = np.int64(table[key])
            if entry == 0:
                best, least = 0, np.int64(1 << 30)
                for k in range(len(colors)):
                    d = (r - colors[k, 0]) ** 2 + (g - colors[k, 1]) ** 2 + (b - colors[k, 2]) ** 2
                    if d < least:
                        best, least = k, d
                entry = (best + 1) | OFF
                table[key] = entry
            if entry & OFF:
                off += 1
            out[v, u] = ids[(entry & (OFF - 1)) - 1]
    return off
