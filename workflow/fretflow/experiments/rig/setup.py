"""The rig of a recording before anything is fitted: its case, where the fit begins, and what its meshes leave out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fretflow.case.config import Case, Mesh, Rig, Specimens, Wear, validate_case
from fretflow.case.plausibility import PLAUSIBLE
from fretflow.case.sections import ContactSection
from fretflow.core.errors import NonConvergenceError, UnreliableRecordingError
from fretflow.core.records import Array
from fretflow.core.units import pretty_quantity
from fretflow.effects.contact_stiffness import ContactStiffness
from fretflow.experiments.rig.model import SAMPLES, RigModel
from fretflow.experiments.rig.observation import Observation, check_blocks
from fretflow.experiments.rig.simulation import Hypothesis, Simulation
from fretflow.recordings.kinds.facts import FactsTest
from fretflow.recordings.loopset import plateau
from fretflow.recordings.recording import Recording
from fretflow.recordings.schema import DisplacementOf, MeasuredAt, RecordedTest
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.structure.two_mass_rig.joint import rig_of

# Elements per side of the contact square that fits are made with, of second degree: with the same 25 nodes as 4 by 4
# linear elements the specimens' compliance is 2.9 % too small instead of 9.7 %. One more tells what these leave out.
ELEMENTS, DEGREE, GROWTH = 2, 2, 2.0
CONFIRMING = Mesh().contact_elements // DEGREE  # with the nodes of a case's own mesh
FRICTION = PLAUSIBLE["contact.friction_coefficient"]
# The corners of ridge and body let the compliance converge by about h^1.1 only (M. L. Williams, J. Appl. Mech. 19
# (1952) 526-528: exponent 0.54 of a corner of 270 degrees, twice that in energy). Against 6 by 6 elements, growth 1.35,
# the coarse mesh misses 2.4 to 3.2 of the difference between the two; what is told beyond the finer stays as an error.
EXTRAPOLATED = 2.5


def case_of(recording: Recording, elements: int = CONFIRMING, name: str = "recorded") -> Case:
    """Return the case of a recording of the rig; what it does not say is as the defaults have it.

    Raises
    ------
    UnreliableRecordingError
        If it lacks what no default can replace.
    """
    test = recording.test
    for field in ("excitation_amplitude", "normal_load", "excitation_frequency"):
        if getattr(test, field) is None:
            raise UnreliableRecordingError(f"{recording.path}: test.{field} is not given; a recording of the rig is "
                                           "predicted from it")
    loops = recording.loops
    check_blocks(recording)
    case = bare_case(test, test.cycles or int(loops.cycles[-1] if loops else 0), elements, name)
    specimen = recording.specimen or Specimens()
    distance = None if loops is None else loops.displacement_of
    if distance is not None and distance.distance > 0.0:
        if any(distance.distance > one.ridge_height + one.body_height for one in (specimen.upper, specimen.lower)):
            raise UnreliableRecordingError(f"{recording.path}: loops.displacement_of: "
                                           f"{pretty_quantity(distance.distance, 'm')} lies outside the specimen")
        sides = {side: getattr(specimen, side).model_copy(update={"observation_distance": distance.distance})
                 for side in ("upper", "lower")}
        specimen = specimen.model_copy(update=sides)
    return case.model_copy(update={"title": recording.title, "rig": recording.rig or Rig(), "specimen": specimen})


def linear_case(case: Case) -> Case:
    """Return a case with the same contact nodes on linear elements: what another code as coarse would solve."""
    mesh = case.mesh.model_copy(update={"contact_elements": case.mesh.contact_elements * case.mesh.degree, "degree": 1})
    return case.model_copy(update={"name": f"{case.name}-linear", "mesh": mesh})


def bare_case(test: RecordedTest | FactsTest, cycles: int, elements: int, name: str) -> Case:
    """Return the case of a test on so many elements a side, all else being as the defaults have it."""
    return validate_case({
        "format": "fretflow-case/1", "name": name,
        "mesh": {"contact_elements": elements, "degree": DEGREE, "growth": GROWTH},
        "test": {"excitation_amplitude": f"{test.excitation_amplitude!r} N", "cycles": cycles,
                 "excitation_frequency": f"{test.excitation_frequency!r} Hz",
                 "normal_load": f"{test.normal_load!r} N"}})


def first_friction(recording: Recording) -> float:
    """Return the friction coefficient that the loops' plateaus show, of all loops together; without any the default."""
    loops = recording.loops
    if loops is None:
        return ContactSection().friction_coefficient
    limit = plateau(loops.mean(loops.force_name))
    load = float(recording.test.normal_load or np.nan)
    return float(np.clip(np.nanmedian(limit) / load, *FRICTION))


