"""What a replay should give, by the plain reference, and what one gave, read back."""

from collections import defaultdict
import json
from pathlib import Path

import numpy as np
from persem_ros.core.refine.regions import REGIONS
from persem_ros.inputs.decode import image_messages, messages
from persem_ros.inputs.recording.recording import Recording
from persem_ros.outputs.map import store
from persem_ros.outputs.results.rundir import FILES
from persem_ros.settings.config import Config, updated
import reference as ref
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

UNKNOWN = ref.UNKNOWN


def config_of(values=()):
    """Return the Config with {dotted name: value} applied; voxels of 0.2 m."""
    return updated(Config(), {'memory.voxel_size': 0.2, **dict(values)})


def frames_of(path, config):
    """Return all frames of a recording with their truth."""
    with Recording(path, config) as recording:
        return list(recording.frames(truth=True))


class Expected:
    """
    The reference's map of some frames, and what it renders and measures.

    Parameters
    ----------
    frames : list of Frame
    config : Config
    methods : sequence of str

    """

    def __init__(self, frames, config, methods):
        self.frames, self.config = frames, config
        m = config.memory
        self.memory = ref.Memory(m.voxel_size, config.map.origin)
        self.dynamic = [c for c in m.dynamic_labels if c >= 0]
        for f in frames:
            points, ids = ref.backproject(
                f.depth, f.camera.rays, f.labels, m.ignore_labels, self.dynamic, m.min_depth,
                m.max_depth, m.stride or ref.auto_stride(
                    f.depth, f.camera.K[0, 0], m.voxel_size, m.min_depth, m.max_depth))
            self.memory.add(ref.observe(points, ids, f.T_map_camera, m.voxel_size, m.min_pixels,
                                        config.map.origin), f.stamp, ids, f.sensor, f.T_map_camera)
        voxel_methods = [name for name in (*methods, config.refine.method)
                         if name not in ('raw2d', 'ema2d')]
        self.labels = {name: {v: c for v, (c, _) in
                              ref.label(self.memory, name, config.refine).items()}
                       for name in voxel_methods}
        self.own = [ref.resampled(f.labels, *f.depth.shape) for f in frames]
        self.pixels = [self._points(f) for f in frames]
        self.images = {name: self._images(name) for name in methods}

    def published(self):
        """Return the refined images at the labels' size, (H, W) int lists."""
        return [self._published(f, points) for f, points in zip(self.frames, self.pixels)]

    def metrics(self):
        """Return truth_flicker, methods and regions of metrics.json."""
        truths = [flat(ref.resampled(f.truth, *f.depth.shape)) for f in self.frames]
        valids = [[self._valid(d, c) and self._counts(t) for d, c, t in zip(
            flat(f.depth), flat(own), truth)]
            for f, own, truth in zip(self.frames, self.own, truths)]
        everywhere = [[True] * len(v) for v in valids]
        regions = ref.regions(self.memory, self.config.refine.neighbours)
        at = [[regions.get(self._voxel(f, p), set()) for p in points]
              for f, points in zip(self.frames, self.pixels)]
        total = sum(map(sum, valids))
        result = {**self._measured(truths, valids, everywhere, True), 'regions': {}}
        for name in ('all', *REGIONS):
            inside = everywhere if name == 'all' else [[name in here for here in row]
                                                       for row in at]
            counted = sum(a and b for one, two in zip(valids, inside) for a, b in zip(one, two))
            result['regions'][name] = {'share': 100 * counted / total,
                                       **self._measured(truths, valids, inside, False)}
        return result

    def _points(self, f):
        m = self.config.memory
        return [(float(x) * d, float(y) * d, d) if np.isfinite(d) and d > 0
                and m.min_depth <= d <= m.max_depth else None
                for d, (x, y) in zip(flat(f.depth), f.camera.rays.reshape(-1, 2))]

    def _voxel(self, f, point):
        return None if point is None else ref.voxel_of(
            point, f.T_map_camera, self.config.memory.voxel_size, self.config.map.origin)

    def _rendered(self, f, points, own, method, dynamic):
        return ref.render(self.labels[method], points, own, f.T_map_camera,
                          self.config.memory.voxel_size, 'unknown', dynamic,
                          self.config.map.origin)

    def _images(self, method):
        """Return a method's images on the depth grid, flat."""
        if method == 'raw2d':
            return [flat(own) for own in self.own]
        if method == 'ema2d':
            assert len({f.sensor for f in self.frames}) == 1
            smooth = ref.ema2d(self.own, self.config.ema.alpha, self.config.memory.ignore_labels)
            return [[UNKNOWN if c < 0 else c for c in flat(image)] for image in smooth]
        return [self._rendered(f, points, flat(own), method, self.dynamic)
                for f, points, own in zip(self.frames, self.pixels, self.own)]

    def _published(self, f, points):
        shape, ignored = f.depth.shape, [c for c in self.config.memory.ignore_labels if c >= 0]
        image = self._rendered(f, points, [None] * len(points), self.config.refine.method, ())
        rows = [image[v * shape[1]:(v + 1) * shape[1]] for v in range(shape[0])]
        rows = ref.resampled(rows, *f.labels.shape)
        fill = self.config.render.fill == 'input'
        return [[int(own) if own in self.dynamic or (c == UNKNOWN and fill)
                 else (*ignored, UNKNOWN)[0] if c == UNKNOWN else c
                 for c, own in zip(row, line)] for row, line in zip(rows, f.labels)]

    def _counts(self, c):
        return ref.countable(c) and c not in self.config.memory.ignore_labels

    def _valid(self, d, c):
        m = self.config.memory
        return bool(np.isfinite(d)) and d > 0 and m.min_depth <= d <= m.max_depth \
            and self._counts(c)

    def _measured(self, truths, valids, inside, iou):
        both = [[a and b for a, b in zip(*rows)] for rows in zip(valids, inside)]
        result = {}
        for name, images in self.images.items():
            table = sum((ref.confusion(*rows) for rows in zip(truths, images, both)),
                        start=ref.Counter())
            result[name] = {'pixel_accuracy': ref.pixel_accuracy(table), 'miou': ref.miou(table),
                            'flicker': self._flicker(images, valids, inside)}
            if iou:
                result[name]['iou'] = {str(c): x for c, x in sorted(ref.iou(table).items())}
        return {'truth_flicker': self._flicker(truths, valids, inside), 'methods': result}

    def _flicker(self, images, valids, inside):
        """Flicker of consecutive frames of a sensor; a pair belongs to the later frame."""
        before, pairs, changed = {}, 0, 0
        for f, image, valid, here in zip(self.frames, images, valids, inside):
            if f.sensor in before:
                for a, b, x, y, counts in zip(*before[f.sensor], image, valid, here):
                    pairs += b and y and counts
                    changed += b and y and counts and a != x
            before[f.sensor] = image, valid
        return 100 * changed / pairs if pairs else None


