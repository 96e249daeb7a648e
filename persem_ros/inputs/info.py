"""What is in a recording: one row a topic, what a replay would use, what it lacks."""

from dataclasses import dataclass, field
from datetime import datetime, timezone

from persem_ros.inputs import latched, messages
from persem_ros.inputs.assemble import Assembler
from persem_ros.inputs.camera import same_aspect
from persem_ros.inputs.messages import BadMessage
from persem_ros.inputs.poses import PoseBuffer
from persem_ros.inputs.topics import COMPRESSED, first_messages, IMAGE, INFO, NEEDED, POSES, TF

STAMPED = {IMAGE, COMPRESSED, INFO, *POSES.values()}
PLAUSIBLE = 400 * 365 * 86400 * 10**9       # ns; times beyond are shown as numbers
COLUMNS = ('topic', 'type', 'messages', 'Hz', 'encoding', 'size', 'frame', 'first', 'last', '')


@dataclass
class Row:
    """What one topic holds; stamps are header stamps where the type has a header."""

    name: str
    msgtype: str
    count: int = 0
    encoding: str = ''
    size: str = ''
    frame: str = ''
    first: int = None           # smallest stamp, ns
    last: int = None            # largest stamp, ns
    back: int = 0               # stamps smaller than the one before
    repeated: int = 0
    previous: int = field(default=None, repr=False)

    @property
    def rate(self):
        """Messages per second between the first and the last stamp, 0 where there is none."""
        span = (self.last or 0) - (self.first or 0)
        return (self.count - 1) * 1e9 / span if self.count > 1 and span > 0 else 0.0

    def see(self, stamp):
        """Count a message with *stamp*."""
        self.count += 1
        self.first = stamp if self.first is None else min(self.first, stamp)
        self.last = stamp if self.last is None else max(self.last, stamp)
        if self.previous is not None and self.msgtype in STAMPED:
            self.back += stamp < self.previous
            self.repeated += stamp == self.previous
        self.previous = stamp


def survey(source, progress=iter):
    """
    Read a whole recording without decoding its images.

    Parameters
    ----------
    source : persem_ros.inputs.source.Source
        The open recording.
    progress : callable
        Wraps the iterable of messages, for a progress bar.

    Returns
    -------
    list of Row
        By topic name.

    """
    rows = {(t.name, t.msgtype): Row(t.name, t.msgtype) for t in source.topics}
    names = {t.name for t in source.topics}
    for name, kind, time, data in progress(source.messages(names)):
        row = rows[name, kind]
        try:
            row.see(messages.header(data)[0] if kind in STAMPED else time)
        except BadMessage:
            row.see(time)
    for name, msg in first_messages(source, names).items():
        for row in rows.values():
            if row.name == name:
                _describe(row, msg)
    return list(rows.values())


def problems(source, choice, config):
    """
    Return what stands in the way of a replay: sentences with flags to paste.

    Parameters
    ----------
    source : persem_ros.inputs.source.Source
        The open recording.
    choice : persem_ros.inputs.topics.Choice
        The topics that would be used.
    config : persem_ros.config.Config
        The settings.

    """
    found = list(choice.problems)
    names = {topic.name for chosen in choice.cameras.values() for topic in chosen.values()}
    firsts = first_messages(source, names)
    statics = latched.read(source, choice).statics
    for chosen in choice.cameras.values():
        samples = {kind: firsts[topic.name] for kind, topic in chosen.items()
                   if topic.name in firsts}
        found += _unusable(chosen, samples, config)
        if not choice.problems:
            found += _unmounted(statics, samples, config)
    return list(dict.fromkeys(found))


def text(source, rows, choice, lacking):
    """
    Return the report.

    Parameters
    ----------
    source, rows, choice, lacking
        The source, its survey, the choice and its problems.

    Returns
    -------
    str
        Lines of plain text.

    """
    start = min((row.first for row in rows if row.first), default=0)
    end = max((row.last for row in rows if row.last), default=0)
    total = sum(row.count for row in rows)
    lines = [f'{source.path}: {source.storage}, {_bytes(source.size)}, {total} messages',
             f'from {_date(start)} to {_date(end)} ({(end - start) / 1e9:.1f} s)', '']
    lines += _table([COLUMNS] + [_cells(row, start) for row in rows]) + ['']
    lines += [f'note: {note}' for note in source.notes]
    for camera, chosen in choice.cameras.items():
        lines.append(f'a replay would use{f" for camera {camera}" if camera else ""}:')
        lines += [f'  {kind:<12} {topic.name} ({_short(topic.msgtype)})'
                  for kind, topic in chosen.items()]
    lines += [f'  {kind:<12} {topic.name}' for kind, topics in (
        ('tf', choice.tf if 'pose' not in next(iter(choice.cameras.values())) else []),
        ('tf_static', choice.tf_static), ('legend', choice.legends)) for topic in topics]
    lines += [f'missing: {sentence}' for sentence in lacking]
    lines.append('not usable as it is' if lacking else
                 f'usable: persem replay {source.path} --out DIR')
    return '\n'.join(lines) + '\n'


