"""The case file of a bolted structure: its bodies and joint, and what is asked of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError, model_validator

from fretflow.case.config import WAY_OUT, explain
from fretflow.case.sections import Section, Title
from fretflow.core import units as u
from fretflow.core.errors import ConfigError
from fretflow.core.files import CASE, STRUCTURE, no_file, read_toml

SHOWN_BY = "docs/case.md shows"


class Elasticity(Section):
    """The material of bodies."""

    youngs_modulus: u.Pressure = Field(205e9, description="Young's modulus")
    poissons_ratio: float = Field(0.29, gt=-1.0, lt=0.5, description="Poisson's ratio")
    density: u.Density = Field(7800.0, description="mass density")


class Pair(Section):
    """Two named faces that touch."""

    upper: str = Field(description="name of the upper face, a physical group of the mesh")
    lower: str = Field(description="name of the lower face")


class BoltTable(Section):
    """A bolt with a round shank."""

    head: str = Field("", description="face under its head")
    nut: str = Field("", description="face under its nut")
    diameter: u.Length = Field(description="of the shank")
    grip: u.Length = Field(description="length between head and nut")
    mass: u.Mass | None = Field(None, description="of bolt, nut and washers")


class Sensor(Section):
    """A point that is observed and may be driven."""

    at: tuple[u.SignedLength, u.SignedLength, u.SignedLength] = Field(description="place")
    along: tuple[float, float, float] = Field(description="direction")


class JoinedBodies(Section):
    """What holds the bodies of a mesh together, and where they are observed."""

    interfaces: tuple[Pair, ...] = Field((Pair(upper="upper lap", lower="lower lap"),), description="faces that touch")
    bolts: tuple[BoltTable, ...] = Field((), description="each; of a lap beam one, which stands for all")
    clamped: tuple[str, ...] = Field((), description="faces that are held still")
    sensors: dict[str, Sensor] = Field(default_factory=dict)
    mesh_unit: u.Length = Field(1.0, description='that the mesh counts in, such as "1 mm"')
    materials: dict[str, Elasticity] = Field(
        default_factory=dict, description="of bodies of another material, by the group of their volume")


class Bodies(JoinedBodies):
    """Bodies of a mesh, and what holds them together."""

    mesh: Path | None = Field(None, description="a mesh, from the folder of this file")
    lap_beam: dict[str, Any] | None = Field(None, description="or a bolted lap beam that is made, see docs/case.md")
    material: Elasticity = Field(default_factory=Elasticity)
    modes: int = Field(20, ge=1, le=500, description="modes of the closed joint that are kept")

    @model_validator(mode="after")
    def _one_source(self) -> Bodies:
        if (self.mesh is None) == (self.lap_beam is None):
            raise ValueError("give one of mesh and lap_beam")
        if self.mesh is None and (self.materials or self.mesh_unit != 1.0):
            raise ValueError("materials and mesh_unit are of a mesh; a lap beam is of one material, in metres")
        if self.mesh is not None and not all(bolt.head and bolt.nut for bolt in self.bolts):
            raise ValueError("bolts: name the faces under head and nut of each")
        if not self.bolts or (self.lap_beam is not None and len(self.bolts) > 1):
            raise ValueError("bolts: give each bolt of a mesh, or the one that stands for all of a lap beam")
        if not self.sensors:
            raise ValueError("sensors: give at least one; amplitudes are those of the first")
        return self


class BoltedJointTable(Section):
    """The contact and what presses it."""

    friction_coefficient: float = Field(gt=0.0, le=5.0, description="Coulomb friction coefficient")
    bolt_load: u.Force = Field(description="of each bolt")
    modal_damping: float = Field(0.0, ge=0.0, lt=1.0, description="damping ratio without the joint")


class BackboneTable(Section):
    """Frequency and damping over amplitude."""

    mode: int = Field(1, ge=1, description="number of the mode, from 1")
    smallest: u.Length = Field(description="amplitude of the first sensor, were nothing to slide")
    largest: u.Length = Field(description="likewise; a joint that slides or opens moves it some per cent more or less")
    points: int = Field(13, ge=3, le=200, description="amplitudes from the smallest to the largest")
    periodic: int = Field(2, ge=0, description="of these also as periodic motions")
    measured: Path | None = Field(None, description="CSV with amplitude_m, frequency_Hz and damping_ratio to compare")

    @model_validator(mode="after")
    def _rises(self) -> BackboneTable:
        if not self.smallest < self.largest or self.periodic > self.points:
            raise ValueError("largest must be above smallest, and periodic at most points")
        return self


class ResponseTable(Section):
    """Forced responses."""

    at: str = Field(description="the sensor that is driven")
    forces: tuple[u.Force, ...] = Field(min_length=1, description="amplitudes of the force, a curve each")


class BoltedWearTable(Section):
    """Wear of the interfaces while the mode vibrates."""

    coefficient: u.WearCoefficient = Field(1.1e-14, description="Archard wear coefficient")
    amplitude: u.Length = Field(description="of the first sensor, were nothing to slide")
    cycles: int = Field(ge=1, le=10**15, description="length of the test in cycles")


class BoltedCase(Section):
    """A whole case file of a bolted structure, in SI."""

    format: Literal["fretflow-structure/1"] = Field(description="format of this file")
    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=100,
                      description="name of the case; names its result folder")
    title: Title = Field("", description="one line for people")
    structure: Bodies
    joint: BoltedJointTable
    backbone: BackboneTable
    response: ResponseTable | None = None
    wear: BoltedWearTable | None = None


def load_bolted_case(path: Path) -> BoltedCase | None:
    """Read a case file of a bolted structure; None if the file is of another format.

    Raises
    ------
    ConfigError
        Naming the file, the field and the way out.
    """
    raw = read_toml(path, ConfigError, WAY_OUT, formats=(CASE, STRUCTURE))
    if raw.get("format") != STRUCTURE:
        return None
    try:
        case = BoltedCase.model_validate(raw)
    except ValidationError as error:
        raise ConfigError(f"{path}: {explain(error, raw, '', BoltedCase, SHOWN_BY)}") from error
    files = {"structure": {"mesh": case.structure.mesh}, "backbone": {"measured": case.backbone.measured}}
    for table, ((key, file),) in ((name, tuple(one.items())) for name, one in files.items()):
        if file is not None:
            whole = (path.parent / file).resolve()
            if not whole.is_file():
                raise ConfigError(f"{path}: {table}.{key}: {no_file(whole)}; it counts from the case file's folder")
            own = getattr(case, table).model_copy(update={key: whole})
            case = case.model_copy(update={table: own})
    return case