def flat(image):
    """Return the values of an image, row by row."""
    return [x for row in np.asarray(image).tolist() for x in row]


def recorded(folder):
    """Return {topic: [message, ...]} of a recording, and {topic: its first QoS profile}."""
    found = defaultdict(list)
    with AnyReader([Path(folder)]) as reader:
        for connection, _, data in reader.messages():
            found[connection.topic].append(reader.deserialize(data, connection.msgtype))
    with Reader(folder) as reader:
        profiles = {c.topic: c.ext.offered_qos_profiles[0] for c in reader.connections}
    return dict(found), profiles


def refined_images(folder, topic='/mapper/labels'):
    """Return [(stamp, frame_id, encoding, (H, W) int32), ...] of a replay's refined/."""
    return [(messages.stamp_ns(m), m.header.frame_id, m.encoding, image_messages.labels(m)[0])
            for m in recorded(Path(folder) / 'refined')[0][topic]]


def histories(path):
    """Return {voxel: [(c, s, t), ...]} and {voxel: label} of a map file."""
    memory = store.load(path).memory()
    columns = memory.voxels()
    voxels = [tuple(v) for v in columns['voxel'].tolist()]
    return ({v: list(zip(*(a.tolist() for a in memory.history(v)))) for v in voxels},
            dict(zip(voxels, columns['label'].tolist())))


def check_whole(folder):
    """Fail unless every result in *folder* is whole; return their names."""
    folder = Path(folder)
    names = {entry.name for entry in folder.iterdir() if not entry.name.startswith('.')}
    assert names <= set(FILES)
    for name in names:
        path = folder / name
        if name.endswith('.json'):
            json.loads(path.read_text(), parse_constant=lambda word: 1 / 0)
        elif name == 'map.persem':
            store.load(path).memory()
        elif name == 'refined':
            assert recorded(path)[0]['/mapper/map']
        elif name == 'map.ply':
            head, _, body = path.read_bytes().partition(b'end_header\n')
            count = int(head.partition(b'element vertex ')[2].split()[0])
            assert len(body) % count == 0 and body
        elif name == 'report.html':
            assert path.read_text().rstrip().endswith('</html>')
        else:
            assert path.read_text().startswith('#')
    return names
