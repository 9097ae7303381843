"""The keys of case files and recordings, from the models that read them."""

from __future__ import annotations

import json
import types
from collections.abc import Iterable, Iterator
from enum import Enum
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from pages.markdown import escape, prose, table


def case_keys() -> str:
    """Return every key of a case file, table by table."""
    from fretflow.case.config import Case

    return "\n\n".join(key_tables(Case)) + "\n"


def recording_keys() -> str:
    """Return every key of a ``recording.toml``, and the channels."""
    from fretflow.recordings.channels import CHANNELS
    from fretflow.recordings.schema import ChannelSpec, RecordingFile

    shared = ("rig", "specimen")
    channels = table(("channel", "SI unit"), ((f"`{name}`", " or ".join(f"`{unit}`" for unit in units))
                                              for name, units in CHANNELS.items()))
    return "\n\n".join([*key_tables(RecordingFile, skip=shared),
                        "### A channel", key_table(ChannelSpec), "### Names of channels", channels]) + "\n"


def bolted_keys() -> str:
    """Return every key of the case file of a bolted structure."""
    from fretflow.case.bolted import BoltedCase

    return "\n\n".join(key_tables(BoltedCase)) + "\n"


def structure_keys() -> str:
    """Return every key of a recording of a structure."""
    from fretflow.recordings.kinds.structure_sections import StructureFile

    return "\n\n".join(key_tables(StructureFile)) + "\n"


def key_tables(model: type[BaseModel], name: str = "", skip: tuple[str, ...] = ()) -> Iterator[str]:
    """Yield heading, explanation and keys of `model`, then of the tables in it."""
    from fretflow.case.config import Specimens

    if model is Specimens:
        yield from key_tables(get_args(model)[0] if get_args(model) else model.model_fields["upper"].annotation, name)
        yield ("`[specimen.upper]` and `[specimen.lower]` take the same keys, for what differs between the two; "
               "keys under `[specimen]` hold for both.")
        return
    yield f"### `[{name}]`" if name else "### At the top"
    yield prose(model.__doc__)
    if keys := key_table(model):
        yield keys
    for key, info in model.model_fields.items():
        if key not in skip and (inner := table_in(info)):
            origin = get_origin(plain_type(info.annotation))
            double, inside = origin is tuple, f"{name}.{key}" if name else key
            inside += ".NAME" if origin is dict else ""
            yield from key_tables(inner, f"[{inside}]" if double else inside)


def key_table(model: type[BaseModel]) -> str:
    """Return the keys of `model` that are no tables, with unit, default and limits."""
    rows = [(name_of(key, info), kind_of(info), default_of(info), limits_of(info), escape(info.description or ""))
            for key, info in model.model_fields.items()
            if table_in(info) is None and (get_origin(plain_type(info.annotation)) is not dict or info.description)]
    return table(("key", "takes", "default", "limits", "meaning"), rows) if rows else ""


def name_of(key: str, info: FieldInfo) -> str:
    """Return a key as it is written: that of channels stands for the name of each."""
    kind = plain_type(info.annotation)
    return "name of each channel" if get_origin(kind) is dict and is_channel(get_args(kind)[1]) else f"`{key}`"


def plain_type(annotation: Any) -> Any:
    """Return a type without ``None`` beside it and without annotations."""
    options = get_args(annotation) if get_origin(annotation) in (Union, types.UnionType) else (annotation,)
    kept = [option for option in options if option is not type(None)]
    first = kept[0]
    return get_args(first)[0] if hasattr(first, "__metadata__") else (first if len(kept) == 1 else annotation)


def table_in(info: FieldInfo) -> type[BaseModel] | None:
    """Return the model of a key that is a table, an array of tables, or tables with names of their own."""
    kind = plain_type(info.annotation)
    if get_origin(kind) in (tuple, dict):
        kind = get_args(kind)[get_origin(kind) is dict]
    return kind if isinstance(kind, type) and issubclass(kind, BaseModel) and not is_channel(kind) else None


def is_channel(kind: Any) -> bool:
    """Return whether a type is the table of one column, which is told once."""
    return isinstance(kind, type) and issubclass(kind, BaseModel) and "column" in kind.model_fields


def marks_of(info: FieldInfo) -> Iterator[Any]:
    """Yield the annotations of a key, also those inside an optional type."""
    yield from info.metadata
    for option in get_args(info.annotation):
        yield from getattr(option, "__metadata__", ())


def unit_of(info: FieldInfo) -> str:
    """Return the SI unit of a key, if it has one."""
    return unit_among(marks_of(info))


def unit_among(marks: Iterable[Any]) -> str:
    """Return the SI unit that one of `marks` tells; that of a ratio is none."""
    from fretflow.core.units import Unit
    from fretflow.recordings.kinds.structure_columns import Parsed

    return next((mark.unit for mark in marks if isinstance(mark, Unit | Parsed) and mark.unit != "1"), "")


def kind_of(info: FieldInfo) -> str:
    """Return in words what a key takes."""
    kind, unit = plain_type(info.annotation), unit_of(info)
    if get_origin(kind) is tuple:
        return in_brackets(get_args(kind), unit)
    if get_origin(kind) is dict and is_channel(get_args(kind)[1]):
        return "a channel"
    if unit:
        return f'text as `"1 {unit}"`'
    if is_channel(kind):
        return "a channel"
    if isinstance(kind, type) and issubclass(kind, Enum):
        return " or ".join(f'`"{option.value}"`' for option in kind)
    if get_origin(kind) is Literal:
        return " or ".join(f"`{json.dumps(option)}`" for option in get_args(kind))
    if get_origin(kind) in (Union, types.UnionType):
        return " or ".join(word(option) for option in get_args(kind) if option is not type(None))
    return word(kind)


def in_brackets(elements: tuple[Any, ...], unit: str) -> str:
    """Return in words what a list of `elements` takes, a range or a place where there are so many."""
    first = elements[0]
    unit = unit or unit_among(getattr(first, "__metadata__", ()))
    count = "" if Ellipsis in elements else f"{('two', 'three')[len(elements) - 2]} "
    if unit:
        return f'{count}texts as `"1 {unit}"` in brackets'
    return f"{count}{word(get_args(first)[0] if hasattr(first, '__metadata__') else first)}s in brackets"


def word(kind: Any) -> str:
    """Return the word for a type."""
    return "a table" if get_origin(kind) is dict else WORDS.get(kind, "text")


WORDS = {int: "whole number", float: "number", bool: "`true` or `false`", str: "text", Path: "path of a file"}


def default_of(info: FieldInfo) -> str:
    """Return the default as a case file would have it."""
    from fretflow.core.units import format_quantity

    if info.is_required():
        return "**required**"
    value = info.get_default(call_default_factory=True)
    if value is None or value in ("", ()):
        return "none"
    if unit := unit_of(info):
        return f'`"{format_quantity(value, unit)}"`'
    return f"`{json.dumps(value.value if isinstance(value, Enum) else value)}`"


def limits_of(info: FieldInfo) -> str:
    """Return the limits of a number."""
    names = {Ge: ("ge", "≥"), Gt: ("gt", ">"), Le: ("le", "≤"), Lt: ("lt", "<")}
    limits = [f"{sign} {getattr(mark, attribute):g}" for mark in marks_of(info)
              for kind, (attribute, sign) in names.items() if isinstance(mark, kind)]
    checks = {getattr(getattr(mark, "func", None), "__name__", "") for mark in marks_of(info)}
    return ", ".join(limits) or ("> 0" if "_positive" in checks else "≥ 0" if "_not_negative" in checks else "")
