"""Property: physics that an independent integration in time put into a structure is named from its decay, or none."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from fretflow.core.errors import NonConvergenceError
from fretflow.experiments.structure.backbone import held_out
from fretflow.experiments.structure.experiment import StructureExperiment
from fretflow.experiments.structure.points import (
    ROUGH,
    BackbonePoints,
    averaging,
    noise_of,
    scatter,
    shrunk,
    with_backbone,
)
from fretflow.experiments.structure.run import diagnose_structure, gone_on
from fretflow.inference import strategy
from fretflow.inference.experiment import Covariance, Point
from fretflow.inference.parameters import HALF
from fretflow.inference.search import FAST, NEGLIGIBLE
from fretflow.inference.strategy import allow_for_chance, start_search
from fretflow.inference.verdict import Verdict
from fretflow.recordings.kinds.structures import read_structure_recording
from fretflow.solvers.nonlinear_modes.periodic_mode import follow_mode
from fretflow.solvers.nonlinear_modes.ring_down import instantaneous_mode


def write(structures, folder, matrices, decay, bolts, of):
    """Write the recording of a decay (time, signal, frequency), with noise as peaks of a measured one have it."""
    seen = instantaneous_mode(*decay)
    rng = np.random.default_rng(7)
    order = np.argsort(seen.amplitude)
    order = order[seen.amplitude[order] > 0.03 * seen.amplitude.max()]
    count = len(order)
    frequency = seen.frequency[order] + 0.02 * rng.standard_normal(count)
    damping = seen.damping[order] * (1.0 + 0.02 * rng.standard_normal(count))
    table = np.c_[1e6 * seen.amplitude[order], frequency, 100.0 * damping]
    structures.write_backbone(folder, matrices, table, bolts, of)
    return read_structure_recording(folder)


@pytest.fixture(scope="module")
def sprung(structures, tmp_path_factory):
    """Return a recording of a lapped beam with asperities whose stiffness follows the root of the pressure."""
    beam = structures.lap_beam(25)
    pressure = np.abs(beam.contact_map @ beam.preload)[2::3] / beam.areas
    springs = 3e12 * beam.areas * np.sqrt(pressure / (3.0 / beam.areas.sum()))
    decay = structures.decay_in_time(beam, 10, springs, 0.45, 8e3, 1e-3, 9e-5, 200)
    return write(structures, tmp_path_factory.mktemp("sprung"), beam, decay, '"2 kN", "20 kN"', "tip")


def test_asperities_of_a_lapped_beam_are_named(sprung):
    diagnosis = diagnose_structure(sprung, True, lambda share, text: None)
    assert diagnosis.verdict is Verdict.NAMED
    assert diagnosis.effects == ("contact-stiffness",)
    values = {one.name: one for one in diagnosis.parameters}
    # the stiffness itself goes with the pressure at which it is stated, which a backbone does not tell
    for name, truth in (("structure.bolt_load", 8e3), ("structure.friction_coefficient", 0.45),
                        ("contact-stiffness.exponent", 0.5)):
        assert values[name].low < truth < values[name].high
    assert diagnosis.held_out.after < 0.2 * diagnosis.held_out.before
    written = diagnosis.to_json()
    json.dumps(written)
    assert written["verdict"] == "named"
    assert written["location"]["channel"] in ("frequency", "damping")


@pytest.fixture(scope="module")
def sliding(structures, tmp_path_factory):
    """Return a recording of rigid sliders beside a damper of 0.1 %."""
    rng = np.random.default_rng(5)
    stiffness, limits = rng.uniform(500.0, 1500.0, 40), rng.uniform(0.005, 0.1, 40)
    matrices = structures.sliders(stiffness, limits, 2.0, 1e6)
    frequency = np.sqrt((1e6 + stiffness.sum()) / 2.0) / (2.0 * np.pi)
    step = 1.0 / (200.0 * frequency)
    damper = 2.0 * 1e-3 * 2.0 * np.pi * frequency * 2.0
    decay = structures.newmark(2.0, 1e6, stiffness, limits, 8e-5, step, 200 * 150, damper)
    time = step * np.arange(len(decay))
    folder = tmp_path_factory.mktemp("sliding")
    return write(structures, folder, matrices, (time, decay, frequency), '"0.3 N", "3 N"', "head")


def test_nothing_is_missing_from_rigid_sliders(sliding):
    diagnosis = diagnose_structure(sliding, True, lambda share, text: None)
    assert diagnosis.verdict is Verdict.NONE
    assert diagnosis.effects == ()
    product = np.prod([one.value for one in diagnosis.parameters if one.name != "structure.modal_damping"])
    assert product == pytest.approx(1.0, rel=0.1)  # bolt load times friction, which alone a backbone tells


def test_damping_alone_adds_to_a_backbone_and_moves_nothing(sprung, monkeypatch):
    experiment = StructureExperiment.of(sprung)
    plain = experiment.parameters(())
    first = experiment.predict(Point(plain, np.zeros(plain.size)))
    space = experiment.parameters(("joint-damping",))
    point = Point(space, np.where([one.field in ("modal_damping", "slope") for one in space.coordinates], 0.7, 0.0))
    anew = experiment.predict(point)
    monkeypatch.setattr(StructureExperiment, "backbone", None)  # nothing is simulated
    beside = experiment.predict(point, first)
    assert beside.values == pytest.approx(anew.values, rel=1e-9)
    frequency, damping = beside.values.reshape(2, -1) - first.values.reshape(2, -1)
    modal, slope = (space.coordinates[k].value(point.z[k]) for k in (-2, -1))
    middle = plain.coordinates[-1].value(0.0)
    reach = experiment.observation.seen(first.state) / first.state.amplitude
    added = modal - middle + slope * experiment.points.amplitude / np.mean(reach)
    assert np.all(frequency == 0.0)
    assert damping[:-2] == pytest.approx(added[:-2], rel=0.01)  # the last lie at the end of what was followed


def test_which_point_slips_first_is_left_to_chance(sprung):
    experiment = StructureExperiment.of(sprung)
    space = experiment.parameters(("distributed-micro-slip",))
    point = Point(space, np.zeros(space.size))
    first = experiment.predict(point)
    assert experiment.by_chance(experiment.first_prediction()).shape[1] == 0
    other = replace(experiment, draw=1234).predict(point).values - first.values
    known = experiment.measurement.covariance()
    told = replace(known, modes=np.hstack([known.modes, experiment.by_chance(first)]))
    assert np.mean(known.whiten(other)**2) > 3.0  # the same factors at other points
    assert np.mean(told.whiten(other)**2) < 0.5 * np.mean(known.whiten(other)**2)


def of_another_draw(sprung):
    """Return the experiment, a truth whose slip limits vary, and what another draw of these shows, with noise."""
    experiment = StructureExperiment.of(sprung)
    space = experiment.parameters(("distributed-micro-slip",))
    truth = Point(space, np.zeros(space.size))
    seen = replace(experiment, draw=1234).predict(truth).values.reshape(2, -1)
    return experiment, truth, seen * (
        1.0 + np.array([[5e-5], [0.01]]) * np.random.default_rng(8).standard_normal(seen.shape))


def test_parameters_do_not_take_up_what_is_left_to_chance(sprung):
    experiment, truth, (frequency, damping) = of_another_draw(sprung)
    names = truth.effects
    of_others = replace(experiment, points=replace(
        experiment.points, frequency=frequency, damping=damping, frequency_sd=5e-5 * frequency,
        damping_sd=0.01 * damping))
    first = of_others.predict(truth)
    search = start_search(of_others, of_others.first_prediction(), FAST, lambda task, asked: [*map(task, asked)])
    search.fits[names] = search.fitter.fit(truth, first, 8)
    alone = search.log_evidence(names)
    assert np.abs(search.fits[names].z).max() > HALF
    allow_for_chance(search)
    assert search.log_evidence(names) > alone + 2.0
    assert np.abs(search.fits[names].z).max() < HALF


def test_limits_that_vary_are_judged_where_they_do_and_not_where_other_errors_put_them(sprung, monkeypatch):
    """Under other errors than what is left to chance they are best equal, less probable than what explains all."""
    experiment, truth, (frequency, damping) = of_another_draw(sprung)
    names, rival = truth.effects, frozenset({"joint-damping"})
    of_others = replace(experiment, points=replace(
        experiment.points, frequency=frequency, damping=damping, frequency_sd=5e-5 * frequency,
        damping_sd=0.01 * damping))
    first = of_others.predict(truth)
    search = start_search(of_others, of_others.first_prediction(), FAST, lambda task, asked: [*map(task, asked)])
    equal = np.where([one.field == "spread" for one in truth.parameters.coordinates], -5.0, truth.z)
    search.fits[names] = search.fitter.at(replace(truth, z=equal), first)
    space = of_others.parameters(sorted(rival))
    nearer = replace(of_others.predict(Point(space, np.zeros(space.size)), first), values=0.5 * (
        of_others.measurement.values + search.fits[names].predicted))
    search.fits[rival] = search.fitter.linearised(nearer)
    before = search.log_evidence(names)
    assert before < search.log_evidence(rival, frozenset()) - NEGLIGIBLE
    monkeypatch.setattr(strategy, "is_explained", lambda search: True)
    allow_for_chance(search)
    assert search.log_evidence(names) > before + NEGLIGIBLE
    assert np.abs(search.fits[names].z).max() < HALF


def test_what_is_left_to_chance_stays_an_error_where_others_are_told_anew(sprung):
    """A pattern that no fit knows would make parameters go where one draw happens to lead."""
    experiment, truth, (frequency, damping) = of_another_draw(sprung)
    names = truth.effects
    backbone = replace(sprung.backbone, amplitude=experiment.points.amplitude, frequency=frequency, damping=damping)
    of_others = StructureExperiment.of(replace(sprung, backbone=backbone))
    search = start_search(of_others, of_others.first_prediction(), FAST, lambda task, asked: [*map(task, asked)])
    search.fits[names] = search.fitter.linearised(of_others.predict(truth))
    allow_for_chance(search)
    told = of_others.told_at(search.fits[names].prediction)
    again = gone_on(told, search, [frozenset(), names])
    assert np.abs(again.fits[names].z).max() < HALF
    assert again.leaves_noise(names)
    unseen = held_out(told, again, names)  # small amplitudes tell which draw it is
    assert unseen.after < 0.8 * unseen.before


def test_few_draws_tell_how_far_the_next_one_is_off():
    place = np.linspace(0.0, 1.0, 28)
    root = np.linalg.cholesky(np.exp(-np.abs(place[:, None] - place) / 0.2))
    rng, seen = np.random.default_rng(4), []
    for _ in range(40):
        draws, others = root @ rng.standard_normal((28, 16)), root @ rng.standard_normal((28, 40))
        known = (Covariance(np.full(28, 1e-3), modes) for modes in (draws / 4.0, shrunk(draws)))
        seen.append([np.mean(one.whiten(others)**2) for one in known])
    plain, told = np.mean(seen, axis=0)
    assert plain > 10.0  # what is out of the span of the draws would be noise
    assert 0.5 < told < 2.0


def test_a_wrong_value_that_is_stated_is_told_and_is_no_missing_physics(sliding):
    unknown = {name: ends for name, ends in sliding.unknown.items() if name != "modal_damping"}
    wrong = replace(sliding, known={"modal_damping": 4e-3}, unknown=unknown)
    diagnosis = diagnose_structure(wrong, True, lambda share, text: None)
    assert diagnosis.verdict is Verdict.NONE
    damping = next(one for one in diagnosis.parameters if one.name == "structure.modal_damping")
    assert damping.low < 1e-3 < damping.high
    assert any("instead of 0.004" in note for note in diagnosis.warnings)


def test_noise_is_read_off_neighbours_and_points_are_averaged(sprung):
    place = np.sort(np.random.default_rng(1).uniform(0.0, 1.0, 4000))
    values = 3.0 + place**2 + 0.01 * np.random.default_rng(2).standard_normal(4000)
    assert scatter(place, values) == pytest.approx(0.01, rel=0.05)
    points = BackbonePoints.of(sprung.backbone)
    assert len(points.amplitude) <= 24
    assert np.all(np.diff(points.amplitude) > 0.0)
    assert points.frequency_sd.max() < 0.2


def test_noise_is_told_in_proportion_or_the_same_for_all():
    rng = np.random.default_rng(3)
    place = np.linspace(0.0, 4.0, 200)
    values = 1e-3 + 8e-3 / (1.0 + np.exp(-8.0 * (place - 2.0)))
    relative = noise_of(place, values * (1.0 + 0.01 * rng.standard_normal(200)), ROUGH["damping"])
    assert relative[[0, -1]] == pytest.approx(0.01 * values[[0, -1]], rel=0.3)
    same = noise_of(place, values + 4e-5 * rng.standard_normal(200), ROUGH["damping"])
    assert same == pytest.approx(np.full(200, 4e-5), rel=0.3)


def test_kinks_that_a_model_predicts_are_no_noise():
    place = np.linspace(0.0, 4.0, 14)
    kinks = 0.01 * np.abs(np.sin(2.5 * place)) + 1e-3
    values = kinks * (1.0 + 0.03 * np.random.default_rng(6).standard_normal(14))
    smooth = 2e-3 * place  # what the model lacks
    plain, told = (noise_of(place, values + smooth, ROUGH["damping"], own) for own in ((), (kinks,)))
    truth = np.sqrt(np.mean((0.03 * kinks)**2))
    assert np.sqrt(np.mean(plain**2)) > 5.0 * truth
    assert np.sqrt(np.mean(told**2)) < 2.0 * truth


def test_few_points_seldom_tell_too_little_noise():
    place, told = np.linspace(0.0, 3.0, 10), []
    for seed in range(60):
        values = 1.0 + 0.015 * np.random.default_rng(seed).standard_normal(10)
        told.append(np.median(noise_of(place, values, ROUGH["damping"])) / 0.015)
    assert np.percentile(told, 5) > 0.7  # 0.36 where all that the scatter seems to tell is believed


def test_a_mean_over_a_kink_is_off_by_as_much_as_is_told():
    place, missed, told = np.linspace(0.0, 3.0, 22), [], []
    for kink in np.linspace(1.0, 1.3, 40):
        fine = place[:, None] + np.linspace(-0.5, 0.5, 401) * (place[1] - place[0])
        means = np.maximum(fine - kink, 0.0).mean(axis=1)
        missed.append(means - np.maximum(place - kink, 0.0))
        told.append(averaging(place, means))
    assert np.sqrt(np.mean(np.square(told))) == pytest.approx(np.sqrt(np.mean(np.square(missed))), rel=0.5)
    assert np.max(averaging(place, 2.0 + 3.0 * place)) < 1e-12


def test_noise_is_told_on_steep_curves_too():
    place = np.linspace(0.0, 4.0, 24)
    values = 1500.0 - 300.0 / (1.0 + np.exp(-4.0 * (place - 2.5)))  # neighbours differ by up to 50
    seen = [scatter(place, values + np.random.default_rng(seed).standard_normal(24)) for seed in range(40)]
    assert np.median(seen) == pytest.approx(1.0, rel=0.4)


@pytest.mark.parametrize("points", [9, 13])  # few, of which all predictions are periodic motions, and more
def test_what_static_loads_leave_out_is_put_right_by_periodic_motions(structures, tmp_path, points):
    """A joint that slides over much of its faces moves otherwise than its linear mode."""
    beam, count = structures.lap_beam(points, 4), 24
    seen = np.geomspace(5e-6, 1e-4, count)
    table = np.c_[1e6 * seen, np.full(count, 110.0), np.full(count, 0.2)]
    structures.write_backbone(tmp_path, beam, table, '"200 N", "2 kN"', "tip")
    experiment = StructureExperiment.of(read_structure_recording(tmp_path))
    static = replace(experiment, static=True).first_prediction()
    right = (experiment if experiment.few else experiment.corrected(static)).predict(static.point)
    joint = experiment.joint(static.point)
    mode = joint.linear_modes(1)[0]
    reach = static.state.amplitude
    motions = follow_mode(joint, mode, np.geomspace(0.5 * reach.min(), 1.5 * reach.max(), 80), tolerance=1e-4)
    periodic = np.interp(seen, [one.outputs[0] for one in motions], [one.frequency for one in motions])
    off = [np.median(np.abs(one.values[:count] - periodic)) for one in (static, right)]
    assert off[0] > 0.03
    assert off[1] < 0.2 * off[0]


def test_a_hypothesis_that_leaves_no_path_for_the_bolts_has_no_solution(sprung):
    class Gaping(StructureExperiment):
        def joint(self, point):
            joint = super().joint(point)
            return replace(joint, structure=replace(joint.structure, preload=None)) if point.effects else joint

    experiment = Gaping(**vars(StructureExperiment.of(sprung)))
    space = experiment.parameters(["bending-gap"])
    with pytest.raises(NonConvergenceError):
        experiment.predict(Point(space, np.zeros(space.size)))


def test_the_recorded_mode_is_that_of_the_frequency_or_the_stated_one(sprung):
    experiment = StructureExperiment.of(sprung)
    assert experiment.mode == 0
    assert experiment.measurement.channels == ("frequency", "damping")
    assert experiment.held_out.sum() == 2 * max(1, round(len(experiment.points.amplitude) / 3.0))
    assert {"contact-stiffness", "bending-gap", "joint-damping"} <= set(experiment.candidates())


def test_a_ring_down_alone_is_read_as_its_backbone(structures, tmp_path):
    rng = np.random.default_rng(5)
    stiffness, limits = rng.uniform(500.0, 1500.0, 40), rng.uniform(0.005, 0.1, 40)
    matrices = structures.sliders(stiffness, limits, 2.0, 1e6)
    frequency = np.sqrt((1e6 + stiffness.sum()) / 2.0) / (2.0 * np.pi)
    step = 1.0 / (100.0 * frequency)
    decay = structures.newmark(2.0, 1e6, stiffness, limits, 8e-5, step, 100 * 100, 5.0)
    time = step * np.arange(len(decay))
    recording = write(structures, tmp_path, matrices, (time, decay, frequency), '"0.3 N", "3 N"', "head")
    np.savetxt(tmp_path / "ring.csv", np.c_[time, 1e6 * decay], delimiter=",", header="t,x", comments="")
    text = structures.BACKBONE.format(bolts='"0.3 N", "3 N"', of="head").split("[backbone]")[0]
    (tmp_path / "recording.toml").write_text(text + """[ring_down]
file = "ring.csv"
time = { column = "t", unit = "s" }
head = { column = "x", unit = "um" }
""")
    backbone = with_backbone(read_structure_recording(tmp_path)).backbone
    top = backbone.amplitude > 2e-5
    told = recording.backbone
    assert top.sum() > 5
    damping = np.interp(backbone.amplitude[top], told.amplitude, told.damping)
    assert damping == pytest.approx(backbone.damping[top], rel=0.1)
