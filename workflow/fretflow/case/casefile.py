"""Case files as text: a parsed case written back exactly, and a commented file to start from.

Both are made from the models of `core.config`, so that they cannot fall behind them.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from fretflow.case.config import Case, validate_case
from fretflow.core.files import CASE
from fretflow.core.units import Unit, exact_quantity, format_quantity, pretty_number, pretty_quantity

# What a file to start from sets; everything else in it is a commented default.
_START = {
    "format": CASE,
    "name": "my-joint",
    "title": "A first case",
    "test": {"excitation_frequency": "100 Hz", "excitation_amplitude": "53 N", "normal_load": "60 N",
             "cycles": 100_000},
}


@dataclass(frozen=True)
class Entry:
    """One key of a case: where it stands, its value in SI, its unit, its meaning, whether it is a default."""

    table: tuple[str, ...]
    key: str
    value: Any
    unit: str
    meaning: str
    is_default: bool
    resolved: Any  # what a run takes where the value is not set

    @property
    def readable(self) -> str:
        """Return the value in a unit that engineers use."""
        if self.value is None:
            return "not set" if self.resolved is None else f"{self.resolved:,}"
        if self.unit:
            return pretty_quantity(self.value, self.unit)
        if isinstance(self.value, Enum):
            return str(self.value.value)
        if isinstance(self.value, tuple):
            return ", ".join(v if isinstance(v, str) else f"{v:,}" for v in self.value) or "none"
        if isinstance(self.value, bool):
            return str(self.value).lower()  # as TOML writes it
        return self.value if isinstance(self.value, str) else pretty_number(self.value, 15)

    @property
    def toml(self) -> str:
        """Return the value as TOML, exactly."""
        if self.unit:
            return f'"{exact_quantity(self.value, self.unit)}"'
        if isinstance(self.value, Enum):
            return json.dumps(self.value.value)
        if isinstance(self.value, tuple):
            return json.dumps(list(self.value))
        if isinstance(self.value, Path):
            return json.dumps(str(self.value), ensure_ascii=False)
        if not isinstance(self.value, bool | str) and 1e4 <= self.value < 1e15 and self.value == int(self.value):
            return f"{int(self.value):_}"  # 100_000, as one types it
        return json.dumps(self.value, ensure_ascii=False)


def entries(model: BaseModel, table: tuple[str, ...] = ()) -> Iterator[Entry]:
    """Yield every key of `model`, its own first and then those of its tables, in the order of the models.

    Tables of free content are left out.
    """
    fields = {name: info for name, info in type(model).model_fields.items()
              if not isinstance(getattr(model, name), dict)}
    tables = [name for name in fields if isinstance(getattr(model, name), BaseModel)]
    for name, info in fields.items():
        if name not in tables:
            value = getattr(model, name)
            yield Entry(table, name, value, unit_of(type(model), name), _meaning(info),
                        not info.is_required() and value == info.get_default(call_default_factory=True),
                        getattr(model, f"resolved_{name}", value))
    for name in tables:
        yield from entries(getattr(model, name), (*table, name))


def dump_case(case: Case) -> str:
    """Return `case` as a case file that parses to an equal case."""
    lines: list[str] = []
    table: tuple[str, ...] = ()
    for entry in entries(case):
        if entry.table != table:
            table = entry.table
            lines += ["", f"[{'.'.join(table)}]"]
        if entry.value is not None:
            lines.append(f"{entry.key} = {entry.toml}")
    for name, content in case.effects.items():
        lines += ["", f"[effects.{name}]", *(f"{key} = {json.dumps(value)}" for key, value in content.items())]
    return "\n".join(lines) + "\n"


def starting_case() -> str:
    """Return a commented case file: what must be given is set, every default is shown as a comment."""
    case = validate_case(_START)
    lines = [
        "# A case file of fretflow. Physical numbers are text with a unit, in any unit of their dimension.",
        "# Keys behind a '#' show their default; `fretflow show FILE` lists all values that a run would use.",
        "",
    ]
    table: tuple[str, ...] = ()
    for entry in entries(case):
        if entry.table == ("specimen", "lower"):
            continue
        if entry.table != table:
            table = entry.table
            lines += ["", *_heading(table)]
        given = entry.key in _given(table)
        if entry.value is None:
            line = f"# {entry.key} is not set"
        else:
            value = f'"{format_quantity(entry.value, entry.unit)}"' if entry.unit else entry.toml
            line = f"{'' if given else '# '}{entry.key} = {value}"
        lines.append(f"{line:<46}  # {entry.meaning}")
    return "\n".join(lines) + "\n"


def _given(table: tuple[str, ...]) -> dict[str, Any]:
    content: Any = _START
    for name in table:
        content = content.get(name, {})
    return dict(content)


def _heading(table: tuple[str, ...]) -> list[str]:
    if table == ("specimen", "upper"):
        return ["# Both specimens; [specimen.upper] and [specimen.lower] take the keys in which they differ.",
                "[specimen]"]
    return [f"[{'.'.join(table)}]"]


def _meaning(info: FieldInfo) -> str:
    text = info.description or ""
    if isinstance(info.annotation, type) and issubclass(info.annotation, Enum):
        return f"{text}: {' or '.join(info.annotation)}"
    return text


def unit_of(model: type[BaseModel], name: str) -> str:
    """Return the SI unit of a field, nothing where it has none."""
    info = model.model_fields[name]
    for mark in (*info.metadata, *_nested_metadata(info.annotation)):
        if isinstance(mark, Unit):
            return mark.unit
    return ""


def _nested_metadata(annotation: Any) -> tuple[Any, ...]:
    """Return the metadata of ``Annotated`` types inside an optional type."""
    return tuple(mark for option in get_args(annotation) for mark in getattr(option, "__metadata__", ()))
