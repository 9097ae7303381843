"""Where a fit of the rig begins: friction and wear as the recording itself shows them, and its case."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fretflow.case.config import Rig, Specimens
from fretflow.core.errors import UnreliableRecordingError
from fretflow.experiments.loops import HARMONICS
from fretflow.experiments.rig import run
from fretflow.experiments.rig.experiment import BASELINE, measured
from fretflow.experiments.rig.model import DENSER
from fretflow.experiments.rig.observation import from_zero, observe
from fretflow.experiments.rig.setup import (
    case_of,
    depth_error,
    errors_of,
    first_friction,
    first_wear,
    friction_from_energy,
    load_calibration,
)
from fretflow.experiments.rig.simulation import Hypothesis
from fretflow.inference.decision import Decision
from fretflow.inference.experiment import Covariance
from fretflow.inference.parameters import Parameters
from fretflow.inference.posterior import Posterior
from fretflow.inference.verdict import Verdict
from fretflow.recordings.kinds.joints import FRETTING_RIG
from fretflow.recordings.loopset import LoopSet
from fretflow.recordings.recording import Recording
from fretflow.recordings.repeatability import smooth_waves
from fretflow.recordings.schema import DisplacementOf, MeasuredAt, RecordedTest, RecordedWear, SweepCondition
from scipy.stats import chi2

SAMPLES, FRICTION, LOAD, STROKE, COUNTS = 400, 0.6, 50.0, 20e-6, (0, 10_000, 30_000)


def recorded(volume: float | None = 1e-12, **test: float | None) -> Recording:
    """Return rigid Coulomb loops: force mu N sign(v), the displacement a cosine."""
    phase = 2.0 * np.pi * np.arange(SAMPLES) / SAMPLES
    x = 0.5 * STROKE * np.cos(phase)
    force = FRICTION * LOAD * np.sign(-np.sin(phase))
    shape = (len(COUNTS), 1, SAMPLES)
    loops = LoopSet(cycles=np.array(COUNTS), frequency=np.full(len(COUNTS), 100.0), phase=phase,
                    channels={"displacement": np.broadcast_to(x, shape).copy(),
                              "friction_force": np.broadcast_to(force, shape).copy()},
                    units={"displacement": "m", "friction_force": "N"}, sd={}, calibration_sd={},
                    displacement_of=DisplacementOf(MeasuredAt.CONTACT_FACES), aligned_to="displacement")
    stated: Any = {"excitation_frequency": 100.0, "excitation_amplitude": 60.0, "normal_load": LOAD, **test}
    return Recording(path=Path("a-recording"), title="t", given={}, rig=None, specimen=None, notes=(), series=None,
                     test=RecordedTest.model_construct(kind=FRETTING_RIG, cycles=30_000, **stated), sweep=None,
                     wear=RecordedWear.model_construct(worn_volume=volume), loops=loops, frf=None, wear_depth=None)


def test_a_rig_that_the_recording_does_not_tell_is_told_to_be_the_default() -> None:
    bare = recorded()
    told = replace(bare, rig=Rig(), specimen=Specimens())
    assert run.faulty(told, ["a gain"]).warnings == ("a gain",)
    assert [one.partition(":")[0] for one in run.faulty(bare, ["a gain"]).warnings] == ["a gain", "rig", "specimen"]


def test_a_displacement_from_outside_the_specimen_is_refused() -> None:
    recording = recorded()
    far = replace(recording.loops, displacement_of=DisplacementOf(MeasuredAt.DISTANCE, 1.0))
    with pytest.raises(UnreliableRecordingError, match=r"loops\.displacement_of: 1 m lies outside the specimen"):
        case_of(replace(recording, loops=far))


def test_friction_is_read_off_the_plateaus() -> None:
    """A rigid slider's force is mu N all the time."""
    assert first_friction(recorded()) == pytest.approx(FRICTION, rel=1e-6)


