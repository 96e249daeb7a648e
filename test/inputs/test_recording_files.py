"""The files of a recording, as people have them: lost, packed, renamed, beside a log, foreign."""

from io import BytesIO
import shutil
import sqlite3
import struct
import tracemalloc

import bags
import numpy as np
from persem_ros.errors import PersemError
from persem_ros.inputs.recording import finding
from persem_ros.inputs.recording.recording import Recording
from persem_ros.inputs.recording.source import Source
from persem_ros.outputs.recording.writer import RecordingWriter
from persem_ros.settings.config import Config
import pytest
from rosbags.rosbag2.storage_mcap import zstd
import yaml

STORAGES = [('mcap', 'mcap'), ('sqlite3', 'db3')]


def read(path):
    """Return (stamps of all frames, notes)."""
    with Recording(path, Config()) as recording:
        return [f.stamp for f in recording.frames()], recording.notes


def stamps(*numbers):
    """Return the stamps of frames."""
    return [bags.stamp(i) for i in numbers]


def refused(path):
    """Return the sentence with which an input is refused."""
    with pytest.raises(PersemError) as caught:
        read(path)
    assert '\n' not in str(caught.value)
    return str(caught.value)


def split(path, storage='mcap', parts=3, each=2):
    """Write a recording in several files with a metadata.yaml that lists them; its frames."""
    suffix, merged = dict(STORAGES)[storage], None
    path.mkdir()
    for part in range(parts):
        name, work = f'{path.name}_{part}.{suffix}', path.parent / f'{path.name}-part{part}'
        with RecordingWriter(work, storage=storage) as out:
            for i in range(each * part, each * part + each):
                out.pose('pose', bags.stamp(i), 'map', bags.pose(i))
                bags.write_images(out, i)
        shutil.move(work / f'{work.name}.{suffix}', path / name)
        info = yaml.safe_load((work / 'metadata.yaml').read_text())
        info = info['rosbag2_bagfile_information']
        info['relative_file_paths'] = [name]
        info['files'][0]['path'] = name
        if merged is None:
            merged = info
            continue
        merged['relative_file_paths'].append(name)
        merged['files'] += info['files']
        for topic, more in zip(merged['topics_with_message_count'],
                               info['topics_with_message_count']):
            topic['message_count'] += more['message_count']
    edit(path, lambda _: merged)
    return path


def edit(path, change):
    """Replace the content of a metadata.yaml by what *change* makes of it."""
    file = path / 'metadata.yaml'
    old = yaml.safe_load(file.read_text())['rosbag2_bagfile_information'] if file.exists() else {}
    file.write_text(yaml.safe_dump({'rosbag2_bagfile_information': change(old) or old}))


def packed(file):
    """Replace a file by its Zstandard form, as rosbag2 compresses files."""
    target = file.with_name(f'{file.name}.zstd')
    target.write_bytes(zstd.compress(file.read_bytes()))
    file.unlink()
    return target


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_split_recording_is_read_in_order_and_nothing_is_said(tmp_path, storage):
    assert read(split(tmp_path / 'bag', storage)) == (stamps(*range(6)), [])


@pytest.mark.parametrize('storage, suffix', STORAGES)
def test_a_split_file_that_is_missing_is_named_and_the_others_are_read(tmp_path, storage, suffix):
    path = split(tmp_path / 'bag', storage)
    (path / f'bag_1.{suffix}').unlink()
    found, notes = read(path)
    assert found == stamps(0, 1, 4, 5)
    assert any(f'bag_1.{suffix}' in note and '(8 messages)' in note for note in notes)
    assert any('/semantic/image has 4 messages, not 6' in note for note in notes)


def test_files_that_are_all_missing(tmp_path):
    path = split(tmp_path / 'bag')
    for file in path.glob('*.mcap'):
        file.unlink()
    assert 'bag_0.mcap, bag_1.mcap, bag_2.mcap, none of which is there' in refused(path)


