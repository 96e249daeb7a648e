"""The trace of a voxel (core.refine.explain) as text for people."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.evidence import TIE
from persem_ros.outputs.map.cloud import SOURCES

if TYPE_CHECKING:
    from persem_ros.core.memory.frame_table import FrameTable
    from persem_ros.outputs.map.stored import StoredMap
    from persem_ros.settings.config import Refine
    from persem_ros.settings.legend import Legend

TILTS = ('upright', 'sloping', 'level', 'of no direction')
ROUGHNESS = ('smooth', 'rough', 'scattered')
# What stands in the columns of the tables, below them.
GEOMETRY_WORDS = (
    'looks: share of its own looks. Shares of places that are of this class: overall, anywhere;',
    'shape, of this height and shape; here and here 2, of this kind in two squares around it.',
    'around: what its neighbours are. together: how probable it is; the first row is the label.')
EVIDENCE_WORDS = (
    'h_v: evidence, the sum of s below; p_v: its share; q_v: mean p_v of the neighbours; S_hard:',
    'share of neighbours with this majority; anchor: p_v and q_v mixed; replayed: evidence in',
    'which the old, the doubtful and the surprising weigh less.')
HISTORY_WORDS = (
    's: share of the pixels that fell into the voxel in that frame and said so, with the',
    "segmenter's confidence where topics.confidence gives it; gap: frames since the one before;",
    'g: 1 where it contradicts the leader; weight: of s, in the replay; leader: after it.')


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What an explanation names besides the voxel: size, frame, frame table, settings, legend."""

    voxel_size: float
    origin: Sequence[float]
    map_frame: str
    frames: FrameTable
    settings: Refine
    legend: Legend


def of_file(stored: StoredMap) -> Surroundings:
    """Return the Surroundings of the voxels in a map file."""
    return Surroundings(stored.saved.voxel_size, stored.saved.origin, stored.map_frame,
                        stored.saved.frames, stored.config().refine, stored.legend)


def explanation(around: Surroundings, voxel: NDArray[np.int32], trace: dict[str, Any]) -> str:
    """
    Return what a voxel has seen and why it has its label, as lines of text.

    Parameters
    ----------
    around : Surroundings
        Of the map.
    voxel : sequence of 3 int
        Its index.
    trace : dict
        What core.refine.explain.explain returned.

    """
    name, settings = names(around.legend), around.settings
    label = trace['stored_label']
    share = trace['shares'].get(label, 0.0) if trace['geometry'] is None else \
        trace['geometry']['posterior'].get(label, 0.0)
    centre = [(i + 0.5) * around.voxel_size + o for i, o in zip(voxel, around.origin)]
    lines = [f'voxel {" ".join(str(int(i)) for i in voxel)}, centre '
             f'{" ".join(f"{x:.3f}" for x in centre)} m in {around.map_frame}',
             f'label {label} {name(label)}, by {SOURCES[trace["stored_source"]]} '
             f'(method {settings.method}), confidence {share:.4f}: ' + (
                 'its share of the evidence' if trace['geometry'] is None else
                 'how probable the method holds it'),
             f'{trace["observations"]} observations, majority label {trace["majority"]} '
             f'{name(trace["majority"])}, {trace["neighbours"]} neighbours', '', 'why']
    lines += [f'  {sentence}' for sentence in reasons(trace, settings, name, around.voxel_size)]
    if trace['geometry'] is not None:
        lines += ['', *geometry_table(trace['geometry'], name)]
    lines += ['', *evidence_table(trace, name), '', *history_table(trace, around.frames, name)]
    return '\n'.join(lines)


Namer = Callable[[int], str]        # the name of a class id


def names(legend: Legend) -> Namer:
    """Return a function that gives a class id's name, fit for a terminal."""
    return lambda c: ''.join(x if x.isprintable() else '?' for x in legend.name(c))


