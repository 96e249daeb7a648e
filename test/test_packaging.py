"""What setup.py, package.xml and the package say of themselves must agree, and install."""

import importlib
import os
from pathlib import Path
import re
import runpy
import shutil
import subprocess
import sys
from xml.etree import ElementTree

from persem_ros import __version__
from persem_ros.errors import missing, NEEDED
import pytest
import setuptools
import yaml

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ('persem_ros', 'config', 'launch', 'resource', 'setup.py', 'setup.cfg', 'package.xml',
           'pyproject.toml', 'LICENSE')


@pytest.fixture(scope='module')
def setup_arguments():
    """Return what setup.py hands to setuptools.setup."""
    arguments = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(setuptools, 'setup', lambda **given: arguments.update(given))
        patch.chdir(ROOT)
        runpy.run_path('setup.py')
    return arguments


@pytest.fixture(scope='module')
def package_xml():
    """Return the root element of package.xml."""
    return ElementTree.parse(ROOT / 'package.xml').getroot()


def test_versions_are_equal(setup_arguments, package_xml):
    newest = re.search(r'^(\d+\.\d+\.\d+|Forthcoming)\b.*\n-+$',
                       (ROOT / 'CHANGELOG.rst').read_text(), re.MULTILINE).group(1)
    assert setup_arguments['version'] == package_xml.findtext('version') == __version__
    assert newest in (__version__, 'Forthcoming')


def test_name_and_licence_are_equal(setup_arguments, package_xml):
    assert setup_arguments['name'] == package_xml.findtext('name') == 'persem_ros'
    assert setup_arguments['license'] == package_xml.findtext('license') == 'Apache-2.0'
    assert (ROOT / 'resource' / 'persem_ros').is_file()


def test_executables_exist(setup_arguments):
    scripts = dict(re.split(r'\s*=\s*', line)
                   for line in setup_arguments['entry_points']['console_scripts'])
    assert 'persem' in scripts
    for name, target in scripts.items():
        module, function = target.split(':')
        if module.startswith('persem_ros.ros.'):    # importing it needs ROS
            source = ROOT / (module.replace('.', '/') + '.py')
            assert f'def {function}(' in source.read_text(), name
        else:
            assert callable(getattr(importlib.import_module(module), function)), name


def test_every_folder_of_modules_is_a_package(setup_arguments):
    folders = {'.'.join(path.parent.relative_to(ROOT).parts)
               for path in (ROOT / 'persem_ros').rglob('*.py')}
    assert folders == set(setup_arguments['packages'])


def test_every_configuration_file_is_installed(setup_arguments):
    installed = {name for _, names in setup_arguments['data_files'] for name in names}
    there = {str(path.relative_to(ROOT)) for folder in ('config', 'launch')
             for path in (ROOT / folder).rglob('*.*')
             if path.is_file() and '__pycache__' not in path.parts}
    assert there <= installed


def test_the_windows_of_rviz_are_open_where_their_displays_are_on():
    layout = yaml.safe_load((ROOT / 'config' / 'persem.rviz').read_text())
    state = bytes.fromhex(layout['Window Geometry']['QMainWindow State'])
    images = {one['Name']: one['Enabled'] for one in layout['Visualization Manager']['Displays']
              if one['Class'].endswith('/Image')}
    assert set(images.values()) == {True, False}
    for name, enabled in images.items():        # Qt: 0xfb, the name, 1 where it is shown
        found = state.index(b'\xfb' + len(name * 2).to_bytes(4, 'big') + name.encode('utf-16-be'))
        assert state[found + 5 + 2 * len(name)] == enabled, name


def test_ros_dependencies_cover_the_imports_of_the_node(package_xml):
    declared = {element.text for element in package_xml.iter('exec_depend')}
    imported = {name for path in (ROOT / 'persem_ros').rglob('*.py')
                for name in re.findall(r'^\s*(?:from|import) (rclpy|\w+_msgs|std_srvs|tf2_\w+)\b',
                                       path.read_text(), re.MULTILINE)}
    workspace = {'px4_msgs'}        # in nobody's index: used where the user has built it
    assert imported - workspace | {'rclpy'} <= declared