def test_a_split_file_that_cannot_be_read(tmp_path):
    path = split(tmp_path / 'bag')
    (path / 'bag_1.mcap').write_bytes(bytes(5000))
    (path / 'bag_2.mcap').write_bytes(b'')
    found, notes = read(path)
    assert found == stamps(0, 1)
    assert any('bag_1.mcap cannot be read' in note for note in notes)
    assert any('bag_2.mcap is empty' in note for note in notes)


def test_counts_of_metadata_that_differ_from_the_files_are_said_by_topic(tmp_path):
    path = bags.write(tmp_path / 'bag')

    def change(info):
        for topic in info['topics_with_message_count']:
            if topic['topic_metadata']['name'] == '/depth/image':
                topic['message_count'] = 7
    edit(path, change)
    found, notes = read(path)
    assert found == stamps(*range(5))
    assert notes == ['bag: the files differ from what metadata.yaml counts: /depth/image has 5 '
                     'messages, not 7']


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
@pytest.mark.parametrize('profiles', ['', [], 'nonsense: [', [{'durability': 'best_available'}]])
def test_qos_of_metadata_does_not_matter(tmp_path, storage, profiles):
    path = bags.write(tmp_path / 'bag', storage=storage)

    def change(info):
        for topic in info['topics_with_message_count']:
            topic['topic_metadata']['offered_qos_profiles'] = profiles
    edit(path, change)
    assert read(path) == (stamps(*range(5)), [])


@pytest.mark.parametrize('content, word', [
    ('rosbag2_bagfile_information: [', 'cannot be used'), ('', 'form of rosbag2'),
    ('rosbag2_bagfile_information: {}', 'form of rosbag2'), (b'\xff\xfe', 'cannot be used')])
def test_metadata_that_cannot_be_read_is_not_needed(tmp_path, content, word):
    path = bags.write(tmp_path / 'bag')
    (path / 'metadata.yaml').write_bytes(content if isinstance(content, bytes)
                                         else content.encode())
    found, notes = read(path)
    assert found == stamps(*range(5)) and word in notes[0]


@pytest.mark.parametrize('keep', [True, False])
@pytest.mark.parametrize('storage, suffix', STORAGES)
def test_compressed_files(tmp_path, storage, suffix, keep):
    """With the metadata that lists them and without, alone, and beside what they hold."""
    path = split(tmp_path / 'bag', storage)
    files = [packed(file) for file in sorted(path.glob(f'*.{suffix}'))]
    if keep:
        edit(path, lambda info: {**info, 'relative_file_paths': [f.name for f in files],
                                 'compression_format': 'zstd', 'compression_mode': 'FILE'})
    else:
        (path / 'metadata.yaml').unlink()
    found, notes = read(path)
    assert found == stamps(*range(6)) and len(notes) == (not keep)
    assert read(files[1]) == (stamps(2, 3), [])
    files[1].with_suffix('').write_bytes(zstd.decompress(files[1].read_bytes()))
    assert read(path)[0] == stamps(*range(6))
    files[1].unlink()       # decompressed by hand: metadata.yaml lists the other name
    assert read(path)[0] == stamps(*range(6))


def test_a_compressed_file_that_was_cut_off(tmp_path):
    noise = np.random.default_rng(1).integers(0, 256, (600, 800), np.uint8)
    path = bags.write(tmp_path / 'bag', extra=lambda out: out.image(
        'noise', bags.stamp(9), '', noise, 'mono8'))
    file = packed(path / 'bag.mcap')
    file.write_bytes(file.read_bytes()[:-1000])
    with Source(path) as source:
        assert any('bag.mcap.zstd is cut off or damaged' in note for note in source.notes)


def test_files_that_were_renamed(tmp_path):
    path = bags.write(tmp_path / 'bag')
    (path / 'bag.mcap').rename(path / 'flight.mcap')
    found, notes = read(path)
    assert found == stamps(*range(5))
    assert 'lists bag.mcap' in notes[0] and 'flight.mcap was read instead' in notes[0]


def test_a_file_beside_the_listed_ones_is_named(tmp_path):
    path = split(tmp_path / 'bag')
    shutil.copy(path / 'bag_0.mcap', path / 'labels.mcap')
    found, notes = read(path)
    assert found == stamps(*range(6))
    assert len(notes) == 1 and f'{path}+{path / "labels.mcap"}' in notes[0]


