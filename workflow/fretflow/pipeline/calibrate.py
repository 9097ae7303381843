"""Masses, springs and damping of the rig from measured modes and sliding distances, K_w from a worn volume."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import eigh

from fretflow.case.casefile import dump_case
from fretflow.case.config import Case, Rig
from fretflow.core.errors import InputError
from fretflow.core.plugins import FIGURES, provided
from fretflow.core.records import Array, to_dataset
from fretflow.core.store import write_whole
from fretflow.core.units import pretty_quantity
from fretflow.inference.evidence import drawn
from fretflow.pipeline.problem import make_problem
from fretflow.pipeline.run_records import RunRecords
from fretflow.pipeline.runner import Runner
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution
from fretflow.solvers.quasi_static.jenkins_start import jenkins_arm_motion
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver, sliding_distance
from fretflow.structure.two_mass_rig.identification import Data, Identification, LogNormalPrior, identify_mapped
from fretflow.structure.two_mass_rig.joint import rig_of
from fretflow.structure.two_mass_rig.lumped import LumpedRig
from fretflow.wear.identification import WearCoefficient, identify_wear_coefficient, settled_face

# How far a case's rig may be off before anything is measured: a factor for one standard deviation up or down.
PRIOR_FACTORS = {"moving_mass": 3.0, "arm_mass": 3.0, "in_phase_frequency": 1.2,
                 "out_of_phase_frequency": 1.2, "damping_ratio": 10.0}
UNITS = {"moving_mass": "kg", "arm_mass": "kg", "in_phase_frequency": "Hz", "out_of_phase_frequency": "Hz",
         "damping_ratio": ""}
MODES = ("in_phase_frequency", "out_of_phase_frequency")
# Relative standard deviations of measured values that state none.
SLIDING_SD, MODE_SD, VOLUME_SD = 0.05, 0.01, 0.05
# Where to start: moving mass and damping over their priors, in standard deviations.
START_MASSES, START_DAMPINGS = np.linspace(-1.5, 1.5, 13), np.linspace(-1.0, 1.5, 9)
ELEMENT_SAMPLES = 128
BEYOND = 1.2  # times the cycles that a proportional volume would take
MAX_EXTENSIONS = 8


@dataclass(frozen=True)
class CalibrationTest:
    """A load at which the sliding distance was measured."""

    name: str
    problem: PeriodicProblem  # on the settled face, where the test spends most of its time
    distance: float  # m
    relative_sd: float


@dataclass
class CalibratedRig:
    """Measured values as functions of the rig; each period starts from the last one at its load."""

    conditions: Sequence[CalibrationTest]
    modes: tuple[str, ...]
    solver: QuasiStaticSolver
    added_mass: float  # kg, of the upper specimen, which moves with the arm
    _last: dict[str, PeriodicSolution] = field(default_factory=dict)

    def predict(self, parameters: Array) -> Array:
        """Return the modes (Hz) and sliding distances (m) by true periods."""
        return self._values(parameters, self._period)

    def estimate(self, parameters: Array) -> Array:
        """Return them with the contact as one friction element, which takes milliseconds."""
        return self._values(parameters, _element)

    def _values(self, parameters: Array, sliding: Callable[[CalibrationTest, LumpedRig], float]) -> Array:
        rig = LumpedRig.from_modes(*map(float, parameters))
        frequencies = dict(zip(MODES, rig_modes(rig), strict=True))
        heavier = replace(rig, arm_mass=rig.arm_mass + self.added_mass)
        return np.array([*(frequencies[mode] for mode in self.modes), *(sliding(c, heavier) for c in self.conditions)])

    def _period(self, condition: CalibrationTest, rig: LumpedRig) -> float:
        problem = replace(condition.problem, structure=rig_of(condition.problem.structure).with_rig(rig))
        self._last[condition.name] = solution = self.solver.solve(problem, self._last.get(condition.name))
        return sliding_distance(solution, problem.interface)


def rig_modes(rig: LumpedRig) -> Array:
    """Return the two sliding modes of the bare rig, Hz, ascending."""
    return np.asarray(np.sqrt(eigh(rig.stiffness, rig.mass, eigvals_only=True)) / (2.0 * np.pi))


def calibrate_rig(cases: Sequence[Case], reduced: Mapping[str, Path]) -> Identification:
    """Identify masses, modes (hence springs) and damping of the rig that all `cases` share.

    A measured sliding distance, the mean of a test, is met by the model on the settled face, where the wear of a test
    in gross slip spends most of its time.

    Parameters
    ----------
    cases : sequence of Case
        With ``measured``; equal but for the test, the wear and what was measured.
    reduced : mapping of str to Path
        Folder of the reduced specimens by the case's name.

    Raises
    ------
    InputError
        If the cases differ, no sliding distance was measured, or the hinge has a damping ratio of its own.
    NonConvergenceError
        If a period is not found.
    """
    _check_alike(cases)
    first = cases[0]
    if first.rig.hinge_damping_ratio is not None:
        raise InputError(f"{first.name}: rig.hinge_damping_ratio: one damping ratio is identified, of both springs; "
                         "leave it out")
    conditions = [_condition(case, reduced[case.name]) for case in cases if case.measured.sliding_distance]
    if not conditions:
        raise InputError("measured.sliding_distance: no case has it, so that nothing tells the rig's masses")
    modes = {mode: value for mode in MODES if (value := getattr(first.measured, mode)) is not None}
    added = rig_of(conditions[0].problem.structure).quasi_static().rig.arm_mass - first.rig.arm_mass
    solver = QuasiStaticSolver(first.solver.model_copy(update={"estimate_error": False}))
    model = CalibratedRig(conditions, tuple(modes), solver, added)
    data = Data(
        names=(*modes, *(condition.name for condition in conditions)),
        value=np.array([*modes.values(), *(condition.distance for condition in conditions)]),
        relative_sd=np.array([*(MODE_SD for _ in modes), *(condition.relative_sd for condition in conditions)]))
    prior = LogNormalPrior(names=tuple(PRIOR_FACTORS), factor=np.array(list(PRIOR_FACTORS.values())),
                  value=np.array([getattr(first.rig, name) for name in PRIOR_FACTORS]))
    return identify_mapped(model.predict, model.estimate, prior, data, _starts(prior))


def calibrated_case(case: Case, rig: Identification | None, coefficient: float | None) -> Case:
    """Return `case`, renamed, with the identified rig and wear coefficient where there are any, to six figures."""
    updates: dict[str, object] = {"name": f"{case.name}-calibrated"}
    if rig is not None:
        values: dict[str, Any] = {name: float(f"{value:.6g}")
                                  for name, value in zip(rig.prior.names, rig.value, strict=True)}
        updates["rig"] = Rig.model_construct(**values)
    if coefficient is not None:
        updates["wear"] = case.wear.model_copy(update={"coefficient": float(f"{coefficient:.6g}")})
    return case.model_copy(update=updates)


def calibrate_wear(case: Case, run: Callable[[Case], Mapping[str, Path]]) -> WearCoefficient:
    """Identify the coefficient with which `case` wears its measured volume by the end of the test.

    Parameters
    ----------
    case : Case
        With ``measured.worn_volume``.
    run : callable
        Runs a case up to the wear stage and returns the folders of its stages.

    Raises
    ------
    InputError
        If the model cannot wear that much.
    """
    volume, cycles = case.measured.worn_volume, case.test.total_cycles
    if volume is None or cycles == 0:
        raise InputError(f"{case.name}: needs measured.worn_volume and a test with cycles")
    sd = case.measured.worn_volume_sd or VOLUME_SD * volume
    marched = case
    for _ in range(MAX_EXTENSIONS):
        worn = RunRecords(run(marched))
        coefficient = identify_wear_coefficient(worn.history, worn.areas, case.wear.coefficient, cycles, volume, sd)
        if coefficient is not None:
            return coefficient
        longer = math.ceil(BEYOND * marched.test.total_cycles * volume / float(worn.history.volume[-1]))
        marched = case.model_copy(
            update={"test": case.test.model_copy(update={"cycles": longer, "duration": None})})
    raise InputError(f"{case.name}: measured.worn_volume = {volume * 1e9:.4g} mm³ is not reached in "
                     f"{marched.test.total_cycles:,} cycles; raise wear.coefficient")


def _condition(case: Case, reduced: Path) -> CalibrationTest:
    if case.effects:
        raise InputError(f"{case.name}: calibrate identifies the baseline only, whose wear goes with coefficient times "
                         f"cycles; leave out [effects.{min(case.effects)}]")
    problem, distance = make_problem(case, reduced), case.measured.sliding_distance or math.nan
    interface, flexibility = problem.interface, problem.boundary.flexibility[2::3, 2::3]
    worn = settled_face(flexibility, interface.areas, interface.gap, problem.normal_load)
    sd = case.measured.sliding_distance_sd
    return CalibrationTest(
        name=f"sliding distance of {case.name}", distance=distance,
        problem=replace(problem, interface=replace(interface, gap=interface.gap + worn)),
        relative_sd=SLIDING_SD if sd is None else sd / distance)


def _element(condition: CalibrationTest, rig: LumpedRig) -> float:
    """Return the sliding distance, m, with the contact as one element as stiff as the stuck joint."""
    problem, joint = condition.problem, condition.problem.boundary
    sliding = joint.motion[:, 1]
    stiffness = float(sliding @ joint.bare_stiffness @ sliding)
    limit = float(np.mean(problem.friction_coefficient)) * problem.normal_load
    arm = jenkins_arm_motion(rig, stiffness, limit, problem.excitation.amplitude, problem.frequency, ELEMENT_SAMPLES)
    return max(float(np.ptp(arm)) - 2.0 * limit / stiffness, 0.0)


def _starts(prior: LogNormalPrior) -> list[Array]:
    mass, damping = (prior.names.index(name) for name in ("moving_mass", "damping_ratio"))
    unit = np.eye(len(prior.names))
    return [prior.parameters(a * unit[mass] + b * unit[damping]) for a in START_MASSES for b in START_DAMPINGS]


def _check_alike(cases: Sequence[Case]) -> None:
    for case in cases[1:]:
        for part in ("rig", "specimen", "mesh", "reduction", "contact", "solver"):
            if getattr(case, part) != getattr(cases[0], part):
                raise InputError(f"{case.name}: [{part}] differs from that of {cases[0].name}; cases that are "
                                 "calibrated together are of one joint")


def calibrate_cases(cases: Sequence[Case], runner: Runner, out: Path, tell_rig: Callable[[Identification], None],
                    tell_wear: Callable[[str, WearCoefficient], None]) -> list[Path]:
    """Identify what the cases' [measured] tables allow, tell it, and write calibrated cases and a JSON file.

    Raises
    ------
    InputError
        If nothing was measured that could be calibrated on.
    """
    if not any(case.measured.sliding_distance or case.measured.worn_volume for case in cases):
        raise InputError("[measured]: no case has a sliding_distance or a worn_volume to calibrate on")
    rig = None
    if any(case.measured.sliding_distance for case in cases):
        reduced = {case.name: runner.run(case, "reduce")["reduce"].folder for case in cases}
        rig = calibrate_rig(cases, reduced)
        tell_rig(rig)
    coefficients: dict[str, WearCoefficient] = {}
    for case in cases:
        if case.measured.worn_volume:
            coefficients[case.name] = calibrate_wear(
                calibrated_case(case, rig, None),
                lambda one: {name: result.folder for name, result in runner.run(one, "wear").items()})
            tell_wear(case.name, coefficients[case.name])
    shared = _mean(list(coefficients.values()))
    files = [_write(out, calibrated_case(case, rig, shared), _remarks(rig, coefficients)) for case in cases]
    content = json.dumps(_plain(rig, coefficients), indent=2)
    write_whole(out / "calibration.json", f"{content}\n".encode())
    return [*files, *(_posterior(out, rig) if rig is not None else ()), out / "calibration.json"]


def _posterior(out: Path, rig: Identification) -> list[Path]:
    """Write draws of the rig's parameters, as ArviZ reads them, and their corner plot."""
    draws = dict(zip(UNITS.items(), np.exp(drawn(np.log(rig.value), rig.covariance)), strict=True))
    chains = to_dataset({name: (("chain", "draw"), own[None], unit or "1") for (name, unit), own in draws.items()}, {})
    chains.to_netcdf(out / "calibration.nc", group="posterior", engine="h5netcdf")
    told = "90 % and 50 % regions; a parameter that the data do not determine is as wide as before"
    return [out / "calibration.nc", provided(FIGURES, "corner")(
        out / "calibration.png", "Calibrated rig", told, [(f"rig.{name}", unit or "1", own)
                                                          for (name, unit), own in draws.items()])]


