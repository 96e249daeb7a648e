"""Taxonomies: which ids count, and which count as one, from a legend (spec section 6)."""

from __future__ import annotations

from dataclasses import dataclass, replace

from persem_ros.settings.legend import Legend
from persem_ros.settings.legend_files import load_legend


@dataclass(frozen=True, eq=False)
class Taxonomy:
    """
    A many-to-one table of ids and what its classes are called.

    Attributes
    ----------
    name : str
    table : dict, optional
        None: every id stands for itself.
    legend : Legend
        Names and colours of the classes.

    """

    name: str
    table: dict[int, int] | None
    legend: Legend


def taxonomy(labels: str = '', grouped: bool = False, dynamic: bool = True,
             legend: Legend | None = None) -> Taxonomy:
    """
    Return the Taxonomy that the options of persem evaluate ask for.

    Parameters
    ----------
    labels : str
        A shipped legend or a YAML file; empty: every id counts, as in a replay.
    grouped : bool
        One class a group of the legend; it has the id, and the colour, of the group's first.
    dynamic : bool
        False: ids of things that move are left out.
    legend : Legend, optional
        Of the recording: stands in for *labels* where the other options need one, and names
        the classes.

    """
    if not labels and not grouped and dynamic:
        return Taxonomy('all ids', None, legend or Legend())
    legend = load_legend(labels) if labels else legend or Legend()
    moving = set(() if dynamic else legend.dynamic)
    kept = {c.id: c for c in legend.classes if not c.ignored and c.id not in moving}
    if grouped:
        table = {i: ids[0] for ids in legend.groups().values()
                 for ids in [tuple(c for c in ids if c in kept)] for i in ids}
    else:
        table = {i: i for i in kept}
    names = Legend(legend.title, tuple(
        replace(c, name=c.group, color=kept[table[c.id]].color)
        if grouped and c.id in kept else c for c in legend.classes))
    parts = [legend.title or labels, 'grouped' if grouped else 'single classes',
             '' if dynamic else 'without dynamic ones']
    return Taxonomy(', '.join(filter(None, parts)), table, names)
