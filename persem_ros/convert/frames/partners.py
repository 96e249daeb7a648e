"""Which files belong to which frames: by their stamps, their names, or the numbers in these."""

from __future__ import annotations

from collections.abc import Iterator

from persem_ros.convert.files import canonical
from persem_ros.convert.stamps import number_of_name, stamps_from_names


def partners_of(
        times: dict[str, int], named: bool, others: list[str], tolerance: float
) -> dict[str, tuple[str, int]]:
    """
    Return {key: (other key, its stamp)} of the files that belong to the frames.

    Where names are stamps, the nearest one within *tolerance* seconds, each used once;
    otherwise the same name, or else the same number in the name.

    """
    other_times = stamps_from_names(others) if named else None
    if other_times is not None:
        return _nearest(times, other_times, round(tolerance * 1e9))
    return {key: (other, times[key]) for key, other in namesakes(list(times), others).items()}


def namesakes(keys: list[str], others: list[str]) -> dict[str, str]:
    """Return {key: other} of the same names, or else of the same numbers in them."""
    names = {canonical(other): other for other in others}
    result = {key: names[canonical(key)] for key in keys if canonical(key) in names}
    if result:
        return result
    numbers = {number_of_name(other): other for other in others}
    result = {key: numbers[number_of_name(key)] for key in keys
              if number_of_name(key) is not None and number_of_name(key) in numbers}
    # A few numbers in common are chance: two folders that count differently.
    return result if 2 * len(result) >= min(len(keys), len(others)) else {}


def _nearest(
        times: dict[str, int], other_times: dict[str, int], tolerance: int
) -> dict[str, tuple[str, int]]:
    """Return {key: (other key, its stamp)}, the closest pairs first, each used once."""
    result, taken = {}, set()
    for _, key, other in sorted(_near(times, other_times, tolerance)):
        if key not in result and other not in taken:
            result[key] = other, other_times[other]
            taken.add(other)
    return result


def _near(
        times: dict[str, int], other_times: dict[str, int], tolerance: int
) -> Iterator[tuple[int, str, str]]:
    """Yield (difference, key, other) of all pairs within *tolerance* nanoseconds."""
    keys, others = (sorted(these, key=these.__getitem__) for these in (times, other_times))
    first = 0
    for key in keys:
        while first < len(others) and other_times[others[first]] < times[key] - tolerance:
            first += 1
        for other in others[first:]:
            if other_times[other] > times[key] + tolerance:
                break
            yield abs(other_times[other] - times[key]), key, other
