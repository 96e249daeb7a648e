"""Settings as YAML in ROS form, read by the node and the command line alike."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
import functools
import textwrap
from typing import Any, TYPE_CHECKING

from persem_ros.errors import PersemError
from persem_ros.guard.words import sentence, short
from persem_ros.settings.config import Config, nearest, settings, updated
from persem_ros.settings.parameter_file import Entry, parse, read, read_text, scalar

if TYPE_CHECKING:
    from pathlib import Path

# Where the node's default is another.
NODE_DEFAULTS = {'memory.max_history': 128, 'map.max_voxels': 2_000_000}
HEADER = 'Settings of persem_ros, read by the node and by the command line (--config).'


def from_args(
        config_path: Path | str | None = None, set_items: Sequence[str] = (), node: bool = False
) -> Config:
    """
    Return the Config that a command line asks for.

    Parameters
    ----------
    config_path : path, optional
        YAML file in ROS form.
    set_items : texts
        name=value; the last one wins, and all win over the file.
    node : bool
        Start from the node's defaults instead of the command line's.

    Raises
    ------
    PersemError
        For an unreadable file, an unknown setting or a value that does not fit; the file and
        line or the option are named.

    """
    base = from_values(NODE_DEFAULTS) if node else Config()
    values: dict[str, Any] = {}
    config = base
    if config_path is not None:
        config = from_file(config_path, base)
        values.update({name: value for name, (value, _) in read(config_path).items()})
    items = dict(map(parse_item, set_items))
    from_values(items, config, '--set ')
    # Together once more: a camera's topics derive from shared ones that an option may give.
    return from_values({**values, **items}, base)


def given_names(
        config_path: Path | str | None = None, set_items: Sequence[str] = ()
) -> set[str]:
    """Return the set of names that the file and the options of from_args give."""
    names = {parse_item(item)[0] for item in set_items}
    return names | (set(read(config_path)) if config_path else set())


def from_values(
        values: Mapping[str, Any], config: Config | None = None, source: str = ''
) -> Config:
    """
    Return *config* (default: all defaults) with {dotted name: value} applied.

    The order of the names does not matter: shared topics come before the cameras that derive
    theirs from them. Refusals start with *source*.

    """
    config = Config() if config is None else config
    per_camera = {n: v for n, v in values.items() if n == 'cameras' or n.startswith('cameras.')}
    shared = {n: v for n, v in values.items() if n not in per_camera}
    try:
        return updated(updated(config, shared), per_camera)
    except PersemError as error:
        raise PersemError(f'{source}{error}') from None


def from_file(path: Path | str, config: Config | None = None) -> Config:
    """
    Return *config* (default: all defaults) with the settings of a YAML file applied.

    Parameters
    ----------
    path : path
        File in ROS form: '/**:', 'mapper:' or '/mapper:' over 'ros__parameters:'. Sections of
        other nodes and ROS's own parameters are passed over.
    config : Config, optional
        What holds where the file is silent.

    """
    return _applied(read(path), path, config)


def from_text(text: str, name: str) -> Config:
    """Return the Config of a YAML text in ROS form; *name* stands for it in refusals."""
    return _applied(read_text(text, name), name, None)


def _applied(
        entries: Mapping[str, Entry], path: Path | str, config: Config | None
) -> Config:
    """Return *config* with the entries {name: (value, line)} of a file applied."""
    values = {name: value for name, (value, _) in entries.items()}
    try:
        return from_values(values, config)
    except PersemError as error:
        text = str(error)
        # One bad name or value has its own line; the sentence starts with it or quotes it.
        lines = [line for name, (_, line) in entries.items()
                 if text.startswith(f'{name}:') or short(name) in text.partition(',')[0]]
        place = f'{path}, line {lines[0]}' if lines else str(path)
        raise PersemError(f'{place}: {text}') from None


def parse_item(item: str) -> tuple[str, Any]:
    """
    Return (name, value) of a 'name=value' option.

    The setting's default says what the text means: a list may come with or without brackets, a
    string is taken as it stands, anything else is read as YAML.

    """
    name, equals, text = item.partition('=')
    shown = sentence(item)
    name, text = name.strip(), text.strip()
    known = {n: value for n, value, _ in settings()}
    if not equals or not name:
        example = f'{name}={scalar(known[name])}' if name in known else 'memory.voxel_size=0.2'
        raise PersemError(f'--set {shown}: expected name=value, with = and without spaces, for '
                          f'example {example}')
    default = known.get(name, '' if name.startswith('cameras.') else None)
    if default is None:
        raise PersemError(f'--set {shown}: unknown setting {short(name)}{nearest(name, known)}; '
                          "'persem config' lists all settings")
    if isinstance(default, str):
        return name, text
    if isinstance(default, tuple) and not text.startswith('['):
        text = f'[{text}]'
    try:
        return name, parse(text)
    except ValueError:
        raise PersemError(f'--set {shown}: cannot be read; lists are written [1, 2]') from None


def to_yaml(config: Config, left_out: Collection[str] = ()) -> str:
    """
    Return *config* as YAML in ROS form, each setting with its help text, unit and range.

    Parameters
    ----------
    config : Config
        What to write.
    left_out : names
        Written as a comment, so that each reader's own default holds.

    """
    lines = [f'# {HEADER}', '/**:', '  ros__parameters:']
    section = None
    for name, value, meta in settings(config):
        head, _, tail = name.partition('.')
        if head == 'cameras':       # the list and its items cannot share a nested key
            head, tail = '', name
        if head and head != section:
            lines.append(f'    {head}:')
        section = head
        indent = ' ' * (6 if head else 4)
        lines += _wrapped(comment(name, meta), f'{indent}# ')
        if value == ():     # ROS cannot type an empty list; these mean none, too
            value = ('',) if name == 'cameras' else (-1,)
        mark = '# ' if name in left_out else ''
        lines.append(f'{indent}{mark}{tail}: {scalar(value)}')
    return '\n'.join(lines) + '\n'


@functools.lru_cache(1024)      # each map, save and checkpoint has the same comments
def _wrapped(text: str, indent: str) -> list[str]:
    """Return the lines of a comment."""
    return textwrap.wrap(text, 99, initial_indent=indent, subsequent_indent=indent,
                         break_long_words=False)


def to_markdown() -> str:
    """Return the table of all settings that docs/parameters.md shows."""
    lines = ['# Settings', '',
             'Written by `persem config --markdown`. The names are ROS parameter names; on the',
             'command line they are given as `--set name=value` or in a YAML file (`--config`).',
             'A setting marked *fixed* cannot be changed while the node maps.', '',
             '| setting | default | unit | range | meaning |', '|---|---|---|---|---|']
    for name, value, meta in settings():
        default = f'`{scalar(value)}`'
        if name in NODE_DEFAULTS:
            default += f' (node: `{scalar(NODE_DEFAULTS[name])}`)'
        fixed = '' if meta['live'] else ' (*fixed*)'
        text = meta['help'].replace('|', '\\|')
        lines.append(f'| `{name}` | {default} | {meta["unit"]} | {span(meta)} | {text}{fixed} |')
    lines += ['', 'With several cameras (`cameras: [front, down]`) each has its own',
              '`cameras.<name>.topics.*`, by default the shared name below its own:',
              '`front/semantic/image`, and `cameras.<name>.frame` in place of `camera.frame`.']
    return '\n'.join(lines) + '\n'


def comment(name: str, meta: Mapping[str, Any]) -> str:
    """Return a setting's help text with unit, range and the node's default in one line."""
    bounds = ' '.join(part for part in (span(meta), meta['unit']) if part)
    text = meta['help'] + (f' [{bounds}]' if bounds else '')
    if name in NODE_DEFAULTS:
        text += f'; default of the node: {scalar(NODE_DEFAULTS[name])}'
    return text


def span(meta: Mapping[str, Any]) -> str:
    """Return a setting's range or choices as text, '' where everything goes."""
    if meta['choices']:
        return ', '.join(meta['choices'])
    if meta['low'] is None and meta['high'] is None:
        return ''
    return f'{meta["low"]} .. {meta["high"]}'
