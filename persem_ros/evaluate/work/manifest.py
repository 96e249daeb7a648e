"""What a result was made of, so that nothing is computed twice and nothing stale is shown."""

from __future__ import annotations

from dataclasses import asdict
import functools
import hashlib
import json
from pathlib import Path
from typing import Any, TYPE_CHECKING
import zipfile

import numpy as np
from numpy.typing import NDArray
from persem_ros.errors import PersemError
from persem_ros.evaluate.measure.result import Result
from persem_ros.inputs.recording.excerpt import WHOLE
from persem_ros.inputs.recording.finding import split
from persem_ros.outputs.files import replacing, write_json
from persem_ros.outputs.results import timing
from persem_ros.settings.config import settings
from persem_ros.settings.legend import Legend
from persem_ros.settings.legend_files import load_legend

if TYPE_CHECKING:
    from persem_ros.evaluate.work.task import Task
    from persem_ros.settings.legend_class import LegendClass

MANIFEST, SUMMARY, ARRAYS = 'manifest.json', 'summary.json', 'arrays.npz'
PIECE = 1 << 22
LEGENDS = ('taxonomy', 'labels.legend')     # whole legends, as text
SHOWN = 4           # classes of a difference


def identity(task: Task) -> dict[str, Any]:
    """
    Return all that decides a task's result, as JSON: its inputs by content, its settings.

    Two tasks of one identity have one result, wherever the recording lies.

    """
    values = {name: list(value) if isinstance(value, tuple) else value
              for name, value, _ in settings(task.config)}
    if values['labels.legend']:
        values['labels.legend'] = load_legend(str(values['labels.legend'])).to_yaml()
    return {'recording': '+'.join(content_hash(part) for part in split(task.recording)),
            **({} if task.excerpt == WHOLE else {'excerpt': asdict(task.excerpt)}),
            'predictions': content_hash(task.predictions) if task.predictions else '',
            'settings': values, 'methods': list(task.methods),
            'taxonomy': load_legend(task.labels).to_yaml() if task.labels else '',
            'grouped': task.grouped, 'dynamic': task.dynamic,
            'disturbance': asdict(task.disturbance), 'pictures': task.pictures,
            'source': source_hash(), 'versions': {
                name: version for name, version in timing.versions().items()
                if name not in ('commit', 'persem_ros')}}


def key_of(found: dict[str, Any]) -> str:
    """Return a short name for an identity."""
    return hashlib.sha256(json.dumps(found, sort_keys=True).encode()).hexdigest()[:16]


@functools.lru_cache(maxsize=256)
def content_hash(path: str) -> str:
    """Return a hash of a file or of all files in a folder, names included."""
    root = Path(path)
    if not root.exists():
        raise PersemError(f'{root} does not exist')
    files = sorted(p for p in root.rglob('*') if p.is_file()) if root.is_dir() else [root]
    digest = hashlib.blake2b(digest_size=16)
    for file in files:
        name = str(file.relative_to(root)) if root.is_dir() else file.suffix
        digest.update(f'{name}\0{file.stat().st_size}\0'.encode())
        with open(file, 'rb') as stream:
            while piece := stream.read(PIECE):
                digest.update(piece)
    return digest.hexdigest()


@functools.lru_cache(maxsize=1)
def source_hash() -> str:
    """Return a hash of the package's source: a commit says nothing of a changed work tree."""
    root = Path(__file__).parents[2]
    digest = hashlib.blake2b(digest_size=16)
    for file in sorted(root.rglob('*.py')):
        if not file.is_relative_to(root / 'commands') and file.parent.name != 'report':
            digest.update(str(file.relative_to(root)).encode() + file.read_bytes())
    return digest.hexdigest()


def save(folder: Path, found: dict[str, Any], summary: dict[str, Any],
         arrays: dict[str, NDArray[Any]]) -> None:
    """Write a result and, last, the manifest that makes it count."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / MANIFEST).unlink(missing_ok=True)
    named: dict[str, Any] = dict(arrays)    # its stubs take any name for that of an option
    with replacing(folder / ARRAYS) as work:
        with open(work, 'wb') as out:
            np.savez_compressed(out, **named)
    write_json(folder / SUMMARY, summary)
    write_json(folder / MANIFEST, {'commit': timing.commit(), **found})


def load(folder: Path, found: dict[str, Any] | None = None) -> Result | None:
    """Return a finished result, None where *found* is not its identity."""
    folder = Path(folder)
    try:
        manifest = json.loads((folder / MANIFEST).read_text('utf-8'))
        manifest.pop('commit', None)
        if found is not None and manifest != json.loads(json.dumps(found)):
            return None
        summary = json.loads((folder / SUMMARY).read_text('utf-8'))
        with np.load(folder / ARRAYS, allow_pickle=False) as arrays:
            return Result(summary, dict(arrays))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError,
            zipfile.BadZipFile):
        return None


def inputs(folder: Path) -> dict[str, Any]:
    """Return the recording and the excerpt that a result is of, {} where nothing says it."""
    try:
        found = json.loads((folder / MANIFEST).read_text('utf-8'))
        return {'recording': found['recording'], 'excerpt': found.get('excerpt')}
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def changes(old: dict[str, Any], new: dict[str, Any]) -> list[str]:
    """Return what differs between two identities, as short sentences."""
    lines = []
    for name in sorted({*old, *new}):
        a, b = old.get(name), new.get(name)
        if a == b:
            continue
        if isinstance(a, dict) and isinstance(b, dict):
            lines += [_change(key, a.get(key), b.get(key))
                      for key in sorted({*a, *b}) if a.get(key) != b.get(key)]
        else:
            lines.append(_change(name, a, b))
    return lines


def _change(name: str, a: object, b: object) -> str:
    """Return one difference; of legends only the titles and the classes that differ."""
    legends = [_legend(text) for text in (a, b)]
    if name not in LEGENDS or None in legends or legends == [Legend()] * 2:
        return f'{name}: {_short(a)} -> {_short(b)}'
    titles: list[str] = []
    rows: list[dict[int, LegendClass]] = []
    for legend in legends:
        assert legend is not None, 'looked at above'
        rows.append({item.id: item for item in legend.classes})
        titles.append(repr(legend.title or 'a legend') if legend.classes else 'none')
    before, now = rows
    alone = [] if 'none' in titles else [
        f'only {when}: ' + _named([item for item in mine.values() if (
            item.id not in theirs or item.name != theirs[item.id].name)])
        for when, mine, theirs in (('before', before, now), ('now', now, before))]
    parts = [' -> '.join(titles), *(part for part in alone if not part.endswith(': '))]
    if titles[0] == titles[1] and len(parts) == 1:
        parts = [f'{titles[0]}, other colours, groups, flags or order']
    return f'{name}: {", ".join(parts)}'


def _named(items: list[LegendClass]) -> str:
    more = f' and {len(items) - SHOWN} more' if len(items) > SHOWN else ''
    return ' '.join(f'{item.id} {_short(item.name)}' for item in items[:SHOWN]) + more


def _legend(text: object) -> Legend | None:
    """Return the legend of a text, one without classes of '', None where it is none."""
    try:
        return Legend.from_yaml(str(text)) if text else Legend()
    except PersemError:
        return None


def _short(value: object) -> str:
    text = ' '.join(str(value).split())
    return text if len(text) <= 60 else text[:57] + '...'
