"""What a run holds: its result files as records, and what they tell as labelled arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fretflow.case.config import Case, load_case
from fretflow.contact.interface import area_mean
from fretflow.contact.law import ContactState
from fretflow.core.plugins import FIGURES, provided
from fretflow.core.records import Labelled, to_dataset
from fretflow.pipeline.response_curves import kept_curves
from fretflow.pipeline.run_records import RunRecords
from fretflow.pipeline.stage import CASE_FILE
from fretflow.pipeline.summary import Figure, result_warnings, summarise
from fretflow.pipeline.trends import Trend

if TYPE_CHECKING:
    import xarray as xr

    from fretflow.structure.sensors import Signals


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
    >>> results = RunResults.of("runs/test1")  # doctest: +SKIP
    >>> results.wear.volume.isel(cycles=-1).item()  # m^3 at the end of the test  # doctest: +SKIP
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
        """Return the hysteresis loops, dimensions (cycles, phase); phase in rad as in recordings.

        ``displacement`` in m is that of the observed points, ``face_displacement`` the area mean over the contact,
        ``friction_force`` in N is of the upper specimen on the lower one.
        """
        import xarray as xr

        areas, loops = self.areas, []
        for cycles, period in self.periods.items():
            along = {"displacement": (period.upper_observation - period.lower_observation)[:, 0],
                     "face_displacement": area_mean(period.displacement[:, :, 0], areas),
                     "friction_force": period.friction_force}
            phase = 2.0 * np.pi * np.arange(len(period.friction_force)) / len(period.friction_force)
            loops.append(to_dataset({name: (("phase",), values, "N" if "force" in name else "m")
                                   for name, values in along.items()},
                                  {"phase": (("phase",), phase, "rad"), "cycles": ((), cycles, "1")}))
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

    @cached_property
    def channels(self) -> dict[int, Signals]:
        """Return what acted and moved in the kept periods, by cycle count, before any sensor."""
        from fretflow.pipeline.problem import make_model

        return self.signals(make_model(self.case, self.folders["reduce"]), self.case.test.total_cycles)

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

        return export_recording(self.case, self, self.channels, Path(folder), noise)

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
