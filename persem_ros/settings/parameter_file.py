"""YAML in the form of ROS parameter files: text to values with their lines, and back."""

from __future__ import annotations

from collections.abc import Iterator
import copy
import functools
from pathlib import Path
import re
from typing import Any, NamedTuple

from persem_ros.errors import PersemError
from persem_ros.guard.words import sentence, short
from persem_ros.guard.yaml_text import check, PARSER, SETTINGS
import yaml

NODE = 'mapper'
ROS_OWN = re.compile(r'use_sim_time$|qos_overrides\.|start_type_description_service$')


class Entry(NamedTuple):
    """A value of a file, and the line that it stands in."""

    value: Any
    line: int


class _Loader(yaml.SafeLoader):
    """YAML whose numbers are what ROS takes for numbers: 1e-3 is one, 1:30 and a date are not."""

    yaml_implicit_resolvers = copy.deepcopy(yaml.SafeLoader.yaml_implicit_resolvers)


for _first in _Loader.yaml_implicit_resolvers:
    _Loader.yaml_implicit_resolvers[_first] = [
        (tag, pattern) for tag, pattern in _Loader.yaml_implicit_resolvers[_first]
        if tag.rpartition(':')[2] not in ('int', 'float', 'timestamp')]
_Loader.add_implicit_resolver(
    'tag:yaml.org,2002:int', re.compile(r'[-+]?(0|[1-9][0-9]*)$'), list('-+0123456789'))
_Loader.add_implicit_resolver(
    'tag:yaml.org,2002:float',
    re.compile(r'[-+]?(([0-9]+\.[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?|[0-9]+[eE][-+]?[0-9]+)$'
               r'|[-+]?\.(inf|Inf|INF)$|\.(nan|NaN|NAN)$'), list('-+.0123456789'))
# The same by libyaml, for whole files: eight times as fast.
_Quick: Any = type('_Quick', (PARSER,),
                   {'yaml_implicit_resolvers': _Loader.yaml_implicit_resolvers})


def read(path: Path | str) -> dict[str, Entry]:
    """Return {dotted name: (value, line)} of a YAML file in ROS form."""
    try:
        with open(path, encoding='utf-8') as file:
            text = file.read(SETTINGS.size + 1)     # more than that is refused below
    except OSError as error:
        raise PersemError(f'{path}: cannot be read ({error.strerror}); expected a YAML file in '
                          "ROS form, 'persem config' prints one") from None
    except UnicodeDecodeError:
        raise PersemError(f'{path}: not YAML: not text') from None
    return read_text(text, path)


def read_text(text: str, path: Path | str) -> dict[str, Entry]:
    """
    Return {dotted name: (value, line)} of a YAML text in ROS form.

    Parameters
    ----------
    text : str
        '/**:', 'mapper:' or '/mapper:' over 'ros__parameters:'; sections of other nodes and
        ROS's own parameters are passed over.
    path : path
        Stands for the text in refusals.

    Raises
    ------
    PersemError
        For a text without settings of ours, or one that names a setting twice.

    """
    try:
        check(text, SETTINGS, _Quick)
        root = yaml.compose(text, _Quick)
    except yaml.YAMLError as noticed:
        error = _told(text, noticed)
        mark = getattr(error, 'problem_mark', None)
        line = f', line {mark.line + 1}' if mark else ''
        problem = getattr(error, 'problem', None) or 'not text'
        raise PersemError(f'{path}{line}: not YAML: {problem}') from None
    except (ValueError, RecursionError) as error:
        raise PersemError(f'{path}: not settings: {error}') from None
    sections = list(_sections(root, '', path)) if root is not None else []
    if not sections:
        raise PersemError(f"{path}: expected '/**:' and below it 'ros__parameters:', found "
                          "neither; 'persem config' prints a file to start from")
    ours = [(name, node) for name, node in sections if _is_ours(name)]
    if not ours:
        found = sentence(', '.join(name for name, _ in sections[:5]))
        raise PersemError(f"{path}: expected settings for '/**' or '{NODE}', "
                          f'found only those of {found}')
    entries: dict[str, Entry] = {}
    # As in ROS, what is meant for one node wins over a wildcard.
    for _, section in sorted(ours, key=lambda item: '*' not in item[0]):
        entries.update(_flat(section, '', path))
    return {name: entry for name, entry in entries.items() if not ROS_OWN.match(name)}


