"""The handbook as a site: `make docs`. Nothing is fetched, neither by the build nor by the pages."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from taichi_bearings import __version__

project = "taichi_bearings"
author = "the taichi_bearings authors"
project_copyright = f"2026, {author}"
release = version = __version__
extensions = ["myst_nb", "sphinx.ext.autodoc", "from_code"]
exclude_patterns = ["_build"]
myst_heading_anchors = 3
nb_execution_mode = "off"  # notebooks keep their outputs; the tests run them
nb_ipywidgets_js: dict[str, dict[str, str]] = {}
html_theme = "furo"
html_title = "Frustrated bearings"
html_static_path = ["_static"]
html_css_files = ["handbook.css"]
autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_preserve_defaults = True
