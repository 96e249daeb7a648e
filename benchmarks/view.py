"""
What persem map view costs in Chromium without a GPU: seconds, bytes, memory, frames, pictures.

benchmarks/view.py [--voxels N,N] [--map FILE] [--pictures FOLDER] makes flat maps of N voxels (or
takes a file), opens them in a new browser at 1280 x 800 and prints a row each; pictures are taken
at two widths. Needs a Chromium.

"""

import argparse
import base64
import contextlib
import itertools
import json
import math
import os
from pathlib import Path
import shutil
import subprocess
import sys
import tempfile
import time

from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.outputs.map import store
from persem_ros.settings.config import Config
from persem_ros.settings.legend_files import load_legend
from scenes import fill

FLAGS = ('--headless', '--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader',
         '--enable-unsafe-swiftshader', '--remote-debugging-pipe', '--no-first-run')
SIZES = ((1280, 800), (420, 800))
TURN = 6.0              # s for which the map is turned, to count frames
# Every frame on the screen begins with one of these.
COUNT = """
window.framesDrawn = 0;
const clear = WebGL2RenderingContext.prototype.clear;
WebGL2RenderingContext.prototype.clear = function (bits) {
  if (!this.getParameter(this.FRAMEBUFFER_BINDING)) window.framesDrawn += 1;
  return clear.call(this, bits);
};
"""
READY = "document.body.dataset.ready || document.querySelector('#note.alone') ? 1 : 0"


