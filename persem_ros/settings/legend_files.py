"""Files of legends: those that came with the package, and anybody's."""

from __future__ import annotations

from collections.abc import Iterator
import os
from pathlib import Path
import site
import sys
import sysconfig

from persem_ros.errors import PersemError
from persem_ros.settings.legend import Legend
from persem_ros.settings.setting import nearest


def load_legend(name: Path | str) -> Legend:
    """
    Return the Legend of a shipped name (town, uavscenes, forest, cityscapes) or of a file.

    Raises
    ------
    PersemError
        When there is neither, or the file is not a legend.

    """
    shipped = shipped_legends()
    path = shipped.get(str(name)) or Path(name)
    if not str(name) or not path.is_file():
        raise PersemError(f'legend {str(name)!r}: neither a file nor a shipped legend'
                          f'{nearest(name, shipped)}; shipped: {", ".join(shipped)}')
    try:
        text = path.read_text(encoding='utf-8')
    except (OSError, UnicodeDecodeError) as error:
        raise PersemError(f'{path}: cannot be read as text: '
                          f'{" ".join(str(error).split())}') from None
    return Legend.from_yaml(text, str(path))


def shipped_legends() -> dict[str, Path]:
    """Return {name: path} of the legends that came with the package."""
    for folder in _folders():
        files = sorted(folder.glob('*.yaml'))
        if files:
            return {path.stem: path for path in files}
    raise PersemError('the shipped legends are missing: expected share/persem_ros/config/labels '
                      "below the installation's prefix; reinstall persem_ros")


def _folders() -> Iterator[Path]:
    """Yield where config/labels may be: source tree, environment, ROS prefixes."""
    root = Path(__file__).resolve().parents[2]
    yield root / 'config' / 'labels'
    prefixes: list[str | Path | None] = [
        sys.prefix, sysconfig.get_path('data'), site.getuserbase(), root,
        *os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)]
    for prefix in prefixes:
        if prefix:
            yield Path(prefix) / 'share' / 'persem_ros' / 'config' / 'labels'
