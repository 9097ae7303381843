"""The references of the command line and of the Python interface."""

from __future__ import annotations

import re
import types

from sphinx.application import Sphinx


def commands() -> str:
    """Return the reference of all commands, as their help has it."""
    from fretflow.cli.app import app

    text = app.generate_docs(output_format="markdown")
    body = re.sub(r"(?s)^.*?(?=^## fretflow run)", "", text, count=1, flags=re.MULTILINE)
    body = re.sub(r"OUT/NAME(-\w+(\.\w+)?)?", r"`\g<0>`", body).replace(" -m sphinx", "")  # what started this process
    return "# Commands\n\nWhat `./fretflow COMMAND --help` says.\n\n" + body


def public_names() -> str:
    """Return a section of reST for each kind of public name."""
    import fretflow

    groups: dict[str, list[str]] = {
        title: [] for title in ("Functions", "Classes", "Errors and warnings", "Modules", "Values")}
    for name in fretflow.__all__:
        value = getattr(fretflow, name)
        where = ("Modules" if isinstance(value, types.ModuleType) else "Values" if not callable(value)
                 else "Functions" if not isinstance(value, type)
                 else "Errors and warnings" if issubclass(value, Exception) else "Classes")
        groups[where].append(name)
    directives = {"Functions": "autofunction", "Classes": "autoclass", "Modules": "automodule",
                  "Errors and warnings": "autoexception", "Values": "autodata"}
    lines = []
    for title, names in groups.items():
        if names:
            lines += [title, "-" * len(title), ""]
        for name in sorted(names, key=str.lower):
            value = getattr(fretflow, name)
            lines += [f".. {directives[title]}:: {value.__name__ if title == 'Modules' else f'fretflow.{name}'}"]
            lines += ["   :members:"] if title in ("Classes", "Modules") else []
            lines += [""]
    return "\n".join(lines)


def keep_bars(app: Sphinx, what: str, name: str, value: object, options: object, lines: list[str]) -> None:
    """Have the bars of absolute values in docstrings read as such, not as reST's substitutions."""
    for row, line in enumerate(lines):
        parts = re.split(r"(``.+?``)", line)
        lines[row] = "".join(part if part.startswith("``") else part.replace("|", "\\|") for part in parts)
