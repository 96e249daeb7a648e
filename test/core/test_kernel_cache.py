"""Where compiled kernels are kept: a change of one file leaves those alone that do not use it."""

from pathlib import Path

from persem_ros.core import jit
import pytest

CORE = jit.PACKAGE / 'core'


@pytest.mark.parametrize('source, used, unused', [
    ('memory/blocks.py', 'memory/pools.py', 'geometry/shape.py'),
    ('refine/selection.py', 'memory/history.py', 'frame/render.py'),
    ('warmup.py', 'geometry/sparse.py', None)])
def test_a_folder_is_named_after_what_its_kernels_use(source, used, unused):
    files = jit.imported(CORE / source)
    assert {CORE / source, CORE / used} <= files
    assert unused is None or CORE / unused not in files


def test_imports_are_found_in_every_form(tmp_path, monkeypatch):
    package = tmp_path / 'persem_ros'
    (package / 'core').mkdir(parents=True)
    for name in ('a', 'b', 'c', 'd'):
        (package / 'core' / f'{name}.py').write_text('import numpy as np\n')
    source = package / 'core' / 'a.py'
    source.write_text('from persem_ros.core.b import x\nfrom persem_ros.core import c\n'
                      'def f():\n    from persem_ros.core.d import (\n        y, z)\n')
    monkeypatch.setattr(jit, 'PACKAGE', package)
    jit.imports.cache_clear()
    assert {path.stem for path in jit.imported(source)} == {'a', 'b', 'c', 'd'}
    jit.imports.cache_clear()


def test_another_content_is_another_folder(tmp_path, monkeypatch):
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path / 'kernels'))
    source = tmp_path / 'kernel.py'
    source.write_text('x = 1\n')
    before = jit.cache_folder.__wrapped__(str(source))
    assert jit.cache_folder.__wrapped__(str(source)) == before
    assert Path(before).parent == tmp_path / 'kernels'
    source.write_text('x = 2\n')
    assert jit.cache_folder.__wrapped__(str(source)) != before
