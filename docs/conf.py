"""The documentation as a site: `make docs` builds it with Sphinx, warnings are errors."""

from pathlib import Path
import re
import sys

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from persem_ros import __version__      # noqa: E402, I100

project = 'persem_ros'
author = 'persem_ros maintainers'
copyright = f'{author}, Apache-2.0'     # noqa: A001 - Sphinx's name
release = version = __version__
extensions = ['myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.napoleon']
html_theme = 'sphinx_rtd_theme'         # that of docs.ros.org
html_title = 'persem_ros'
html_static_path = ['static']
html_css_files = ['persem.css']
exclude_patterns = ['site', 'Thumbs.db']
myst_heading_anchors = 4                # links like results.md#how-it-is-measured
suppress_warnings = ['myst.xref_ambiguous']
autodoc_typehints = 'none'              # docstrings give shapes and units, which types do not
napoleon_google_docstring = False
nitpicky = False
linkcheck_ignore = [r'http://localhost', r'http://127\.0\.0\.1']


def _moved(app, path, page, content):
    """Let links of the files above docs/ lead from here; *content* is a list of one text."""
    text = re.sub(r'\]\((ARCHITECTURE|CONTRIBUTING)\.md\)', lambda m: f']({m[1].lower()}.md)',
                  content[0])
    text = re.sub(r'\]\(docs/', '](', text.replace('](CHANGELOG.rst)', '](changelog.rst)'))
    content[0] = re.sub(r'\]\((examples/|config/)', r'](../\1', text)


def setup(app):
    """Hear of files that are included; Sphinx calls this."""
    app.connect('include-read', _moved)