def test_ringing_of_the_force_leaves_the_rubbed_friction_alone() -> None:
    """A harmonic that the displacement does not have does no work: the energy stays 2 mu N stroke a cycle."""
    plain = recorded()
    assert plain.loops is not None
    assert friction_from_energy(plain) == pytest.approx(FRICTION, rel=2e-3)
    rung = {**plain.loops.channels, "friction_force": plain.loops.channels["friction_force"]
            + 0.4 * FRICTION * LOAD * np.sin(7.0 * plain.loops.phase)}
    ringing = replace(plain, loops=replace(plain.loops, channels=rung))
    assert friction_from_energy(ringing) == pytest.approx(FRICTION, rel=2e-3)
    assert first_friction(ringing) > 1.2 * FRICTION


@pytest.mark.parametrize(("stated", "of_load"), [
    ({}, 0.0), ({"friction_force": 0.004}, 0.004), ({"friction_force": 0.004, "normal_force": 0.01}, 0.01)])
def test_the_load_is_known_as_its_gauge_or_that_of_the_force_is(stated: dict[str, float], of_load: float) -> None:
    one = recorded()
    assert one.loops is not None
    assert load_calibration(replace(one, loops=replace(one.loops, calibration_sd=stated))) == of_load
    assert load_calibration(replace(one, loops=None)) == 0.0


def test_wear_coefficient_follows_from_volume_and_energy() -> None:
    """V = K (E / mu), with E the energy 2 mu N stroke of each cycle."""
    slid = 2.0 * STROKE * COUNTS[-1]
    assert first_wear(recorded(), FRICTION) == pytest.approx(1e-12 / (LOAD * slid), rel=2e-3)


def test_without_volume_the_usual_coefficient_is_the_start() -> None:
    """Nothing tells the wear."""
    assert first_wear(recorded(volume=None), FRICTION) == pytest.approx(1.1e-14, abs=0.0)


def test_case_has_what_the_recording_says() -> None:
    """The case runs at the recording's load, drive and length."""
    case = case_of(recorded(), 6)
    assert (case.test.normal_load, case.test.excitation_amplitude) == (LOAD, 60.0)
    assert case.test.total_cycles == 30_000
    assert (case.mesh.contact_elements, case.mesh.degree) == (6, 2)


@pytest.mark.parametrize("field", ["normal_load", "excitation_amplitude", "excitation_frequency"])
def test_what_cannot_be_predicted_from_is_named(field: str) -> None:
    """One clear line names the field that is missing."""
    with pytest.raises(UnreliableRecordingError, match=f"test.{field} is not given"):
        case_of(recorded(**{field: None}))


def test_errors_of_the_coarse_model_are_extrapolated_loop_by_loop() -> None:
    """An error of second order that more samples leave is as large as the error that stays; modes are a piece each."""
    pieces: Any = [SimpleNamespace(place=slice(0, 3)), SimpleNamespace(place=slice(3, 5))]
    exact, left = np.full(5, 10.0), 1.0 / DENSER**2
    plain, denser = exact + 1.0, exact + left
    seen: Any = SimpleNamespace(pieces=pieces, rows=lambda block: np.zeros(5, dtype=bool))
    correction, modes = errors_of(seen, plain, denser, plain, DENSER)
    assert plain + correction - exact == pytest.approx(np.full(5, left))
    assert np.count_nonzero(modes, axis=0).tolist() == [0, 3, 0, 2]
    assert modes.sum(axis=1) == pytest.approx(np.full(5, -left))


