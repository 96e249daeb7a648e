"""What became of the frames of recordings, as lines for people."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from statistics import median_low
from typing import Any


def lines(frames: Mapping[str, Any], rest: str,
          reasons: Mapping[str, str] | None = None) -> list[str]:
    """
    Return how many frames were used, and why others were dropped.

    Parameters
    ----------
    frames
        'used', a number, and 'dropped', numbers by reason; where memory.stride is 0 'strides',
        numbers by the stride that was taken.
    rest
        What else the first line says.
    reasons
        A sentence for each reason why something was dropped.

    """
    from persem_ros.inputs.sync.pairing import UNUSED
    dropped = {reason: n for reason, n in frames['dropped'].items() if reason != UNUSED}
    # Poses and camera infos are no frames; depth images are counted with their labels.
    lost = sum(n for reason, n in dropped.items()
               if ': ' not in reason or reason.startswith('labels: '))
    found = [f'{frames["used"]} frames used, {lost} dropped; {rest}']
    if strides := frames.get('strides'):
        taken = list(Counter(strides).elements())
        found.append(f'  memory.stride 0 came to {median_low(taken)} (median; {min(taken)} to '
                     f'{max(taken)})')
    if unused := frames['dropped'].get(UNUSED):
        found.append(f'  {unused} depth images came without labels, which is no loss')
    for reason, n in sorted(dropped.items()):
        why = (reasons or {}).get(reason, '')
        found.append(f'  {n} dropped: {reason}' + (f'; {why}' if why and why != reason else ''))
    return found
