"""The file ``recording.toml``: what was tested and which columns of which files hold what, validated, in SI.

The sections [rig] and [specimen] are those of case files. Every key is optional there; what is given wins over the
user's case, see `RecordingFile.given`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, Field, InstanceOf, field_validator, model_validator

from fretflow.case.config import Rig, Section, Specimens
from fretflow.core import units as u
from fretflow.core.errors import UnitError, did_you_mean
from fretflow.recordings.channels import CHANNELS, INDICES, unit_size
from fretflow.recordings.description import FILE as FILE
from fretflow.recordings.description import Description, read_description, validated
from fretflow.recordings.kinds import RecordingKind, kind_called

EXPORTED = "recording"  # the folder of a run that holds it as a recording


def name_of(path: Path) -> str:
    """Return what results of the recording at `path` are named after: its folder, or a single file without suffix.

    A folder that has the name of all exports is told by the one that it lies in.
    """
    whole = path.resolve()
    folder = whole.parent if whole.name == FILE else whole
    if not folder.is_dir():
        return whole.stem
    return f"{folder.parent.name}-{EXPORTED}".lstrip("-") if folder.name == EXPORTED else folder.name


def _kind(value: object) -> RecordingKind:
    if (kind := kind_called(value)).reader != RecordingKind.reader:
        raise ValueError(f"a {kind} is no recording of loops; `fretflow diagnose` reads it")
    return kind


class MeasuredAt(StrEnum):
    """Where a displacement was measured."""

    CONTACT_FACES = "contact-faces"
    BACK_FACES = "back-faces"
    DISTANCE = "distance"


@dataclass(frozen=True)
class DisplacementOf:
    """What a displacement is the relative displacement of; at a distance from the interface, it in m."""

    place: MeasuredAt
    distance: float = 0.0


def _displacement_of(value: object) -> DisplacementOf:
    if isinstance(value, DisplacementOf):
        return value
    if value in (MeasuredAt.CONTACT_FACES, MeasuredAt.BACK_FACES):
        return DisplacementOf(MeasuredAt(str(value)))
    try:
        distance = u.parse_quantity(value, "m")
    except ValueError as error:
        raise ValueError(f'{value!r} is none of "contact-faces", "back-faces" and a distance such as "1 mm"') from error
    if not distance > 0.0:
        raise ValueError(f'{value!r} is no distance from the interface; "contact-faces" is the interface itself')
    return DisplacementOf(MeasuredAt.DISTANCE, distance)


class RecordedTest(Section):
    """What was done to the joint, as far as it is known."""

    __test__ = False

    kind: Annotated[InstanceOf[RecordingKind], BeforeValidator(_kind)] = Field(
        description="what is to be predicted")
    excitation_frequency: u.Frequency | None = Field(None, description="frequency of the excitation")
    excitation_amplitude: u.Force | None = Field(None, description="amplitude of the exciting force")
    displacement_amplitude: u.Length | None = Field(None, description="amplitude of an imposed displacement")
    normal_load: u.Force | None = Field(None, description="static normal load")
    normal_load_sd: u.Force | None = Field(None, description="its standard deviation")
    cycles: int | None = Field(None, ge=0, description="length of the test in cycles")

    @model_validator(mode="after")
    def _sd_of_something(self) -> RecordedTest:
        if self.normal_load is None and self.normal_load_sd is not None:
            raise ValueError("normal_load_sd is given without normal_load")
        if self.normal_load is not None and (self.normal_load_sd or 0.0) >= self.normal_load:
            raise ValueError(f"normal_load_sd: {self.normal_load_sd:g} N is no less than the load; check its unit")
        return self


class RecordedWear(Section):
    """What was worn off by the end of the test, from both faces."""

    worn_volume: u.Volume | None = Field(None, description="volume worn off both faces")
    worn_volume_sd: u.Volume | None = Field(None, description="its standard deviation")

    @model_validator(mode="after")
    def _sd_of_something(self) -> RecordedWear:
        if self.worn_volume is None and self.worn_volume_sd is not None:
            raise ValueError("worn_volume_sd is given without worn_volume")
        return self


class ChannelSpec(Section):
    """One channel of a block: its column, unit and errors."""

    column: str | int = Field(description="heading of the column, or its place counted from 1")
    unit: str = Field("", description="unit of the numbers in the column")
    scale: float = Field(1.0, description="factor on the numbers in the column: -1 turns a reversed sign")
    sd: str | None = Field(None, description="standard deviation of one sample, with its unit")
    calibration_sd: float = Field(0.0, ge=0.0, lt=1.0, description="standard deviation of the gain, relative")


class FileBlock(Section):
    """A file of the recording and its channels."""

    file: str = Field(description="file, from the folder of recording.toml")
    channels: dict[str, ChannelSpec] = Field(description='its column: displacement = { column = "x_um", unit = "um" }')

    @model_validator(mode="before")
    @classmethod
    def _gather_channels(cls, value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        own = {key: entry for key, entry in value.items() if key in cls.model_fields and key != "channels"}
        return {**own, "channels": {key: entry for key, entry in value.items() if key not in own}}

    @field_validator("channels", mode="before")
    @classmethod
    def _known(cls, value: dict[str, Any]) -> dict[str, Any]:
        if not value:
            raise ValueError('names no column; write them such as displacement = { column = "a", unit = "um" }')
        for name, entry in value.items():
            if name not in CHANNELS:
                raise ValueError(f"{name}: unknown key; channels are {', '.join(CHANNELS)}"
                                 f"{did_you_mean(name, [*CHANNELS, *cls.model_fields])}")
            if not isinstance(entry, dict):
                raise ValueError(f'{name}: must be a table such as {{ column = "a", unit = "{CHANNELS[name][0]}" }}')
        return value

    @field_validator("channels")
    @classmethod
    def _units(cls, value: dict[str, ChannelSpec]) -> dict[str, ChannelSpec]:
        for name, spec in value.items():
            if not spec.unit and name not in INDICES:
                raise ValueError(f"{name}.unit: is required, for example {CHANNELS[name][0]!r}")
            _check_unit(name, spec)
        return value

    def sd_of(self, name: str) -> float | None:
        """Return the standard deviation of one sample of channel `name` in SI, if the file gives it."""
        spec = self.channels[name]
        return None if spec.sd is None else u.parse_quantity(spec.sd, unit_size(name, spec.unit)[1])


def _check_unit(name: str, spec: ChannelSpec) -> None:
    if spec.scale == 0.0:
        raise ValueError(f"{name}.scale: must not be zero")
    try:
        si = unit_size(name, spec.unit)[1]
    except UnitError as error:
        raise ValueError(f"{name}.unit: {error}") from error
    if spec.sd is not None:
        try:
            sd = u.parse_quantity(spec.sd, si)
        except ValueError as error:
            raise ValueError(f"{name}.sd: {error}") from error
        if sd < 0.0:
            raise ValueError(f"{name}.sd: must not be negative, got {spec.sd!r}")


class LoopsBlock(FileBlock):
    """Loops at several cycle counts."""

    displacement_of: Annotated[DisplacementOf | None, BeforeValidator(_displacement_of)] = Field(
        None, description="what the displacement is of")


class SeriesBlock(LoopsBlock):
    """One long record."""


class SweepCondition(Section):
    """The condition of one set of loops in a sweep; what is not given is as in [test]."""

    id: int = Field(description="its number in the column of conditions")
    excitation_frequency: u.Frequency | None = Field(None, description="frequency of the excitation")
    excitation_amplitude: u.Force | None = Field(None, description="amplitude of the exciting force")
    displacement_amplitude: u.Length | None = Field(None, description="amplitude of an imposed displacement")
    normal_load: u.Force | None = Field(None, description="static normal load")


class SweepBlock(LoopsBlock):
    """Loops at other conditions than those of the test."""

    same_channels_as: Literal["loops"] | None = Field(None, description="block that tells the channels")
    conditions: tuple[SweepCondition, ...] = Field(min_length=1, description="the conditions")

    @model_validator(mode="after")
    def _own_ids(self) -> SweepBlock:
        ids = [condition.id for condition in self.conditions]
        if len(set(ids)) < len(ids):
            raise ValueError(f"conditions: id {next(i for i in ids if ids.count(i) > 1)} stands twice")
        return self


class MapBlock(FileBlock):
    """A table without cycles: a frequency response, a map of depth."""


class RecordingFile(Description):
    """A whole ``recording.toml``."""

    test: RecordedTest
    rig: Rig | None = None
    specimen: Specimens | None = None
    wear: RecordedWear = Field(default_factory=RecordedWear)
    loops: LoopsBlock | None = None
    series: SeriesBlock | None = None
    sweep: SweepBlock | None = None
    frf: MapBlock | None = None
    wear_depth: MapBlock | None = None

    @model_validator(mode="after")
    def _something_to_read(self) -> RecordingFile:
        if all(getattr(self, name) is None for name in ("loops", "series", "sweep", "frf", "wear_depth")):
            raise ValueError("give at least one of the blocks loops, series, sweep, frf, wear_depth")
        if self.sweep is not None and self.sweep.same_channels_as is not None and self.loops is None:
            raise ValueError("sweep.same_channels_as: there is no block [loops]")
        needs_place = self.loops is not None and self.loops.displacement_of is None
        if self.test.kind.full_model and needs_place:
            raise ValueError('loops.displacement_of: is required: "contact-faces", "back-faces" or a distance '
                             'from the interface such as "1 mm"')
        return self

    def given(self) -> dict[str, Any]:
        """Return what the file says of test, rig and specimens, in SI, by the keys of case files."""
        return {name: _set_fields(section) for name in ("test", "rig", "specimen")
                if (section := getattr(self, name)) is not None}


def _set_fields(section: BaseModel) -> dict[str, Any]:
    values = {name: getattr(section, name) for name in sorted(section.model_fields_set)}
    return {name: _set_fields(value) if isinstance(value, BaseModel) else value for name, value in values.items()}


def load_recording_file(path: Path) -> RecordingFile:
    """Read and validate ``recording.toml`` at `path`.

    Raises
    ------
    CorruptRecordingError
        If it cannot be read.
    ConfigError
        Naming the file, the field and the way out.
    """
    raw = read_description(path)
    sweep, loops = raw.get("sweep"), raw.get("loops")
    if isinstance(sweep, dict) and isinstance(loops, dict) and sweep.get("same_channels_as") == "loops":
        raw["sweep"] = {**{key: entry for key, entry in loops.items() if key not in ("file", "cycle")}, **sweep}
    return validated(RecordingFile, raw, path)
