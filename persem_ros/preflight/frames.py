"""Which frame is which: labels, depth and camera info of one camera, and the root of the map."""

from collections.abc import Iterator

import numpy as np
from persem_ros.preflight.depth import is_cloud_of
from persem_ros.preflight.findings import Finding, NOTE, REFUSE, Remedy, WARN
from persem_ros.preflight.sample import Sample, View


def check(sample: Sample) -> Iterator[Finding]:
    """Yield where the frames of images, camera infos and transforms do not go together."""
    for view in sample.views:
        yield from _robot(view, sample)
        yield from _info(view, sample)
        yield from _labels(view)
        if sample.config.pose.source == 'tf':
            yield from _root(view, sample)


def _robot(view: View, sample: Sample) -> Iterator[Finding]:
    """Yield whose transforms are used, where there are several robots'."""
    trees = sample.tf.get(view.name, {})
    spaces = [space for space in trees if space]
    if len(spaces) < 2:
        return
    fitting = [space for space in spaces if view.image_frame in trees[space]]
    topics = ' and '.join(f'{space}/tf' for space in sorted(spaces))
    setting = 'topics.tf' if not view.name else view.setting('tf')
    if len(fitting) == 1:
        yield Finding(NOTE, f"of {topics}, {fitting[0]}/tf leads to the images' "
                            f'frame {view.image_frame!r} and was used',
                      takes={setting: f'{fitting[0]}/tf'})
    else:
        yield Finding(REFUSE, f'{topics} are of several robots, and nothing says which one '
                              'carries the camera',
                      tuple(Remedy({setting: f'{space}/tf'}) for space in sorted(spaces)))


def _info(view: View, sample: Sample) -> Iterator[Finding]:
    """Yield what to do about a camera info of another camera than the depth's."""
    info, depth = view.frame('camera_info'), view.frame('depth')
    if not info or not depth or info == depth or is_cloud_of(view):
        return
    topic, setting = view.topics['camera_info'], view.setting('camera_info')
    said = f'the camera info on {topic} is of {info!r}, the depth images are of {depth!r}'
    right = sorted(name for name, frame in sample.info_frames.items() if frame == depth)
    if len(right) == 1 and not sample.live:
        yield Finding(NOTE, f'{said}: that of {right[0]} was used', takes={setting: right[0]})
    elif right:
        yield Finding(REFUSE, said, tuple(Remedy({setting: name}) for name in right))
    elif _apart(view, info, depth) or view.frame('labels') == info:
        yield Finding(REFUSE, f'{said}, which is another camera, and no topic has the camera '
                              'info of the depth images; record it, it has the intrinsics')
    else:
        yield Finding(WARN, f'{said}: taken for one camera; if they are two, the camera info of '
                            f'the depth images has to be recorded', (Remedy(
                                {setting: 'TOPIC'}, 'names another topic'),))


def _labels(view: View) -> Iterator[Finding]:
    """Yield labels of another frame than the depth's, untied; labels.py has the tied ones."""
    labels, depth = view.frame('labels'), view.frame('depth')
    if not labels or not depth or labels == depth:
        return
    said = f'the label images are of {labels!r}, the depth images of {depth!r}'
    if not view.poses.tree.connected(labels, depth) and not is_cloud_of(view):
        yield Finding(WARN, f'{said}, and no transform connects them: taken for one camera')


def _apart(view: View, one: str, two: str) -> bool:
    """Return whether static transforms say that two frames are not the same."""
    T = view.poses.tree.chain(one, two, None).T
    return T is not None and not np.allclose(T, np.eye(4), atol=1e-6)


def _root(view: View, sample: Sample) -> Iterator[Finding]:
    """Yield the frame that the map is in, where no transform names the one that is set."""
    tree, frame, target = view.poses.tree, view.image_frame, sample.config.frames.map
    if tree.connected(target, frame):
        return
    roots = tree.roots(frame)
    if not roots:
        yield Finding(REFUSE, 'no transform on /tf or /tf_static leads to the frame of the '
                              f'images, {frame!r}: {tree.edges()}')
        return
    known = target in tree.parents or any(target in above for above in tree.parents.values())
    said = f"/tf leads to the images' frame {frame!r} from {' and '.join(map(repr, roots))}, " + (
        f'and {target!r} is not connected with it' if known else f'there is no {target!r}')
    if len(roots) == 1:
        yield Finding(NOTE, f'{said}: the map is in {roots[0]!r}', takes={'frames.map': roots[0]})
    else:
        yield Finding(REFUSE, said, tuple(Remedy({'frames.map': root}) for root in roots))
