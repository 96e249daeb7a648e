"""
persem_ros: persistent semantic memory for robots.

label images + depth + poses -> observe -> memory -> refine -> render -> stable labels and a map

"""

from __future__ import annotations
TYPE_CHECKING = False     # not typing's: signals are handled before anything else is imported
if TYPE_CHECKING:
    from pathlib import Path

    from persem_ros.notebook import Map

__version__ = '0.1.0'


def open_map(path: Path | str) -> Map:
    """
    Open a map file (.persem) to look into it: columns, queries, histories, explanations.

    Raises
    ------
    PersemError
        For a file that is missing, foreign, of another schema, or damaged.

    """
    from persem_ros.notebook import Map
    return Map(path)