@pytest.mark.parametrize('name', ['README.md', 'CONTRIBUTING.md'])
def test_what_pip_installs_beside_ros_is_said_alike(name):
    assert f'pip install {NEEDED}\n' in (ROOT / name).read_text()


def test_what_pip_installs_beside_ros_is_all_that_the_node_needs(setup_arguments):
    required = {re.split('[<>=;]', item)[0] for item in setup_arguments['install_requires']}
    simulation = {'trimesh', 'embreex'}
    assert {re.split('[<>=]', word)[0].strip('"') for word in NEEDED.split()} | simulation >= \
        required


@pytest.mark.parametrize('error, words', [
    (ModuleNotFoundError("No module named 'numba'", name='numba'), 'package numba is missing'),
    (ModuleNotFoundError("No module named 'cv2'", name='cv2'),
     'package opencv-python-headless is missing'),
    (ModuleNotFoundError("No module named 'rclpy'", name='rclpy'), 'source /opt/ros/jazzy'),
    (ImportError('numpy.core.multiarray failed to import'), 'does not fit the others')])
def test_a_missing_package_is_one_sentence_with_what_to_type(error, words):
    sentence = missing(error)
    assert words in sentence and '\n' not in sentence
    assert NEEDED in sentence or 'source' in sentence


def test_a_module_of_ours_that_is_missing_is_a_defect():
    with pytest.raises(ModuleNotFoundError):
        missing(ModuleNotFoundError('gone', name='persem_ros.gone'))


def test_an_installation_is_whole(tmp_path):
    pytest.importorskip('pip')
    source, site = tmp_path / 'source', tmp_path / 'site'
    source.mkdir()
    for name in SOURCES:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, source / name,
                            ignore=shutil.ignore_patterns('__pycache__'))
        elif (ROOT / name).exists():
            shutil.copy(ROOT / name, source / name)
    _run('-m', 'pip', 'install', '--quiet', '--no-deps', '--no-build-isolation',
         '--disable-pip-version-check', '--target', site, source)
    assert _files(source / 'persem_ros') == _files(site / 'persem_ros')
    shutil.rmtree(source)
    code = 'import persem_ros.settings.legend_files as x; print(x.__file__, *x.shipped_legends())'
    shown = _run('-c', code, cwd=tmp_path, env={**os.environ, 'PYTHONPATH': str(site)})
    module, *legends = shown.split()
    assert Path(module).is_relative_to(site)
    assert legends == sorted(path.stem for path in (ROOT / 'config' / 'labels').glob('*.yaml'))
    assert (site / 'share' / 'persem_ros' / 'config' / 'persem.yaml').is_file()


def _files(folder):
    """Return the names of all files below a folder, compiled ones left out."""
    return {str(path.relative_to(folder)) for path in folder.rglob('*')
            if path.is_file() and '__pycache__' not in path.parts}


def _run(*arguments, **more):
    """Run Python with *arguments* and return what it printed."""
    done = subprocess.run([sys.executable, *map(str, arguments)], capture_output=True, text=True,
                          **more)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_page_of_the_documentation_is_in_its_contents():
    """Sphinx warns of one that is not, which `make docs` takes for an error; here without it."""
    index = (ROOT / 'docs' / 'index.md').read_text()
    listed = index.partition('```{toctree}')[2].partition('```')[0].split()
    pages = {path.stem for path in (ROOT / 'docs').glob('*.*') if path.suffix in ('.md', '.rst')}
    assert pages - set(listed) == {'index'}


@pytest.mark.parametrize('page', sorted(str(path.relative_to(ROOT)) for path in (
    *ROOT.glob('*.md'), *ROOT.glob('docs/*.md'))))
def test_links_between_pages_lead_somewhere(page):
    text = re.sub('```.*?```', '', (ROOT / page).read_text(), flags=re.DOTALL)
    for link in re.findall(r'\]\(([^)#:\s]+)[^)]*\)', text):
        assert ((ROOT / page).parent / link).exists(), link