def parameter_rows(identification: Identification) -> list[dict[str, Any]]:
    """Return the rig's parameters for people: before, after, 95 % interval, whether the data determine them."""
    low, high = identification.interval
    return [{"name": name, "before": pretty_quantity(before, unit, 4), "after": pretty_quantity(after, unit, 4),
             "low": pretty_quantity(a, unit, 3), "high": pretty_quantity(b, unit, 3), "determined": bool(known)}
            for (name, unit), before, after, a, b, known in zip(
                UNITS.items(), identification.prior.value, identification.value, low, high, identification.determined,
                strict=True)]


def _mean(coefficients: Sequence[WearCoefficient]) -> float | None:
    """Return the mean coefficient, each by the inverse of its variance."""
    if not coefficients:
        return None
    weights = [1.0 / one.sd**2 for one in coefficients]
    return sum(w * one.value for w, one in zip(weights, coefficients, strict=True)) / sum(weights)


def _remarks(rig: Identification | None, coefficients: Mapping[str, WearCoefficient]) -> list[str]:
    lines = ["# Calibrated on measured values; intervals are of 95 %."]
    if rig is not None:
        lines += [f"# rig.{row['name']}: {row['low']} to {row['high']}, "
                  + ("determined" if row["determined"] else "not determined by these data")
                  for row in parameter_rows(rig)]
    for name, one in coefficients.items():
        low, high = one.interval
        lines.append(f"# wear.coefficient by {name}: {low:.4g} to {high:.4g} m^2/N")
    return lines