def test_errors_of_an_approach_sensor_are_those_of_all_loops() -> None:
    """Faces worn by 16 um, then a sweep: a gain 0.4 % too large, or a lost zero, is one deviate for all loops."""
    noise, seen = np.random.default_rng(1), recorded().loops
    assert seen is not None
    phase, counts = seen.phase, (3, 4, SAMPLES)

    def loops(depth: Any) -> LoopSet:
        channels = {name: np.broadcast_to(values, counts) + 1e-3 * values.max() * noise.standard_normal(counts)
                    for name, values in seen.channels.items()}
        channels["approach"] = depth[:, None, None] + 1e-8 * (np.cos(phase) + noise.standard_normal(counts))
        return replace(seen, channels=channels, units={**seen.units, "approach": "m"},
                       calibration_sd={"approach": 0.004})

    sweep: Any = SimpleNamespace(loops=loops(np.full(3, 16e-6)), conditions=[
        SweepCondition.model_construct(id=count, normal_load=1.0 + count) for count in COUNTS])
    observed = observe(replace(recorded(), loops=loops(np.linspace(0.0, 16e-6, 3)), sweep=sweep))
    for error in (0.004 * observed.values, np.full_like(observed.values, 1e-6)):
        own = np.where(observed.rows(channel="approach"), error, 0.0)
        assert np.linalg.norm(own / np.sqrt(observed.variance)) > 20.0
        assert np.linalg.norm(Covariance(observed.variance, observed.modes).whiten(own)) < 1.0


@pytest.mark.parametrize(("measured", "start"), [(200, 0.0), (256, 0.0), (101, 0.0), (64, 0.0),
                                                 (1001, 0.01), (51, 0.1)])
def test_loops_of_any_number_of_samples_are_seen_in_the_same_harmonics(measured: int, start: float) -> None:
    """What has no more harmonics than are compared is read exactly, wherever the samples lie."""
    rng = np.random.default_rng(measured)
    cosines, sines = rng.standard_normal((2, 13))

    def wave(at: Any) -> Any:
        return sum(cosines[k] * np.cos(k * at) + sines[k] * np.sin(k * at) for k in range(13))

    phase = start + 2.0 * np.pi * np.arange(measured) / measured
    values = from_zero(wave(phase)[None], phase)
    assert values[0] == pytest.approx(wave(2.0 * np.pi * np.arange(measured) / measured), abs=1e-12)


def thinned(every: int) -> Recording:
    """Return the recording with every so many of its samples."""
    seen = recorded()
    assert seen.loops is not None
    return replace(seen, loops=replace(seen.loops, phase=seen.loops.phase[::every], channels={
        name: values[..., ::every] for name, values in seen.loops.channels.items()}))


def test_too_few_samples_of_a_period_are_refused() -> None:
    """Fifty tell twelve harmonics; of forty too many fold into those that are compared."""
    assert observe(thinned(8)).harmonics == HARMONICS
    with pytest.raises(UnreliableRecordingError, match=r"40 samples a period are too few .* record 48 or more"):
        observe(thinned(10))


def test_noise_falls_with_the_samples_that_are_recorded() -> None:
    """Each harmonic is read off all samples: with eight times as many, white noise has an eighth of the variance."""
    rng = np.random.default_rng(5)
    seen = recorded()
    assert seen.loops is not None
    every = {name: np.repeat(values, 3, axis=1) + 0.1 * values.max() * rng.standard_normal(
        (len(COUNTS), 3, SAMPLES)) for name, values in seen.loops.channels.items()}

    def variance(step: int) -> float:
        loops = replace(seen.loops, phase=seen.loops.phase[::step],  # type: ignore[union-attr]
                        channels={name: values[..., ::step] for name, values in every.items()})
        observation = observe(replace(seen, loops=loops))
        repeated = observation.variance * observation.noise  # without what timing is off by
        return float(np.mean(repeated[observation.rows(channel="friction_force")]))

    assert variance(8) / variance(1) == pytest.approx(8.0, rel=0.3)


