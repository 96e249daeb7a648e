"""The page as a whole: what goes into the templates."""

from __future__ import annotations

from datetime import datetime, timezone
import functools
from importlib import resources
from typing import Any, TYPE_CHECKING

import jinja2
import numpy as np
from numpy.typing import NDArray
from persem_ros.frames import UNKNOWN
from persem_ros.outputs.map.cloud import SOURCES
from persem_ros.outputs.report import cloud3d, colors, maps, series, tables
from persem_ros.outputs.report.png import data_uri, png

if TYPE_CHECKING:
    from persem_ros.core.memory.frame_table import FrameTable
    from persem_ros.inputs.recording.sessions import Sessions
    from persem_ros.outputs.results.mapped import Overview
    from persem_ros.passes import Replay
    from persem_ros.settings.legend import Legend

METHOD_TEXTS = {
    'raw2d': 'the input labels as they came',
    'ema2d': 'input labels smoothed over time in the image',
    'majority': 'the most evidence of each voxel',
    'persem': 'anchored in histories, revised by trust, verified by context',
    'geometry': 'what places of this height and shape are called here, and the neighbours'}


def render(replay: Replay, result: dict[str, Any], frames: list[dict[str, Any]], ids: list[int],
           flicker: dict[str, Any]) -> str:
    """
    Return report.html as text.

    Parameters
    ----------
    replay : persem_ros.passes.Replay
        Finished.
    result : dict
        The content of metrics.json.
    frames : list of dict
        The strip: number, seconds, sensor and panels (strip.panels).
    ids : list of int
        The ids that the strip shows.
    flicker : dict
        FlickerSeries.lines().

    """
    method = replay.config.refine.method
    overview = replay.mapped.overview()
    legend, missing = replay.legend, replay.without_truth()
    context = {
        'name': replay.recording.name, 'method': method, 'result': result,
        'headlines': tables.headlines(result, method),
        'has_truth': not missing, 'no_truth': missing[:1].upper() + missing[1:],
        'has_color': any(p['key'] == 'color' for f in frames for p in f['panels']),
        'has_legend': bool(legend.classes), 'legend_title': legend.title,
        'frames': frames, 'strip_classes': _classes(legend, ids),
        'sources': _sources(overview.sources), 'verdicts': _verdicts(),
        'table': tables.methods_table(result['methods']), 'method_texts': METHOD_TEXTS,
        'method_names': list(result['methods']),
        'iou': tables.iou_rows(result, legend),
        'flicker': flicker, 'chart': series.chart(flicker),
        'regions': {name: {**row, 'table': tables.methods_table(row['methods'])}
                    for name, row in result['regions'].items()},
        'stages': tables.stages(replay.timing), 'timing': replay.timing,
        'memory': tables.memory_rows(replay.timing, result['voxels']),
        'legend': tables.legend_rows(legend, overview.labels, ids, replay.overruled,
                                     replay.pipeline.memory.voxel_size),
        'changed': tables.changed_settings(replay.config),
        'command': tables.command(replay.recording.words, replay.out, replay.config,
                                  replay.methods, replay.causal),
        'causal': replay.causal, 'topics': _topics(replay.recording),
        'examples': replay.recording.examples, 'notes': replay.recording.notes,
        'seconds': _seconds(replay.pipeline.memory.frames),
        'map_frame': replay.config.frames.map,
        'voxel_size': replay.pipeline.memory.voxel_size,
        'written': datetime.now(timezone.utc).strftime('%Y-%m-%d %H:%M UTC'),
        **_map(replay, overview)}
    return environment().get_template('report.html').render(context)


@functools.lru_cache(maxsize=1)
def environment() -> jinja2.Environment:
    """Return the templates; everything that they show is escaped."""
    env = jinja2.Environment(
        loader=jinja2.PackageLoader('persem_ros.outputs.report', 'templates'),
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    env.filters.update(css=colors.css, bytes=tables.bytes_text, number=_number)
    env.globals.update(asset=_asset)
    return env


def _asset(name: str) -> str:
    """Return a file of ours that goes into the page as it is."""
    return (resources.files('persem_ros.outputs.report') / 'assets' / name).read_text('utf-8')


def _number(value: float | None, digits: int = 0) -> str:
    """Return a number with thin spaces between thousands, a dash where there is none."""
    return '–' if value is None else f'{value:,.{digits}f}'.replace(',', '\u202f')     # no break


def _map(replay: Replay, overview: Overview) -> dict[str, Any]:
    """Return the map's pictures and the 3-D view's data."""
    memory, coarse = replay.pipeline.memory, overview.voxel_size
    top = maps.top_view(overview.columns, coarse, replay.legend)
    tracks = maps.tracks(memory)
    view = cloud3d.packed(overview.columns, coarse, replay.legend, tracks)
    view |= {'merged': view['merged'] * round(coarse / memory.voxel_size),
             'voxels': int(overview.sources.sum())}
    for layer in top['layers']:
        layer['image'] = data_uri('image/png', png(layer.pop('pixels')))
    lines = [' '.join(f'{1000 * x:.1f},{1000 * y:.1f}' for x, y in maps.on_top(track, top))
             for track in tracks]
    return {'top': top, 'view': view, 'tracks': lines,
            'scale_bar': maps.scale_bar(np.ptp(top['x'])), 'ramp': colors.css_gradient()}


def _classes(legend: Legend, ids: list[int]) -> list[dict[str, Any]]:
    return [{'id': i, 'name': 'no label' if i == UNKNOWN else legend.name(i),
             'color': legend.color(i)} for i in ids]


def _sources(counts: NDArray[np.int64]) -> list[dict[str, Any]]:
    """Return name, meaning, colour and number of voxels of what can decide a label."""
    return [{'name': name, 'text': colors.SOURCE_TEXTS[name], 'color': color, 'voxels': int(n)}
            for name, color, n in zip(SOURCES, colors.SOURCE_COLORS, counts)]


def _verdicts() -> list[dict[str, str | tuple[int, int, int]]]:
    return [{'name': name, 'color': color}
            for name, color in zip(colors.VERDICTS, colors.VERDICT_COLORS)]


def _topics(recording: Sessions) -> list[tuple[str, str, str, str]]:
    """Return (camera, kind, topic name, type) of what was read."""
    return [(camera, kind, info.name, info.msgtype)
            for camera, kinds in recording.topics.items() for kind, info in kinds.items()]


def _seconds(frames: FrameTable) -> float:
    return float(frames.stamp.max() - frames.stamp.min()) / 1e9 if len(frames) else 0.0
