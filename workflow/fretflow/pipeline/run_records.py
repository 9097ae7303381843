"""What stands in a run's result files, by stage: the one place that knows which file of which stage holds what."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.interface import Interface
from fretflow.core.errors import InputError
from fretflow.core.records import Array, quantity, record
from fretflow.core.specimen_mesh import MeshSummary
from fretflow.core.store import read_record
from fretflow.effects.cycle import true_signals
from fretflow.effects.model import EffectModel
from fretflow.pipeline.stage import CHECKPOINTS
from fretflow.solvers.periodic import PeriodicSolution
from fretflow.structure.reduction.reduced_specimen import ModeShapes, ReducedSpecimen
from fretflow.structure.sensors import Signals
from fretflow.structure.two_mass_rig.lumped import RigModes
from fretflow.wear.checkpoint import kept_states
from fretflow.wear.history import WearHistory

SIDES = ("upper", "lower")


@record
class LoopSeries:
    """What is read off the hysteresis loops at several cycle counts; nan where a loop does not show it."""

    cycles: NDArray[np.int64] = quantity("1", "(K,)", coordinate=True)
    regime: tuple[str, ...] = quantity("", "(K,)")
    friction_coefficient: Array = quantity("1", "(K,)")
    tangential_stiffness: Array = quantity("N/m", "(K,)")
    dissipated_energy: Array = quantity("J", "(K,), per cycle")
    sliding_distance: Array = quantity("m", "(K,), without the elastic part")
    peak_to_peak: Array = quantity("m", "(K,)")


@record
class ForcedResponse:
    """The moving mass under a force of constant amplitude, at rising frequencies."""

    cycles: int  # wear cycles before
    excitation: float = quantity("N")
    frequency: Array = quantity("Hz", "(F,)", coordinate=True)
    amplitude: Array = quantity("m", "(F,), first harmonic of the moving mass")
    phase: Array = quantity("rad", "(F,), of that harmonic behind the force, 0 to 2 pi")
    checked: Array = quantity("Hz", "(C,), where the full solution was found too", coordinate=True,
                              default_factory=lambda: np.empty(0))
    error: Array = quantity("1", "(C,), of the amplitude there", default_factory=lambda: np.empty(0))

    @property
    def resonance(self) -> float:
        """Return the frequency (Hz) of the largest amplitude, by the parabola through three points."""
        top = int(np.argmax(self.amplitude))
        if top in (0, len(self.amplitude) - 1):
            return float(self.frequency[top])
        around = slice(top - 1, top + 2)
        a, b, _ = np.polyfit(self.frequency[around] - self.frequency[top], self.amplitude[around], 2)
        return float(self.frequency[top] - b / (2.0 * a))

    @property
    def worst(self) -> tuple[float, float]:
        """Return the largest relative error of the checked amplitudes and its frequency (Hz); nan where none is."""
        if not len(self.error):
            return float("nan"), float("nan")
        place = int(np.argmax(np.abs(self.error)))
        return float(abs(self.error[place])), float(self.checked[place])


def stated_error(responses: Sequence[ForcedResponse]) -> str:
    """Say how far responses are off the full solution where that was found too; empty where it was not."""
    (error, frequency), count = max(one.worst for one in responses), min(len(one.checked) for one in responses)
    return (f"of {count} amplitudes of each curve the worst is {100.0 * error:.1f} % off the full solution, at "
            f"{frequency:.4g} Hz") if count else ""


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
    def meshes(self) -> tuple[MeshSummary, MeshSummary]:
        """Return what the meshes of the upper and the lower specimen hold."""
        upper, lower = (read_record(self._file("mesh", f"{side}.h5"), MeshSummary) for side in SIDES)
        return upper, lower

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

    @cached_property
    def interface(self) -> Interface:
        """Return the unworn contact."""
        upper, lower = self.reduced
        return Interface(upper.contact_nodes[:, :2], upper.contact_areas, upper.profile + lower.profile)

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
    def unworn(self) -> PeriodicSolution:
        """Return the unworn period."""
        return read_record(self._file("solve", "solution.h5"), PeriodicSolution)

    @cached_property
    def periods(self) -> dict[int, PeriodicSolution]:
        """Return the kept periods by cycle count, the unworn one first."""
        if self.has("wear"):
            return dict(sorted(kept_states(self.folders["wear"] / CHECKPOINTS, PeriodicSolution).items()))
        return {0: self.unworn}

    def signals(self, model: EffectModel, total_cycles: int) -> dict[int, Signals]:
        """Return the channels of the kept periods by cycle count, before any sensor; `model` has the run's effects."""
        made = {}
        for cycles, period in self.periods.items():
            worn = int(np.searchsorted(self.history.cycles, cycles)) if self.has("wear") else None
            problem = model.problem(model.initial() if worn is None else self.history.slow(worn))
            observed = (period.upper_observation - period.lower_observation)[:, 0]
            made[cycles] = true_signals(problem, period, observed, cycles / max(total_cycles, 1))
        return made

    @cached_property
    def responses(self) -> list[ForcedResponse]:
        """Return the forced responses there are: unworn, then worn."""
        if not self.has("response"):
            return []
        files = [self.folders["response"] / f"{name}.h5" for name in ("unworn", "worn")]
        return [read_record(file, ForcedResponse) for file in files if file.is_file()]

    @cached_property
    def observed_loops(self) -> LoopSeries:
        """Return what is read off the loops at the observed points."""
        return read_record(self._file("response", "loops_observed.h5"), LoopSeries)