@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_noise_of_a_colour_weighs_its_own_waves_less(colour: float) -> None:
    """Whitened waves of the first harmonics have unit variance; those of red noise taken as white have more."""
    rng, seen, plain = np.random.default_rng(11), recorded(), observe(recorded())
    assert seen.loops is not None
    waves, squares = smooth_waves(plain.samples)[:, [1, 2, 3, 4, 6, 7, 8, 9]], []  # the gain has the fundamental
    for _ in range(10):
        white = np.fft.rfft(rng.standard_normal((len(COUNTS), 3, SAMPLES)))
        made = np.fft.irfft(white / np.abs(1.0 - colour * np.exp(-2j * np.pi * np.arange(white.shape[2]) / SAMPLES)))
        channels = {name: np.repeat(values, 3, axis=1) for name, values in seen.loops.channels.items()}
        channels["friction_force"] += 3.0 * made  # far above what digits hide
        observation = observe(replace(seen, loops=replace(seen.loops, channels=channels)))
        own = observation.rows(channel="friction_force")
        known = Covariance(observation.variance * observation.noise, observation.modes)  # without what timing is off by
        whitened = known.whiten(observation.values - plain.values)[own]
        squares.append(np.mean((whitened.reshape(-1, plain.samples) @ waves)**2))
    assert 0.6 < np.mean(squares) < 1.4


def noisy(force: float) -> Recording:
    """Return three repeats of each loop, 0.5 % noise, with a force (N) added to all of them."""
    seen, rng = recorded(), np.random.default_rng(3)
    assert seen.loops is not None
    channels = {name: np.repeat(values, 3, axis=1) + 5e-3 * values.max() * rng.standard_normal(
        (len(COUNTS), 3, SAMPLES)) for name, values in seen.loops.channels.items()}
    channels["friction_force"] += force
    return replace(seen, loops=replace(seen.loops, channels=channels))


@pytest.mark.parametrize(("force", "is_seen"), [(0.15, False), (-3.0, True)])
def test_a_force_beyond_what_a_sensor_s_zero_may_be_off_is_seen(force: float, is_seen: bool) -> None:
    """Beside a friction of 30 N a load cell's zero may well be off by 0.15 N, but not by 3 N, in all loops alike."""
    plain, moved = observe(noisy(0.0)), observe(noisy(force))
    change = moved.values - plain.values
    assert np.max(np.abs(change)) == pytest.approx(abs(force), rel=1e-6)
    assert (float(np.linalg.norm(Covariance(moved.variance, moved.modes).whiten(change))) > 3.0) == is_seen


@pytest.mark.parametrize("seed", range(4))
def test_a_load_that_falls_is_seen_though_its_loops_are_flat(seed: int) -> None:
    """A gauge's zero is known to 1 % and from loop to loop to 0.3 %; a load of 50 N falls by a tenth in the last."""
    plain, rng = noisy(0.0), np.random.default_rng(seed)
    assert plain.loops is not None
    flat = LOAD + 0.1 * rng.standard_normal(plain.loops.channels["displacement"].shape)
    seen = observe(replace(plain, loops=replace(plain.loops, channels={**plain.loops.channels, "normal_force": flat})))
    lost = np.zeros(len(seen.values))
    lost[seen.rows(channel="normal_force", cycles=COUNTS[-1])] = 0.1 * LOAD
    assert np.linalg.norm(Covariance(seen.variance, seen.modes).whiten(lost)) > 10.0


def test_levels_are_those_of_the_approach_and_of_the_normal_force() -> None:
    """A displacement's and a friction force's mean is the zero of their sensors; a drive has no law."""
    plain = noisy(0.0)
    assert plain.loops is not None
    force = plain.loops.channels["friction_force"]
    channels = {**plain.loops.channels, "excitation": 2.0 * force, "normal_force": LOAD + 1e-2 * force,
                "approach": 1e-8 * force}
    seen = observe(replace(plain, loops=replace(plain.loops, channels=channels)))
    measurement = measured(seen, np.zeros(len(seen.values)), COUNTS[-1], None)
    assert measurement.levels == {"approach", "normal_force"}
    assert measurement.inputs == {"excitation"}