def reasons(
        trace: dict[str, Any], settings: Refine, name: Namer, voxel_size: float) -> list[str]:
    """Return the steps from the evidence to the label, a sentence each, with their numbers."""
    majority, result = trace['majority'], []
    most = trace['evidence'][majority]
    tied = sum(abs(h - most) <= TIE for h in trace['evidence'].values()) > 1
    result.append(f'majority: {majority} {name(majority)} has the most evidence, {most:.4f}'
                  + (' (the smallest id of a tie)' if tied else ''))
    selective = settings.method in ('trust', 'context', 'history', 'context_history', 'persem')
    if trace['geometry'] is not None:
        result += _by_geometry(trace['geometry'], voxel_size, name, majority)
    elif not selective:
        result.append(f'the method {settings.method} fuses the history into one label; '
                      'it has no further steps')
    elif not trace['recurrent']:
        result.append(f'not refined: {trace["observations"]} observations, refine.'
                      f'min_observations is {settings.min_observations}')
    else:
        result += _refinement(trace, settings, name)
    if trace['gone'] is not None:
        looks = f' in {trace["gone"]} seconds' if trace['gone'] else ''
        return [*result[:1], f'gone: later frames looked through it{looks} since it was last '
                'observed; it is not shown and no neighbour']
    if trace['changed']:
        result.append('observed since the map was last refined: the stored label may be older '
                      'than this trace')
    elif (selective or trace['geometry']) and trace['label'] != trace['stored_label']:
        result.append(f'this trace ends at {trace["label"]} {name(trace["label"])}: the map was '
                      'refined with other settings, or class volatility has changed')
    return result


def _by_geometry(found: dict[str, Any], voxel_size: float, name: Namer,
                 majority: int) -> list[str]:
    """Return the sentences about votes, place, names of such places, neighbours and outcome."""
    def leading(values: dict[int, float]) -> str:
        best = sorted(values, key=lambda c: (-values[c], c))[:3]
        return ', '.join(f'{name(c)} {values[c]:.2f}' for c in best if values[c] >= 0.005)

    away = ', '.join(map(name, found['unlikely']))
    if majority in found['unlikely']:
        away += f'; against most votes, which say {name(majority)}'
    result = [f'looks: {leading(found["votes"])}; those from one direction count once, which '
              f'leaves {found["looks"]:.2f}; as even these repeat mistakes of each other, they '
              f'weigh like {found["independent"]:.2f} that do not',
              f'place: {found["height"] * voxel_size:.2f} m above ground ({found["height"]} '
              f'voxels), {TILTS[found["tilt"]]}, {ROUGHNESS[found["roughness"]]}',
              f'places of this height and shape are called: {leading(found["shape"])}',
              *([f'hardly found so high, by refine.geometry.heights: {away}'] if away else []),
              f'around here, of this kind: {leading(found["cell"])}',
              'neighbours: ' + (leading(found['neighbours']) or 'none')]
    return result + [f'all together: {leading(found["posterior"])}']


def geometry_table(found: dict[str, Any], name: Namer) -> list[str]:
    """Return the table of what each class gets from every part of the method geometry."""
    lines = [f'{"id":>5}  {"class":<20}{"looks":>9}{"overall":>9}{"shape":>9}{"here":>9}'
             f'{"here 2":>9}{"around":>9}{"together":>11}']
    order = sorted(found['posterior'], key=lambda c: (-found['posterior'][c], c))
    for c in order[:16]:
        lines.append(f'{c:>5}  {name(c)[:19]:<20}' + ''.join(
            f'{found[key].get(c, 0.0):>9.4f}' for key in (
                'votes', 'frequencies', 'shape', 'cell', 'shifted_cell', 'neighbours'))
            + f'{found["posterior"][c]:>11.4f}')
    return [*lines, *GEOMETRY_WORDS]


