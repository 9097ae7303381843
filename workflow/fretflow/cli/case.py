"""The commands init and show: a case file to start from, and one as it is read."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

from rich.markup import escape

from fretflow.cli.terminal import Terminal, load, new_table
from fretflow.core.errors import InputError

if TYPE_CHECKING:
    from fretflow.case.config import Case


def init(path: Path = Path("case.toml"), /) -> None:
    """Write a commented case file to start from.

    Parameters
    ----------
    path
        file to write; an existing one is left alone
    """
    from fretflow.case.casefile import starting_case

    try:
        with path.open("x", encoding="utf-8") as handle:
            handle.write(starting_case())
    except FileExistsError as error:
        raise InputError(f"{path}: exists and is left as it is; name another file") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); name another file") from error
    Terminal().print(f"{path} written; `fretflow run {path}` runs it", highlight=False, markup=False, soft_wrap=True)


def show(case: Path, /) -> None:
    """Show the parsed case: every value with its unit, and which ones are defaults.

    Parameters
    ----------
    case
        case file
    """
    _show(load(case))


def _show(case: Case) -> None:
    """Print every value of `case` in the units that engineers use."""
    from fretflow.case.casefile import entries

    console, shown = Terminal(), list(entries(case))
    if case.effects:
        from fretflow.effects.catalogue import parse_effects

        for effect in parse_effects(case.effects):
            shown += entries(effect, ("effects", effect.id))
    for table, group in groupby(shown, key=lambda entry: entry.table):
        view = new_table(".".join(table) or "case", "key", "value", "", "meaning")
        for entry in group:
            view.add_row(
                entry.key, escape(entry.readable), "default" if entry.is_default else "", entry.meaning
            )
        console.print(view)