def _write(out: Path, case: Case, remarks: Sequence[str]) -> Path:
    path = out / f"{case.name}.toml"
    write_whole(path, ("\n".join(remarks) + "\n\n" + dump_case(case)).encode())
    return path


def _plain(rig: Identification | None, coefficients: Mapping[str, WearCoefficient]) -> dict[str, Any]:
    plain: dict[str, Any] = {
        "wear_coefficient_m2_per_N": {name: {"value": one.value, "low": one.interval[0], "high": one.interval[1]}
                                      for name, one in coefficients.items()}}
    if rig is None:
        return plain
    low, high = rig.interval
    springs = LumpedRig.from_modes(*map(float, rig.value))
    plain["rig"] = {
        name: {"value": value, "low": a, "high": b, "unit": UNITS[name] or "1", "determined": bool(known)}
        for name, value, a, b, known in zip(rig.prior.names, map(float, rig.value), map(float, low), map(float, high),
                                            rig.determined, strict=True)}
    plain["springs_N_per_m"] = {"ground": springs.ground_stiffness, "hinge": springs.hinge_stiffness}
    plain["fit"] = {name: {"measured": value, "model": predicted, "standard_deviations_off": off}
                    for name, value, predicted, off in zip(rig.data.names, map(float, rig.data.value),
                                                           map(float, rig.predicted), map(float, rig.deviation),
                                                           strict=True)}
    plain["determined_products"] = [{"product": rig.product(k), "relative_sd": float(rig.direction_sd[k]),
                                     "gain": float((1.0 + rig.strength[k]**2) ** 0.5)}
                                    for k in range(len(rig.strength))]
    return plain