def friction_from_energy(recording: Recording) -> float:
    """Return the friction coefficient by energy over sliding distance, which ringing of the force leaves alone.

    Where a contact hardly slides it is far below the plateaus' coefficient.
    """
    loops = recording.loops
    if loops is None:
        return ContactSection().friction_coefficient
    x, force = loops.mean("displacement"), loops.mean(loops.force_name)
    limit = _energy(x, force) / (2.0 * np.maximum(np.ptp(x, axis=1), np.finfo(float).tiny))
    load = float(recording.test.normal_load or np.nan)
    return float(np.clip(np.nanmedian(limit) / load, *FRICTION))


def load_calibration(recording: Recording) -> float:
    """Return the relative sd of what is known of the normal load: that of its gauge, or of the friction force's."""
    loops = recording.loops
    if loops is None:
        return 0.0
    stated = loops.calibration_sd
    return stated.get("normal_force") or stated.get(loops.force_name, 0.0)


def _energy(x: Array, force: Array) -> Array:
    """Return the dissipated energy (loops,) of displacements and forces (loops, N), J."""
    return np.asarray(np.abs(np.sum(force * 0.5 * (np.roll(x, -1, axis=1) - np.roll(x, 1, axis=1)), axis=1)))


def first_wear(recording: Recording, friction: float) -> float:
    """Return the wear coefficient (m^2/N) that volume and dissipated energy show; the default without loops."""
    loops, volume = recording.loops, recording.wear.worn_volume
    if loops is None:
        return Wear().coefficient
    if volume is None and recording.wear_depth is not None and recording.specimen is not None:
        depth = recording.wear_depth.channels.get("depth", np.zeros(1))
        volume = float(np.mean(depth)) * recording.specimen.upper.contact_width**2
    x, force = loops.mean("displacement"), loops.mean(loops.force_name)
    energy = _energy(x, force)
    total = float(np.sum(0.5 * (energy[1:] + energy[:-1]) * np.diff(loops.cycles)))
    if not volume or not total > 0.0:
        return Wear().coefficient
    return volume * friction / total


def model_of(recording: Recording, observation: Observation, problem: PeriodicProblem, wear: float) -> RigModel:
    """Return the model of a recording on the mesh of `problem`."""
    loops = recording.loops
    displacement = DisplacementOf(MeasuredAt.CONTACT_FACES) if loops is None else loops.displacement_of
    if displacement is None:
        raise UnreliableRecordingError(f"{recording.path}: loops.displacement_of is not given")
    return RigModel(problem=problem, wear_coefficient=wear, observation=observation, displacement_of=displacement,
                    samples=SAMPLES, total_cycles=recording.test.cycles or max(observation.counts))


def stiff_asperities(problem: PeriodicProblem, share: float) -> ContactStiffness:
    """Return asperities, alike everywhere, of a `share` of the specimens' mean normal compliance.

    All faces have asperities. Nobody states such that add no more than what a modulus is known to, and other codes have
    springs as stiff in place of hard contact; all the same they take the peaks of pressure at the edges away.
    """
    part = problem.interface.areas / problem.interface.areas.sum()
    compliance = part @ rig_of(problem.structure).quasi_static().flexibility[2::3, 2::3] @ part
    return ContactStiffness().changed(stiffness=1.0 / float(share * compliance), exponent=0.0, ratio=1.0)


def worn_as_much(model: RigModel, simulation: Simulation) -> tuple[RigModel, Simulation]:
    """Return the model with the wear coefficient that makes the mean depth the measured one, and its simulation.

    Raises
    ------
    NonConvergenceError
        If there is none.
    """
    rows = model.observation.rows(block="map")
    measured, own = (float(np.mean(values[rows])) for values in (model.observation.values, model.predict(simulation)))
    if not measured > 0.0 or not own > 0.0:
        return model, simulation
    scaled = replace(model, wear_coefficient=model.wear_coefficient * measured / own)
    return scaled, scaled.simulate(Hypothesis())


def first_simulation(models: Sequence[RigModel]) -> tuple[RigModel, Simulation]:
    """Return the model whose displacement is the nearest to the recording's, each loop's zero free, and its simulation.

    A model that has no simulation gets less friction until it has; one that never has is left out. The force decides
    nothing: its sensor may lie.

    Raises
    ------
    NonConvergenceError
        If there is none.
    """
    simulated: list[tuple[RigModel, Simulation]] = []
    for model in models:
        try:
            simulated.append(_eased(model))
        except NonConvergenceError:
            if not simulated and model is models[-1]:
                raise
    return min(simulated, key=lambda one: _displacement_error(*one))


