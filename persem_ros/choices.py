"""What a replay decides before it reads: methods, legend, whether memory holds the whole map."""

from __future__ import annotations

from collections.abc import Sequence
import logging
from pathlib import Path
from typing import TYPE_CHECKING

from persem_ros.core.refine.labelled import LOCAL
from persem_ros.errors import PersemError
from persem_ros.outputs.map import store
from persem_ros.settings.config import Config, IMAGE_METHODS, METHODS, nearest
from persem_ros.settings.legend import Legend

if TYPE_CHECKING:
    from persem_ros.inputs.recording.recording import Recording
    from persem_ros.inputs.recording.sessions import Sessions
    from persem_ros.passes import Watcher

log = logging.getLogger(__name__)


def chosen_methods(methods: Sequence[str] | None, config: Config) -> tuple[str, ...]:
    """Return the methods to be measured, refine.method among them; refuse unknown ones."""
    known = IMAGE_METHODS + METHODS
    methods = list(methods or ('raw2d', 'majority', config.refine.method))
    if methods == ['all']:
        methods = list(known)
    for name in methods:
        if name not in known:
            raise PersemError(f'unknown method {name!r}{nearest(name, known)}; expected all, or '
                              f'some of {", ".join(known)}')
    return tuple(dict.fromkeys(methods + [config.refine.method]))


def chosen_legend(config: Config, recording: Recording | Sessions) -> Legend:
    """Return the legend of labels.legend, else the recording's, else one of made-up colours."""
    text = recording.legend_text        # that of labels.legend where it is set
    legend = Legend.from_yaml(text, "the recording's legend") if text else Legend()
    return legend.ignoring(config.memory.ignore_labels)


def pages(config: Config, methods: Sequence[str], watchers: Sequence[Watcher],
          causal: bool) -> bool:
    """
    Return whether a replay does with a part of the map in memory; warn where one cannot.

    Refuses an attached file that does not fit the settings.

    """
    if not config.map.attached:
        return False
    others = {*methods} - {*IMAGE_METHODS, 'majority', config.refine.method}
    why = ''
    if not others <= LOCAL:
        why = 'the method geometry beside another is measured on the whole map'
    elif causal and others:
        why = f'--causal measures {", ".join(sorted(others))} on the whole map'
    elif any(getattr(watcher, 'whole_map', False) for watcher in watchers):
        why = '--rerun follows the whole map'
    if why:
        if config.memory.max_voxels or config.memory.keep_radius:
            log.warning('%s is held in memory as a whole: %s', config.map.path, why)
        return False
    if Path(config.map.path).exists():
        stored = store.head(config.map.path).stored
        stored.check_fits(config)
        stored.warn_of_history(config)
    return True
