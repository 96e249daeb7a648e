"""One input that means harm, made from its kind and number, and all that is done with it."""

import contextlib
import io
import random
import shutil

import numpy as np
from persem_ros import cli
from persem_ros.errors import PersemError
from persem_ros.inputs.decode import messages
from persem_ros.inputs.decode.serialized import Decoder
from persem_ros.replay import compile_kernels
from persem_ros.settings import config_file
from persem_ros.settings.legend import Legend, load_legend
from rosbags.typesys import get_typestore, Stores
from tampering import exercise, FLOATS, NUMBERS, tamper, TEXTS

KINDS = ('map', 'recording', 'legend', 'settings', 'cdr')
# Most of the numbers go to what costs least.
SHARES = ('cdr',) * 40 + ('legend',) * 25 + ('settings',) * 25 + ('map',) * 6 + ('recording',) * 4
STRANGE = (b'\xff' * 8, b'\xff' * 7 + b'\x7f', bytes(8), b'\0\0\0\0\1\0\0\0', b'\0\0\0\x80' * 2)
TYPES = {'sensor_msgs/msg/Image': (messages.labels, messages.depth, messages.color),
         'sensor_msgs/msg/CompressedImage': (messages.labels, messages.depth, messages.color),
         'geometry_msgs/msg/PoseStamped': (messages.pose,),
         'nav_msgs/msg/Odometry': (messages.pose,), 'tf2_msgs/msg/TFMessage': (
             messages.transforms,)}


class Trial:
    """
    What inputs are made from, and a folder for them.

    Parameters
    ----------
    folder : Path
        Empty; everything is written below it.

    """

    def __init__(self, folder):
        compile_kernels()       # not a part of what an input takes
        self.folder = folder
        self.bags = {}
        self._whole = None
        self._decode = Decoder()
        self.legend = load_legend('town').to_yaml()
        self.settings = config_file.to_yaml(config_file.from_args())
        self._samples = dict(_samples())

    def kind_of(self, number):
        """Return the kind of the input of this number."""
        return SHARES[random.Random(number).randrange(len(SHARES))]

    def run(self, kind, number):
        """Make the input and use it; return what went wrong, '' for nothing."""
        try:
            getattr(self, f'_{kind}')(random.Random(f'{kind} {number}'), number)
        except PersemError as error:
            text = str(error)
            return '' if len(text) < 5000 else f'a refusal of {len(text)} characters'
        except Exception as error:
            return f'{type(error).__name__}: {" ".join(str(error).split())[:200]}'
        return ''

    def _map_file(self):
        """Return a small map, made once."""
        if self._whole is None:
            import core_worlds as cw
            from persem_ros.core.refine.job import refine
            from persem_ros.outputs.map import store
            from persem_ros.settings.config import Config, Refine
            rng, memory = np.random.default_rng(1), cw.core_of([])
            for t in range(8):
                seen = {tuple(voxel): (int(rng.choice(cw.IDS)), float(rng.choice(cw.SHARES)))
                        for voxel in rng.integers(-9, 9, (40, 3)).tolist()}
                memory.add(cw.observations(10 ** 18 + 10 ** 8 * t, seen, [1, 2], f'cam {t % 2}'))
            refine(memory, Refine())
            self._whole = self.folder / 'whole.persem'
            store.save(self._whole, memory, Config(), load_legend('town'))
        return self._whole

    def _map(self, rng, number):
        """Tamper with a map; do all that may be done to it."""
        path = self.folder / 'tampered.persem'
        tamper(self._map_file(), path, number)
        exercise(path, self.folder / 'again.persem')

    def _recording(self, rng, number):
        """Damage a file of a recording; look at it, and map it at times."""
        storage = rng.choice(('mcap', 'sqlite3'))
        packed = rng.random() < 0.5
        if (storage, packed) not in self.bags:
            path = self.folder / f'bag-{storage}-{packed}'
            self._quiet(['simulate', str(path), '--frames', '2', '--size', '48x36', '--storage',
                         storage, *(['--compress'] if packed else [])])
            self.bags[storage, packed] = path
        bag = self.folder / 'bag'
        shutil.rmtree(bag, ignore_errors=True)
        shutil.copytree(self.bags[storage, packed], bag)
        file = rng.choice(sorted(bag.iterdir()))
        file.write_bytes(damaged(rng, file.read_bytes()))
        if rng.random() < 0.3:
            (bag / 'metadata.yaml').unlink()
        self._quiet(['info', str(bag)])
        if rng.random() < 0.3:
            self._quiet(['replay', str(bag), '--out', str(self.folder / 'out'), '--force',
                         '--set', 'memory.voxel_size=2'])

    def _legend(self, rng, number):
        """Read a legend that somebody changed."""
        legend = Legend.from_yaml(self._text(rng, self.legend), 'file')
        assert Legend.from_yaml(legend.to_yaml()) == legend

    def _text(self, rng, text):
        return damaged(rng, text.encode()).decode('utf-8', 'replace')

    def _settings(self, rng, number):
        """Read settings that somebody changed."""
        config_file.from_text(self._text(rng, self.settings), 'file')

    def _cdr(self, rng, number):
        """Decode a message that somebody changed."""
        kind = rng.choice(sorted(TYPES))
        try:
            msg = self._decode(damaged(rng, self._samples[kind]), kind)
            for read in TYPES[kind]:
                with contextlib.suppress(PersemError):
                    read(msg)
        except PersemError:
            pass

    def _quiet(self, argv):
        """Run a command; raise RuntimeError for an internal error."""
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            cli.main(argv)
        if 'internal error' in err.getvalue() or 'Traceback' in err.getvalue():
            raise RuntimeError(err.getvalue()[-400:])


def damaged(rng, data):
    """Return bytes that were cut, flipped, doubled, zeroed or filled with strange lengths."""
    data = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4))):
        if not data:
            break
        at, act = rng.randrange(len(data)), rng.randrange(7)
        if act == 0:
            del data[at:]
        elif act == 1:
            data[at] ^= 1 << rng.randrange(8)
        elif act == 2:
            del data[at:at + rng.randrange(1, 300)]
        elif act == 3:
            data[at:at + 20] = bytes(min(20, len(data) - at))
        elif act == 4:
            data[at:at] = rng.randbytes(rng.randrange(1, 60))
        elif act == 5:
            data[at:at + 8] = rng.choice(STRANGE)
        else:
            data[at:at] = str(rng.choice(NUMBERS + FLOATS + TEXTS)).encode()
    return bytes(data)


def _samples():
    """Yield (type, serialized message) of each type."""
    from persem_ros.outputs.recording.messages import MessageFactory
    store = get_typestore(Stores.ROS2_JAZZY)
    make = MessageFactory(store.types)
    import cv2
    ids = np.arange(48, dtype=np.uint8).reshape(6, 8)
    png = cv2.imencode('.png', ids)[1]
    for kind, message in (
            ('sensor_msgs/msg/Image', make.image(1, 'camera', ids, 'mono8')),
            ('sensor_msgs/msg/CompressedImage',
             make.compressed(1, 'camera', 'mono8; png compressed', png.tobytes())),
            make.pose(1, 'map', np.eye(4), 'PoseStamped', ''),
            make.pose(1, 'map', np.eye(4), 'Odometry', 'base'),
            ('tf2_msgs/msg/TFMessage', make.make(
                'tf2_msgs/msg/TFMessage', [make.transform(1, 'map', 'base', np.eye(4))]))):
        yield kind, bytes(store.serialize_cdr(message, kind))
