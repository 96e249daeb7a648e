"""Label images: whether they can be read as ids, and whether they fit the depth."""

from collections.abc import Iterator

from persem_ros.inputs import fit
from persem_ros.inputs.decode import messages
from persem_ros.inputs.decode.labels import LabelReader, LEGEND
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.preflight.findings import Finding, REFUSE, WARN
from persem_ros.preflight.sample import Sample, View
from persem_ros.settings.config import Config
from persem_ros.settings.legend import Legend

ODD = 0.5       # share of pixels in colours that are none of the legend's: no labels at all


def check(sample: Sample) -> Iterator[Finding]:
    """Yield what is wrong with the first label images."""
    for view in sample.views:
        yield from _view(view, sample.config, sample.legend)


def _view(view: View, config: Config, legend: Legend | None) -> Iterator[Finding]:
    faults, sizes = [], []
    reader = LabelReader(config.labels)
    for msg in view.firsts.get('labels', ()):
        try:
            sizes.append(reader(msg, legend)[0].shape)
        except BadMessage as fault:
            faults.append(fault)
    if not sizes:
        what = f'label images on {view.topics["labels"]}: {faults[0]}' if faults else \
            f'{view.topics["labels"]} has no message that can be read'
        yield Finding(REFUSE, what)
        return
    if reader.channel == LEGEND and reader.off > ODD * reader.pixels:
        yield Finding(REFUSE, f'{100 * reader.off / reader.pixels:.0f} % of the pixels on '
                              f"{view.topics['labels']} have a colour that is none of the "
                              "legend's: another topic, or another legend (labels.legend)?")
    elif reader.off:
        yield Finding(WARN, reader.note)
    for msg in view.firsts.get('depth', ()):
        try:
            size = messages.depth(msg).shape
        except BadMessage:      # check_depth says so
            continue
        try:
            fit.matching(sizes[0], size, config.labels.fit)
        except BadMessage as fault:
            yield Finding(REFUSE, str(fault))
        return
