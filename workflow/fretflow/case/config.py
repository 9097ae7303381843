"""The case file: every input of a run, validated, in SI units."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, Field, ValidationError, model_validator
from pydantic_core import ErrorDetails

from fretflow.case.sections import (
    SIDES,
    BodyShape,
    ContactSection,
    FaceShape,
    FrequencyResponse,
    Measured,
    Mesh,
    Output,
    PeriodicMethod,
    PreloadContact,
    Reduction,
    Rig,
    Section,
    SlidingRegime,
    Solver,
    Specimen,
    Specimens,
    Test,
    Title,
    Wear,
    WearScheme,
)
from fretflow.core.errors import ConfigError, missing_last, reason
from fretflow.core.files import CASE, no_file, read_toml

__all__ = [
    "BodyShape", "Case", "ContactSection", "FaceShape", "FrequencyResponse", "Measured", "Mesh", "Output",
    "PeriodicMethod", "PreloadContact", "Reduction", "Rig", "Section", "SlidingRegime", "Solver", "Specimen",
    "Specimens", "Test", "Wear", "WearScheme", "explain", "load_case", "slice_hash", "validate_case",
]

WAY_OUT = "a case is a TOML file, and `fretflow init` writes one to start from"


class Case(Section):
    """A whole case file, in SI; `load_case` reads one. A changed copy is made by ``model_copy``.

    Examples
    --------
    >>> import fretflow as ff
    >>> case = ff.load_case("examples/quick.toml")
    >>> case.test.excitation_frequency, case.contact.friction_coefficient  # Hz, 1
    (100.0, 0.88)
    """

    format: Literal["fretflow-case/1"] = Field(description="format of this file")
    name: str = Field(
        pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=100,  # of a file's 255, as other names are made of it
        description="name of the case; names its result folder"
    )
    title: Title = Field("", description="one line for people")
    test: Test
    rig: Rig = Field(default_factory=Rig)
    specimen: Specimens = Field(default_factory=Specimens)
    mesh: Mesh = Field(default_factory=Mesh)
    reduction: Reduction = Field(default_factory=Reduction)
    contact: ContactSection = Field(default_factory=ContactSection)
    solver: Solver = Field(default_factory=Solver)
    wear: Wear = Field(default_factory=Wear)
    output: Output = Field(default_factory=Output)
    measured: Measured = Field(default_factory=Measured)
    effects: dict[str, dict[str, Any]] = Field(
        default_factory=dict, description="physics beyond the baseline, a table [effects.<id>] each")

    @model_validator(mode="after")
    def _asked_cycles_are_reached(self) -> Case:
        for key in ("loop_cycles", "wear_map_cycles"):
            if max(getattr(self.output, key), default=0) > self.test.total_cycles:
                raise ValueError(f"output.{key} goes beyond the {self.test.total_cycles} cycles of the test")
        return self


def load_case(path: Path | str) -> Case:
    """Read and validate a case file.

    Parameters
    ----------
    path : Path or str
        A TOML file in which every physical number is text with its unit; ``fretflow init`` writes one.

    Returns
    -------
    Case
        In SI.

    Raises
    ------
    ConfigError
        Naming the file, the field and the way out.

    Examples
    --------
    >>> import fretflow as ff
    >>> ff.load_case("examples/test1.toml").test.normal_load  # N
    60.0
    """
    path = Path(path)
    raw = read_toml(path, ConfigError, WAY_OUT, formats=(CASE,))
    case = validate_case(raw, source=str(path))
    given = {side: file for side in SIDES if (file := getattr(case.mesh, side)) is not None}
    meshes = {side: (path.parent / file).resolve() for side, file in given.items()}
    for side, mesh in meshes.items():
        if not mesh.is_file():
            raise ConfigError(f"{path}: mesh.{side}: {no_file(mesh)}; the path counts from the case file's folder")
    return case.model_copy(update={"mesh": case.mesh.model_copy(update=meshes)}) if meshes else case


def validate_case(raw: dict[str, Any], source: str = "case") -> Case:
    """Validate a parsed case file; `source` names it in errors.

    Raises
    ------
    ConfigError
        Naming the first field in error, why, and the way out.
    """
    try:
        return Case.model_validate(raw)
    except ValidationError as error:
        raise ConfigError(f"{source}: {explain(error, raw)}") from error


def explain(error: ValidationError, raw: dict[str, Any], table: str = "", model: type[BaseModel] = Case,
            shown_by: str = "`fretflow init` writes a file with") -> str:
    """Return one line that names the first field in error, as the parsed file `raw` has it, and the way out."""
    reasons = {_as_written(e["loc"], raw): _reason(e, model, shown_by) for e in missing_last(error)}
    field, reason = next(iter(reasons.items()))
    more = f" (and {len(reasons) - 1} more)" if len(reasons) > 1 else ""
    return ": ".join(filter(None, (".".join(filter(None, (table, field))), reason))) + more


def _as_written(location: tuple[int | str, ...], raw: dict[str, Any]) -> str:
    """Name a field as the file has it: a key under [specimen] holds for both sides but stands there once."""
    if location[:1] == ("specimen",) and len(location) > 1:
        own = _table(raw, "specimen", str(location[1]))
        if not own or (len(location) > 2 and location[2] not in own):
            location = (location[0], *location[2:])
    return ".".join(str(part) for part in location)


def _table(raw: Any, *names: str) -> Any:
    for name in names:
        raw = raw.get(name, {}) if isinstance(raw, dict) else {}
    return raw


def _reason(error: ErrorDetails, model: type[BaseModel], shown_by: str) -> str:
    clearer = {
        "extra_forbidden": f"unknown key; {shown_by} all known ones",
        "missing": f"is required; {shown_by} it",
        "dict_type": f"must be a table of keys; {shown_by} them",
        "model_type": f"must be a table of keys; {shown_by} them",
        "string_pattern_mismatch": "takes letters, digits, '.', '_', '-' and begins with one of the first two",
    }
    return reason(error, clearer, model)


def slice_hash(*parts: Any) -> str:
    """Return a short stable hash of sections and plain data."""
    text = json.dumps(parts, sort_keys=True, default=_plain)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def _plain(part: object) -> object:
    if isinstance(part, BaseModel):
        return part.model_dump(mode="json")
    raise TypeError(f"{type(part).__name__} has no stable text to hash")