def with_log(path):
    """Write a recording whose newest messages are in a write-ahead log only, as after a kill."""
    bags.write(path, storage='sqlite3')
    file = path / 'bag.db3'
    base = sqlite3.connect(file, isolation_level=None)
    base.execute('PRAGMA journal_mode=WAL')
    base.execute('PRAGMA wal_autocheckpoint=0')
    last = base.execute('SELECT max(timestamp) FROM messages').fetchone()[0]
    rows = base.execute('SELECT topic_id, timestamp, data FROM messages').fetchall()
    base.execute('DELETE FROM messages WHERE timestamp > ?', (bags.stamp(2.2),))
    base.execute('PRAGMA wal_checkpoint(TRUNCATE)')
    base.executemany('INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)',
                     [row for row in rows if row[1] > bags.stamp(2.2)])
    copy = path.parent / 'killed'
    shutil.copytree(path, copy)
    base.close()
    assert (copy / 'bag.db3-wal').stat().st_size and last
    return copy


def test_a_write_ahead_log_is_read_and_nothing_is_changed(tmp_path):
    path = with_log(tmp_path / 'bag')
    before = {file.name: file.read_bytes() for file in path.iterdir()}
    for given in (path, path / 'bag.db3', path / 'bag.db3-wal'):
        found, notes = read(given)
        assert found == stamps(*range(5))
        assert any('bag.db3-wal holds 10 messages' in note for note in notes)
    assert {file.name: file.read_bytes() for file in path.iterdir()} == before
    (path / 'bag.db3-wal').unlink()
    found, notes = read(path)
    assert found == stamps(0, 1)
    assert any('/semantic/image has 3 messages, not 5' in note for note in notes)


def test_metadata_given_as_the_recording(tmp_path):
    path = bags.write(tmp_path / 'bag')
    assert read(path / 'metadata.yaml') == (stamps(*range(5)), [])


def test_a_folder_above_a_recording(tmp_path):
    path = bags.write(tmp_path / 'day' / 'bag')
    found, notes = read(tmp_path / 'day')
    assert found == stamps(*range(5)) and f'{tmp_path / "day"} holds one recording, {path}' in \
        notes[0]
    second = bags.write(tmp_path / 'day' / 'deeper' / 'bag')
    text = refused(tmp_path / 'day')
    assert f'holds 2 of them: {path}, {second}' in text and 'A+B' in text


def test_a_plus_sign_parts_recordings_and_no_names(tmp_path):
    names = [tmp_path / 'c++' / 'drive', tmp_path / 'a+b' / 'labels', tmp_path / 'x']
    for name in names:
        name.mkdir(parents=True)
    assert finding.split('+'.join(map(str, names))) == names
    assert finding.split(names[1]) == [names[1]]
    assert finding.split('no/such+thing') == [finding.Path('no/such+thing')]
    path = bags.write(tmp_path / 'bag')
    assert 'nothing does not exist' in refused(f'{path}+{tmp_path / "nothing"}')


def foreign(path, encoding, schema, profile=''):
    """Write an .mcap file with one message of another system."""
    def text(word):
        return struct.pack('<I', len(word)) + word.encode()

    def record(out, kind, data):
        out.write(struct.pack('<BQ', kind, len(data)) + data)

    out = BytesIO()
    out.write(b'\x89MCAP0\r\n')
    record(out, 1, text(profile) + text('test'))
    record(out, 3, struct.pack('<H', 1) + text('Image') + text(schema) + text(''))
    record(out, 4, struct.pack('<HH', 7, 1) + text('/camera/rgb') + text(encoding) + text(''))
    record(out, 5, struct.pack('<HIQQ', 7, 0, bags.START, bags.START) + b'1234567890')
    record(out, 15, bytes(4))
    record(out, 2, bytes(20))
    out.write(b'\x89MCAP0\r\n')
    path.write_bytes(out.getvalue())
    return path


@pytest.mark.parametrize('encoding, schema, words', [
    ('ros1', 'ros1msg', ['ROS 1 messages (/camera/rgb)', 'rosbags-convert']),
    ('protobuf', 'protobuf', ['messages in protobuf (/camera/rgb)', 'persem convert frames']),
    ('json', 'jsonschema', ['messages in json'])])