def test_friction_that_scatters_is_no_motion_that_does_not_repeat_itself() -> None:
    """Repeats that differ as loops follow friction are repeats; those that differ in another way are not."""
    plain = noisy(0.0)
    assert plain.loops is not None
    phase, rng = plain.loops.phase, np.random.default_rng(8)

    def scattered(way: Any) -> Any:
        assert plain.loops is not None
        off = rng.standard_normal((len(COUNTS), 3, 1)) * way
        channels = {name: values + (1e-6 * off if name == "displacement" else off)
                    for name, values in plain.loops.channels.items()}
        return observe(replace(plain, loops=replace(plain.loops, channels=channels)))

    follows, beats = np.sign(np.sin(phase - 0.6)), np.sin(2.0 * phase)
    for way, is_motion in ((follows, False), (beats, True)):
        seen = scattered(way)
        assert seen.unsteady
        slope = np.zeros(len(seen.values))
        lines = np.fft.rfft(follows[::8])[:seen.harmonics + 1]
        for piece in seen.pieces:
            if piece.channel in ("displacement", "friction_force"):
                slope[piece.place] = np.fft.irfft(lines, seen.samples)
        left = seen.scattering(slope)
        assert left.unsteady == is_motion
        assert np.array_equal(left.values, seen.values)
    assert not observe(plain).unsteady


def test_depths_have_the_finer_mesh_s_values_and_an_error_of_each_point() -> None:
    """Where the edge of a scar falls between coarse nodes is gone with the next mesh, and no promise for the rest."""
    rows = np.array([False, False, True, True])
    seen: Any = SimpleNamespace(pieces=[], rows=lambda block: rows, points=np.array([[0.0, 0.0], [1e-3, 0.0]]))
    plain, finer = np.zeros(4), np.array([1.0, 1.0, 3.0, -1.0])
    correction, _ = errors_of(seen, finer, plain, plain, DENSER)
    assert correction[2:] == pytest.approx(finer[2:])
    assert np.all(correction[:2] > finer[:2])
    variance, modes = depth_error(seen, plain, finer)
    every = variance + np.sum(modes**2, axis=1)
    assert every[:2] == pytest.approx(0.0)
    assert every[2] == pytest.approx(every[3])
    assert 1.0 < np.sqrt(every[2]) < 3.0
    seen = SimpleNamespace(rows=lambda block: np.zeros(4, dtype=bool), points=np.zeros((0, 2)))  # no face was measured
    variance, modes = depth_error(seen, plain, finer)
    assert not variance.any()
    assert modes.shape == (4, 0)


def test_an_error_of_the_depths_that_is_alike_along_an_edge_is_alike_in_other_codes() -> None:
    """A mesh that misses the depth of two edges tells of other edges, not of any pattern of as large an error."""
    x, y = np.meshgrid(1e-3 * np.arange(8), 1e-3 * np.arange(10))
    points = np.column_stack([x.ravel(), y.ravel()])
    seen: Any = SimpleNamespace(rows=lambda block: np.ones(80, dtype=bool), points=points)
    missed = 0.05 * np.random.default_rng(4).standard_normal((10, 8))
    missed[[0, -1]] += 1.0
    variance, modes = depth_error(seen, np.zeros(80), missed.ravel())
    assert np.sum(variance + np.sum(modes**2, axis=1)) == pytest.approx(np.sum(missed**2))
    errors = Covariance(variance + 1e-3, modes)

    def p_value(depths: np.ndarray) -> float:
        left = errors.whiten(depths.ravel())
        return float(chi2.sf(left @ left, 80))

    along, over = np.zeros((10, 8)), np.where((x + y) / 1e-3 % 2.0 < 0.5, 0.5, -0.5)
    along[1] = 1.0  # the edge of another mesh
    assert p_value(along) > 0.05
    assert p_value(over) < 1e-6
    seen.points = np.random.default_rng(5).uniform(0.0, 1e-3, (80, 2))  # scattered: a mode for all of them alone
    variance, modes = depth_error(seen, np.zeros(80), missed.ravel())
    assert modes.shape == (80, 1)
    assert np.sum(variance + np.sum(modes**2, axis=1)) == pytest.approx(np.sum(missed**2))


def test_without_loops_friction_is_as_case_files_have_it() -> None:
    assert first_friction(replace(recorded(), loops=None)) == 0.88


