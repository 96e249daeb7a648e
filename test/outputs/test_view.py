"""The viewer: what its page asks for, and what others who ask are told."""

from contextlib import closing
import http.client
import json
import os
from pathlib import Path
import re
import shutil
import socket
import subprocess
import threading

import core_worlds as cw
import numpy as np
from persem_ros.cli import main
from persem_ros.core.memory.capture import dump
from persem_ros.core.refine.explain import explain
from persem_ros.core.refine.whole import refine
from persem_ros.outputs.map import store
from persem_ros.outputs.map.explanation import explanation, of_file
from persem_ros.outputs.map.living import LivingMap
from persem_ros.outputs.map.part import explained, surroundings
from persem_ros.outputs.view.living import LivingView
from persem_ros.outputs.view.pages import ASSETS, Pages
from persem_ros.outputs.view.server import LONGEST_QUERY, Server
from persem_ros.settings.config import Config, updated
from persem_ros.settings.legend import Legend
import pytest

EVIL = '<img src=x onerror=alert(1)>'
LEGEND = Legend.from_yaml(f"""
classes:
- {{id: 1, name: ground, color: [128, 128, 128]}}
- {{id: 2, name: "{EVIL}", color: [255, 0, 0]}}
""")
ORIGIN = (500.0, 0.0, 0.0)


def mapped(frames=range(2), width=90):
    """Return a memory with a floor and a wall."""
    memory = cw.core_of([])
    memory.origin = ORIGIN
    for t in frames:
        seen = {(i, j, 0): (1, 1.0) for i in range(width) for j in range(30)}
        seen |= {(10, j, k): (2, 0.75) for j in range(30) for k in range(1, 5)}
        memory.add(cw.observations(10 ** 9 * t + 5, seen))
    refine(memory, Config().refine)
    return memory


CONFIG = updated(Config(), {'map.origin': list(ORIGIN)})


@pytest.fixture(scope='module')
def path(tmp_path_factory):
    """Return the path of a map file."""
    found = tmp_path_factory.mktemp('view') / 'map.persem'
    store.save(found, mapped(), CONFIG, LEGEND)
    return found


@pytest.fixture(scope='module')
def server(path):
    """Serve the map; return the Server."""
    with Server(Pages(LivingView(path)), 0) as found:
        thread = threading.Thread(target=found.serve_forever, args=(0.02,), daemon=True)
        thread.start()
        yield found
        found.shutdown()


def asked(server, name, method='GET', token=None, **headers):
    """Return (status, headers, body) of a request."""
    with closing(http.client.HTTPConnection('127.0.0.1', server.server_address[1], 20)) as line:
        line.request(method, f'/{server.token if token is None else token}/{name}', **headers)
        answer = line.getresponse()
        return answer.status, answer.headers, answer.read()


def known(server, name):
    """Return the JSON at a name."""
    status, _, body = asked(server, name)
    assert status == 200, body
    return json.loads(body)


@pytest.mark.parametrize('name', ASSETS)
def test_the_page_runs_nothing_but_its_own(server, name):
    status, headers, body = asked(server, name)
    assert status == 200 and len(body) == int(headers['Content-Length']) > 500
    policy = headers['Content-Security-Policy']
    assert "default-src 'none'" in policy and "script-src 'self';" in policy
    assert 'unsafe' not in policy and 'http' not in policy
    assert headers['X-Content-Type-Options'] == 'nosniff'
    assert headers['Cache-Control'] == 'no-store'
    if name != 'tiles.min.js':
        text = body.decode()
        assert 'http:' not in text and 'https:' not in text and 'innerHTML' not in text
        assert ' style=' not in text and 'onclick="' not in text and 'eval(' not in text


def test_what_the_map_is(server):
    info = known(server, 'info.json')
    assert (info['voxels'], info['frames'], info['voxelSize']) == (90 * 30 + 120, 2, 0.5)
    assert [c['name'] for c in info['classes']] == ['ground', EVIL]
    assert info['offset'] == [500.0, 0.0, 0.0] and info['low'] == [0.0, 0.0, 0.0]
    assert len(known(server, 'tracks.json')[0]) == 3        # the last one twice


def test_tiles_are_the_maps(server):
    waiting, points = [known(server, 'tileset.json')['root']], 0
    while waiting:
        tile = waiting.pop()
        waiting += tile.get('children', [])
        status, headers, body = asked(server, tile['content']['uri'])
        assert status == 200 and 'immutable' in headers['Cache-Control']
        assert headers['Content-Type'] == 'model/gltf-binary' and body[:4] == b'glTF'
        size = int.from_bytes(body[12:16], 'little')
        head = json.loads(body[20:20 + size])
        points += head['accessors'][0]['count'] * (tile['geometricError'] == 0)
    assert points == 90 * 30 + 120


