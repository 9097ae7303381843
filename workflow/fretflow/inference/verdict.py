"""What a diagnosis says: its records and the JSON that other programs read."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import field
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fretflow.core.plugins import FIGURES, provided
from fretflow.core.provenance import commit, own_version
from fretflow.core.records import Array, quantity, record, to_dataset
from fretflow.core.store import write_whole

if TYPE_CHECKING:
    import xarray as xr

FALSE_ALARMS = 0.05  # that all tests of a kind together may raise


class Verdict(StrEnum):
    """What is said of the physics that the model leaves out."""

    NONE = "none"  # nothing that the recording shows
    NAMED = "named"
    AMBIGUOUS = "ambiguous"  # one of a set that the recording cannot tell apart
    UNKNOWN = "unknown"  # something that is not in the catalogue


@record
class Detection:
    """Whether anything is left when the baseline's own parameters are refitted."""

    p_value: float
    statistic: str  # name of the test that gave it
    tests: Mapping[str, float]  # name of each test: its p-value, not corrected
    false_alarm_rate: float  # that the threshold keeps, over all tests together


@record
class Candidate:
    """A set of effects as an explanation."""

    effects: tuple[str, ...]  # none: the baseline
    probability: float
    explained: float  # share of the excess chi-squared
    chi_squared: float
    degrees_of_freedom: int  # the chi-squared that noise alone would leave
    log_evidence: float
    converged: bool = False  # fitted to the end; what is given up sooner could explain a little more


@record
class Place:
    """One way to cut where measured and predicted part, and how sure it is."""

    cut: str  # "block", "channel", "phase", "parity", "cycles", "harmonic", "condition", "zone"
    where: str
    share: float  # of the excess that lies there
    p_value: float  # corrected for the search


@record
class Location:
    """Where they part, in words, and all places that were looked at."""

    block: str
    channel: str
    phase: str
    cycles: tuple[int, int]
    zone: str
    parity: str = ""
    harmonic: str = ""
    condition: str = ""
    places: tuple[Place, ...] = ()
    text: str = ""  # one or two sentences


@record
class Estimate:
    """A parameter and its 90 % interval, in SI."""

    name: str  # "contact.friction_coefficient", of an effect its id and its field
    value: float
    low: float
    high: float
    unit: str
    meaning: str = ""
    draws: Array = quantity("SI", "(n,), of the posterior; row for row the same draw in all parameters",
                            default_factory=lambda: np.zeros(0))


@record
class HeldOut:
    """Errors on recordings that were not fitted, as rms over the repeatability sd."""

    what: str
    before: float
    after: float
    floor: float


@record
class Remainder:
    """What the model of the verdict does not explain."""

    share: float  # of what the baseline leaves beyond noise
    times_noise: float  # rms over that of repeats
    where: str  # in words, empty where it is nowhere more than by chance


@record
class Comparison:
    """One loop, or stretch of a record, measured and predicted; all (N,) in SI."""

    label: str
    held_out: bool
    displacement: Array = quantity("m", "(N,), measured")
    force: Array = quantity("N", "(N,), measured")
    before_displacement: Array = quantity("m", "(N,), baseline refitted")
    before_force: Array = quantity("N", "(N,)")
    after_displacement: Array = quantity("m", "(N,), with the named effects")
    after_force: Array = quantity("N", "(N,)")
    time: Array | None = quantity("s", "(N,)", default=None)
    raw_displacement: Array | None = quantity("m", "(n,), all, where fewer or harmonics are compared", default=None)
    raw_force: Array | None = quantity("N", "(n,)", default=None)


@record
class Evolution:
    """What is read off each loop as the cycles go on: measured, before and after; nan where a loop does not show it."""

    cycles: Array = quantity("1", "(n,)")
    friction_limit: Array = quantity("N", "(3, n)")
    tangential_stiffness: Array = quantity("N/m", "(3, n)")
    dissipated_energy: Array = quantity("J", "(3, n), of a cycle")
    sliding_distance: Array = quantity("m", "(3, n)")