def _refinement(trace: dict[str, Any], settings: Refine, name: Namer) -> list[str]:
    """Return the sentences about anchor, replay and context."""
    majority, candidate, result = trace['majority'], trace['candidate'], []
    if settings.method in ('history', 'context_history', 'persem'):
        result.append(_anchor(trace, settings, name))
        if trace['anchor_label'] not in (None, majority):
            return result
    if settings.method in ('trust', 'persem'):
        best = f'{candidate} {name(candidate)}' if candidate is not None else 'no other label'
        text = f'replay: {best} leads the decayed evidence'
        if candidate is not None:
            margin, tau = trace['replay_margin'], settings.tau_replay
            text += (f' by {margin:.4f}, {_against(margin, tau)} refine.tau_replay {tau:g}')
        result.append(text)
    elif settings.method != 'history':
        result.append('context: ' + (
            f'most neighbours are {candidate} {name(candidate)}' if candidate is not None
            else 'no other label leads among the neighbours'))
    if candidate is not None and trace['hard_margin'] is not None:
        tau = settings.tau_context
        result.append('context: over the majority label it leads by ' + ' and by '.join(
            f'{trace[key]:.4f} in {words} ({_against(trace[key], tau)} refine.tau_context '
            f'{tau:g})' for key, words in (('hard_margin', "the neighbours' labels"),
                                           ('soft_margin', 'their histories'))))
    if candidate is not None:
        result.append('accepted' if trace['label'] == candidate else
                      f'not accepted: {majority} {name(majority)} stays')
    return result


def _anchor(trace: dict[str, Any], settings: Refine, name: Namer) -> str:
    """Return the sentence about the history anchor."""
    label, majority = trace['anchor_label'], trace['majority']
    if label is None:
        return 'anchor: no neighbours, the majority label stays'
    text = (f'anchor: (1 - {settings.eta:g}) p_v + {settings.eta:g} q_v is largest for {label} '
            f'{name(label)}, {trace["anchor"][label]:.4f}')
    if label != majority:
        text += f', against {trace["anchor"][majority]:.4f} for the majority label: final'
    return text


def _against(margin: float, tau: float) -> str:
    """Return how a margin stands to its threshold."""
    return 'above' if margin > tau + TIE else 'not above'


def evidence_table(trace: dict[str, Any], name: Namer) -> list[str]:
    """Return the table of all classes that the voxel or its neighbours have seen."""
    lines = [f'{"id":>5}  {"class":<20}{"h_v":>10}{"p_v":>9}{"q_v":>9}{"S_hard":>9}'
             f'{"anchor":>9}{"replayed":>10}']
    ids = {*trace['evidence'], *trace['soft']}
    for c in sorted(ids, key=lambda c: (-trace['evidence'].get(c, 0.0), c)):
        lines.append(f'{c:>5}  {name(c)[:19]:<20}{trace["evidence"].get(c, 0.0):>10.4f}'
                     + ''.join(f'{trace[key].get(c, 0.0):>9.4f}'
                               for key in ('shares', 'soft', 'hard', 'anchor'))
                     + f'{trace["replayed"].get(c, 0.0):>10.4f}')
    return [*lines, *EVIDENCE_WORDS]


def history_table(
        trace: dict[str, Any], frames: FrameTable, name: Namer) -> list[str]:
    """Return the table of the stored observations, with the replay's steps."""
    t = frames.here('t')        # rows of what was observed are in memory; of one t, one stamp
    rows = np.flatnonzero(np.isin(t, [step['t'] for step in trace['steps']]))[::-1]
    stamps = dict(zip(t[rows].tolist(), frames.here('stamp')[rows].tolist()))
    lines = [f'{"t":>6}  {"stamp, s":<22}{"id":>5}  {"class":<20}{"s":>7}{"gap":>6}{"g":>3}'
             f'{"weight":>9}  leader']
    missing = trace['observations'] - len(trace['steps'])
    if missing:
        lines.append(f'        ({missing} older ones are not kept)')
    for step in trace['steps']:
        stamp = stamps.get(step['t'])
        at = '-' if stamp is None else f'{stamp // 10 ** 9}.{stamp % 10 ** 9:09}'
        lines.append(f'{step["t"]:>6}  {at:<22}{step["label"]:>5}  '
                     f'{name(step["label"])[:19]:<20}{step["confidence"]:>7.4f}'
                     f'{step["gap"]:>6}{step["surprise"]:>3}{step["weight"]:>9.5f}  '
                     f'{step["leader"]} {name(step["leader"])}')
    return [*lines, *HISTORY_WORDS]