def test_a_click_is_explained_as_by_query(server, path, capsys):
    answer = known(server, 'explain.json?x=5.2&y=3.1&z=1.2&within=2')
    assert main(['map', 'query', str(path), '505.2', '3.1', '1.2']) == 0
    assert capsys.readouterr().out == answer['text'] + '\n'
    assert answer['name'] == EVIL and answer['corner'] == [5.0, 3.0, 1.0]
    assert len(answer['eyes']) == len(answer['colors']) == 2
    beside = known(server, 'explain.json?x=5.2&y=3.1&z=3.4&within=4')
    assert beside['corner'] == [5.0, 3.0, 2.0]
    status, _, body = asked(server, 'explain.json?x=5.2&y=3.1&z=90&within=2')
    assert (status, body) == (400, b'nothing was observed within 2 voxels of this place\n')


@pytest.mark.parametrize('host', [
    'example.org', 'example.org:{port}', '127.0.0.1', '127.0.0.1:1', '127.0.0.1.evil.org:{port}',
    'localhost:{port}@evil.org', '[::1]:{port}', ''])
def test_other_hosts_are_refused(server, host):
    host = host.format(port=server.server_address[1])
    status, _, body = asked(server, '', headers={'Host': host})
    assert status == 421 and b'<' not in body


def test_localhost_is_this_machine(server):
    host = f'LOCALHOST:{server.server_address[1]}'
    assert asked(server, '', headers={'Host': host})[0] == 200


@pytest.mark.parametrize('token', ['', 'info.json', 'x' * 32, '%2e%2e', '..', '{token}x',
                                   '{half}'])
def test_nothing_without_the_token(server, token):
    token = token.format(token=server.token, half=server.token[:-1])
    status, headers, body = asked(server, 'info.json', token=token)
    assert status == 403 and b'voxels' not in body and server.token.encode() not in body
    assert body.startswith(b'open the address that persem map view printed')


def test_tokens_are_random(server, path):
    with Server(server.pages, 0) as other:
        assert len(server.token) >= 32 and other.token != server.token
        assert other.server_address[0] == '127.0.0.1'


@pytest.mark.parametrize('name', [
    '../../../etc/passwd', '%2e%2e/%2e%2e/etc/passwd', '..%2f..%2fsetup.py', '/etc/passwd',
    'assets/view.js', 'tiles.build.sh', 'tiles/../view.js', 'tiles/99_0_0_0_0.glb',
    'tiles/0_1_1_1_0.glb', 'tiles/0_99999999_0_0_0.glb', 'tiles/0_0_0_0_0.glb%00', 'tiles/0_0_0_0',
    'view.js/', '%00', EVIL.replace(' ', '%20')])
def test_other_names_mean_nothing(server, name):
    status, headers, body = asked(server, name)
    assert (status, body) == (404, b'there is no such page\n')
    assert headers['Content-Type'].startswith('text/plain')


@pytest.mark.parametrize('query', [
    '', 'x=1', 'x=1&y=2&z=nan&within=2', 'x=1e9&y=0&z=0&within=2', 'x=1&x=1&y=0&z=0&within=2',
    "x=1'--&y=0&z=0&within=2", f'x=1{"0" * 20}&y=0&z=0&within=2', 'x=%D9%A1&y=0&z=0&within=2',
    '&'.join(f'x{k}=1' for k in range(20))])
def test_numbers_that_are_none(server, query):
    status, _, body = asked(server, f'explain.json?{query}')
    assert status == 400 and body.count(b'\n') == 1 and b'Traceback' not in body


def test_long_requests(server):
    assert asked(server, f'info.json?{"x" * (LONGEST_QUERY + 1)}')[0] == 414
    assert asked(server, 'x' * 70_000)[0] == 414
    status, _, _ = asked(server, '', headers={f'X-{k}': 'x' for k in range(200)})
    assert status == 431


@pytest.mark.parametrize('method', ['POST', 'PUT', 'DELETE', 'OPTIONS', 'TRACE', 'PATCH', 'BREW'])
def test_only_get(server, method):
    status, headers, body = asked(server, '', method, body='x' * 100)
    assert status == 405 and headers['Allow'] == 'GET, HEAD' and headers['Connection'] == 'close'
    assert 'Content-Security-Policy' in headers and b'<' not in body


def test_head(server):
    status, headers, body = asked(server, 'info.json', 'HEAD')
    assert status == 200 and body == b'' and int(headers['Content-Length']) > 100


@pytest.mark.parametrize('sent', [b'\x16\x03\x01\x00\xa5', b'\r\n' * 3, b'GET / HTTP/9.9\r\n\r\n',
                                  b'GET\r\n\r\n', b'GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n',
                                  b'GET /\xe4/ HTTP/1.1\r\nHost: localhost:PORT\r\n\r\n'])
def test_what_is_no_request(server, sent):
    with socket.create_connection(server.server_address[:2], 20) as line:
        line.sendall(sent.replace(b'PORT', b'%d' % server.server_address[1]))
        line.shutdown(socket.SHUT_WR)
        answer = b''.join(iter(lambda: line.recv(4096), b''))
    assert not answer or b' 4' in answer[:14] or b' 505' in answer[:14] or \
        not answer.startswith(b'HTTP')
    assert asked(server, 'changes.json')[0] == 200


