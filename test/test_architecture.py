"""The import graph is part of the design: this file fails when someone bends it."""

import ast
import functools
from graphlib import TopologicalSorter
from pathlib import Path
import re
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / 'persem_ros'
FILES = sorted(PACKAGE.rglob('*.py'))

NOUNS = {'__init__', 'errors', 'frames', 'guard', 'settings'}
LIBRARIES = NOUNS | {'core', 'inputs', 'outputs', 'pipeline', 'preflight'}
# Room or file -> what it may use of the package; a room may always use itself. The longest name
# that fits a file holds.
MAY_IMPORT = {
    '__init__': {'notebook'},     # inside open_map: importing the package stays instant
    'notebook': NOUNS | {'core', 'outputs'},
    '__main__': {'cli'},
    'errors': set(),
    'frames': {'errors'},
    'guard': {'errors'},
    'settings': {'errors', 'frames', 'guard'},
    'core': NOUNS,
    'core.geometry': NOUNS | {'core.jit', 'core.memory'},
    'core.frame': NOUNS | {'core.jit', 'core.memory', 'core.transforms'},
    'core.memory': NOUNS | {'core.jit', 'core.prefetch', 'core.trajectory', 'core.transforms'},
    'pipeline': NOUNS | {'core'},
    'inputs': NOUNS | {'core.jit', 'core.trajectory', 'core.transforms'},
    'inputs.decode': NOUNS | {'core.jit', 'core.transforms'},
    'preflight': NOUNS | {'core', 'inputs'},
    'outputs': NOUNS | {'core'},
    'ahead': set(),
    'cluster': {'errors'},
    'workers': {'errors', 'core.jit', 'cluster'},
    'rendering': LIBRARIES,
    'choices': LIBRARIES,
    'passes': LIBRARIES | {'ahead', 'choices', 'rendering'},
    'replay': LIBRARIES | {'choices', 'passes'},
    'convert': NOUNS | {'core.agreement', 'core.transforms', 'inputs', 'outputs'},
    'simulate': NOUNS | {'core.jit', 'core.transforms', 'inputs', 'outputs'},
    'mosaic': LIBRARIES | {'ahead', 'choices', 'cluster', 'evaluate.work', 'workers'},
    'evaluate': LIBRARIES | {'ahead', 'convert'},
    'evaluate.measure': LIBRARIES,
    'evaluate.work': LIBRARIES | {'ahead', 'convert', 'evaluate.measure', 'workers'},
    'evaluate.show': LIBRARIES | {'evaluate.measure'},
    'commands': LIBRARIES | {'replay', 'convert', 'simulate', 'evaluate', 'mosaic'},
    'cli': NOUNS | {'commands', 'ending'},
    'ending': set(),
    'ros': LIBRARIES | {'ending'},
}
ROS = re.compile(r'(rclpy|rosidl_\w+|\w+_interfaces|\w+_msgs|\w+_srvs|tf2_\w+|cv_bridge|'
                 r'message_filters|launch\w*|ament_\w+)$')
CORE_THIRD_PARTY = {'numpy', 'numba', 'llvmlite'}       # the last one is a part of numba
# What the command line may load before it knows the sub-command: 'persem --help' comes at once.
LIGHT = {'persem_ros.__version__', 'persem_ros.commands', 'persem_ros.ending',
         'persem_ros.errors', 'persem_ros.guard.words', 'persem_ros.settings.config'}
DISTRIBUTIONS = {'cv2': 'opencv-python-headless', 'yaml': 'pyyaml', 'rerun': 'rerun-sdk',
                 'skimage': 'scikit-image', 'sklearn': 'scikit-learn', 'llvmlite': 'numba'}


def module_name(path):
    """Return the dotted name under which a file is imported."""
    parts = path.relative_to(ROOT).with_suffix('').parts
    return '.'.join(parts[:-1] if parts[-1] == '__init__' else parts)


MODULES = {module_name(path): path for path in FILES}


def part(path):
    """Return the folder or file of the package that a file belongs to."""
    return path.relative_to(PACKAGE).with_suffix('').parts[0]


def room(path):
    """Return the name in MAY_IMPORT that holds for a file, the longest that fits."""
    parts = path.relative_to(PACKAGE).with_suffix('').parts
    names = ('.'.join(parts[:n]) for n in range(len(parts), 0, -1))
    return next((name for name in names if name in MAY_IMPORT), parts[0])


class AtRuntime(ast.NodeTransformer):
    """Leaves out what only a type checker reads: it loads nothing and is no arrow."""

    def visit_If(self, node):
        return None if ast.unparse(node.test) == 'TYPE_CHECKING' else self.generic_visit(node)


@functools.cache
def parsed(path):
    """Return the syntax tree of a file."""
    return ast.parse(path.read_text(encoding='utf-8'))


@functools.cache
def imports(path, body=None):
    """Return every dotted name that a file imports when it runs, also inside functions."""
    return list(imported(path, body))


