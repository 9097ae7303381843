"""Property: what meshes and codes differ by is no missing physics: a finer mesh beside a file's own, static loads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fretflow.contact.coulomb import Coulomb
from fretflow.experiments.independent import in_turn
from fretflow.experiments.structure.experiment import StructureExperiment
from fretflow.experiments.structure.run import diagnose_structure, of_baseline, told_again
from fretflow.inference.experiment import Point
from fretflow.inference.search import FAST
from fretflow.inference.strategy import start_search
from fretflow.inference.verdict import Verdict
from fretflow.recordings.kinds.structures import read_structure_recording
from fretflow.solvers.nonlinear_modes.joint import BoltedJoint
from fretflow.solvers.nonlinear_modes.periodic_mode import follow_mode
from fretflow.solvers.nonlinear_modes.quasi_static import quasi_static_backbone
from fretflow.structure.reduction.contact_modes import reduce_structure

LOAD, FRICTION, DAMPING = 6e3, 0.45, 1e-3


@pytest.fixture(scope="module")
def finer(structures, tmp_path_factory):
    """Return a recording of rigid faces with 61 points, whose file has matrices with 25."""
    joint = BoltedJoint(structure=reduce_structure(structures.lap_beam(61)), law=Coulomb(FRICTION), bolt_load=LOAD,
                        modal_damping=DAMPING)
    motions = follow_mode(joint, joint.linear_modes(1)[0], np.geomspace(4e-6, 1.5e-4, 24), tolerance=1e-3)
    amplitude, frequency, damping = np.array([(one.outputs[0], one.frequency, one.damping) for one in motions]).T
    rng = np.random.default_rng(11)
    table = np.c_[1e6 * amplitude, frequency * (1.0 + 2e-4 * rng.standard_normal(24)),
                  100.0 * damping * (1.0 + 0.02 * rng.standard_normal(24))]
    folder, beam = tmp_path_factory.mktemp("finer"), structures.lap_beam(25)
    structures.write_backbone(folder, beam, table, '"2 kN", "20 kN"', "tip")
    return read_structure_recording(folder)


def test_what_a_finer_mesh_shows_otherwise_is_about_what_is_told(finer):
    experiment = StructureExperiment.of(finer)
    space = experiment.parameters(())
    values = {"bolt_load": LOAD, "friction_coefficient": FRICTION, "modal_damping": DAMPING}
    truth = experiment.predict(Point(space, np.array([one.place(values[one.field]) for one in space.coordinates])))
    told = experiment.told_at(truth)
    missed = told.measurement.values - told.predict(truth.point).values
    squares = [float(np.mean(one.measurement.covariance().whiten(missed)**2)) for one in (
        replace(told, spacing=1.0), replace(told, spacing=0.0))]
    assert squares[0] > 5.0
    assert 0.2 < squares[1] < 2.0


def test_errors_of_a_mesh_are_those_of_the_baseline_that_is_judged_by_them(finer):
    experiment = StructureExperiment.of(finer)
    space = experiment.parameters(("bolt-load-spread",))
    elsewhere = experiment.told_at(experiment.predict(Point(space, np.full(space.size, 0.5))))
    search = start_search(experiment, experiment.first_prediction(), FAST, in_turn)
    own = of_baseline(replace(elsewhere, spacing=0.0), search)
    assert own.about.effects == frozenset()
    rest = [one.measurement.covariance().whiten(one.measurement.values - one.predict(own.about).values) for one in (
        replace(elsewhere, spacing=0.0), own)]
    assert np.mean(rest[1]**2) < min(2.0, float(np.mean(rest[0]**2)))


def test_nothing_is_missing_from_rigid_faces_on_another_mesh(finer):
    diagnosis = diagnose_structure(finer, True, lambda share, text: None)
    assert diagnosis.verdict is Verdict.NONE
    values = {one.name: one.value for one in diagnosis.parameters}
    assert values["structure.bolt_load"] * values["structure.friction_coefficient"] == pytest.approx(
        LOAD * FRICTION, rel=0.25)
    assert any("much finer" in note for note in diagnosis.notes)


def test_a_backbone_of_static_loads_is_compared_with_static_loads(structures, tmp_path):
    """As quasi-static simulators make one; periodic motions of this joint differ by many times the noise."""
    beam, asked = structures.lap_beam(13, 4), np.geomspace(5e-6, 2.5e-4, 24)
    joint = BoltedJoint(structure=reduce_structure(beam), law=Coulomb(FRICTION), bolt_load=630.0, modal_damping=DAMPING)
    mode = joint.linear_modes(1)[0]
    curve = quasi_static_backbone(joint, mode, asked / abs(mode_shape(joint, mode)))
    rng = np.random.default_rng(12)
    table = np.c_[1e6 * np.abs(curve.outputs[:, 0]), curve.frequency * (1.0 + 1e-4 * rng.standard_normal(24)),
                  100.0 * curve.damping * (1.0 + 0.02 * rng.standard_normal(24))]
    structures.write_backbone(tmp_path, beam, table, '"200 N", "2 kN"', "tip")
    experiment = StructureExperiment.of(read_structure_recording(tmp_path))
    search = start_search(experiment, experiment.first_prediction(), FAST, in_turn)
    told, again, _ = told_again(experiment, search)
    assert told.static
    assert told.corrected(again.baseline.prediction) is None
    assert again.leaves_noise(frozenset())


def mode_shape(joint, mode):
    """Return the displacement of the tip over the modal amplitude."""
    on_contact, on_modes = joint.structure.outputs["tip"]
    return float(on_contact @ mode.contact + on_modes @ mode.modes)