@record
class ResidualMap:
    """Difference over its sd by loop (rows) and phase (columns), of one channel; phases count as the loops' samples."""

    channel: str
    rows: tuple[str, ...]
    phase: Array = quantity("1", "(P,), share of the period")
    before: Array = quantity("1", "(rows, P)")
    after: Array = quantity("1", "(rows, P)")


@record
class WearMap:
    """Wear depth at P points, measured and predicted."""

    x: Array = quantity("m", "(P,)")
    y: Array = quantity("m", "(P,)")
    measured: Array = quantity("m", "(P,)")
    before: Array = quantity("m", "(P,)")
    after: Array = quantity("m", "(P,)")


@record
class MeasuredCurve:
    """A measured curve of P points beside its predictions: a backbone, a response or a worn profile."""

    label: str
    x_label: str
    x_unit: str
    y_label: str
    y_unit: str
    x: Array = quantity("SI", "(P,), in `x_unit`")
    measured: Array = quantity("SI", "(P,), in `y_unit`")
    before: Array = quantity("SI", "(P,), baseline refitted")
    after: Array = quantity("SI", "(P,), with the named effects")


@record
class WearTests:
    """Worn volumes of n tests, measured and predicted."""

    rows: NDArray[np.int64] = quantity("1", "(n,), of the table")
    measured: Array = quantity("m^3", "(n,)")
    before: Array = quantity("m^3", "(n,)")
    after: Array = quantity("m^3", "(n,)")
    r2_before: float = quantity("1")  # share of the variance of the volumes
    r2_after: float = quantity("1")


@record
class ResidualLaw:
    """What an unlisted effect does, from the data: a channel's residual against the state that explains it best."""

    channel: str
    state: str
    state_unit: str
    channel_unit: str
    x: Array = quantity("SI", "(P,)")
    y: Array = quantity("SI", "(P,)")
    sd: Array = quantity("SI", "(P,)")
    explained: float = quantity("1")


