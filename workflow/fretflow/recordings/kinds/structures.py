"""Recordings of structures with friction joints: what is known of the structure, and how it was seen to vibrate.

::

    [test]
    kind = "structure"
    [structure]
    matrices = "structure.npz"
    friction_coefficient = 0.6
    [structure.unknown]
    bolt_load = ["2 kN", "20 kN"]
    modal_damping = [1e-4, 1e-2]
    [backbone]
    file = "backbone.csv"
    amplitude_of = "tip"
    amplitude = { column = "a", unit = "m/s^2" }
    frequency = { column = "f", unit = "Hz" }
    damping = { column = "zeta", unit = "%" }
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

import numpy as np
from pydantic import ValidationError

from fretflow.case.bolted import Elasticity
from fretflow.case.config import explain
from fretflow.case.plausibility import beyond
from fretflow.core import units as u
from fretflow.core.errors import ConfigError, UnreliableRecordingError
from fretflow.core.records import Array, quantity, record
from fretflow.recordings.description import file_at, read_description, validated
from fretflow.recordings.kinds import RecordingKind
from fretflow.recordings.kinds.joints import STRUCTURE
from fretflow.recordings.kinds.structure_columns import StructureColumn, read_column, stated_sd
from fretflow.recordings.kinds.structure_sections import (
    TYPICAL,
    BackboneBlock,
    Control,
    FreeBlock,
    ResponseBlock,
    StructureFile,
    StructureSection,
)
from fretflow.recordings.kinds.worn_profiles import (
    LineContactSection,
    WornArea,
    WornMapBlock,
    WornProfile,
    read_profile,
    read_volumes,
    read_worn_map,
)
from fretflow.recordings.notes import Note
from fretflow.recordings.readers.structure_files import read_structure
from fretflow.recordings.readers.tables import read_table
from fretflow.recordings.schema import name_of
from fretflow.structure.matrices import StructureMatrices
from fretflow.structure.meshed import assembled_bodies, round_bolts

MODAL = "modal"  # the amplitude is the mass-normalised one of the mode
MODAL_UNIT = "m*kg^0.5"
MOTIONS = ("m", "m/s", "m/s^2")
FEWEST = 3  # points of a backbone


@record
class MeasuredBackbone:
    """A measured backbone of P points, amplitude rising."""

    amplitude_of: str
    mode: int | None
    amplitude: Array = quantity("SI", "(P,), in `amplitude_unit`")
    amplitude_unit: str
    frequency: Array = quantity("Hz", "(P,)")
    damping: Array | None = quantity("1", "(P,)")
    frequency_sd: float | None = quantity("Hz")
    damping_sd: float | None = quantity("1")
    calibration_sd: float = quantity("1", "of the amplitude")


@record
class ControlledResponse:
    """A measured frequency response of P points, force and amplitude as they were."""

    control: Control
    of: str
    at: str | None
    level: float | None
    frequency: Array = quantity("Hz", "(P,)")
    force: Array | None = quantity("N", "(P,)")
    amplitude: Array = quantity("SI", "(P,)")
    amplitude_unit: str
    phase: Array | None = quantity("rad", "(P,)")


@record
class RingDown:
    """Free decays: time (P,) in s and named channels (P,) in SI."""

    time: Array = quantity("s", "(P,)")
    channels: Mapping[str, Array]
    units: Mapping[str, str]


@record
class StructureRecording:
    """A recording of a structure, in SI."""

    kind: ClassVar[RecordingKind] = STRUCTURE

    path: Path
    title: str
    matrices: StructureMatrices
    known: Mapping[str, float]  # bolt_load N, modal_damping unless C tells it, friction_coefficient: what is given
    unknown: Mapping[str, tuple[float, float]]  # and the ranges of the others
    backbone: MeasuredBackbone | None
    responses: tuple[ControlledResponse, ...]
    ring_down: RingDown | None
    notes: tuple[Note, ...]


@record
class WornRecording:
    """A recording of what a line contact wore, in SI."""

    kind: ClassVar[RecordingKind] = STRUCTURE

    path: Path
    title: str
    contact: LineContactSection
    friction: tuple[float, float]  # coefficient, or its range
    profiles: tuple[WornProfile, ...]
    areas: tuple[WornArea, ...]  # of tests whose volume alone is known
    notes: tuple[Note, ...]


def read_structure_recording(path: Path) -> StructureRecording | WornRecording:
    """Read a recording of a structure: its folder or its ``recording.toml``.

    Raises
    ------
    RecordingError
        If a file is damaged, or a backbone has gaps, amplitudes that fall, or one of zero.
    InputError
        Naming the file and the field or matrix that cannot be.
    """
    toml = file_at(path)
    file = _load(toml)
    own = file.structure
    if own.line_contact is not None:
        return _worn(path, file, own.line_contact, toml.parent)
    matrices = _matrices(toml, own)
    notes: list[Note] = []
    known = {name: float(value) for name in TYPICAL if (value := getattr(own, name)) is not None}
    if matrices.modal_damping is not None and own.unknown.modal_damping is None:
        known.setdefault("modal_damping", matrices.modal_damping)
    unknown = {}
    for name, typical in TYPICAL.items():
        if name in known or (name == "modal_damping" and _is_in_matrices(matrices, own)):
            continue
        stated = getattr(own.unknown, name)
        unknown[name] = stated or typical
        if stated is None:
            notes.append(Note("structure", f"{name} is neither known nor given a range; {typical[0]:g} to "
                                           f"{typical[1]:g} in SI is taken"))
    backbone = None if file.backbone is None else _backbone(file.backbone, toml.parent, matrices)
    if file.backbone is not None and backbone is not None and backbone.damping is not None:
        notes += _without_friction(file.backbone, float(backbone.damping.min()), unknown.get("modal_damping"))
    responses = tuple(_response(block, toml.parent, matrices) for block in file.frf)
    ring_down = None if file.ring_down is None else _ring_down(file.ring_down, toml.parent)
    if backbone is None and not responses and ring_down is None:
        raise ConfigError(f"{toml}: give at least one of the blocks backbone, frf and ring_down")
    notes += _implausible(known if own.mesh is None else {
        **known, "youngs_modulus": _material(toml, own).youngs_modulus})
    notes += [Note(name, "is compared where structure.line_contact is given alone") for name in (
        "profile", "wear_depth", "volumes") if getattr(file, name)]
    return StructureRecording(path=path, title=file.title or name_of(path), matrices=matrices, known=known,
                              unknown=unknown, backbone=backbone, responses=responses, ring_down=ring_down,
                              notes=tuple(notes))


def _is_in_matrices(matrices: StructureMatrices, own: StructureSection) -> bool:
    """Tell whether C tells the damping ratio of each mode: where none is stated."""
    return matrices.damping is not None and own.unknown.modal_damping is None


def _implausible(known: Mapping[str, float]) -> list[Note]:
    modulus = "Pa", "specimen.youngs_modulus"
    keys = {"friction_coefficient": ("1", "contact.friction_coefficient"), "youngs_modulus": modulus}
    return [Note("structure", said) for name, key in keys.items() if name in known
            for said in beyond(name, known[name], *key)]


def _matrices(toml: Path, own: StructureSection) -> StructureMatrices:
    if own.mesh is None:
        return read_structure(toml.parent / str(own.matrices))
    return assembled_bodies(toml.parent / own.mesh, own, _material(toml, own), round_bolts(own.bolts))


def _material(toml: Path, own: StructureSection) -> Elasticity:
    given = own.material if isinstance(own.material, dict) else {}
    try:
        return Elasticity.model_validate(given)
    except ValidationError as error:
        raise ConfigError(f"{toml}: structure.material.{explain(error, given, model=Elasticity)}") from error


def _worn(path: Path, file: StructureFile, contact: LineContactSection, folder: Path) -> WornRecording:
    profiles = tuple(read_profile(block, folder) for block in file.profile)
    areas = () if file.volumes is None else read_volumes(file.volumes, folder)
    if file.wear_depth is not None:
        given_map = {"file": file.wear_depth.file, **file.wear_depth.columns}
        try:
            profiles += (read_worn_map(WornMapBlock.model_validate(given_map), folder),)
        except ValidationError as error:
            raise ConfigError(f"{path}: wear_depth.{explain(error, given_map, model=WornMapBlock)}") from error
    if not profiles:
        raise ConfigError(f"{path}: structure.line_contact needs a block profile or wear_depth")
    given = file.structure.friction_coefficient
    low, high = file.structure.unknown.friction_coefficient or TYPICAL["friction_coefficient"]
    notes = [Note(name, "is not compared for a line contact") for name in ("backbone", "frf", "ring_down")
             if getattr(file, name)]
    notes += _implausible({"youngs_modulus": contact.youngs_modulus,
                           **({} if given is None else {"friction_coefficient": float(given)})})
    return WornRecording(path=path, title=file.title or name_of(path), contact=contact, profiles=profiles, areas=areas,
                         friction=(low, high) if given is None else (given, given), notes=tuple(notes))


def _load(toml: Path) -> StructureFile:
    raw = read_description(toml)
    for name in ("frf", "profile"):
        if isinstance(raw.get(name), dict):
            raw[name] = [raw[name]]
    return validated(StructureFile, raw, toml)


def _named(block: str, name: str, there: Mapping[str, Array], what: str) -> None:
    if name not in there:
        raise ConfigError(f"{block}: {name!r} is no {what} of the structure; it has {', '.join(there) or 'none'}")


def _backbone(block: BackboneBlock, folder: Path, matrices: StructureMatrices) -> MeasuredBackbone:
    modal = block.amplitude_of == MODAL
    if not modal:
        _named("backbone.amplitude_of", block.amplitude_of, matrices.outputs, "output")
    wanted = [str(spec.column) for spec in (block.amplitude, block.frequency, block.damping) if spec is not None]
    table = read_table(folder / block.file, wanted)
    units = (MODAL_UNIT, "1") if modal else MOTIONS
    amplitude, unit = read_column(table, "backbone", "amplitude", block.amplitude, units)
    frequency, _ = read_column(table, "backbone", "frequency", block.frequency, ("Hz",))
    damping = None if block.damping is None else read_column(table, "backbone", "damping", block.damping, ("1",))[0]
    where = f"{table.path}: backbone"
    if len(set(amplitude)) < FEWEST:
        raise UnreliableRecordingError(f"{where}: {len(set(amplitude))} points tell no trend; give {FEWEST} or more "
                                       "different amplitudes")
    _check_positive(where, amplitude=amplitude, frequency=frequency)
    falls = np.flatnonzero(np.diff(amplitude) < 0.0)
    if falls.size:
        raise UnreliableRecordingError(f"{where}: the amplitude falls at row {falls[0] + 2}; sort the rows by it")
    if damping is not None and (below := np.flatnonzero(damping < 0.0)).size:
        raise UnreliableRecordingError(f"{where}: damping must not be negative, row {below[0] + 1} has "
                                       f"{damping[below[0]]:g}; leave out such rows, or their damping all over")
    if damping is not None and not np.all(damping < 1.0):
        raise UnreliableRecordingError(f"{where}: damping must be a ratio from 0 to 1, it goes from {damping.min():g} "
                                       f"to {damping.max():g}; name its unit, for example \"%\"")
    if damping is not None and not damping.any():
        raise UnreliableRecordingError(f"{where}: damping holds only zeros; leave it out, so that frequencies alone "
                                       "are compared")
    return MeasuredBackbone(
        amplitude_of=block.amplitude_of, mode=block.mode, amplitude=amplitude,
        amplitude_unit=MODAL_UNIT if modal else unit, frequency=frequency, damping=damping,
        frequency_sd=stated_sd("backbone", "frequency", block.frequency, "Hz"),
        damping_sd=None if block.damping is None else stated_sd("backbone", "damping", block.damping, "1"),
        calibration_sd=block.amplitude.calibration_sd)


def _check_positive(where: str, **columns: Array) -> None:
    for name, values in columns.items():
        if not np.all(values > 0.0):
            raise UnreliableRecordingError(f"{where}: {name} must be positive, row {int(np.argmin(values)) + 1} has "
                                           f"{values.min():g}; leave such rows out")


def _without_friction(block: BackboneBlock, least: float, modal: tuple[float, float] | None) -> list[Note]:
    """Return what contradicts that friction only adds to the modal damping, in its range unless that is known.

    Raises
    ------
    ConfigError
        If all that is recorded is above the modal damping's range, the usual one if it is known, without a unit.
    """
    low, high = modal or TYPICAL["modal_damping"]
    if block.damping is not None and not block.damping.unit and least > high:
        raise ConfigError(f"backbone.damping.unit: is required, as the smallest damping, {least:g}, is above the range "
                          f'of modal_damping, {low:g} to {high:g}; write "%", or "1" if it is a ratio')
    if modal is None or least >= low:
        return []
    return [Note("backbone", f"the smallest damping ratio, {least:.2g}, is below the range of modal_damping, "
                             f"{low:g} to {high:g}, to which friction adds; check its unit and the range")]


def _response(block: ResponseBlock, folder: Path, matrices: StructureMatrices) -> ControlledResponse:
    _named("frf.of", block.of, matrices.outputs, "output")
    if block.at is not None:
        _named("frf.at", block.at, {**matrices.inputs, **matrices.outputs}, "input or output")
    specs = {"frequency": ("Hz",), "force": ("N",), "amplitude": MOTIONS, "phase": ("rad",)}
    table = read_table(folder / block.file, [str(own.column) for name in specs
                                             if (own := getattr(block, name)) is not None])
    columns: dict[str, Array] = {}
    unit = ""
    for name, choices in specs.items():
        spec = getattr(block, name)
        if spec is not None:
            columns[name], si = read_column(table, "frf", name, spec, choices)
            unit = si if name == "amplitude" else unit
    _check_positive(f"{table.path}: frf", **{name: columns[name] for name in ("frequency", "force", "amplitude")
                                             if name in columns})
    level = block.level
    if isinstance(level, str):
        try:
            level = u.parse_quantity(level, "N" if block.control is Control.FORCE else unit)
        except ValueError as error:
            raise ConfigError(f"frf.level: {error}") from error
    if level is not None and level <= 0.0:
        raise ConfigError(f"frf.level: must be positive, got {block.level!r}")
    return ControlledResponse(control=block.control, of=block.of, at=block.at, level=level, amplitude_unit=unit,
                              frequency=columns["frequency"], force=columns.get("force"),
                              amplitude=columns["amplitude"], phase=columns.get("phase"))


def _ring_down(block: FreeBlock, folder: Path) -> RingDown:
    try:
        specs = {name: StructureColumn.model_validate(entry) for name, entry in block.columns.items()}
    except ValidationError as error:
        raise ConfigError(f'ring_down: each key but file is a table such as {{ column = "a", unit = "m/s^2" }} '
                          f"({error.errors()[0]['msg']})") from error
    if block.file is None or "time" not in specs or len(specs) < 2:
        raise ConfigError("ring_down: file, time and at least one channel are required")
    table = read_table(folder / block.file, [str(spec.column) for spec in specs.values()])
    time, _ = read_column(table, "ring_down", "time", specs.pop("time"), ("s",))
    if len(time) < FEWEST:
        raise UnreliableRecordingError(f"{table.path}: ring_down: {len(time)} samples are no decay")
    if not np.all(np.diff(time) > 0.0):
        raise UnreliableRecordingError(f"{table.path}: ring_down: time does not rise throughout")
    columns = {name: read_column(table, "ring_down", name, spec, MOTIONS) for name, spec in specs.items()}
    return RingDown(time=time, channels={name: values for name, (values, _) in columns.items()},
                    units={name: unit for name, (_, unit) in columns.items()})
