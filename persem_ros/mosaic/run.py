"""The story of a build: observe, join, refine, assemble."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
import logging
from pathlib import Path
import shutil
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.cluster import connected
from persem_ros.core.geometry.overruled import summed
from persem_ros.core.jit import Compiling
from persem_ros.core.memory.pools import SIDE
from persem_ros.core.warmup import warm_up
from persem_ros.errors import PersemError
from persem_ros.inputs.recording.finding import split
from persem_ros.mosaic import assemble, folder as folders
from persem_ros.mosaic.fit import Fitted, fitted
from persem_ros.mosaic.join import join, Joining, Part
from persem_ros.mosaic.observe import observe, Observing
from persem_ros.mosaic.plan import Plan, planned, Tile
from persem_ros.mosaic.refine import refine, Refining
from persem_ros.mosaic.surroundings import Surrounded
from persem_ros.outputs.files import write_json, write_text
from persem_ros.outputs.results.timing import hardware, Stopwatch
from persem_ros.preflight.advice import Advice
from persem_ros.settings import config_file
from persem_ros.settings.config import Config

log = logging.getLogger(__name__)
TILE = 64.0             # metres
MOST_TILES = 1_000_000


def build(paths: Sequence[str | Path], out: Path | str, config: Config, tile: float = TILE,
          workers: int = 0, scheduler: str = '', force: bool = False) -> dict[str, Any]:
    """
    Build the map that a replay of recordings one after the other leaves, bit for bit.

    Parameters
    ----------
    paths : sequence of str or Path
        rosbag2 recordings; each is a session.
    out : str or Path
        Folder of the map; a build that was stopped goes on there.
    config : persem_ros.settings.config.Config
        All settings.
    tile : float
        Metres along the edge of a tile, rounded up to whole blocks.
    workers, scheduler
        As of persem_ros.workers.Crew.
    force : bool
        Give up what another build left in the folder.

    Returns
    -------
    dict
        The content of build.json.

    Raises
    ------
    PersemError
        When a recording, a setting, the scheduler or the folder cannot be used: one sentence.

    """
    if scheduler:
        with connected(scheduler):
            pass                # before the work
    watch, began = Stopwatch(), time.perf_counter()
    with watch('look'):
        plan = planned(paths, config, tile)
        identity = plan.identity()
    found = None if force else folders.result_of(out, identity)
    if found is not None:
        log.info('%s is finished already', out)
        return found
    keep = [part for path in paths for part in split(path)]
    with folders.opened(out, identity, force, keep, workers, scheduler) as folder:
        geometry = config.refine.method == 'geometry'
        with Compiling(*['geometry'] if geometry else []):
            warm_up(geometry)
        result = _build(folder, plan, watch)
        result = {**result, 'of': identity, 'total_s': round(time.perf_counter() - began, 3),
                  'stages': {name: round(s, 3) for name, s in watch.seconds.items()},
                  'hardware': hardware()}
        write_text(folder.out / folders.SETTINGS, config_file.to_yaml(plan.config))
        write_json(folder.out / folders.RESULT, result)
        shutil.rmtree(folder.work, ignore_errors=True)
    return result


def _build(folder: folders.Folder, plan: Plan, watch: Stopwatch) -> dict[str, Any]:
    """Do what is left to do; return what the map came to."""
    with watch('observe'):
        paths = [str(folder.path('recordings', f'{item.number:06}.persem'))
                 for item in plan.inputs]
        observed = list(folder.finished(
            'recordings', {f'{item.number:06}': Observing(item, plan.config, plan.side, path)
                           for item, path in zip(plan.inputs, paths)},
            observe, [item.expected for item in plan.inputs], 'observing', 'frames').values())
    _check(observed)
    with watch('index'):
        parts, first = [], 0
        for path, seen_there in zip(paths, observed):
            parts.append(Part(path, first, seen_there['frames']))
            first += seen_there['frames']
        t, placed, seen = assemble.frames_and_seen(parts)
        arrays = [str(folder.path('arrays', f'{name}.npy')) for name in ('t', 'placed', 'seen')]
        rho = str(folder.path('arrays', 'rho.npy'))
        of_frames: tuple[NDArray[Any], ...] = t, placed, seen
        for array, values in zip(arrays, of_frames):
            folders.save_array(Path(array), values)
        tiles = _tiles(plan, parts, observed)
        files = {tile: folder.path('tiles', f'{tile.i}/{tile.j}.persem') for tile in tiles}
        # A folder a row of tiles: whoever writes a file looks through its folder.
        named = {f'{tile.i}/{tile.j}': tile for tile in tiles}
    with watch('join'):
        counts = list(folder.finished(
            'tiles', {name: Joining(tile, tuple(tiles[tile]), plan.config, arrays[0],
                                    arrays[2], str(files[tile])) for name, tile in named.items()},
            join, [1] * len(tiles), 'joining', 'tiles').values())
    with watch('volatility'):
        folders.save_array(Path(rho), assemble.volatility(counts)[2])
    around = {name: Surrounded(tile, str(files[tile]), tuple(
        str(files[other]) for other in tile.around() if other in files), plan.config, *arrays)
        for name, tile in named.items()}
    known, habits, took = None, {}, {}      # type: Any, dict[str, Any], dict[str, Any]
    if plan.config.refine.method == 'geometry':
        with watch('fit'):
            known, took = fitted(folder, around, plan.config.refine)
            habits = _habits(known, observed)
    with watch('refine'):
        refined = list(folder.finished(
            'refined', {name: Refining(of, rho, known) for name, of in around.items()},
            refine, [1] * len(tiles), 'refining', 'tiles').values())
    with watch('assemble'):
        assemble.assemble(folder.out / folders.MAP, plan, parts, files, counts, seen, habits)
    found = summed((row for one in refined for row in one['overruled']), plan.config.refine)
    for note in Advice(plan.config, plan.legend).sentences(seen, found):
        log.warning('%s', note)
    return {'frames': {'used': first,
                       'dropped': dict(sum((Counter(o['dropped']) for o in observed), Counter()))},
            'sessions': len(parts), 'voxels': sum(tile['voxels'] for tile in counts),
            'observations': sum(tile['observations'] for tile in counts), 'tiles': len(tiles),
            'seconds': {'recordings': [one['seconds'] for one in observed],
                        'join': [one['seconds'] for one in counts], **took,
                        'refine': [one['seconds'] for one in refined]}}


def _habits(known: Fitted, observed: list[dict[str, Any]]) -> dict[str, NDArray[Any]]:
    """Return the parameters as a map file has them."""
    ids = np.unique(np.concatenate([one['voted'] for one in observed])).astype(np.uint16)
    return {**known.arrays(), 'known': ids, 'voted': ids}


def _check(observed: list[dict[str, Any]]) -> None:
    """Say what the recordings have to say; refuse them where nothing was observed at all."""
    for one in observed:
        for note in one['notes']:
            log.warning('%s', note if one['recording'] in note else f'{one["recording"]}: {note}')
    if not any(one['observations'] for one in observed):
        raise PersemError(f'{observed[0]["recording"]}: nothing went into the map, '
                          f'{observed[0]["empty"]}')


def _tiles(plan: Plan, parts: list[Part],
           observed: list[dict[str, Any]]) -> dict[Tile, list[Part]]:
    """Return the parts that saw something of each tile, in their order."""
    tiles: dict[Tile, list[Part]] = {}
    for part, one in zip(parts, observed):
        for i, j in one['tiles']:
            tiles.setdefault(Tile(i, j, plan.side), []).append(part)
    if len(tiles) > MOST_TILES:
        larger = 4 * plan.side * SIDE * plan.config.memory.voxel_size
        raise PersemError(f'the map has {len(tiles)} tiles, more than {MOST_TILES}; give a larger '
                          f'one, such as --tile {larger:g}')
    return dict(sorted(tiles.items()))
