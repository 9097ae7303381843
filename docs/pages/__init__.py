"""Pages made from the code when the site is built: effects, keys of files, commands, verification, scoreboards.

They are written to `docs/_made` before Sphinx reads its sources, so that they cannot fall behind the code.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from sphinx.application import Sphinx

from pages.effects import write_effects
from pages.interfaces import commands, keep_bars, public_names
from pages.keys import bolted_keys, case_keys, recording_keys, structure_keys
from pages.links import check_links
from pages.markdown import DOCS, write
from pages.verification import copy_trials, scoreboards, verification


def setup(app: Sphinx) -> dict[str, bool]:
    """Have the pages made before Sphinx looks for its sources, and the trials' own pages copied into the site."""
    app.connect("builder-inited", make_pages, priority=100)  # before sphinx-gallery, whose pages link to these
    app.connect("autodoc-process-docstring", keep_bars, priority=1)  # before its sections become reST
    app.connect("build-finished", copy_trials)
    app.connect("build-finished", check_links, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def make_pages(app: Sphinx) -> None:
    """Write all pages; runs of scripts begin afresh, and are then shared among them."""
    forget_effects({}, "")
    for folder in ("tutorials", "gallery"):
        shutil.rmtree(DOCS / folder / "runs", ignore_errors=True)
    write("cli.md", commands())
    write("case_keys.md", case_keys())
    write("bolted_keys.md", bolted_keys())
    write("recording_keys.md", recording_keys())
    write("structure_keys.md", structure_keys())
    write("verification.md", verification())
    write("trials.md", scoreboards())
    write("api.rst", public_names())
    write_effects()


def forget_effects(gallery_conf: dict[str, Any], file: str) -> None:
    """Take back the effects that a script, or who builds the site, has added."""
    from fretflow.effects.catalogue import FOLDERS

    os.environ.pop(FOLDERS, None)


def shown_pictures(block: Any, variables: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Return what a block of a script ends with as pictures: a figure, a picture's path, or a list of either."""
    from sphinx_gallery.scrapers import figure_rst

    last, saved = variables["example_globals"].get("___"), []
    if last is variables["example_globals"].get("_drawn"):
        return ""  # the end of an earlier block
    variables["example_globals"]["_drawn"] = last
    for shown in last if isinstance(last, list | tuple) else [last]:
        if isinstance(shown, Figure) or (isinstance(shown, Path) and shown.suffix == ".png"):
            target = next(variables["image_path_iterator"])
            shown.savefig(target) if isinstance(shown, Figure) else shutil.copyfile(shown, target)
            saved.append(target)
    return figure_rst(saved, gallery_conf["src_dir"]) if saved else ""
