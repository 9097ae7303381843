"""The spot check of solved periods: each is the start of a time integration, which should stay with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fretflow.case.config import Case
from fretflow.core.errors import InputError, StoreError
from fretflow.core.records import quantity, record
from fretflow.core.store import write_csv
from fretflow.effects.cycle import respond
from fretflow.pipeline.problem import make_model
from fretflow.pipeline.run_records import RunRecords
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution
from fretflow.solvers.time_integration import settle

AGREEMENT = 0.01
SETTLED = 1e-3  # drift per period at which the integration stops, of the arm's peak-to-peak
PATIENCE = 10  # times the asked periods, then it stops anyway
FINER = 4  # steps a sample
FEWEST_STEPS = 512
SMALL = 0.01  # of the arm's motion: less sliding counts as that much, so that a joint that sticks can be checked


@record
class PeriodCheck:
    """A periodic solution beside the last period of a time integration that began at it.

    Both are given at the solution's samples.
    """

    name: str
    method: str
    cycles: int  # wear cycles before
    steps_per_period: int
    time: NDArray[np.float64] = quantity("s", "(N,)")
    periodic_displacement: NDArray[np.float64] = quantity("m", "(N,), area mean of the faces' x")
    periodic_force: NDArray[np.float64] = quantity("N", "(N,)")
    integrated_displacement: NDArray[np.float64] = quantity("m", "(N,)")
    integrated_force: NDArray[np.float64] = quantity("N", "(N,)")
    sliding_distance: tuple[float, float] = quantity("m")  # periodic, integrated
    dissipated_energy: tuple[float, float] = quantity("J")  # per cycle; periodic, integrated
    arm_range: float = quantity("m")  # peak to peak, integrated
    drift: NDArray[np.float64] = quantity("1", "(periods - 1,), see TimeHistory.change")

    @property
    def sliding_difference(self) -> float:
        """Return the error of the sliding distance, relative to the integrated one."""
        periodic, integrated = self.sliding_distance
        return abs(periodic - integrated) / max(integrated, SMALL * self.arm_range)

    @property
    def energy_difference(self) -> float:
        """Return the error of the dissipated energy, relative to the integrated one."""
        periodic, integrated = self.dissipated_energy
        least = SMALL * self.arm_range * float(np.ptp(self.integrated_force))
        return abs(periodic - integrated) / max(integrated, least)

    @property
    def force_difference(self) -> float:
        """Return the rms difference of the friction force, relative to its range."""
        distance = self.periodic_force - self.integrated_force
        return float(np.sqrt(np.mean(distance**2)) / np.ptp(self.integrated_force))

    @property
    def error(self) -> float:
        """Return the largest of the three differences and the last drift."""
        return max(self.sliding_difference, self.energy_difference, self.force_difference,
                   float(self.drift[-1:].max(initial=0.0)))

    @property
    def agrees(self) -> bool:
        """Return whether nothing differs by more than 1 %."""
        return self.error <= AGREEMENT


def check_period(name: str, cycles: int, problem: PeriodicProblem, solution: PeriodicSolution, periods: int = 3,
                 steps: int | None = None) -> PeriodCheck:
    """Integrate at least `periods` periods from `solution` and set their last one beside it.

    The integration goes on, for up to ten times as many periods, while it still drifts by more than 0.1 % in one:
    a right solution is left within a period or two, a wrong one is followed to where it should be.

    Parameters
    ----------
    name : str
        What the period is called in tables.
    cycles : int
        Wear cycles before it.
    problem : PeriodicProblem
        Its gap includes the wear.
    solution : PeriodicSolution
    periods : int
    steps : int, optional
        Per period; by default four a sample of the solution, and at least 512.

    Raises
    ------
    InputError
        If there are too few periods or steps.
    NonConvergenceError
        If the contact of a step is not found.
    """
    samples = len(solution.state)
    steps = max(FINER * samples, FEWEST_STEPS) if steps is None else steps
    history = settle(problem, solution, (periods, PATIENCE * periods), steps, SETTLED)
    response = respond(solution, problem.interface)

    def at_samples(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.interp(np.arange(samples) / samples, np.arange(steps) / steps, history.of_period(values), period=1.0)

    return PeriodCheck(
        name=name, method=solution.method, cycles=cycles, steps_per_period=steps,
        time=np.arange(samples) / (samples * problem.frequency),
        periodic_displacement=problem.interface.mean(solution.displacement[:, :, 0]),
        periodic_force=solution.friction_force,
        integrated_displacement=at_samples(history.relative_displacement),
        integrated_force=at_samples(history.friction_force),
        sliding_distance=(response.sliding_distance, float(history.sliding_distance[-1])),
        dissipated_energy=(response.dissipated_energy, float(history.dissipated_energy[-1])),
        arm_range=float(np.ptp(history.of_period(history.outputs["arm"]))), drift=history.change)


def verify_run(case: Case, folders: Mapping[str, Path], periods: int, steps: int | None,
               note: Callable[[str], None]) -> list[PeriodCheck]:
    """Check the unworn period of a run and, if its wear stage is complete, the last worn one.

    Parameters
    ----------
    case : Case
    folders : mapping of str to Path
        The run's complete stages.
    periods, steps
        As for `check_period`.
    note : callable
        Told what begins.

    Raises
    ------
    StoreError
        If the run has no solved period, or a result file is damaged.
    InputError
        If there are too few periods or steps.
    NonConvergenceError
        If the contact of a step is not found.
    """
    if not {"reduce", "solve"} <= set(folders):
        raise StoreError(f"{case.name}: no solved period yet; `fretflow run CASE --until solve` makes one")
    model = make_model(case, folders["reduce"])
    unworn = model.problem(model.initial())
    run = RunRecords(folders)
    points = [("unworn", 0, unworn, run.unworn)]
    if run.has("wear") and (last := max(run.periods, default=0)) > 0:
        slow = run.history.slow(int(np.searchsorted(run.history.cycles, last)))
        points.append(("worn", last, model.problem(slow), run.periods[last]))
    checks = []
    for name, cycles, problem, solution in points:
        note(f"{name}: integrating from the periodic solution")
        checks.append(check_period(name, cycles, problem, solution, periods, steps))
    return checks


def write_checks(folder: Path, checks: Sequence[PeriodCheck]) -> list[Path]:
    """Write ``NAME.csv`` with the curves of each check, and ``checks.csv`` with their figures.

    Raises
    ------
    StoreError
        If a file cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"{folder}: cannot be written ({error.strerror}); free some space") from error
    files = [write_csv(folder / f"{check.name}.csv", {
        "time_s": check.time,
        "periodic_displacement_m": check.periodic_displacement, "periodic_friction_N": check.periodic_force,
        "integrated_displacement_m": check.integrated_displacement, "integrated_friction_N": check.integrated_force,
    }) for check in checks]
    names = ("name", "method", "cycles", "steps_per_period", "sliding_difference", "energy_difference",
             "force_difference", "agrees")
    columns: dict[str, list[object]] = {name: [getattr(check, name) for check in checks] for name in names}
    for key, unit in (("sliding_distance", "m"), ("dissipated_energy", "J")):
        for place, which in enumerate(("periodic", "integrated")):
            columns[f"{which}_{key}_{unit}"] = [getattr(check, key)[place] for check in checks]
    columns["drift_per_period"] = [float(check.drift[-1:].max(initial=0.0)) for check in checks]
    return [*files, write_csv(folder / "checks.csv", columns)]


def verdict(checks: Sequence[PeriodCheck]) -> str | None:
    """Return what disagrees, in one line, or None if all periods agree with time integration."""
    wrong = [f"{check.name} period off by {100.0 * check.error:.1f} % (sliding distance "
             f"{100.0 * check.sliding_difference:.1f} %, "
             f"energy {100.0 * check.energy_difference:.1f} %, force {100.0 * check.force_difference:.1f} %)"
             for check in checks if not check.agrees]
    if not wrong:
        return None
    remedy = ('use method = "quasi-static"' if any(c.method == "dlft" for c in checks if not c.agrees)
              else "use more samples and harmonics")
    return f"periodic solution and time integration differ: {', '.join(wrong)}; {remedy}"


def check_same_case(given: Case, run: Case, home: Path) -> None:
    """Check that the run in `home` is one of `given`.

    Raises
    ------
    InputError
        If it is of another version of the case.
    """
    if given != run:
        raise InputError(f"{home}: was made with other values than the case file has now; "
                         "run the case again, or give the run's folder")
