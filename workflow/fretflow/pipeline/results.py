"""What a run holds: its result files as records, and what they tell as labelled arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fretflow.case.config import Case, load_case
from fretflow.contact.law import ContactState
from fretflow.core.errors import InputError
from fretflow.core.plugins import FIGURES, provided
from fretflow.core.records import Labelled, to_dataset
from fretflow.core.store import read_record
from fretflow.pipeline.response import ForcedResponse
from fretflow.pipeline.response_curves import kept_curves
from fretflow.pipeline.stage import CASE_FILE, CHECKPOINTS
from fretflow.pipeline.summary import Figure, result_warnings, summarise
from fretflow.pipeline.trends import Trend
from fretflow.solvers.periodic import PeriodicSolution
from fretflow.structure.reduction.reduced_specimen import ModeShapes, ReducedSpecimen
from fretflow.structure.two_mass_rig.lumped import RigModes
from fretflow.wear.checkpoint import kept_states
from fretflow.wear.history import WearHistory

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]
SIDES = ("upper", "lower")


@dataclass(frozen=True)
class RunRecords:
    """The records in a run's complete stages, whose `folders` are given by name; each is read when first asked for."""

    folders: Mapping[str, Path] = field(repr=False)

    def has(self, *stages: str) -> bool:
        """Return whether all of `stages` are complete."""
        return all(stage in self.folders for stage in stages)

    def _file(self, stage: str, name: str) -> Path:
        if stage not in self.folders:
            raise InputError(f"stage {stage} was not run; run the case until {stage} or further")
        return self.folders[stage] / name

    @cached_property
    def reduced(self) -> tuple[ReducedSpecimen, ReducedSpecimen]:
        """Return the reduced upper and lower specimen."""
        upper, lower = (read_record(self._file("reduce", f"{side}.h5"), ReducedSpecimen) for side in SIDES)
        return upper, lower

    @cached_property
    def mode_shapes(self) -> dict[str, ModeShapes]:
        """Return the natural modes of the upper and the lower specimen, clamped at the back, by side."""
        return {side: read_record(self._file("reduce", f"{side}_modes.h5"), ModeShapes) for side in SIDES}

    @cached_property
    def rig_modes(self) -> RigModes:
        """Return the modes of the rig's block and arm, faces apart and stuck."""
        return read_record(self._file("solve", "rig_modes.h5"), RigModes)

    @property
    def nodes(self) -> Array:
        """Return the contact nodes in m, (nodes, 2)."""
        return self.reduced[0].contact_nodes[:, :2]

    @property
    def areas(self) -> Array:
        """Return the contact nodes' areas in m^2, (nodes,)."""
        return self.reduced[0].contact_areas

    @cached_property
    def static_pressure(self) -> Array:
        """Return the pressure after the static load in Pa, (nodes,)."""
        from fretflow.structure.fem.preload import Preload  # starts PETSc, which nothing else here needs

        return read_record(self._file("preload", "preload.h5"), Preload).pressure

    @cached_property
    def history(self) -> WearHistory:
        """Return the wear history."""
        return read_record(self._file("wear", "history.h5"), WearHistory)

    @cached_property
    def periods(self) -> dict[int, PeriodicSolution]:
        """Return the kept periods by cycle count, the unworn one first."""
        if self.has("wear"):
            return dict(sorted(kept_states(self.folders["wear"] / CHECKPOINTS, PeriodicSolution).items()))
        return {0: read_record(self._file("solve", "solution.h5"), PeriodicSolution)}

    @cached_property
    def responses(self) -> list[ForcedResponse]:
        """Return the forced responses there are: unworn, then worn."""
        if not self.has("response"):
            return []
        files = [self.folders["response"] / f"{name}.h5" for name in ("unworn", "worn")]
        return [read_record(file, ForcedResponse) for file in files if file.is_file()]


