"""The site: Sphinx with MyST pages; `pages` makes some of them from the code, sphinx-gallery runs the scripts."""

import logging
import sys
import warnings
from importlib.metadata import version as installed
from importlib.util import find_spec
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parent
sys.path[:0] = [str(HERE), *(str(ROOT / room) for room in ("workflow", "meshes", "postprocess", "trial"))]

project = "fretflow"
author = copyright = "the fretflow authors"
release = version = installed("fretflow")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.napoleon",
              "sphinx.ext.mathjax", "sphinx_gallery.gen_gallery", "pages"]
exclude_patterns = ["_build", "tutorials", "gallery", "_made/effect_list.md", "_made/*_keys.md", "_made/api.rst"]
myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "colon_fence", "attrs_block"]
myst_heading_anchors = 3
default_role = "literal"  # single backticks of docstrings
smartquotes = False  # what is copied into a shell keeps its quotes and dashes

html_theme = "furo"
html_title = f"fretflow {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = html_show_sourcelink = False
html_theme_options = {"navigation_with_keys": True}

# One file that needs no other: equations are set without a network, from a disk too.
MATHJAX = Path(str(find_spec("sphinx-mathjax-offline").origin)).parent / "static" / "mathjax" / "tex-svg-full.js"
mathjax_path = MATHJAX.name
html_static_path += [str(MATHJAX)]

autodoc_typehints = "none"  # the docstrings tell types
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_rtype = False

sphinx_gallery_conf = {
    "examples_dirs": ["tutorials", "gallery"],
    "gallery_dirs": ["_made/tutorials", "_made/gallery"],
    "within_subsection_order": "FileNameSortKey",
    "filename_pattern": r"\.py$",
    "image_scrapers": ("matplotlib", "pages.shown_pictures"),
    "reset_modules": ("matplotlib", "pages.forget_effects"),
    "ignore_repr_types": r"matplotlib|pathlib|list|int",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_signature": False,
    "min_reported_time": 1,
    "write_computation_times": False,
}
warnings.filterwarnings("ignore", message="FigureCanvasAgg is non-interactive", category=UserWarning)
# A style for code, on its import, lets every library print what it does.
logging.getLogger("matplotlib").setLevel(logging.WARNING)