@record
class Diagnosis:
    """All that a diagnosis found; what the report shows. `diagnose` makes it.

    Parameters are in SI with 90 % intervals. The verdict is ``none``, ``named``, ``ambiguous`` (one of ``effects``) or
    ``unknown`` (nothing in the catalogue).

    Examples
    --------
    >>> import fretflow as ff
    >>> diagnosis = ff.diagnose("my recording")  # doctest: +SKIP
    >>> {one.name: (one.value, one.unit) for one in diagnosis.parameters}  # doctest: +SKIP
    >>> diagnosis.to_json()["location"]["block"]  # doctest: +SKIP
    """

    title: str
    recording: str
    kind: str
    verdict: Verdict
    effects: tuple[str, ...]
    probability: float
    sentence: str
    ranking: tuple[Candidate, ...]  # most probable first
    detection: Detection
    location: Location
    parameters: tuple[Estimate, ...]
    held_out: HeldOut | None
    separating_measurement: str
    smallest_visible: Mapping[str, float]  # effect: share of its plausible range that would have been seen
    faults: tuple[str, ...] = ()  # of the instruments, before any model is fitted: no physics is told then
    comparisons: tuple[Comparison, ...] = ()
    evolution: Evolution | None = None
    residual_maps: tuple[ResidualMap, ...] = ()
    wear_map: WearMap | None = None
    wear_tests: WearTests | None = None
    curves: tuple[MeasuredCurve, ...] = ()  # backbones, responses, worn profiles
    residual_law: ResidualLaw | None = None
    remainder: Remainder | None = None
    warnings: tuple[str, ...] = ()  # what makes the verdict less sure than its probability
    notes: tuple[str, ...] = ()  # what else there is to know of the model and the recording
    case_file: str = ""  # text of a case with the named effects that `fretflow run` takes
    after_model: str = ""  # what "after" was predicted with: "baseline + friction-run-in"
    seconds: float = quantity("s", default=0.0)
    stages: Mapping[str, float] = field(default_factory=dict)  # what was done: wall time in s
    memory: tuple[float, float] = (0.0, 0.0)  # largest of this process and of one that worked for it, bytes
    fast: bool = False

    def __repr__(self) -> str:
        """Return the verdict, which the fields then tell more of."""
        return (f"Diagnosis of {self.title or self.recording!r}: {self.verdict}, effects={self.effects}, "
                f"probability={self.probability:.4g}")

    def to_json(self, path: Path | str | None = None) -> dict[str, Any]:
        """Return the diagnosis in the exchange format, written to the file `path` if that is given.

        Raises
        ------
        StoreError
            If the file cannot be written.
        """
        place, fit = self.location, self.held_out
        content = {
            "verdict": self.verdict.value, "effects": list(self.effects), "probability": _plain(self.probability),
            "ranking": [{"effects": list(one.effects), "probability": _plain(one.probability),
                         "explained": _plain(one.explained), "given_up_early": not one.converged}
                        for one in self.ranking],
            "detection": {"p_value": _plain(self.detection.p_value), "statistic": self.detection.statistic},
            "location": {"block": place.block, "channel": place.channel, "phase": place.phase,
                         "cycles": list(place.cycles), "zone": place.zone},
            "parameters": {one.name: {"value": _plain(one.value), "low": _plain(one.low), "high": _plain(one.high),
                                      "unit": one.unit} for one in self.parameters},
            "fit": {} if fit is None else {"held_out": fit.what, "before": _plain(fit.before),
                                           "after": _plain(fit.after), "floor": _plain(fit.floor)},
            "separating_measurement": self.separating_measurement,
            "remainder": {} if self.remainder is None else {
                "share": _plain(self.remainder.share), "times_noise": _plain(self.remainder.times_noise),
                "where": self.remainder.where},
            "warnings": [*self.warnings, *self.notes], "version": own_version(),
            "commit": commit() or "", "seconds": self.seconds, "stages": dict(self.stages),
            "memory": {"main": self.memory[0], "worker": self.memory[1]}}
        if path is not None:
            write_whole(Path(path), (json.dumps(content, indent=1) + "\n").encode())
        return content

    def to_html(self, path: Path | str) -> Path:
        """Write the report, one page that needs neither files nor a network, and return its path.

        Raises
        ------
        StoreError
            If the file cannot be written.
        PlatformError
            If no package that writes reports is installed.
        """
        page: Path = provided(FIGURES, "report")(Path(path), self)
        return page

    def plot(self, what: str = "loops") -> Any:
        """Return a `matplotlib.figure.Figure` of what was measured, by the baseline and with the named effects.

        Parameters
        ----------
        what : str
            ``loops``; ``evolution``, what is read off them over the cycles; ``maps``, the differences over loop and
            phase; ``parameters``, the posterior in pairs; ``wear``, the worn depth and its differences; ``curves``,
            backbones, responses and worn profiles; ``volumes``, of wear tests; ``law``, an unlisted effect's.

        Raises
        ------
        InputError
            If there is no such figure, or nothing to draw on it.
        PlatformError
            If no package that draws is installed.
        """
        return provided(FIGURES, "diagnosis")(self, what)

    @property
    def posterior(self) -> xr.Dataset:
        """Return draws of the parameters, dimensions (chain, draw), as ArviZ names them.

        ``arviz.InferenceData(posterior=diagnosis.posterior)`` goes on with them, and so does ``arviz.from_netcdf`` with
        what ``to_netcdf(file, group="posterior", engine="h5netcdf")`` writes.
        """
        return to_dataset({one.name: (("chain", "draw"), one.draws[None], one.unit) for one in self.parameters
                           if len(one.draws)}, {})


def _plain(value: float) -> float | None:
    """Return `value`, None where JSON has no number for it."""
    return float(value) if math.isfinite(value) else None
