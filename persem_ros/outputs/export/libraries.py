"""Libraries that only exports need: they come with the extra gis."""

from __future__ import annotations

import importlib
from typing import Any

from persem_ros.errors import PersemError

PIP = {'laspy': "'laspy[lazrs]'", 'lazrs': "'laspy[lazrs]'"}    # where pip's name is another


def needed(name: str, what: str) -> Any:
    """
    Import and return a module that *what* needs.

    Raises
    ------
    PersemError
        Where it is not installed: which, and what to type.

    """
    try:
        return importlib.import_module(name)
    except ImportError:
        top = name.partition('.')[0]
        raise PersemError(f'{what} needs the Python package {top}, which is not installed; '
                          f'pip install {PIP.get(top, top)}, or in the checkout '
                          "pip install '.[gis]' for all exports") from None
