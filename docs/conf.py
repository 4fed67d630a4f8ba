"""How the site is built: ``make docs``. What pages are made of the program itself is in `site/`."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "site"))

project = "seqsweep"
author = "the seqsweep authors"
copyright = author
html_title = "seqsweep"

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "pages",
]

# Pages are Markdown that GitHub shows as well; links to places are GitHub's.
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 4
suppress_warnings = ["myst.header", "mystnb.unknown_mime_type", "config.cache"]
exclude_patterns = ["build", "site", "figures/README.md", "gallery/*.ipynb"]
source_suffix = {".md": "myst-nb", ".ipynb": "myst-nb", ".rst": "restructuredtext"}
default_role = "literal"
smartquotes = False  # options have two dashes
nitpicky = False
highlight_language = "none"

# Notebooks come with their outputs: `site/notebooks.py` runs them.
nb_execution_mode = "off"

# The API: docstrings after NumPy's custom, types from the signatures.
autodoc_member_order = "bysource"
autodoc_typehints = "none"
add_module_names = False
napoleon_google_docstring = False
napoleon_use_rtype = False

sphinx_gallery_conf = {
    "examples_dirs": [str(HERE / ".." / "examples" / "gallery")],
    "gallery_dirs": ["gallery"],
    "filename_pattern": "plot_",
    "download_all_examples": False,
    "show_signature": False,
    "min_reported_time": 60,
    "write_computation_times": False,
}

# How it looks. Nothing is fetched from a network: fonts are the reader's own.
html_theme = "pydata_sphinx_theme"
html_static_path = ["site/static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_show_search_summary = False  # it would fetch pages, which a browser forbids where the site is opened from a folder
html_theme_options = {
    "logo": {"text": "seqsweep"},
    "navbar_align": "left",
    "header_links_before_dropdown": 7,
    "secondary_sidebar_items": ["page-toc"],
    "show_prev_next": True,
    "footer_start": ["copyright"],
    "footer_end": [],
    "navigation_with_keys": False,
    "show_nav_level": 1,
}
html_context = {"default_mode": "auto"}
mathjax_path = "no-mathjax.js"  # no page has formulas that need it, and nothing is fetched