@dataclass(frozen=True)
class RunResults(RunRecords):
    """The complete stages of a run; every file is read when it is first asked for.

    Arrays are `xarray.Dataset`: named dimensions, coordinates, and the SI unit of each in ``attrs["units"]``.

    Attributes
    ----------
    case : Case
        What was run.
    home : Path
        Folder of the run.
    folders : mapping of str to Path
        Folder of each complete stage: mesh, reduce, preload, solve, wear, response, render.

    Raises
    ------
    InputError
        Where something is asked of a stage that was not run.
    StoreError
        If a result file is missing or damaged.

    Examples
    --------
    >>> from fretflow.pipeline.results import RunResults
    >>> found = RunResults.of("runs/test1")  # doctest: +SKIP
    >>> found.wear.volume.isel(cycles=-1).item()  # m^3 at the end of the test  # doctest: +SKIP
    """

    case: Case = field(repr=False)
    home: Path

    @classmethod
    def of(cls, home: Path | str) -> RunResults:
        """Return the run kept in `home`, such as ``runs/test1``, its files checked.

        Raises
        ------
        StoreError
            If there is no run, or a result file is missing or damaged.
        """
        from fretflow.pipeline.stages import complete_stages

        home = Path(home)
        folders = complete_stages(home)
        return cls(folders, load_case(home / CASE_FILE), home)

    # Labelled arrays

    @cached_property
    def loops(self) -> xr.Dataset:
        """Return the hysteresis loops, dimensions (cycles, phase); phase is the share of the period.

        ``displacement`` in m is that of the observed points, ``face_displacement`` the area mean over the contact,
        ``friction_force`` in N is of the upper specimen on the lower one.
        """
        import xarray as xr

        weights, loops = self.areas / self.areas.sum(), []
        for cycles, period in self.periods.items():
            along = {"displacement": (period.upper_observation - period.lower_observation)[:, 0],
                     "face_displacement": period.displacement[:, :, 0] @ weights,
                     "friction_force": period.friction_force}
            phase = np.arange(len(period.friction_force)) / len(period.friction_force)
            loops.append(to_dataset({name: (("phase",), values, "N" if "force" in name else "m")
                                   for name, values in along.items()},
                                  {"phase": (("phase",), phase, "1"), "cycles": ((), cycles, "1")}))
        return xr.concat(loops, dim="cycles", join="outer", combine_attrs="override")

    @cached_property
    def maps(self) -> xr.Dataset:
        """Return the contact at the kept cycle counts, dimensions (cycles, node), with x, y and area of the nodes.

        ``mean_pressure`` in Pa over the period; ``stick``, ``slip`` and ``separation``, the share of the period in
        each state; ``wear_depth`` in m, both faces together, where wear was run.
        """
        every = list(self.periods.values())
        maps = {"mean_pressure": ([period.force[:, :, 2].mean(axis=0) / self.areas for period in every], "Pa")}
        maps |= {state.name.lower(): ([np.mean(period.state == state, axis=0) for period in every], "1")
                 for state in ContactState}
        if self.has("wear"):
            rows = np.searchsorted(self.history.cycles, list(self.periods))
            maps["wear_depth"] = (list(self.history.depth[rows]), "m")
        return to_dataset({name: (("cycles", "node"), np.array(values), unit) for name, (values, unit) in maps.items()},
                        {"cycles": (("cycles",), list(self.periods), "1"), **self._places})

    @cached_property
    def wear(self) -> xr.Dataset:
        """Return the wear history: dimension cycles for all jumps, and (cycles, node) for ``depth`` and ``rate``."""
        return self.history.arrays.assign_coords(to_dataset({}, self._places).coords)

    @cached_property
    def curves(self) -> dict[str, xr.Dataset]:
        """Return the forced responses, ``unworn`` and where there is wear ``worn``, dimension frequency (Hz).

        ``amplitude`` in m and ``phase`` in rad behind the force are of the moving mass's first harmonic.
        """
        return {name: to_dataset({"amplitude": (("frequency",), one.amplitude, "m"),
                                "phase": (("frequency",), one.phase, "rad")},
                               {"frequency": (("frequency",), one.frequency, "Hz"), "cycles": ((), one.cycles, "1")})
                for name, one in zip(("unworn", "worn"), self.responses, strict=False)}

    @cached_property
    def response_curves(self) -> dict[str, xr.Dataset]:
        """Return the curves that ``fretflow response`` made last, by name such as ``"unworn, 45 N"``.

        Dimensions (point, channel): the points in their order along the curve, up and then down, around folds.
        ``amplitude`` in m and ``phase`` in rad are of the first harmonic of the motion ``sel(channel="block")``,
        and of ``arm``, ``relative``, ``upper`` and ``lower``.
        """
        return {one.name: one.curve.arrays.assign_coords(cycles=one.cycles) for one in kept_curves(self.folders)}

    @property
    def _places(self) -> dict[str, Labelled]:
        return {"x": (("node",), self.nodes[:, 0], "m"), "y": (("node",), self.nodes[:, 1], "m"),
                "area": (("node",), self.areas, "m^2")}

    # In short

    @property
    def summary(self) -> dict[str, Figure]:
        """Return the figures of the run by name, each with ``value`` (SI), ``unit`` and ``text``."""
        return {figure.name: figure for figure in self.summarised[0]}

    @property
    def warnings(self) -> list[str]:
        """Return what makes the results doubtful, a line each: an inexact reduction, a contact too narrow."""
        return result_warnings(self.case, self.folders)

    @cached_property
    def summarised(self) -> tuple[Sequence[Figure], Sequence[Trend]]:
        """Return the figures of the run, and the paper's trends once wear is known."""
        return summarise(self.case, self.folders)

    def to_recording(self, folder: Path | str, noise: float = 0.0) -> list[Path]:
        """Write loops and wear as a recording in `folder`, and return its files; see `pipeline.exported`."""
        from fretflow.pipeline.exported import export_recording

        return export_recording(self, Path(folder), noise)

    def plot(self) -> Any:
        """Return a `matplotlib.figure.Figure`: loops, the contact's last map, worn volume and responses."""
        return provided(FIGURES, "results")(self)

    def render(self, figures: Sequence[str] = (), formats: Sequence[str] = ()) -> list[Path]:
        """Draw the pictures of the run again, as `fretflow render` does, and return their files.

        Parameters
        ----------
        figures : sequence of str
            Names, such as ``loops``, ``mode_shapes``, ``wear_shape``; all that the case asks for where none is given.
        formats : sequence of str
            ``png``, ``svg``, ``pdf``.

        Raises
        ------
        InputError
            If there is no such picture or format.
        """
        from fretflow.pipeline.stages import render_run

        return render_run(self.home, figures, formats)
