"""The render command: the pictures of a run again."""

from __future__ import annotations

from pathlib import Path

from fretflow.cli.terminal import show_files


def render(run: Path, /) -> None:
    """Draw the pictures of a run again, off-screen, as far as its stages are complete.

    Parameters
    ----------
    run
        result folder of a case, for example runs/test1
    """
    from fretflow.pipeline.stages import render_run

    show_files(render_run(run), "files")
