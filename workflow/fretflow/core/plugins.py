"""What other packages provide, found by the entry points that they declare.

fretflow computes without meshes of its own and without pictures. A package that makes either names its functions in
its ``pyproject.toml``, and nothing here imports it by name::

    [project.entry-points."fretflow.figures"]
    run = "fretflow_post.render:render_run"

Of ``fretflow.meshes``:

- ``specimens``: ``(case, folder) -> (upper, lower)``, both `MeshSummary`; the meshes are written to `folder`;
- ``lap-beam``: ``(table, path) -> pairs``, a bolted lap beam is written to `path`; the faces under head and nut;
- ``surfaces``: ``(path) -> (points, bodies, faces)``, m and the corners (k, 4) of each body's boundary and named face.

Of ``fretflow.figures``, where a file is a path that is written and returned:

- ``bolted``: ``(JointStudy, folder) -> files``;
- ``run``: ``(folders, folder, output) -> files``, all pictures of a run's stages; ``names``: ``(output) -> None``
  refuses those that there are not, before anything is computed;
- ``results``: ``(RunResults) -> Figure``, a run at a glance;
- ``report``: ``(file, Diagnosis) -> file``, its page; ``diagnosis``: ``(Diagnosis, what) -> Figure``;
- ``corner``: ``(file, title, subtitle, parameters) -> file``, draws of each and in pairs;
- ``loops``: ``(file, title, LoopSet, RecordedReadings, index) -> files``;
- ``modes``: ``(file, upper, lower) -> files``; ``response``: ``(file, curves) -> files``;
- ``effect``: ``(file, id, Effect) -> file``.

Effects of other packages are of the group ``fretflow.effects``, see `fretflow.effects.catalogue`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Any

from fretflow.core.errors import PlatformError

MESHES = "fretflow.meshes"
FIGURES = "fretflow.figures"
FORMATS = "FRETFLOW_FORMATS"  # the variable that says in which formats pictures are saved, such as svg,pdf


def formats_asked() -> tuple[str, ...]:
    """Return the formats of pictures that the user's variable names, PNG if it names none."""
    return tuple(one.strip() for one in (os.environ.get(FORMATS) or "png").split(","))


def provided(group: str, name: str) -> Callable[..., Any]:
    """Return the function that an installed package provides as `name` of the entry-point `group`.

    Raises
    ------
    PlatformError
        If no package does, or the one that does cannot be imported.
    """
    declared = tuple(entry_points(group=group, name=name))
    if not declared:
        raise PlatformError(f"{group}: no installed package provides {name!r}; install fretflow whole "
                            "(`./fretflow --version` in a clone does)")
    try:
        function: Callable[..., Any] = declared[0].load()
    except (ImportError, AttributeError) as error:
        raise PlatformError(f"{group}: {declared[0].value} cannot be loaded ({error}); install its package again"
                            ) from error
    return function
