"""Worn profiles and volumes of a line contact, in recordings of kind ``structure``.

::

    [structure.line_contact]            # a cylinder on a flat, in place of matrices and mesh
    radius = "80 mm"
    load = "1066 N/mm"                  # per length
    youngs_modulus = "114 GPa"          # of both bodies
    poissons_ratio = 0.34
    [[profile]]                         # or [profile]; total depth of both bodies across the scar
    file = "profile.csv"
    cycles = 5000
    frequency = "2 Hz"
    displacement_amplitude = "75 um"    # half the stroke, in gross slip
    x = { column = "x", unit = "mm" }
    depth = { column = "z", unit = "mm", sd = "4 um" }
    [wear_depth]                        # or a map, whose depths at each x are averaged
    file = "map.csv"
    y = { column = "y", unit = "mm" }   # and all that a profile has
    [volumes]
    file = "volumes.csv"                # columns volume, cycles, frequency and displacement_amplitude
    width = "8 mm"
    volume = { column = "V", unit = "mm^3", sd = "0.05 mm^3" }
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator
from scipy.integrate import trapezoid

from fretflow.case.config import Section
from fretflow.core import units as u
from fretflow.core.errors import UnreliableRecordingError
from fretflow.core.records import Array, quantity, record
from fretflow.recordings.kinds.structure_columns import TABLE, StructureColumn, number, read_column, stated_sd
from fretflow.recordings.readers.tables import Table, read_table

SAME_PLACE = 1e-6  # of a map's length, which digits of a file may differ by
EARLIER = {"elastic_modulus": "youngs_modulus", "poisson_ratio": "poissons_ratio"}  # names that files still have
FEWEST_PLACES = 5  # of a profile: two edges, a middle and what lies between


class LineContactSection(Section):
    """A cylinder on a flat of the same elastic material, in plane strain."""

    radius: u.Length = Field(description="of the cylinder")
    load: Annotated[float, number("N/m")] = Field(gt=0.0, description="normal load per length")
    youngs_modulus: u.Pressure = Field(description="of both bodies")
    poissons_ratio: float = Field(ge=0.0, lt=0.5, description="of both bodies")

    @model_validator(mode="before")
    @classmethod
    def _under_earlier_names(cls, given: Any) -> Any:
        """Take what stands under an earlier name, unless it stands under both."""
        if not isinstance(given, dict):
            return given
        return {EARLIER[key] if key in EARLIER and EARLIER[key] not in given else key: given[key] for key in given}


class WearCondition(Section):
    """Under what a profile was worn."""

    cycles: int = Field(ge=1, description="length of the test in cycles")
    frequency: u.Frequency = Field(description="frequency of the motion")
    displacement_amplitude: u.Length = Field(description="half the stroke, in gross slip")


class ProfileBlock(WearCondition):
    """A worn profile: total depth of both bodies across the scar, along the sliding."""

    file: str = Field(description=TABLE)
    x: StructureColumn = Field(description="place along the sliding")
    depth: StructureColumn = Field(description="total depth of both bodies there")


class WornMapBlock(ProfileBlock):
    """A worn map: total depth of both bodies, in lines across the scar."""

    y: StructureColumn = Field(description="place across the sliding")


class VolumesBlock(Section):
    """Worn volumes of tests, both bodies together."""

    file: str = Field(description=TABLE)
    width: u.Length = Field(description="length of the line contact")
    volume: StructureColumn = Field(description="worn volume of a test")
    cycles: StructureColumn = Field(description="its length in cycles")
    frequency: StructureColumn = Field(description="its frequency")
    displacement_amplitude: StructureColumn = Field(description="half its stroke")


@record
class WornArea:
    """What a test of a line contact wore: the area of its cross-section."""

    cycles: float = quantity("1")
    frequency: float = quantity("Hz")
    amplitude: float = quantity("m", "half the stroke")
    area: float = quantity("m^2")
    area_sd: float | None = quantity("m^2", default=None)


@record
class WornProfile:
    """A worn profile of P places and the area that it encloses."""

    name: str
    test: WornArea
    x: Array = quantity("m", "(P,), rising")
    depth: Array = quantity("m", "(P,), of both bodies")
    depth_sd: float | None = quantity("m")
    calibration_sd: float = quantity("1", "of the depth")


def read_profile(block: ProfileBlock, folder: Path) -> WornProfile:
    """Read a worn profile.

    Raises
    ------
    RecordingError
        If its file is damaged, or places do not rise, or nothing is worn.
    """
    table = read_table(folder / block.file, [str(block.x.column), str(block.depth.column)])
    x, _ = read_column(table, "profile", "x", block.x, ("m",))
    depth, _ = read_column(table, "profile", "depth", block.depth, ("m",))
    return _profile(block, table, "profile", x, depth, stated_sd("profile", "depth", block.depth, "m"))


def read_worn_map(block: WornMapBlock, folder: Path) -> WornProfile:
    """Read a worn map of a line contact as the mean of its lines, known as well as these agree.

    How far apart lines differ independently nothing tells.

    Raises
    ------
    RecordingError
        If its file is damaged, there are no lines, or nothing is worn.
    """
    table = read_table(folder / block.file, [str(one.column) for one in (block.x, block.y, block.depth)])
    at, _, depths = (read_column(table, "wear_depth", name, spec, ("m",))[0]
                     for name, spec in (("x", block.x), ("y", block.y), ("depth", block.depth)))
    close = SAME_PLACE * float(np.ptp(at))
    order = np.argsort(at, kind="stable")
    column = np.r_[0, np.cumsum(np.diff(at[order]) > close)]
    lines = np.bincount(column)
    if lines.min() < 2:
        raise UnreliableRecordingError(f"{table.path}: wear_depth: x = {1e3 * at[order][np.argmin(lines[column])]:.4g} "
                                       "mm has one depth; give a map in lines, with the same x in each, or a profile")
    x, depth = (np.bincount(column, values[order]) / lines for values in (at, depths))
    away = float(np.sum((depths[order] - depth[column])**2)) / (len(at) - len(x))
    sd = max(stated_sd("wear_depth", "depth", block.depth, "m") or 0.0, np.sqrt(away))
    return _profile(block, table, "wear_depth", x, depth, float(sd))


def _profile(block: ProfileBlock, table: Table, name: str, x: Array, depth: Array, sd: float | None) -> WornProfile:
    """Return depths at places as a profile."""
    if len(x) < FEWEST_PLACES:
        raise UnreliableRecordingError(f"{table.path}: {name}: {len(x)} places tell no shape; give {FEWEST_PLACES} or "
                                       "more")
    if not np.all(np.diff(x) > 0.0):
        raise UnreliableRecordingError(f"{table.path}: {name}: x does not rise at row "
                                       f"{int(np.argmin(np.diff(x))) + 2}; sort the rows by it")
    area = float(trapezoid(depth, x))
    if not area > 0.0:
        raise UnreliableRecordingError(f"{table.path}: {name}: the depth encloses {1e6 * area:.3g} mm²; depth is "
                                       "positive into the bodies")
    return WornProfile(
        name=Path(block.file).stem, x=x, depth=depth, depth_sd=sd,
        calibration_sd=block.depth.calibration_sd, test=WornArea(
            cycles=float(block.cycles), frequency=block.frequency, amplitude=block.displacement_amplitude, area=area))


def read_volumes(block: VolumesBlock, folder: Path) -> tuple[WornArea, ...]:
    """Read worn volumes as areas of the cross-section.

    Raises
    ------
    RecordingError
        If the file is damaged, or a number is not positive.
    """
    units = {"volume": "m^3", "cycles": "1", "frequency": "Hz", "displacement_amplitude": "m"}
    table = read_table(folder / block.file, [str(getattr(block, name).column) for name in units])
    columns = {name: read_column(table, "volumes", name, getattr(block, name), (unit,))[0]
               for name, unit in units.items()}
    for name, values in columns.items():
        if not np.all(values > 0.0):
            raise UnreliableRecordingError(f"{table.path}: volumes: {name} must be positive, row "
                                           f"{int(np.argmin(values)) + 1} has {values.min():g}")
    sd = stated_sd("volumes", "volume", block.volume, "m^3")
    return tuple(WornArea(cycles=cycles, frequency=frequency, amplitude=amplitude, area=volume / block.width,
                          area_sd=None if sd is None else sd / block.width)
                 for volume, cycles, frequency, amplitude in zip(*columns.values(), strict=True))
