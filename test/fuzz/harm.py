"""One input that means harm, made from its kind and number, and all that is done with it."""

from contextlib import redirect_stderr, redirect_stdout, suppress
import io
import random
import shutil
import sqlite3

from damage import damage_rows, damaged, damaged_picture, damaged_text
from persem_ros import cli
from persem_ros.convert import images
from persem_ros.convert.trajectories import poses_from_trajectory
from persem_ros.core.memory.loading import load
from persem_ros.core.refine.whole import refine
from persem_ros.errors import PersemError
from persem_ros.guard.words import sentence
from persem_ros.inputs.decode.serialized import Decoder
from persem_ros.inputs.recording.fixes import read_fixes
from persem_ros.inputs.recording.recording import Recording
from persem_ros.inputs.recording.source import Source
from persem_ros.inputs.trajectory import from_tum
from persem_ros.outputs.export.georeference import enter, fitted, Fixes
from persem_ros.outputs.export.place import Place
from persem_ros.outputs.export.source import MapSource
from persem_ros.outputs.map import store
from persem_ros.outputs.map.merge import merge, without
from persem_ros.outputs.map.move import move_session, session_of
from persem_ros.replay import compile_kernels
from persem_ros.settings import config_file
from persem_ros.settings.config import Config, Refine, settings
from persem_ros.settings.legend import Legend
from persem_ros.settings.legend_files import load_legend
from persem_ros.settings.parameter_file import scalar
import samples
from tampering import exercise, exercise_living, export, renew, tamper

# Most of the numbers go to what costs least; of one map in forty and one recording in sixty
# everything is tried that persem does with it.
SHARES = {'cdr': 56, 'legend': 14, 'settings': 11, 'picture': 5, 'track': 5, 'map': 4,
          'recording': 3, 'living': 2}
DEEP = {'map': 40, 'recording': 60, 'settings': 20, 'living': 20}
REFUSED, ACCEPTED, FAULT = 'refused', 'accepted', 'fault'
LONGEST = 1200          # characters of a refusal


