"""Sphinx: furo, executable pages by myst-nb, mathematics by KaTeX from ``_static`` (nothing is loaded from a network).

``make docs`` builds docs/_build/html, which opens from ``file://``. Pages that are written by the build (API, settings, command
line) come from ``_ext/generated_pages.py``.
"""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import plotly

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS / "_ext"))
# kernels of executable pages inherit these; code of pages is a user's, so how figures are shown is the kernel's matter
os.environ["IPYTHONDIR"] = str(DOCS / "_build" / "ipython")
start = DOCS / "_build" / "ipython" / "profile_default" / "startup"
start.mkdir(parents=True, exist_ok=True)
shutil.copy(DOCS / "_ext" / "plotly_beside.py", start)
os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])

project = "wbmpc"
author = "the wbmpc authors"
copyright = "the wbmpc authors, BSD-3-Clause"
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "generated_pages",
    "notebooks",
    "quick",
    "table_age",
]
root_doc = "index"
exclude_patterns = ["_build", "reference/_*.md"]
# ref.python: a type in a signature may be re-exported by another module
suppress_warnings = ["myst.header", "ref.python"]

html_theme = "furo"
html_title = "wbmpc"
html_static_path = ["_static", "_build/static"]
html_css_files = ["katex/katex.min.css", "site.css"]
html_js_files = [("katex/katex.min.js", {"defer": "defer"})]
# excerpts of search results are fetched, which browsers do not allow on file://
html_show_search_summary = False
mathjax_path = "katex-start.js"
mathjax_options = {"defer": "defer"}
myst_update_mathjax = False
myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4

nb_execution_mode = "cache"
nb_execution_raise_on_error = True
nb_execution_timeout = 600
nb_merge_streams = True

autodoc_default_options = {"members": True}
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
python_maximum_signature_line_length = 100

# Plotly's own script, beside the pages: figures of executable pages refer to it
(DOCS / "_build" / "static").mkdir(parents=True, exist_ok=True)
shutil.copy(Path(plotly.__file__).parent / "package_data" / "plotly.min.js", DOCS / "_build" / "static")