def _eased(model: RigModel) -> tuple[RigModel, Simulation]:
    for _ in range(4):  # to half of the coefficient at which the joint sticks
        try:
            return model, model.simulate(Hypothesis())
        except NonConvergenceError:
            model = replace(model, problem=model.problem.vary(
                friction_coefficient=0.85 * model.problem.friction_coefficient))
    return model, model.simulate(Hypothesis())


def _displacement_error(model: RigModel, simulation: Simulation) -> float:
    left = model.observation.values - model.predict(simulation)
    return float(sum(np.sum((left[piece.place] - left[piece.place].mean())**2)
                     for piece in model.observation.pieces if piece.channel == "displacement"))


def is_seen(observation: Observation, error: Array) -> bool:
    """Tell whether an error (M,) is larger than the noise of a channel of the loops, in the rms of both."""
    share: dict[str, list[Array]] = {}
    for piece in observation.pieces:
        if piece.block in ("loops", "sweep"):
            share.setdefault(piece.channel, []).append(error[piece.place]**2 / observation.variance[piece.place])
    return any(np.mean(np.concatenate(own)) > 1.0 for own in share.values())


def errors_of(observation: Observation, finer: Array, denser: Array, plain: Array, times: float
              ) -> tuple[Array, Array]:
    """Return what the coarse model leaves out (M,), and the modes (M, any) of what is not known of that.

    Each loop's channel has an error of its own, as far as the differences between the meshes (samples) go; for what is
    not known of single depths see `depth_error`. Kinks of the force fall at random between samples, so that errors of
    these are of second order, but not of a sign of their own: the difference to n times as many leaves of itself the
    (n^2 - 1)th part (L. F. Richardson, Phil. Trans. R. Soc. A 210 (1911) 307-357).

    Parameters
    ----------
    observation
        What the predictions are of.
    finer, denser, plain
        Predictions (M,) on the finer mesh, with denser samples, and of the coarse model.
    times
        How much denser these are.
    """
    mesh, sampled = finer - plain, denser - plain
    modes = np.zeros((len(plain), 2 * len(observation.pieces)))
    for column, piece in enumerate(observation.pieces):
        modes[piece.place, 2 * column] = (EXTRAPOLATED - 1.0) * mesh[piece.place]
        modes[piece.place, 2 * column + 1] = sampled[piece.place] / (times**2 - 1.0)
    known = np.where(observation.rows(block="map"), 1.0, EXTRAPOLATED)
    return known * mesh + sampled, modes


def depth_error(observation: Observation, one: Array, other: Array) -> tuple[Array, Array]:
    """Return the variance (M,) and modes (M, any) of errors of the depths that no mesh resolves, in m^2 and m.

    What is alike in all points, or in a row of them along an edge, in the difference of predictions (M,) by two codes
    is so in another code too; it is parted by a two-way analysis of variance, and what is left is each point's own, as
    is all where points do not stand in rows. Between 2 and 3 elements most of it lies where the edge of the scar falls
    between coarse nodes, and is gone with the next mesh; 8 by 8 show 0.9 to 1.0 of the difference, with 1.0 to 1.3 of
    its mean square left elsewhere, most of it at the edges: as much of it stays as an error, half of it where it was
    seen and half in any row. Depths at the edges do not converge evenly: meshes of one kind may agree by chance.
    """
    rows, variance = observation.rows(block="map"), np.zeros(len(one))
    if not rows.any():
        return variance, np.zeros((len(one), 0))
    left, modes = (other - one)[rows], []
    lines = [np.zeros(len(left), dtype=np.int64)] + [
        np.unique(np.round(side / max(np.ptp(side), np.finfo(float).tiny), 6), return_inverse=True)[1]
        for side in observation.points.T]
    for line in lines:
        if 2 * (line.max() + 1) > len(left) > 1:  # fewer than two points a row
            continue
        alike = (np.bincount(line, left) / np.bincount(line))[line]
        left = left - alike
        own = np.zeros((len(rows), line.max() + 1))
        own[rows, line] = np.sqrt(0.5 * (np.mean(alike**2) + alike**2))
        modes.append(own)
    variance[rows] = np.mean(left**2)
    return variance, np.hstack(modes)

