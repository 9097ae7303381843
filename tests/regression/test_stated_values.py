"""Property: a load that is stated wrongly is found beside what is missing, and nothing else is named in its place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fretflow.contact.coulomb import Coulomb
from fretflow.effects.contact_stiffness import ContactStiffness
from fretflow.experiments.independent import in_turn
from fretflow.experiments.structure.experiment import StructureExperiment
from fretflow.experiments.structure.run import either, p_of_stated, released
from fretflow.inference.posterior import posterior
from fretflow.inference.search import FAST, Task, fit_task
from fretflow.inference.strategy import start_search
from fretflow.inference.verdict import FALSE_ALARMS
from fretflow.recordings.kinds.structures import read_structure_recording
from fretflow.solvers.nonlinear_modes.joint import BoltedJoint
from fretflow.solvers.nonlinear_modes.quasi_static import quasi_static_backbone
from fretflow.structure.reduction.contact_modes import reduce_structure

LOAD, FRICTION, DAMPING = 6e3, 0.45, 1e-3
SPRUNG = frozenset({"contact-stiffness"})


@pytest.fixture(scope="module")
def stated(structures, tmp_path_factory):
    """Return a function of the load that is stated: an experiment of static loads on soft asperities, as recorded."""
    beam, folder = structures.lap_beam(13, 4), tmp_path_factory.mktemp("stated")
    rigid = BoltedJoint(structure=reduce_structure(beam), law=Coulomb(FRICTION), bolt_load=LOAD, modal_damping=DAMPING)
    soft = ContactStiffness.neutral().changed(stiffness=5e12 * beam.areas.sum(), exponent=0.5, ratio=1.2,
                                              reference_pressure=rigid.bolted_pressure)
    joint = soft.bolted(rigid)
    mode = joint.linear_modes(1)[0]
    on_contact, on_modes = joint.structure.outputs["tip"]
    gain = abs(float(on_contact @ mode.contact + on_modes @ mode.modes))
    curve = quasi_static_backbone(joint, mode, np.geomspace(4e-6, 1.5e-4, 24) / gain)
    rng = np.random.default_rng(21)
    table = np.c_[1e6 * np.abs(curve.outputs[:, 0]), curve.frequency * (1.0 + 1e-4 * rng.standard_normal(24)),
                  100.0 * curve.damping * (1.0 + 0.02 * rng.standard_normal(24))]
    structures.write_backbone(folder, beam, table, '"2 kN", "20 kN"', "tip")
    recording = read_structure_recording(folder)

    def experiment(load):
        known = {"bolt_load": load, "friction_coefficient": FRICTION}
        return replace(StructureExperiment.of(replace(
            recording, known=known, unknown={"modal_damping": (1e-4, 1e-2)})), static=True)

    return experiment


def searched(experiment):
    """Return a search with the baseline and the true effect fitted."""
    search = start_search(experiment, experiment.first_prediction(), FAST, in_turn)
    space = experiment.parameters(sorted(SPRUNG))
    middle = replace(search.baseline.prediction.point, parameters=space, z=np.zeros(space.size))
    search.keep([fit_task(Task(search.fitter, middle, None, 12))])
    return search


@pytest.mark.parametrize("share", [0.65, 1.0])
def test_a_load_that_is_stated_wrongly_is_free_beside_what_is_missing(stated, share):
    experiment = stated(share * LOAD)
    search, free = searched(experiment), experiment.released()
    again = released(free, search)
    _, best, ((other, _),) = either((experiment, search, []), (free, again, []))
    assert best is (search if share == 1.0 else again)
    assert other < 0.1
    values = best.fits[SPRUNG].parameters.values(best.fits[SPRUNG].z)[""]
    assert best.leaves_noise(SPRUNG)
    assert values["bolt_load"] == pytest.approx(LOAD, rel=0.1)
    assert next(iter(posterior(best).sets)) == SPRUNG
    assert p_of_stated(search, experiment.recording) < FALSE_ALARMS or share == 1.0