@pytest.mark.parametrize(("friction", "compliance", "verdict"), [
    (0.015, 0.0, Verdict.UNKNOWN), (0.03, 0.0, Verdict.NAMED), (2.5, 0.0, Verdict.NAMED), (3.5, 0.0, Verdict.UNKNOWN),
    (0.6, 3.6, Verdict.NAMED), (0.6, -3.9, Verdict.UNKNOWN), (0.6, 8.0, Verdict.UNKNOWN)])
def test_no_physics_is_named_of_a_rig_that_is_not_the_stated_one(
        monkeypatch: pytest.MonkeyPatch, friction: float, compliance: float, verdict: Verdict) -> None:
    """Friction below 0.02 is a fluid film, above 3 seizure; specimens are not a fifth softer than their drawing."""
    monkeypatch.setattr(run, "hypothesis", lambda point: Hypothesis(friction=friction / 0.5))
    names = frozenset({"viscous"})
    space = Parameters.of(BASELINE, ("viscous",))
    z = np.where([one.field == "compliance" for one in space.coordinates], compliance, 0.0)
    z[[one.field == "damping" for one in space.coordinates]] = 3.5  # of the hinge, and of the dashpot
    z[-1] = 5.0  # an effect's own range may be too narrow
    fit = SimpleNamespace(prediction=SimpleNamespace(point=None), parameters=space, z=z)
    decision = Decision(Verdict.NAMED, (names,), names, 0.9, 0.9, (), Posterior({frozenset(): 0.05}, 0.1, {}))
    search: Any = SimpleNamespace(fits={names: fit})
    problem = SimpleNamespace(friction_coefficient=np.full(4, 0.5))
    experiment: Any = SimpleNamespace(rig=SimpleNamespace(problem=problem))
    judged = run.plausible(decision, search, experiment)
    assert judged.verdict is verdict
    # -3.9 is beyond 1 - 9.62e-5 of a normal distribution, four parameters are stated: p = 3.85e-4 is worth odds of 122
    sure = 0.9 if verdict is Verdict.NAMED else 0.95 * 122 / 123 if compliance == -3.9 else 0.95
    assert judged.probability == pytest.approx(sure, abs=1e-4)
    told = "needs baseline.compliance far from what is stated" if compliance else (
        "needs a friction coefficient that no dry contact has")
    assert judged.against == ("" if verdict is Verdict.NAMED else told)


@pytest.mark.parametrize(("drive", "said"), [("steady", "unknown"), ("wandering", "named"), ("unrecorded", "named")])
@pytest.mark.parametrize("first", [Verdict.NAMED, Verdict.NONE])
def test_a_motion_that_does_not_repeat_itself_with_a_drive_that_does_is_of_no_model(
        first: Verdict, drive: str, said: str) -> None:
    """Not where the drive wanders with it, or may do so."""
    plain, rng = noisy(0.0), np.random.default_rng(9)
    assert plain.loops is not None
    off = rng.standard_normal((len(COUNTS), 3, 1)) * np.sin(2.0 * plain.loops.phase)
    channels = {**plain.loops.channels, "displacement": plain.loops.channels["displacement"] + 1e-6 * off}
    if drive != "unrecorded":
        noise = 0.1 * rng.standard_normal(off.shape)
        channels["excitation"] = np.cos(plain.loops.phase) + noise + (off if drive == "wandering" else 0.0)
    names, none = frozenset({"viscous"}), 0.05 if first is Verdict.NAMED else 0.95
    sets = {frozenset(): none, names: 0.96 - none}
    decision = Decision(first, (names,) if first is Verdict.NAMED else (), names, 0.9, max(sets.values()), (),
                        Posterior(sets, 0.04, {}))
    judged = run.periodic(decision, replace(plain, loops=replace(plain.loops, channels=channels)))
    if said == "named":
        assert judged is decision
    else:
        assert judged.verdict is Verdict.UNKNOWN
        assert judged.against == "repeats itself with the drive, which the recorded motion does not"
        assert judged.probability == pytest.approx(1.0 - judged.posterior.none - judged.posterior.listed)
        assert 0.95 < judged.probability < 1.0
