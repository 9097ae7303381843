"""Markdown: tables, plain text and docstrings as such, and the files that pages become."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from inspect import cleandoc
from pathlib import Path

DOCS = Path(__file__).parent.parent
ROOT = DOCS.parent
MADE = DOCS / "_made"


def write(name: str, text: str) -> None:
    """Write the page `name`, unless it stands there already, so that Sphinx reads again what changed alone."""
    path = MADE / name
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a Markdown table; what would end a cell is escaped."""
    lines = [tuple(head)]
    lines += [tuple("---" for _ in lines[0]), *(tuple(row) for row in rows)]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in row) + " |"
                     for row in lines) + "\n"


def escape(text: str, marks: str = "\\`*_[]<>$#~") -> str:
    """Return plain text as Markdown that shows it letter by letter."""
    return re.sub(f"([{re.escape(marks)}])", r"\\\1", text)


def unbroken(quantity: str) -> str:
    """Return a number with its unit on one line, which a browser else breaks at a space and at a slash."""
    return f'<span class="unbroken">{quantity}</span>'


def printed(text: str) -> str:
    """Return plain text with formulas as Markdown that shows these as they are printed, ``h_0`` with an index."""
    from fretflow.inference.words import equation

    return escape(str(equation(text)), "`*_[]$~")


def prose(docstring: str | None, show: Callable[[str], str] = escape) -> str:
    """Return a docstring's text as Markdown: reST's double backticks and colons in Markdown's way."""
    text = cleandoc(docstring or "")
    text = re.sub(r"(?m)^\s*(Parameters|Attributes|Raises|Returns|Examples)\n\s*-{3,}\n(?s:.*)", "", text).strip()
    parts = re.split(r"(`+[^`]+`+)", text.replace("::\n", ":\n"))
    return "".join("`" + part.strip("`") + "`" if part.startswith("`") else show(part) for part in parts)