def _describe(row, msg):
    """Fill in what the first message tells."""
    row.encoding = getattr(msg, 'encoding', None) or getattr(msg, 'format', '') or \
        getattr(msg, 'distortion_model', '')
    if hasattr(msg, 'width') and hasattr(msg, 'height'):
        row.size = f'{msg.width}x{msg.height}'
    elif row.msgtype == COMPRESSED:
        row.size = _compressed_size(msg)
    if hasattr(msg, 'header'):
        row.frame = msg.header.frame_id
        row.frame += f' -> {msg.child_frame_id}' if getattr(msg, 'child_frame_id', '') else ''
    elif row.msgtype == TF and msg.transforms:
        first = msg.transforms[0]
        row.frame = f'{first.header.frame_id} -> {first.child_frame_id}'


def _compressed_size(msg):
    """Return the size of a compressed image, '' where it cannot be decoded."""
    read = messages.depth if 'compressedDepth' in msg.format else messages.color
    try:
        height, width = read(msg).shape[:2]
    except BadMessage:
        return ''
    return f'{width}x{height}'


def _unusable(chosen, samples, config):
    """Return what is wrong with the first messages of the images and camera infos."""
    found, sizes = [], {}
    for kind, read in (('labels', lambda msg: messages.labels(msg)[0]), ('depth', messages.depth),
                       ('camera_info', Assembler(config.camera.rectified).add_info)):
        if kind not in chosen:
            continue
        if kind not in samples:
            found.append(f'{chosen[kind].name} has no message that can be read')
            continue
        try:
            result = read(samples[kind])
            sizes[kind] = None if result is None else result.shape[::-1]
        except BadMessage as fault:
            found.append(f'{NEEDED[kind]} on {chosen[kind].name}: {fault}')
    labels, depth = sizes.get('labels'), sizes.get('depth')
    if labels and depth and not same_aspect(labels, depth):
        found.append(f'label images are {labels[0]} x {labels[1]}, depth images {depth[0]} x '
                     f'{depth[1]}: expected one aspect ratio')
    return found


def _unmounted(statics, samples, config):
    """Return the sentence for poses that nothing connects with the camera."""
    if 'pose' not in samples or 'depth' not in samples:
        return []
    poses = PoseBuffer(config)
    for transform in statics:
        poses.add_static(*transform)
    try:
        stamp, T, parent, child = messages.pose(samples['pose'])
    except BadMessage as fault:
        return [f'poses: {fault}']
    poses.add(stamp, T, parent, child)
    frame = messages.frame_id(samples['depth']) or messages.frame_id(samples['labels'])
    return [poses.mount_sentence(frame)] if poses.lookup(stamp, frame).T is None else []


def _cells(row, start):
    remarks = [f'{n} {what}' for n, what in ((row.back, 'stamps go back'),
                                             (row.repeated, 'stamps repeat')) if n]
    times = [f'{(stamp - start) / 1e9:+.3f}' if stamp is not None else ''
             for stamp in (row.first, row.last)]
    rate = f'{row.rate:.1f}' if row.rate else ''
    return (row.name, _short(row.msgtype), str(row.count), rate, row.encoding, row.size, row.frame,
            *times, ', '.join(remarks))


def _table(rows):
    """Return the rows as aligned lines; numbers to the right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    right = {COLUMNS.index(name) for name in ('messages', 'Hz', 'first', 'last')}
    return ['  '.join(cell.rjust(width) if i in right else cell.ljust(width)
                      for i, (cell, width) in enumerate(zip(row, widths))).rstrip()
            for row in rows]


def _short(kind):
    return kind.rpartition('/')[2]


def _bytes(size):
    for unit in ('bytes', 'kB', 'MB', 'GB'):
        if size < 1000 or unit == 'GB':
            return f'{size:.0f} {unit}' if unit == 'bytes' else f'{size:.1f} {unit}'
        size /= 1000


def _date(stamp):
    """Return a stamp as UTC; simulated clocks start in 1970 and are shown as seconds."""
    if not 10**17 < stamp < PLAUSIBLE:
        return f'{stamp / 1e9:.3f} s'
    return datetime.fromtimestamp(stamp / 1e9, timezone.utc).strftime('%Y-%m-%d %H:%M:%S UTC')
