"""The linters of ROS itself, over everything."""

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = [str(ROOT / name) for name in ('persem_ros', 'test', 'launch', 'benchmarks', 'setup.py')
           if (ROOT / name).exists()]


def test_flake8():
    from ament_flake8.main import main_with_errors
    status, errors = main_with_errors(argv=FOLDERS)
    assert status == 0, '\n'.join(errors)


def test_pep257():
    from ament_pep257.main import main
    assert main(argv=FOLDERS) == 0


def test_xmllint(capfd):
    import shutil
    from ament_xmllint.main import main
    if shutil.which('xmllint') is None:
        pytest.skip('no xmllint here (apt install libxml2-utils)')
    status = main(argv=[str(ROOT / 'package.xml'), '--extensions', 'xml'])
    said = ''.join(capfd.readouterr())
    if 'failed to load external entity "http' in said:
        pytest.skip('the schema of package.xml cannot be reached from here')
    assert status == 0, said
