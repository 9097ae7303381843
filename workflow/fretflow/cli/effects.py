"""The effects command: the table of all effects, or one of them with its picture."""

from __future__ import annotations

from collections.abc import Mapping
from inspect import cleandoc
from pathlib import Path
from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

from fretflow.cli.terminal import Json, Terminal, keep_json, new_table, show_files
from fretflow.core.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from fretflow.effects.effect import Effect


def effects(effect: str | None = None, /, *, out: Path = Path("runs/effects"), json: Json = None) -> None:
    """List the physics beyond the baseline, or describe one effect with its equation, parameters and a picture.

    Parameters
    ----------
    effect
        id of an effect
    out
        folder of the picture
    """
    from fretflow.effects.catalogue import catalogue

    known = catalogue()
    if effect is None:
        _list(known)
    elif effect in known:
        _show(effect, known[effect], out)
    else:
        raise InputError(f"{effect}: there is no such effect; `fretflow effects` lists them"
                         f"{did_you_mean(effect, known)}")
    keep_json(json, [_sheet(kind) for name, kind in known.items() if effect in (None, name)])


def _sheet(kind: type[Effect]) -> dict[str, object]:
    """Return what is said of an effect, ranges in SI."""
    from fretflow.case.casefile import entries

    priors = kind.priors()
    return {"id": kind.id, "title": kind.title, "block": str(kind.block), "equation": kind.equation,
            "source": kind.source, "observables": kind.observables, "recordings": sorted(map(str, kind.acts_in())),
            "parameters": [{
                "name": entry.key, "default": entry.value, "unit": entry.unit, "meaning": entry.meaning,
                "plausible": [priors[entry.key].low, priors[entry.key].high] if entry.key in priors else None}
                for entry in entries(kind())]}


def _list(known: Mapping[str, type[Effect]]) -> None:
    """Print all effects: id, block, equation, where they show."""
    view = new_table("effects: physics beyond the baseline; `fretflow effects ID` shows one", "id", "block", "equation",
                     "shows in")
    for name, kind in known.items():
        view.add_row(name, kind.block, escape(kind.equation), escape("; ".join(kind.observables)))
    Terminal().print(view)


def _show(name: str, kind: type[Effect], out: Path) -> None:
    """Print the sheet of an effect and draw its picture."""
    from fretflow.core.plugins import FIGURES, provided

    console = Terminal(highlight=False)
    console.print(f"[bold]{name}[/bold]: {escape(kind.title)}")
    for paragraph in cleandoc(kind.__doc__ or "").split("\n\n"):
        console.print(escape(" ".join(paragraph.replace("``", "").split())))
    sheet = Table.grid(padding=(0, 2))
    for heading, text in (("changes", kind.block), ("equation", kind.equation), ("source", kind.source),
                          ("shows in", "; ".join(kind.observables)),
                          ("recordings", ", ".join(sorted(map(str, kind.acts_in())))),
                          ("acts", _acts(kind)), ("not with", _excluded(kind))):
        for part in text.split("; "):  # each on a line of its own, where it has the room
            if part:
                sheet.add_row(heading, escape(part))
                heading = ""
    console.print(sheet)
    console.print(_parameters(kind))
    picture: Path = provided(FIGURES, "effect")(out / f"{name}.png", name, kind())
    show_files([picture], "picture")


def _acts(kind: type[Effect]) -> str:
    from fretflow.effects.effect import Effect

    where = {"period": "within the period (residual, Jacobian and derivatives)",
             "evolve": "over cycles (memory)", "wear_factor": "over cycles (wear rate)",
             "sense": "in the sensors", "limit": "on driven joints (friction limit)",
             "force": "on driven joints (force)", "moved": "on driven joints (motion)"}
    acts = [text for method, text in where.items() if getattr(kind, method) is not getattr(Effect, method)]
    return "; ".join([*acts, *(["over cycles (what acts within the period)"] if kind.over_cycles else [])])


def _excluded(kind: type[Effect]) -> str:
    return "; ".join(f"{other} ({why})" for other, why in kind.excludes.items())


def _parameters(kind: type[Effect]) -> object:
    from fretflow.case.casefile import entries
    from fretflow.core.units import pretty_number, pretty_quantity

    view = new_table(f"[effects.{kind.id}]", "parameter", "default", "plausible range", "meaning", "range from")
    priors = kind.priors()
    for entry in entries(kind()):
        prior = priors.get(entry.key)
        ends = () if prior is None else (prior.low, prior.high)
        span = " to ".join(pretty_quantity(end, entry.unit, 3) if entry.unit else pretty_number(end) for end in ends)
        view.add_row(entry.key, escape(entry.readable), span, entry.meaning, "" if prior is None else prior.source)
    return view
