"""Label images: whether they can be read as ids, and whether they fit the depth."""

from collections.abc import Iterator

from persem_ros.frames import same_aspect
from persem_ros.inputs.decode import messages
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.preflight.findings import Finding, REFUSE
from persem_ros.preflight.sample import Sample, View


def check(sample: Sample) -> Iterator[Finding]:
    """Yield what is wrong with the first label images."""
    for view in sample.views:
        yield from _view(view)


def _view(view: View) -> Iterator[Finding]:
    faults, sizes = [], []
    for msg in view.firsts.get('labels', ()):
        try:
            sizes.append(messages.labels(msg)[0].shape[::-1])
        except BadMessage as fault:
            faults.append(fault)
    if not sizes:
        what = f'label images on {view.topics["labels"]}: {faults[0]}' if faults else \
            f'{view.topics["labels"]} has no message that can be read'
        yield Finding(REFUSE, what)
        return
    for msg in view.firsts.get('depth', ()):
        try:
            size = messages.depth(msg).shape[::-1]
        except BadMessage:      # check_depth says so
            continue
        if not any(same_aspect(one, size) for one in sizes):
            yield Finding(REFUSE, f'label images are {sizes[0][0]} x {sizes[0][1]}, depth images '
                                  f'{size[0]} x {size[1]}: expected one aspect ratio')
        return
