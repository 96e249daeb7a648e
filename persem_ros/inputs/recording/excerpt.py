"""Which frames of an input are used: --start, --end and --every."""

from dataclasses import dataclass

from persem_ros.errors import PersemError

RELATIVE = 1e9          # below: seconds after the first frame; a date in seconds is above
NANO = 1e16             # from here on a stamp is in nanoseconds, below in seconds


@dataclass(frozen=True)
class Excerpt:
    """
    A part of an input.

    Poses and latched messages before *start* count all the same.

    Attributes
    ----------
    start, end : str
        Seconds after the first frame (numbers below 1e9), or stamps in seconds or nanoseconds;
        '' for no bound.
    every : int
        Every how many complete frames of each camera are used; t has no holes.

    Raises
    ------
    PersemError
        Where these are no such numbers.

    """

    start: str = ''
    end: str = ''
    every: int = 1

    def __post_init__(self) -> None:
        """Refuse what is no number, and an end before the start."""
        for name in ('start', 'end'):
            _check(name, getattr(self, name))
        if self.every < 1:
            raise PersemError(f'--every {self.every}: expected a whole number from 1 on')
        if self.start and self.end and _is_relative(self.start) == _is_relative(self.end) \
                and _nanoseconds(self.end) < _nanoseconds(self.start):
            raise PersemError(f'--end {self.end} is before --start {self.start}')

    @property
    def needs_first(self) -> bool:
        """Whether a bound is counted from the first frame."""
        return any(text and _is_relative(text) for text in (self.start, self.end))

    def bounds(self, first: int | None) -> tuple[int | None, int | None]:
        """Return the stamps of start and end, ns; *first* is that of the first frame."""
        start, end = (None if not text or _is_relative(text) and first is None else
                      _nanoseconds(text) + (first if first and _is_relative(text) else 0)
                      for text in (self.start, self.end))
        return start, end

    def words(self) -> list[str]:
        """Return the options as words of a command line."""
        given = {'--start': self.start, '--end': self.end,
                 '--every': str(self.every) if self.every > 1 else ''}
        return [word for pair in given.items() if pair[1] for word in pair]

    def sentence(self, bounds: tuple[int | None, int | None]) -> str:
        """Return how the options were understood, '' where all frames are used."""
        words = [f'{word} {_shown(stamp)} (--{name} {text}, '
                 f'{"seconds after the first frame" if _is_relative(text) else "a stamp"})'
                 for name, word, text, stamp in zip(
                     ('start', 'end'), ('from', 'until'), (self.start, self.end), bounds)
                 if text and stamp is not None]
        if self.every > 1:
            words.append(f'one of {self.every} complete frames of a camera')
        if not (self.start or self.end):
            return f'used is {words[0]}' if words else ''
        return f'used are frames {", ".join(words)}'

    def outside(self, first: int, last: int) -> str:
        """Return the sentence for an excerpt without any label image of *first* to *last*, ns."""
        given = ' '.join(f'--{name} {text}' for name, text in (('start', self.start),
                                                               ('end', self.end)) if text)
        return (f'no label image lies within {given}: they run from {_shown(first)} to '
                f'{_shown(last)}; a number below 1e9 is seconds after the first frame, any other '
                'one a stamp in seconds or nanoseconds')


def _check(name: str, text: str) -> None:
    try:
        good = not text or 0 <= float(text) < 2**63
    except ValueError:
        good = False
    if not good:
        raise PersemError(f'--{name} {text}: expected seconds after the first frame, or a stamp '
                          'in seconds or nanoseconds')


def _is_relative(text: str) -> bool:
    return float(text) < RELATIVE


def _nanoseconds(text: str) -> int:
    """Return a number as nanoseconds, exactly: a stamp in seconds has more digits than float."""
    if float(text) >= NANO:
        return int(text) if text.isdigit() else round(float(text))
    whole, _, fraction = text.partition('.')
    if whole.isdigit() and (fraction.isdigit() or not fraction):
        return int(whole) * 10**9 + int(f'{fraction:0<9.9}')
    return round(float(text) * 1e9)


def _shown(stamp: int) -> str:
    return f'{stamp // 10**9}.{stamp % 10**9:09d} s'


WHOLE = Excerpt()