class Browser:
    """A Chromium, told what to do over two pipes (Chrome DevTools Protocol)."""

    def __init__(self, folder):
        mine, out = os.pipe()
        read, theirs = os.pipe()
        words = ' '.join([shutil.which('chromium') or 'chromium', *FLAGS,
                          f'--user-data-dir={folder}'])
        self.process = subprocess.Popen(
            ['bash', '-c', f'exec {words} 3<&{mine} 4>&{theirs}'], pass_fds=(mine, theirs),
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        os.close(mine)
        os.close(theirs)
        self._out, self._in = os.fdopen(out, 'wb', 0), os.fdopen(read, 'rb')
        self._numbers, self._rest = itertools.count(1), b''
        self.bytes = self.requests = 0
        target = self.ask('Target.createTarget', None, url='about:blank')['targetId']
        self.session = self.ask('Target.attachToTarget', None, targetId=target,
                                flatten=True)['sessionId']
        for domain in ('Page', 'Network', 'Runtime'):
            self.ask(f'{domain}.enable')
        self.ask('Page.addScriptToEvaluateOnNewDocument', source=COUNT)

    def ask(self, method, session='own', **parameters):
        """Return the answer to a command; count what was loaded meanwhile."""
        number = next(self._numbers)
        message = {'id': number, 'method': method, 'params': parameters}
        if session:
            message['sessionId'] = self.session
        self._out.write(json.dumps(message).encode() + b'\0')
        while True:
            while b'\0' not in self._rest:
                self._rest += os.read(self._in.fileno(), 1 << 20)
            text, _, self._rest = self._rest.partition(b'\0')
            answer = json.loads(text)
            if answer.get('method') == 'Network.loadingFinished':
                self.bytes += answer['params']['encodedDataLength']
                self.requests += 1
            if answer.get('id') == number:
                return answer.get('result', answer)

    def value(self, expression):
        """Return what an expression is in the page."""
        return self.ask('Runtime.evaluate', expression=expression)['result'].get('value')

    def size(self, width, height):
        """Make the page so large."""
        self.ask('Emulation.setDeviceMetricsOverride', width=width, height=height,
                 deviceScaleFactor=1, mobile=False)

    def wait(self, expression, seconds):
        """Return the seconds until an expression is true, None where they were not enough."""
        start = time.monotonic()
        while time.monotonic() < start + seconds:
            if self.value(expression):
                return time.monotonic() - start
            time.sleep(0.1)
        return None

    def click(self, x, y):
        """Click at a place of the page."""
        for kind in ('mousePressed', 'mouseReleased'):
            self.ask('Input.dispatchMouseEvent', type=kind, x=x, y=y, button='left', clickCount=1)

    def turned(self, x, y):
        """Drag at a place for TURN seconds; return the frames a second meanwhile."""
        def mouse(kind, at, button):
            self.ask('Input.dispatchMouseEvent', type=kind, x=at, y=y, button='left',
                     buttons=button, clickCount=1)
        mouse('mousePressed', x, 1)
        start, before = time.monotonic(), self.value('window.framesDrawn')
        while (now := time.monotonic() - start) < TURN:
            mouse('mouseMoved', round(x + 0.3 * x * math.sin(now)), 1)
        frames = self.value('window.framesDrawn') - before
        mouse('mouseReleased', x, 0)
        return frames / (time.monotonic() - start)

    def picture(self, path):
        """Write what is to be seen as a PNG."""
        data = self.ask('Page.captureScreenshot', format='png')['data']
        path.write_bytes(base64.b64decode(data))

    def memory(self):
        """Return {kind: MB} of the tab's process and the one that draws."""
        found = {}
        for folder in Path('/proc').glob('[0-9]*'):
            with contextlib.suppress(OSError, ValueError):
                words = (folder / 'cmdline').read_bytes().replace(b'\0', b' ').split()
                kind = next((w[7:].decode() for w in words if w.startswith(b'--type=')), '')
                if kind in ('renderer', 'gpu-process') and _parents(folder.name) & {
                        self.process.pid}:
                    rows = dict(line.split(':') for line in (
                        folder / 'smaps_rollup').read_text().splitlines()[1:])
                    found[kind] = found.get(kind, 0) + int(rows['Pss'].split()[0]) / 1e3
        return found

    def close(self):
        """End the browser."""
        with contextlib.suppress(OSError):
            self.ask('Browser.close', None)
        self.process.wait(20)


def _parents(pid):
    """Return the process ids above one."""
    found = set()
    while pid not in ('0', '1'):
        pid = (Path('/proc') / pid / 'stat').read_text().rpartition(')')[2].split()[1]
        found.add(int(pid))
    return found


def measured(path, pictures):
    """Return a row of the table."""
    start = time.monotonic()
    server = subprocess.Popen([sys.executable, '-m', 'persem_ros', 'map', 'view', str(path),
                               '--port', '0'], stdout=subprocess.PIPE, text=True)
    address = next(word for word in server.stdout.readline().split() if word.startswith('http'))
    served = time.monotonic() - start
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        browser = Browser(folder)
        try:
            browser.size(*SIZES[0])
            browser.ask('Page.navigate', url=address)
            whole = browser.wait(READY, 300)
            first = int(browser.value('document.body.dataset.first') or 0) / 1e3
            row = {'file_mb': path.stat().st_size / 1e6, 'server_ready_s': served,
                   'first_picture_s': first, 'all_tiles_s': whole, 'requests': browser.requests,
                   'loopback_mb': browser.bytes / 1e6,
                   'points': int(browser.value('document.body.dataset.points') or 0),
                   'tab_mb': sum(browser.memory().values()), **browser.memory()}
            row['frames_a_second'] = browser.turned(SIZES[0][0] * 0.6, SIZES[0][1] * 0.55)
            status = Path(f'/proc/{server.pid}/status').read_text()
            row['server_mb'] = int(status.partition('VmHWM:')[2].split()[0]) / 1e3
            for width, height in SIZES if pictures else ():
                browser.size(width, height)
                browser.ask('Page.reload')
                browser.wait(READY, 300)
                browser.click(width * 0.6, height * 0.55)
                browser.wait("document.getElementById('why-text').textContent ? 1 : 0", 120)
                time.sleep(2)
                browser.picture(pictures / f'view_{path.stem}_{width}.png')
            return row
        finally:
            browser.close()
            server.terminate()
            server.wait(20)


def main():
    """Print a row for each map."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--voxels', default='1000000,10000000')
    parser.add_argument('--map')
    parser.add_argument('--pictures', type=Path)
    args = parser.parse_args()
    if args.pictures:
        args.pictures.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(args.map)] if args.map else []
        for n in [] if args.map else map(int, args.voxels.split(',')):
            memory = VoxelMemory(0.5)
            fill(memory, n)
            paths.append(Path(folder) / f'flat_{n}.persem')
            store.save(paths[-1], memory, Config(), load_legend('town'))
            del memory
        for path in paths:
            print(json.dumps({'map': path.stem, **{
                name: value if isinstance(value, int) or value is None else round(value, 2)
                for name, value in measured(path, args.pictures).items()}}), flush=True)


if __name__ == '__main__':
    main()