def _told(text: str, error: yaml.YAMLError) -> yaml.YAMLError:
    """Return what is wrong with a text as Python's parser says it: its lines are those to mend."""
    try:
        check(text, SETTINGS, _Loader)
    except yaml.YAMLError as told:
        return told
    except ValueError:
        pass
    return error


def parse(text: str) -> Any:
    """Return one value written in YAML; ValueError where it is none."""
    try:
        check(text, SETTINGS, _Loader)
        return yaml.load(text, _Loader)     # a SafeLoader: values only, no objects
    # Tags with values that they do not fit (!!int "") raise almost anything.
    except Exception as error:
        raise ValueError(str(error)) from None


def scalar(value: Any) -> str:
    """Return a value as YAML that ROS reads with the same type."""
    if isinstance(value, tuple):
        return '[' + ', '.join(scalar(item) for item in value) + ']'
    if isinstance(value, str) and not value.isprintable():
        return yaml.safe_dump(value, default_style='"', width=1 << 20).strip()
    if isinstance(value, str):
        return "'" + value.replace("'", "''") + "'"
    if type(value) is int:
        return str(value)
    if type(value) is float:
        return _float(repr(value))
    return yaml.safe_dump(value).split('\n')[0]


@functools.lru_cache(1024)      # the defaults, again for each file that holds settings
def _float(text: str) -> str:
    """Return a float, given as Python writes it, as YAML."""
    return yaml.safe_dump(float(text)).split('\n')[0]


def _sections(
        node: yaml.Node, path: str, file: Path | str
) -> Iterator[tuple[str, yaml.MappingNode]]:
    """Yield (node name, mapping below ros__parameters) of every node in the file."""
    if not isinstance(node, yaml.MappingNode):
        return
    for key, value in node.value:
        if not isinstance(key, yaml.ScalarNode):
            continue
        if key.value == 'ros__parameters':
            if not isinstance(value, yaml.MappingNode):
                raise PersemError(f'{file}, line {key.start_mark.line + 1}: expected settings '
                                  'below ros__parameters')
            yield path or '(no node)', value
        else:
            yield from _sections(value, f'{path}/{str(key.value).strip("/")}', file)


def _is_ours(name: str) -> bool:
    """Tell whether a node name of a parameter file means the mapper, in any namespace."""
    return name.rpartition('/')[2] in (NODE, '*', '**')


def _flat(node: yaml.MappingNode, prefix: str, file: Path | str) -> dict[str, Entry]:
    """Return {dotted name: (value, line)} of a mapping node."""
    entries: dict[str, Entry] = {}
    for key, value in node.value:
        line = key.start_mark.line + 1
        if not isinstance(key, yaml.ScalarNode):
            raise PersemError(f'{file}, line {line}: expected a name before the colon')
        name = f'{prefix}{key.value}'
        if isinstance(value, yaml.MappingNode):
            below = _flat(value, f'{name}.', file)
        else:
            try:
                below = {name: Entry(_Loader('').construct_object(value, deep=True), line)}
            # Tags with values that they do not fit (!!int "") raise almost anything.
            except Exception as error:
                why = getattr(error, 'problem', None) or str(error) or type(error).__name__
                raise PersemError(f'{file}, line {line}: {short(name)}: {sentence(why)}') from None
        twice = sorted(set(below) & set(entries))
        if twice:
            raise PersemError(f'{file}, line {line}: {twice[0]} is given twice, first in line '
                              f'{entries[twice[0]].line}')
        entries.update(below)
    return entries