def test_a_port_in_use_and_ports_that_are_none(server, path, capsys):
    port = server.server_address[1]
    assert main(['map', 'view', str(path), '--port', str(port)]) == 1
    assert capsys.readouterr().err == (f'persem: port {port} is in use; give another one with '
                                       '--port, or --port 0 for any that is free\n')
    assert main(['map', 'view', str(path), '--port', '70000']) == 1
    assert 'expected a number from 1 to 65535' in capsys.readouterr().err


def test_a_browser_without_webgl_says_so(server, tmp_path):
    browser = next(filter(None, map(shutil.which, (
        'chromium', 'chromium-browser', 'google-chrome'))), None)
    if browser is None:
        pytest.skip('needs Chromium')
    done = subprocess.run(
        [browser, '--headless', '--no-sandbox', '--disable-3d-apis', '--no-first-run',
         f'--user-data-dir={tmp_path}', '--virtual-time-budget=5000', '--dump-dom',
         server.address], capture_output=True, text=True, timeout=60)
    note = re.search('<p id="note"[^>]*>([^<]*)<', done.stdout).group(1)
    assert note == ('This page draws with WebGL 2, which this browser does not offer or has '
                    'switched off; try another one, or persem map export --ply for a desktop '
                    'program.')
    assert re.search('<canvas id="map"[^>]* hidden', done.stdout)


def test_maps_that_are_none(tmp_path, capsys):
    assert main(['map', 'view', str(tmp_path / 'no.persem')]) == 1
    store.save(tmp_path / 'empty.persem', cw.core_of([]), Config(), LEGEND)
    assert main(['map', 'view', str(tmp_path / 'empty.persem')]) == 1
    err = capsys.readouterr().err.splitlines()
    assert len(err) == 2 and 'there is nothing to look at, the map is empty' in err[1]


def test_a_map_that_was_damaged_meanwhile(tmp_path):
    path = tmp_path / 'map.persem'
    store.save(path, mapped(), CONFIG, LEGEND)
    pages = Pages(LivingView(path))
    path.write_bytes(b'no map any more')
    with pytest.raises(Exception, match='not a map file'):
        pages.answer('changes.json', '')


def test_a_living_map_is_followed(tmp_path):
    path = tmp_path / 'map.persem'
    store.save(path, mapped(width=40), CONFIG, LEGEND)
    view = LivingView(path)
    before = view.tileset()['root']
    assert view.look() == 0
    living = LivingMap(path, CONFIG, lambda: LEGEND)
    memory = living.memory()
    seen = {(i, j, 0): (2, 1.0) for i in range(300, 320) for j in range(-20, 5)}
    memory.add(cw.observations(10 ** 11, seen))
    refine(memory, CONFIG.refine)
    living.write(dump(memory))
    assert view.look() == 1 and view.look() == 1
    assert view.source.n_voxels == 40 * 30 + 120 + 500 and len(view.source.stamps) == 3
    after = view.tileset()['root']
    assert after != before
    points = sum(len(view.pyramid.points(tile)) for tile in smallest(view.pyramid.octree))
    assert points == view.source.n_voxels
    at = np.array([300.5, -19.5, 0.5])
    assert view.nearest(at, 2).tolist() == [300, -20, 0]
    living.close()


def test_another_file_in_its_place(tmp_path):
    path = tmp_path / 'map.persem'
    store.save(path, mapped(), CONFIG, LEGEND)
    view = LivingView(path)
    store.save(path, mapped(width=20), CONFIG, LEGEND)
    assert view.look() == 1 and view.source.n_voxels == 20 * 30 + 120
    os.utime(path, ns=(1, 1))
    assert view.look() == 2         # the same blocks; nobody can tell


def smallest(octree):
    """Return the tiles of every voxel."""
    found = [octree.root]
    for tile in found:
        found += octree.children(tile)
    return [tile for tile in found if tile.level == 0]


@pytest.mark.parametrize('method', ['persem', 'geometry'])
def test_a_part_explains_as_the_whole(tmp_path, method):
    """A voxel's surroundings say the same of it as the whole map does."""
    config = updated(CONFIG, {'refine.method': method, 'refine.geometry.window': 3})
    memory = mapped(width=150)
    refine(memory, config.refine)
    store.save(tmp_path / 'map.persem', memory, config, LEGEND)
    whole = store.load(tmp_path / 'map.persem')
    everything = whole.memory()
    for voxel in np.array([[10, 5, 3], [80, 29, 0], [0, 0, 0]], np.int32):
        point = (voxel + 0.5) * 0.5 + ORIGIN
        stored, part, found = surroundings(Path(tmp_path / 'map.persem'), point)
        assert (found == voxel).all() and part.n_voxels < everything.n_voxels
        assert explained(stored, part, found)[0] == explanation(
            of_file(whole), voxel, explain(everything, voxel, config.refine))
