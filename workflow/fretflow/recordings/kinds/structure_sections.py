"""The tables of a recording of a structure: what each key may hold."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from fretflow.case.bolted import JoinedBodies
from fretflow.case.config import Section
from fretflow.recordings.description import Description
from fretflow.recordings.kinds.structure_columns import TABLE, StructureColumn, number, positive_range
from fretflow.recordings.kinds.worn_profiles import LineContactSection, ProfileBlock, VolumesBlock

TYPICAL = {  # where nothing is said of them
    "bolt_load": (100.0, 1e5),  # N, from an M3 to an M24 bolt at two thirds of the proof load of class 8.8
    "friction_coefficient": (0.1, 1.0),  # dry metals
    "modal_damping": (1e-5, 1e-2),  # from a free-free bar of steel to a bolted assembly
}


class Control(StrEnum):
    """What was held while a response was recorded."""

    FORCE = "force"
    RESPONSE = "response"


class UnknownRanges(Section):
    """What is to be found, each within a range."""

    bolt_load: Annotated[tuple[float, float] | None, positive_range("N")] = Field(None, description="of each bolt")
    modal_damping: Annotated[tuple[float, float] | None, positive_range("1")] = Field(
        None, description="damping ratio without the joint")
    friction_coefficient: Annotated[tuple[float, float] | None, positive_range("1")] = Field(
        None, description="Coulomb friction coefficient")

    @field_validator("modal_damping")
    @classmethod
    def _below_one(cls, value: tuple[float, float] | None) -> tuple[float, float] | None:
        if value and value[1] >= 1.0:
            raise ValueError('is a range of damping ratios below 1, such as [1e-4, "1 %"]')
        return value


class StructureSection(JoinedBodies):
    """The structure, and what is known and unknown of its joint."""

    matrices: str | None = Field(None, description="file of its matrices, from the folder of recording.toml")
    mesh: str | None = Field(None, description="or a mesh of its bodies, joined by what follows")
    line_contact: LineContactSection | None = None
    material: str | dict[str, Any] | None = Field(None, description="youngs_modulus, poissons_ratio and density")
    bolt_load: Annotated[float | None, number("N")] = Field(None, gt=0.0, description="of each bolt, where known")
    modal_damping: Annotated[float | None, number("1")] = Field(
        None, ge=0.0, lt=1.0, description="damping ratio without the joint, where known")
    friction_coefficient: Annotated[float | None, number("1")] = Field(
        None, gt=0.0, description="Coulomb friction coefficient, where known")
    unknown: UnknownRanges = Field(default_factory=UnknownRanges)

    @model_validator(mode="after")
    def _one_source(self) -> StructureSection:
        if [self.matrices, self.mesh, self.line_contact].count(None) != 2:
            raise ValueError('give one of matrices, such as "structure.npz", mesh and line_contact')
        of_mesh = sorted({"bolts", "clamped", "sensors", "materials", "mesh_unit"} & self.model_fields_set)
        if self.mesh is None and of_mesh:
            raise ValueError(f"{of_mesh[0]}: belongs to a mesh, which is not given; matrices have their own")
        if self.mesh is not None and not (self.bolts and all(one.head and one.nut for one in self.bolts)):
            raise ValueError("bolts: give each, and name the faces under its head and nut")
        if self.mesh is not None and isinstance(self.material, str):
            raise ValueError("material: of a mesh is a table of youngs_modulus, poissons_ratio and density")
        for name in TYPICAL:
            if getattr(self, name) is not None and getattr(self.unknown, name) is not None:
                raise ValueError(f"{name}: is given both a value and, in structure.unknown, a range")
        return self


class BackboneBlock(Section):
    """Natural frequency and damping over amplitude."""

    file: str = Field(description=TABLE)
    amplitude_of: str = Field(description='a named output, or "modal"')
    mode: int | None = Field(None, ge=1, description="its number among the elastic modes, from 1")
    amplitude: StructureColumn = Field(description="as displacement, velocity or acceleration, by its unit")
    frequency: StructureColumn = Field(description="natural frequency there")
    damping: StructureColumn | None = Field(None, description="damping ratio there")


class ResponseBlock(Section):
    """A frequency response under control."""

    file: str = Field(description=TABLE)
    control: Control = Field(description="what was held while the frequency changed")
    of: str = Field(description="a named output")
    at: str | None = Field(None, description="a named input, where it is driven")
    level: str | float | None = Field(None, description="amplitude at which it was held, with its unit")
    frequency: StructureColumn = Field(description="frequency of the force")
    force: StructureColumn | None = Field(None, description="amplitude of the force")
    amplitude: StructureColumn = Field(description="amplitude of the output")
    phase: StructureColumn | None = Field(None, description="of the output behind the force")


class FreeBlock(Section):
    """A table whose columns are free to choose."""

    file: str | None = Field(None, description=TABLE)
    columns: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _gather(cls, value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        return {"file": value.get("file"), "columns": {key: entry for key, entry in value.items() if key != "file"}}


class StructureTest(Section):
    """What was done."""

    kind: Literal["structure"] = Field(description="what is to be predicted")
    cycles: int | None = Field(None, ge=0, description="length of the test in cycles")


class StructureFile(Description):
    """A whole ``recording.toml`` of a structure."""

    test: StructureTest
    structure: StructureSection
    backbone: BackboneBlock | None = None
    frf: tuple[ResponseBlock, ...] = ()
    ring_down: FreeBlock | None = None
    profile: tuple[ProfileBlock, ...] = ()
    wear_depth: FreeBlock | None = None
    volumes: VolumesBlock | None = None