class Trial:
    """
    What inputs are made from, and a folder for them.

    Parameters
    ----------
    folder : Path
        Empty; everything is written below it.

    """

    def __init__(self, folder):
        self.folder = folder
        self._decode = Decoder()
        self._config = Config()
        self._legend_text = load_legend('town').to_yaml()
        self._settings_lines = [f'{name}: {scalar(value)}' for name, value, _ in settings()]
        self._messages = samples.serialized()
        self.whole = samples.small_map(folder / 'whole.persem')
        self.recordings = samples.small_recordings(folder)
        self.pictures = samples.pictures()
        self.tracks = samples.tracks()
        self.source = MapSource(self.whole)

    def warm_up(self):
        """Import, compile and load everything, so that it is no part of what an input takes."""
        compile_kernels(('geometry',))
        for kind in SHARES:
            for number in range(12):
                self.run(kind, number)
                self.run(kind, number * DEEP.get(kind, 40))

    def kind_of(self, number):
        """Return the kind of the input of this number."""
        return random.Random(number).choices(tuple(SHARES), tuple(SHARES.values()))[0]

    def run(self, kind, number):
        """Make the input of a kind and number and use it; see outcome()."""
        rng = random.Random(f'{kind} {number}')
        return self.outcome(getattr(self, f'_{kind}'), rng, number % DEEP.get(kind, 1) == 0)

    def outcome(self, use, *given):
        """Return (REFUSED, the sentence), (ACCEPTED, '') or (FAULT, what went wrong)."""
        try:
            use(*given)
        except PersemError as error:
            text = sentence(str(error))     # what the command line shows of it
            return (REFUSED, text) if len(text) < LONGEST else \
                (FAULT, f'a refusal of {len(text)} characters')
        except Exception as error:
            return FAULT, f'{type(error).__name__}: {" ".join(str(error).split())[:300]}'
        return ACCEPTED, ''

    def _cdr(self, rng, deep):
        kind, data = rng.choice(self._messages)
        self.use_cdr(kind, damaged(rng, data, same=rng.random() < 0.7))

    def _legend(self, rng, deep):
        lines = self._legend_text.splitlines(keepends=True)
        self.use_legend(damaged_text(rng, ''.join([*lines[:2], *rng.sample(lines[2:], 4)])))

    def _settings(self, rng, deep):
        chosen = rng.sample(self._settings_lines, rng.randint(1, 5))
        if rng.random() < 0.3:
            items = [damaged_text(rng, line).strip().replace(': ', '=', 1) for line in chosen]
            config_file.from_args(None, items)
        else:
            self.use_settings(damaged_text(rng, settings_file(chosen)), deep)

    def _map(self, rng, deep):
        path = self.folder / 'tampered.persem'
        if rng.random() < 0.3:
            path.write_bytes(damaged(rng, self.whole.read_bytes()))
            if rng.random() < 0.2:
                with suppress(sqlite3.Error, TypeError, IndexError, ValueError, OverflowError):
                    renew(path)
        else:
            tamper(self.whole, path, rng.randrange(1 << 60))
        self.use_map(path, deep)

    def _recording(self, rng, deep):
        files = dict(rng.choice(list(self.recordings.values())))
        if rng.random() < 0.3:
            del files['metadata.yaml']
        chosen, inside = rng.choice(sorted(files)), rng.random() < 0.5
        if not inside:
            files[chosen] = damaged(rng, files[chosen])
        bag = self.written(files)
        if inside and (database := next(bag.glob('*.db3'), None)):
            damage_rows(rng, database)
        self.use_recording(bag, deep, frames=rng.random() < 0.2)

    def _picture(self, rng, deep):
        name, data = rng.choice(self.pictures)
        path = self.folder / name
        path.write_bytes(damaged_picture(rng, data))
        self.use_picture(path)

    def _track(self, rng, deep):
        name, text = rng.choice(self.tracks)
        path = self.folder / name
        path.write_text(damaged_text(rng, text) if rng.random() < 0.5 else
                        damaged(rng, text.encode()).decode('utf-8', 'replace'))
        self.use_track(path)

    def _living(self, rng, deep):
        path = self.folder / 'tampered.persem'
        tamper(self.whole, path, rng.randrange(1 << 60))
        self.use_living(path, rng.choice(('attach', 'merge', 'forget', 'place', 'export')), deep)

    def use_picture(self, path):
        """Read a file as labels, as depth and as colours, as persem convert does."""
        refusals = []
        for read in (images.read_labels, images.read_depth, images.read_color):
            try:
                read(path)
            except PersemError as error:
                refusals.append(error)
        if len(refusals) == 3:
            raise refusals[0]

    def use_track(self, path):
        """Read a file of poses or of satellite fixes."""
        if path.name.startswith('fixes'):
            stamps, values = read_fixes(path)
            fitted(self.source, Fixes(stamps, *values.T))
        elif path.suffix == '.tum':
            trajectory, stored = from_tum(path), store.load(self.whole)
            memory = load(move_session(stored, session_of(stored, trajectory), trajectory))
            refine(memory, Refine())
            store.save(self.folder / 'again.persem', memory, self._config)
            store.load(self.folder / 'again.persem')
        else:
            poses = poses_from_trajectory(path, ['0', '1', '2'], True)
            for stamp in poses.stamps[:3]:
                poses.at('0', stamp + 1)

    def use_living(self, path, what, deep):
        """Do with a map file what writes it or reads it block by block."""
        for suffix in ('-wal', '-shm', '-journal'):
            path.with_name(path.name + suffix).unlink(missing_ok=True)
        if what == 'attach':
            exercise_living(path)
        elif what == 'merge':
            done = merge([store.load(self.whole), store.load(path)], by_id=deep)
            refine(done.memory, Refine())
        elif what == 'forget':
            without(store.load(path), 0)
        elif what == 'place':
            enter(path, Place('EPSG:32632', 1.0, 2.0, 3.0, 4.0))
            store.load(path)
        else:
            export(path)
            if deep:
                quiet(['map', 'export', str(path), '--force', *samples.exports(self.folder)])

    def use_cdr(self, kind, data):
        """Deserialize a message and read it in every way in which its type is read."""
        msg = self._decode(data, kind)
        refusals = []
        for read in samples.READERS[kind]:
            try:
                read(msg)
            except PersemError as error:
                refusals.append(error)
        if len(refusals) == len(samples.READERS[kind]):
            raise refusals[0]

    def use_legend(self, text):
        """Read a legend, write it and read that."""
        legend = Legend.from_yaml(text, 'file')
        assert Legend.from_yaml(legend.to_yaml()) == legend

    def use_settings(self, text, deep=True):
        """Read settings; *deep*: write them and read that."""
        config = config_file.from_text(text, 'file')
        assert not deep or config_file.from_text(config_file.to_yaml(config), 'again') == config

    def use_map(self, path, deep):
        """Load a map and refine it; *deep*: all that may be done to a map."""
        if deep:
            exercise(path, self.folder / 'again.persem')
            return
        memory = store.load(path).memory()
        assert len(memory.voxels()['voxel']) == memory.n_voxels - memory.n_gone
        refine(memory, Refine())
        assert set(memory.voxels()['label'].tolist()) <= set(memory.seen_ids.nonzero()[0].tolist())

    def written(self, files):
        """Return the folder of a recording of {file name: bytes}."""
        bag = self.folder / 'bag'
        shutil.rmtree(bag, ignore_errors=True)
        bag.mkdir()
        for name, data in files.items():
            (bag / name).write_bytes(data)
        return bag

    def use_recording(self, bag, deep, frames=False):
        """Read all messages, or all *frames*; *deep*: persem info and persem replay."""
        if deep:
            quiet(['info', str(bag)])
            quiet(['replay', str(bag), '--out', str(self.folder / 'out'), '--force',
                   '--set', 'memory.voxel_size=2'])
        elif frames:
            with Recording(bag, self._config) as recording:
                for _ in recording.frames(truth=True, color=True):
                    pass
        else:
            with Source(bag) as source:
                for _, kind, _, data in source.messages({topic.name for topic in source.topics}):
                    with suppress(PersemError):
                        source.decode(data, kind)


def settings_file(lines):
    """Return lines 'name: value' as a settings file."""
    return '/**:\n  ros__parameters:\n' + ''.join(f'    {line}\n' for line in lines)


def quiet(argv):
    """Run a command; raise RuntimeError for an internal error."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        cli.main(argv)
    if 'internal error' in err.getvalue() or 'Traceback' in err.getvalue():
        raise RuntimeError(err.getvalue()[-400:])
