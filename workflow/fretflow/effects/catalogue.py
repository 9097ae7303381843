"""All effects there are: the files of this room, entry points of other packages, and files in a user's folder.

The folders are those that the variable FRETFLOW_EFFECTS names, separated as in PATH; the entry points are of the group
``fretflow.effects`` and name an effect's class.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import pkgutil
import sys
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any
from zlib import crc32

from pydantic import ValidationError

from fretflow.case.casefile import entries, unit_of
from fretflow.case.config import explain
from fretflow.core.errors import ConfigError, InputError, did_you_mean
from fretflow.core.units import exact_quantity
from fretflow.effects.effect import Effect
from fretflow.recordings.kinds import RecordingKind

GROUP = "fretflow.effects"
FOLDERS = "FRETFLOW_EFFECTS"
MODULES = "fretflow_user_effects_"  # begins the names of the modules that users' files are
REQUIRED = ("id", "title", "block", "equation", "source", "observables")


def catalogue() -> Mapping[str, type[Effect]]:
    """Return all effects by id, sorted.

    Returns
    -------
    mapping of str to type
        Each a subclass of `Effect`, which tells its equation, source, parameters with units, and what it shows in.

    Raises
    ------
    InputError
        If a user's file cannot be loaded, or two effects share an id.

    Examples
    --------
    >>> import fretflow as ff
    >>> viscous = ff.catalogue()["viscous"]
    >>> viscous.title, viscous(damping="500 N*s/m").damping
    ('dashpot beside the contact', 500.0)
    """
    return _collect(os.environ.get(FOLDERS, ""))


def add_effects(folder: Path | str) -> Mapping[str, type[Effect]]:
    """Add the effects in the Python files of `folder` to the catalogue, for this process and those that it starts.

    Returns
    -------
    mapping of str to type
        The whole catalogue, by id.

    Raises
    ------
    InputError
        If a file cannot be loaded, lacks what an effect has to say, or has an id that is taken.

    Examples
    --------
    >>> import fretflow as ff
    >>> ff.add_effects("examples/own_effects")["friction-bump"].equation
    'mu (1 + a exp(-(x / w)^2))'
    """
    before = os.environ.get(FOLDERS, "")
    folders = os.pathsep.join(dict.fromkeys([*filter(None, before.split(os.pathsep)), str(Path(folder).resolve())]))
    effects = _collect(folders)  # which refuses what cannot be used
    os.environ[FOLDERS] = folders
    return effects


def described(effect: str, field: str) -> tuple[str, str]:
    """Return the SI unit and the meaning of an effect's parameter."""
    kind = catalogue()[effect]
    return unit_of(kind, field) or "1", kind.model_fields[field].description or ""


def is_own(kind: type[Any]) -> bool:
    """Tell whether an effect is a user's or another package's: its ranges are of the user's joint, not of a rig's."""
    return issubclass(kind, Effect) and not kind.__module__.startswith(f"{__package__}.")


def import_own() -> None:
    """Import users' effects where there are any, so that what refers to them can be unpickled."""
    if os.environ.get(FOLDERS):
        catalogue()


def parse_effects(tables: Mapping[str, Mapping[str, Any]], source: str = "case") -> tuple[Effect, ...]:
    """Return the effects of a case's ``[effects.<id>]`` tables, sorted by id.

    Raises
    ------
    ConfigError
        Naming `source`, the effect and its field.
    """
    effects = []
    for name in sorted(tables):
        known = catalogue()
        if name not in known:
            raise ConfigError(f"{source}: effects.{name}: there is no such effect; `fretflow effects` lists them"
                              f"{did_you_mean(name, known) or _unread()}")
        try:
            effects.append(known[name].model_validate(dict(tables[name])))
        except ValidationError as error:
            said = explain(error, {}, f"effects.{name}", known[name])
            raise ConfigError(f"{source}: {said}; `fretflow effects {name}` describes it") from error
    check_together(effects, source)
    return tuple(effects)


def _unread() -> str:
    """Return a hint at the variable that names the folders of users' effects, where it names none."""
    return "" if os.environ.get(FOLDERS) else f"; one of your own needs its folder in {FOLDERS}"


def check_together(effects: Iterable[Effect], source: str = "effects") -> None:
    """Check that `effects` work together.

    Raises
    ------
    ConfigError
        Naming the two that do not, and why.
    """
    chosen = {effect.id: effect for effect in effects}
    for name, effect in chosen.items():
        for other, why in effect.excludes.items():
            if other in chosen:
                raise ConfigError(f"{source}: effects.{name} and effects.{other} do not work together: {why}")


def tables(effects: Iterable[Effect]) -> dict[str, dict[str, Any]]:
    """Return `effects` as tables of a case file, exactly; parameters that are not set are left out."""
    return {effect.id: {entry.key: exact_quantity(entry.value, entry.unit) if entry.unit else entry.value
                        for entry in entries(effect) if entry.value is not None}
            for effect in sorted(effects, key=lambda effect: effect.id)}


@cache
def _collect(folders: str) -> Mapping[str, type[Effect]]:
    effects: dict[str, type[Effect]] = {}
    origin: dict[str, str] = {}
    for kind, where in (*_own(), *_of_entry_points(), *_of_folders(folders)):
        lacking = [name for name in REQUIRED if not hasattr(kind, name)]
        if lacking:
            raise InputError(f"{where}: effect {kind.__name__} lacks {', '.join(lacking)}")
        if not all(isinstance(one, RecordingKind) for one in kind.kinds):
            raise InputError(f"{where}: effect {kind.id!r}: kinds must be a set of kinds of recordings, such as "
                             f"ff.ALL_KINDS, got {kind.kinds!r}")
        if kind.id in effects:
            raise InputError(f"{where}: effect {kind.id!r} is already that of {origin[kind.id]}; give it another id")
        effects[kind.id], origin[kind.id] = kind, where
    return MappingProxyType(dict(sorted(effects.items())))


def _effects_of(module: ModuleType) -> Iterator[type[Effect]]:
    for value in vars(module).values():
        if isinstance(value, type) and issubclass(value, Effect) and value.__module__ == module.__name__ \
                and value is not Effect:
            yield value


def _own() -> Iterator[tuple[type[Effect], str]]:
    import fretflow.effects as room

    for info in pkgutil.iter_modules(room.__path__):
        module = importlib.import_module(f"{room.__name__}.{info.name}")
        for kind in _effects_of(module):
            yield kind, f"fretflow/effects/{info.name}.py"


def _of_entry_points() -> Iterator[tuple[type[Effect], str]]:
    for point in entry_points(group=GROUP):
        kind = point.load()
        if not (isinstance(kind, type) and issubclass(kind, Effect)):
            raise InputError(f"entry point {point.name} of {GROUP}: {point.value} is no effect's class")
        yield kind, f"entry point {point.name}"


def _of_folders(folders: str) -> Iterator[tuple[type[Effect], str]]:
    for folder in filter(None, folders.split(os.pathsep)):
        files = sorted(Path(folder).glob("*.py"))
        if not files:
            raise InputError(f"{FOLDERS}: no .py file in {folder}; name the folder of an effect's file")
        for file in files:
            yield from ((kind, str(file)) for kind in _effects_of(_load(file)))


def _load(file: Path) -> ModuleType:
    # Of two folders' files of one name each is a module; other processes import both under the same names.
    name = f"{MODULES}{file.stem}_{crc32(str(file.resolve()).encode()):x}"
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise InputError(f"{file}: cannot be loaded as Python")
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # users' code may fail in any way
        del sys.modules[name]
        raise InputError(f"{file}: {type(error).__name__}: {error}") from error
    return module