def test_messages_of_other_systems(tmp_path, encoding, schema, words):
    text = refused(foreign(tmp_path / 'flight.mcap', encoding, schema, 'ros1'))
    for word in words:
        assert word in text


def test_messages_of_other_systems_beside_good_ones_are_named(tmp_path):
    path = bags.write(tmp_path / 'bag')
    (path / 'metadata.yaml').unlink()
    foreign(path / 'other.mcap', 'json', 'jsonschema')
    found, notes = read(path)
    assert found == stamps(*range(5))
    assert any('/camera/rgb: messages in json cannot be read' in note for note in notes)


@pytest.mark.parametrize('name, content, word', [
    ('old.bag', b'#ROSBAG V2.0\n', 'rosbags-convert --src'),
    ('old', b'#ROSBAG V2.0\n', 'ROS 1 recording'),
    ('old.bag.active', b'#ROSBAG V2.0\n', 'rosbag reindex old.bag'),
    ('flight.mcap', b'version https://git-lfs.github.com/spec/v1\n', 'git lfs pull'),
    ('flight.zip', b'PK\x03\x04', 'unpack it'),
    ('notes.txt', b'hello', "file of type '.txt'")])
def test_files_that_are_something_else(tmp_path, name, content, word):
    (tmp_path / name).write_bytes(content)
    assert word in refused(tmp_path / name)


def test_a_folder_of_ros_1_recordings(tmp_path):
    (tmp_path / 'old.bag').write_bytes(b'#ROSBAG V2.0\n')
    assert 'old.bag is a ROS 1 recording' in refused(tmp_path)


@pytest.mark.parametrize('storage, suffix', STORAGES)
def test_a_file_may_have_any_name(tmp_path, storage, suffix):
    path = bags.write(tmp_path / 'bag', storage=storage)
    (path / f'bag.{suffix}').rename(tmp_path / 'flight')
    assert read(tmp_path / 'flight') == (stamps(*range(5)), [])


def test_one_topic_in_both_recordings_of_an_input_is_said(tmp_path):
    first, second = bags.write(tmp_path / 'a'), bags.write(tmp_path / 'b', frames=7)
    found, notes = read(f'{first}+{second}')
    assert found == stamps(*range(7))
    assert '/semantic/image is in a and in b: of messages with one stamp that of a is used' in \
        notes


def test_metadata_of_a_recorder_on_windows(tmp_path):
    path = bags.write(tmp_path / 'bag')
    edit(path, lambda info: {**info, 'relative_file_paths': ['bag\\bag.mcap']})
    assert read(path) == (stamps(*range(5)), [])


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
@pytest.mark.parametrize('compress', [False, True])
def test_a_long_recording_whose_heads_are_not_kept(tmp_path, storage, compress, monkeypatch):
    monkeypatch.setattr('persem_ros.inputs.recording.source.REMEMBERED', 3)
    path = bags.write(tmp_path / 'bag', storage=storage, compress=compress)
    assert read(path) == (stamps(*range(5)), [])


def test_what_was_read_of_an_uncompressed_recording_is_not_kept(tmp_path):
    noise = np.random.default_rng(1).integers(0, 256, (1024, 1024), np.uint8)
    path = bags.write(tmp_path / 'bag', extra=lambda out: [
        out.image('noise', bags.stamp(9 + i), '', noise, 'mono8') for i in range(8)])
    with Source(path) as source:
        tracemalloc.start()
        try:
            assert sum(name == '/noise' for name, *_ in source.messages({'/noise'})) == 8
            assert tracemalloc.get_traced_memory()[0] < 2 * noise.nbytes
        finally:
            tracemalloc.stop()


def test_a_folder_of_git_lfs_pointers_says_so(tmp_path):
    (tmp_path / 'flight').mkdir()
    (tmp_path / 'flight' / 'flight_0.mcap').write_text(
        'version https://git-lfs.github.com/spec/v1\noid sha256:abc\nsize 123\n')
    assert "'git lfs pull' fetches it" in refused(tmp_path / 'flight')