def imported(path, body):
    tree = AtRuntime().visit(ast.parse(path.read_text(encoding='utf-8')))
    for node in ast.walk(tree) if body is None else body(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f'{path.name}: use absolute imports'
            yield from (f'{node.module}.{alias.name}' for alias in node.names)


def at_top(tree):
    """Return the statements that run when a module is imported, conditional ones included."""
    found, waiting = [], list(tree.body)
    while waiting:
        node = waiting.pop()
        found.append(node)
        if not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            waiting += ast.iter_child_nodes(node)
    return found


def is_ours(name):
    return name.split('.')[0] == 'persem_ros'


def is_foreign(name):
    top = name.split('.')[0]
    return top not in sys.stdlib_module_names and not is_ours(name)


def module_of(name):
    """Return the module of ours that importing *name* loads."""
    while name not in MODULES:
        name = name.rpartition('.')[0]
    return name


def within(module, allowed):
    """Whether a module (below persem_ros, dotted) is one of *allowed* or inside one."""
    return any(module == name or module.startswith(f'{name}.') for name in allowed)


@functools.cache
def requirements():
    """Return the names of all distributions that setup.py requires, extras included."""
    tree = ast.parse((ROOT / 'setup.py').read_text(encoding='utf-8'))
    lists = [node for keyword in ast.walk(tree) if isinstance(keyword, ast.keyword)
             and keyword.arg in ('install_requires', 'extras_require')
             for node in ast.walk(keyword.value) if isinstance(node, ast.List)]
    return {re.match(r'[\w.-]+', item.value).group().lower()
            for node in lists for item in node.elts}


def each_file(function):
    return pytest.mark.parametrize('path', FILES, ids=lambda p: str(p.relative_to(ROOT)))(function)


@each_file
def test_imports_follow_the_data_flow(path):
    here = room(path)
    assert here in MAY_IMPORT, f'{here}: say in MAY_IMPORT what it may use'
    for name in filter(is_ours, imports(path)):
        target = module_of(name).partition('.')[2] or '__init__'
        assert within(target, MAY_IMPORT[here] | {here}), f'{here} may not import {name}'


@each_file
def test_ros_stays_in_its_folder(path):
    if part(path) != 'ros':
        assert not [name for name in imports(path) if ROS.match(name.split('.')[0])]


@each_file
def test_third_parties_are_declared(path):
    declared = requirements()
    for name in filter(is_foreign, imports(path)):
        top = name.split('.')[0]
        if not ROS.match(top):
            assert DISTRIBUTIONS.get(top, top).replace('_', '-').lower() in declared, \
                f'{top} is imported, but setup.py does not require it'


@pytest.mark.parametrize('path', sorted(PACKAGE.rglob('core/**/*.py')),
                         ids=lambda p: str(p.relative_to(PACKAGE)))
def test_the_core_needs_numpy_and_numba_only(path):
    assert {name.split('.')[0] for name in filter(is_foreign, imports(path))} <= CORE_THIRD_PARTY


@pytest.mark.parametrize('path', [PACKAGE / 'cli.py', *sorted(PACKAGE.glob('commands/*.py'))],
                         ids=lambda p: p.name)
def test_the_command_line_starts_light(path):
    for name in imports(path, at_top):
        assert not is_foreign(name), f'{name}: import it inside run()'
        assert not is_ours(name) or within(name, LIGHT), f'{name}: import it inside run()'


def test_modules_form_no_cycle():
    graph = {module: {module_of(name) for name in filter(is_ours, imports(path))} - {module}
             for module, path in MODULES.items()}
    list(TopologicalSorter(graph).static_order())   # raises CycleError, which names the cycle


@each_file
def test_only_the_command_line_ends_the_process_and_prints(path):
    tree = parsed(path)
    words = {ast.unparse(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    words |= {ast.unparse(node.exc).split('(')[0] for node in ast.walk(tree)
              if isinstance(node, ast.Raise) and node.exc}
    if part(path) not in ('cli', 'ending', '__main__'):
        assert not words & {'sys.exit', 'exit', 'quit', 'os._exit', 'SystemExit'}
    if part(path) not in ('cli', 'commands'):
        assert not words & {'print', 'input'}


def test_all_threads_of_the_node_stand_back_for_the_mapping():
    made = {(path.name, ast.unparse(call.args[-1])) for path in FILES if part(path) == 'ros'
            for call in ast.walk(parsed(path)) if isinstance(call, ast.Call)
            and ast.unparse(call.func) == 'ThreadPoolExecutor'}
    assert len(made) >= 7 and {what for _, what in made} == {'stand_back'}


@each_file
def test_loggers_and_docstrings(path):
    text = path.read_text(encoding='utf-8')
    assert ast.get_docstring(parsed(path)) or not text.strip(), 'say in a line what it is'
    assert 'getLogger()' not in text, 'the root logger belongs to the application'
