"""The response stage: loops as the rig's users read them, and the first resonance, unworn and worn."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fretflow.case.config import Case, PeriodicMethod, SlidingRegime
from fretflow.core.errors import NonConvergenceError
from fretflow.core.store import read_record, write_csv, write_record
from fretflow.effects.model import EffectModel
from fretflow.pipeline.ensemble import LocalPool, own_processes
from fretflow.pipeline.problem import make_model
from fretflow.pipeline.response_curves import sweep_of
from fretflow.pipeline.run_records import ForcedResponse, LoopSeries, RunRecords
from fretflow.pipeline.stage import Figures, Stage, StageContext
from fretflow.recordings.hysteresis import HysteresisLoop, LoopReadings, read_loop
from fretflow.solvers.continuation.curve import SweepDirection, channel_index
from fretflow.solvers.continuation.follow import respond
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution, PeriodicSolver
from fretflow.solvers.quasi_static.backbone import BackboneSolver, has_backbone
from fretflow.solvers.solve import make_solver

WORTH_A_PROCESS = 100  # nodes: a response takes some 9 s at 121, of which a process that starts takes 2 s
REFINEMENTS = 4  # halvings of the frequency step on both sides of the largest point


def _read(displacement: NDArray[np.float64], force: NDArray[np.float64], normal_load: float) -> LoopReadings:
    """Read one loop; faces that stick all the time do not move at all, and make none."""
    if np.ptp(displacement) > 0.0:
        return read_loop(HysteresisLoop(displacement=displacement, force=force), normal_load)
    return LoopReadings(regime=SlidingRegime.STICK, friction_coefficient=None, friction_limit=None,
                        tangential_stiffness=None, tangential_compliance=None, dissipated_energy=0.0,
                        sliding_distance=0.0, peak_to_peak=0.0)


def read_loops(periods: Mapping[int, PeriodicSolution], normal_load: float,
               displacement: Callable[[PeriodicSolution], NDArray[np.float64]]) -> LoopSeries:
    """Read the loops of `periods`, given by cycle count, under `normal_load` (N).

    `displacement` returns the relative displacement (N,), m, that a period's friction force is drawn over.
    """
    readings = [_read(displacement(period), period.friction_force, normal_load) for period in periods.values()]
    names = ("friction_coefficient", "tangential_stiffness", "dissipated_energy", "sliding_distance", "peak_to_peak")
    return LoopSeries(
        cycles=np.array(list(periods), dtype=np.int64), regime=tuple(str(r.regime) for r in readings),
        **{name: np.array([getattr(one, name) for one in readings], dtype=float) for name in names})  # None is nan


def step_frequencies(solver: PeriodicSolver, problem: PeriodicProblem, frequencies: NDArray[np.floating[Any]],
                     note: Callable[[int], None]) -> dict[float, PeriodicSolution]:
    """Return the period at each of the rising `frequencies` (Hz) and at some more near the largest amplitude.

    Each solution starts from its neighbour's, and from zero where that fails.

    Raises
    ------
    NonConvergenceError
        Naming the frequency.
    """
    solutions: dict[float, PeriodicSolution] = {}

    def solve(frequency: float) -> None:
        nearest = min(solutions, key=lambda known: abs(known - frequency), default=None)
        solutions[frequency] = _solve_near(solver, problem.vary(frequency=frequency), solutions.get(nearest or 0.0))
        note(len(solutions))

    for frequency in frequencies:
        solve(float(frequency))
    for _ in range(REFINEMENTS):
        known = sorted(solutions)
        top = max(known, key=lambda frequency: abs(first_harmonic(solutions[frequency])))
        place = known.index(top)
        for neighbour in known[max(place - 1, 0):place] + known[place + 1:place + 2]:
            solve(0.5 * (top + neighbour))
    return dict(sorted(solutions.items()))


def _solve_near(
    solver: PeriodicSolver, problem: PeriodicProblem, start: PeriodicSolution | None
) -> PeriodicSolution:
    try:
        return solver.solve(problem, start)
    except NonConvergenceError:
        if start is None:
            raise
    try:
        return solver.solve(problem)
    except NonConvergenceError as error:
        raise NonConvergenceError(
            f"forced response at {problem.frequency:.6g} Hz: {error}", error.history
        ) from error


def first_harmonic(solution: PeriodicSolution) -> complex:
    """Return the complex amplitude U of the moving mass, ``x = Re U exp(i omega t)``, in m."""
    block = solution.rig_displacement[:, 0]
    return complex(2.0 * np.fft.rfft(block)[1] / len(block))


def forced_response(case: Case, solver: PeriodicSolver, problem: PeriodicProblem, cycles: int,
                    progress: Callable[[float], None]) -> ForcedResponse:
    """Return the response of `problem` over the frequencies that `case` asks for, after `cycles` of wear."""
    asked = case.output.frequency_response
    frequencies = np.geomspace(asked.start, asked.stop, asked.points)
    total = asked.points + 2 * REFINEMENTS
    periods = step_frequencies(solver, problem, frequencies, lambda done: progress(min(1.0, done / total)))
    amplitudes = np.array([first_harmonic(period) for period in periods.values()])
    return ForcedResponse(cycles=cycles, excitation=problem.excitation.amplitude, frequency=np.array(list(periods)),
                          amplitude=np.abs(amplitudes), phase=np.mod(-np.angle(amplitudes), 2.0 * np.pi))


def check_response(solver: PeriodicSolver, problem: PeriodicProblem, response: ForcedResponse) -> ForcedResponse:
    """Return a response with its amplitudes compared to `solver`'s: at both ends, the peak and midway between them.

    Where `solver` finds no period nothing is compared.
    """
    order, last = response.frequency, len(response.frequency) - 1
    top = int(np.argmax(response.amplitude))
    midway = [int(np.argmin(np.abs(np.log(order**2 / (order[top] * order[end]))))) for end in (0, last)]
    errors = {}
    for place in sorted({0, midway[0], top, midway[1], last}):
        with suppress(NonConvergenceError):
            full = solver.solve(problem.vary(frequency=float(order[place])))
            errors[float(order[place])] = float(response.amplitude[place] / abs(first_harmonic(full)) - 1.0)
    return replace(response, checked=np.array([*errors]), error=np.array([*errors.values()]))


def _respond(case: Case, problem: PeriodicProblem, cycles: int, progress: Callable[[float], None]) -> ForcedResponse:
    """Step the frequency with the contact's backbone and check some points, or with DLFT where the case asks for it.

    What a backbone does not know (an effect) is followed by continuation.
    """
    solver = make_solver(case.solver)
    if case.solver.method is PeriodicMethod.DLFT:
        return forced_response(case, solver, problem, cycles, progress)
    if not has_backbone(problem):
        return _followed(case, problem, cycles, progress)
    fast = BackboneSolver.of(problem, case.solver.resolved_harmonics, case.solver.resolved_samples)
    return check_response(solver, problem, forced_response(case, fast, problem, cycles, progress))


def _followed(case: Case, problem: PeriodicProblem, cycles: int, progress: Callable[[float], None]) -> ForcedResponse:
    """Return the response by continuation from the lowest frequency upward."""
    sweep = replace(sweep_of(case, None, None), directions=(SweepDirection.UP,))

    def note(direction: SweepDirection, frequency: float) -> None:
        progress(min(1.0, np.log(frequency / sweep.start) / np.log(sweep.stop / sweep.start)))

    curve = respond(problem, sweep, note)
    block = curve.first_harmonic[:, channel_index("block")]
    return ForcedResponse(cycles=cycles, excitation=problem.excitation.amplitude, frequency=curve.frequency,
                          amplitude=np.abs(block), phase=np.mod(-np.angle(block), 2.0 * np.pi))


def _run(context: StageContext) -> Figures:
    """Write the loops' readings and the forced responses.

    ``loops_observed.h5`` and ``loops_faces.h5`` (LoopSeries): at the observed points and at the faces.
    ``unworn.h5`` and ``worn.h5`` (ForcedResponse); without wear only the first. ``measured_loops.csv``: as sensors
    record them.
    """
    case = context.case
    model, run = make_model(case, context.inputs["reduce"]), RunRecords(context.inputs)
    history = run.history
    unworn, worn = model.problem(model.initial()), model.problem(history.slow(-1))
    _write_loops(context.folder, run, unworn)
    _write_measured(context, model, run)
    states = {"unworn": (0, unworn), "worn": (int(history.cycles[-1]), worn)}
    if not history.depth[-1].any() and not model.effects:
        del states["worn"]
    files = {name: context.folder / f"{name}.h5" for name in states}
    left = [name for name, file in files.items() if not file.is_file()]  # all but those of an interrupted run
    at_once = min(own_processes(), len(left)) if unworn.interface.size >= WORTH_A_PROCESS else 1
    if at_once > 1:
        context.progress(0.0, f"frequency stepping, {' and '.join(left)}")
    with LocalPool(at_once) as pool:
        pool(_write_response, [
            (case, states[name], files[name], None if at_once > 1 else part(context, index, len(left), name))
            for index, name in enumerate(left)])
    figures: dict[str, float | int | str | None] = {}
    for name, file in files.items():
        response = read_record(file, ForcedResponse)
        figures[f"{name}_resonance_Hz"] = response.resonance
        figures[f"{name}_points"] = len(response.frequency)
        figures[f"{name}_worst_error"] = response.worst[0]
    return figures


def _write_response(call: tuple[Case, tuple[int, PeriodicProblem], Path, Callable[[float], None] | None]) -> None:
    """Write the response of a case at a cycle count into a file, and tell of the progress where that is asked for."""
    case, (cycles, problem), file, progress = call
    write_record(file, _respond(case, problem, cycles, progress or (lambda share: None)))


def _write_loops(folder: Path, run: RunRecords, problem: PeriodicProblem) -> None:
    motions: dict[str, Callable[[PeriodicSolution], NDArray[np.float64]]] = {
        "observed": lambda period: (period.upper_observation - period.lower_observation)[:, 0],
        "faces": lambda period: problem.interface.mean(period.displacement[:, :, 0])}
    for name, motion in motions.items():
        series = read_loops(run.periods, problem.normal_load, motion)
        write_record(folder / f"loops_{name}.h5", series)
        units = {f.name: f.metadata.get("unit", "1") for f in fields(series)}
        write_csv(folder / f"loops_{name}.csv", {
            key + (f"_{unit}" if unit != "1" else ""): getattr(series, key) for key, unit in units.items()})


def _write_measured(context: StageContext, model: EffectModel, run: RunRecords) -> None:
    """Write ``measured_loops.csv``: what the sensors of the rig would record at each kept cycle count."""
    rows = [(cycles, model.sense(seen)) for cycles, seen in run.signals(model, context.case.test.total_cycles).items()]
    write_csv(context.folder / "measured_loops.csv", {
        "cycle": np.concatenate([np.full(len(seen.displacement), cycles) for cycles, seen in rows]),
        "time_s": np.concatenate([seen.step * np.arange(len(seen.displacement)) for _, seen in rows]),
        "excitation_N": np.concatenate([seen.excitation for _, seen in rows]),
        "displacement_m": np.concatenate([seen.displacement for _, seen in rows]),
        "friction_force_N": np.concatenate([seen.friction_force for _, seen in rows])})


def part(context: StageContext, index: int, parts: int, text: str) -> Callable[[float], None]:
    """Return the progress of part `index` of several equal `parts` of a stage."""
    return lambda share: context.progress((index + share) / parts, f"frequency stepping, {text}")


STAGE = Stage("response", 4, lambda case: case.output.frequency_response, ("reduce", "solve", "wear"), _run)
