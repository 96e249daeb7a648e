"""Which frame is which: what the poses place, and what leads from there to the camera."""

from collections.abc import Iterator

from persem_ros.inputs.decode import messages
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.inputs.sync.poses import NO_MOUNT
from persem_ros.preflight.findings import Finding, REFUSE
from persem_ros.preflight.sample import Sample, View


def check(sample: Sample) -> Iterator[Finding]:
    """Yield what stands between the poses and the cameras."""
    for view in sample.views:
        if 'pose' in view.topics:
            yield from _mount(view)


def _mount(view: View) -> Iterator[Finding]:
    """Yield the sentence for poses that nothing connects with the camera."""
    for msg in view.firsts.get('pose', ()):
        try:
            stamp = messages.pose(msg)[0]
        except BadMessage as fault:
            yield Finding(REFUSE, f'poses: {fault}')
            continue
        if view.poses.lookup(stamp, view.image_frame).reason == NO_MOUNT:
            yield Finding(REFUSE, view.poses.mount_sentence(view.image_frame))
        return
