"""How the site is made of these pages: `make docs`.

Nothing is fetched, neither when it is built nor when it is read; `check_site.py` looks.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from bayesdrill import __version__

if TYPE_CHECKING:
    from sphinx.application import Sphinx

sys.path.insert(0, str(Path(__file__).parent))

project = "bayesdrill"
version = release = __version__
project_copyright = "the authors of bayesdrill"

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
exclude_patterns = ["paper.template.md"]

# Anchors as a forge makes them, so that one link serves both.
myst_heading_anchors = 4
smartquotes = False

# Notebooks are texts, run whenever the site is built; a cell that fails, fails the build.
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_execution_show_tb = True
nb_merge_streams = True
nb_render_markdown_format = "myst"
nb_ipywidgets_js: dict[str, dict[str, str]] = {}

# Docstrings are plain text with code in single ticks.
default_role = "literal"
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 80
add_module_names = False

html_theme = "furo"
html_title = f"bayesdrill {__version__}"
html_static_path = ["site"]
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_copy_source = False
html_show_sourcelink = False
html_show_sphinx = False
html_theme_options = {"navigation_with_keys": True, "top_of_page_buttons": []}
copybutton_exclude = ".linenos, .gp, .go"


def setup(app: Sphinx) -> None:
    """Pages with marks get what the program says of itself."""
    import reference

    def fill(_: Sphinx, __: str, source: list[str]) -> None:
        source[0] = reference.fill(source[0])

    app.connect("source-read", fill)
