"""The meshes that recordings are fitted on, against the compliance that spectral elements give.

The trial's specimens come from a code of their own: third order, nodes of Gauss, Lobatto and Legendre.
"""

from functools import partial

import numpy as np
import pytest
from fretflow import read_recording
from fretflow.case.config import Reduction, validate_case
from fretflow.experiments.rig.observation import observe
from fretflow.experiments.rig.setup import (
    DEGREE,
    ELEMENTS,
    GROWTH,
    case_of,
    depth_error,
    first_friction,
    first_wear,
    linear_case,
    model_of,
    stiff_asperities,
)
from fretflow.experiments.rig.simulation import Hypothesis
from fretflow.experiments.tools import DiagnosisTools
from fretflow.pipeline.diagnose import reduced_problem
from fretflow.wear.slow import SlowState
from fretflow_trial.joint import specimens

pytestmark = pytest.mark.fem
SQUARE = {"body": "square", "body_width": "6 mm", "body_height": "5 mm", "contact_width": "1 mm",
          "ridge_height": "1 mm", "youngs_modulus": "193 GPa", "poissons_ratio": 0.29, "density": "8000 kg/m^3"}
TEST = {"excitation_amplitude": "60 N", "excitation_frequency": "100 Hz", "normal_load": "60 N", "cycles": 1000}


def problem_on(folder, mesh):
    """Return the problem of two square specimens on a mesh."""
    case = validate_case({"format": "fretflow-case/1", "name": "compliance", "mesh": mesh, "test": TEST,
                          "specimen": {"upper": SQUARE, "lower": SQUARE}})
    plain = case.model_copy(update={"reduction": Reduction(fixed_interface_modes=1, checked_frequencies=1)})
    return reduced_problem(plain, folder)


def compliance(folder, mesh):
    """Return the mean compliance under an even traction, sliding and normal, m/N, of both specimens together."""
    return mean_compliance(problem_on(folder, mesh))


def mean_compliance(problem):
    share = problem.interface.areas / problem.interface.areas.sum()
    flexible = problem.structure.quasi_static().flexibility
    return np.array([share @ flexible[k::3, k::3] @ share for k in (0, 2)])


def test_coarse_mesh_has_the_specimens_compliance(tmp_path):
    joint = specimens()
    exact = np.array([joint.share @ block @ joint.share for block in (joint.sliding, joint.normal)])
    quadratic = compliance(tmp_path, {"contact_elements": ELEMENTS, "degree": DEGREE, "growth": GROWTH})
    linear = compliance(tmp_path, {"contact_elements": DEGREE * ELEMENTS})
    assert quadratic == pytest.approx(exact, rel=0.03)
    assert np.all(linear < 0.95 * exact)


def test_reduced_specimens_are_kept(tmp_path, monkeypatch):
    first = compliance(tmp_path, {"contact_elements": 2})
    kept = list(tmp_path.iterdir())
    assert len(kept) == 1
    monkeypatch.setattr("fretflow.pipeline.runner.Runner.run", lambda *asked: pytest.fail("made again"))
    assert np.array_equal(compliance(tmp_path, {"contact_elements": 2}), first)


def test_stiff_asperities_add_their_share_and_lower_the_peaks_of_pressure(tmp_path):
    """Under an even pressure springs in series add their compliance; hard faces press the most at the corners."""
    hard = problem_on(tmp_path, {"contact_elements": 2, "degree": 2})
    rough = stiff_asperities(hard, 0.05).period(hard, SlowState.unworn(hard.interface.size))
    before, after = mean_compliance(hard), mean_compliance(rough)
    assert after - before == pytest.approx(0.05 * before[1])  # as much in sliding
    area = hard.interface.areas

    def pressures(problem):
        """Return the pressures (n,) of bodies that approach by a micrometre, all points touching."""
        normal = problem.structure.quasi_static().flexibility[2::3, 2::3]
        return np.linalg.solve(normal, np.full(len(area), 1e-6)) / area

    peaks = [own.max() / (own @ area / area.sum()) for own in map(pressures, (hard, rough))]
    assert peaks[0] > 1.15 * peaks[1]
    rigid = stiff_asperities(hard, 1e-9).period(hard, SlowState.unworn(hard.interface.size))
    assert pressures(rigid) == pytest.approx(pressures(hard), rel=1e-6)


def test_edges_of_the_scar_are_as_sure_as_codes_agree(tmp_path, recordings):
    """Codes that the errors were not made from have ends of the stroke within 2 sd of the prediction.

    What meshes of one kind differ by is not enough: 5 linear elements a side have less worn ends.
    """
    recording = read_recording(recordings / "example_baseline")
    observation = observe(recording)
    tools = DiagnosisTools(partial(reduced_problem, models=tmp_path), map)
    coarse, fine, dense, five = (case_of(recording, own, f"{own}") for own in (2, 3, 4, 5))
    five = five.model_copy(update={"mesh": five.mesh.model_copy(update={"degree": 1})})
    models = [model_of(recording, observation, one.vary(friction_coefficient=first_friction(recording)),
                       0.2 * first_wear(recording, 0.6))
              for one in tools.statics([coarse, fine, linear_case(coarse), dense, five])]
    assert models[2].problem.interface.size == models[0].problem.interface.size
    rows = observation.rows(block="map")
    plain, finer, linear, *others = (model.predict(model.simulate(Hypothesis())) for model in models)
    ends = np.abs(observation.points[:, 0]) > 0.99 * np.abs(observation.points[:, 0]).max()
    weights = np.zeros(len(plain))  # of the mean depth at the ends, less that of all points
    weights[rows] = ends / ends.sum() - 1.0 / rows.sum()
    variances = [weights**2 @ variance + np.sum((weights @ modes)**2) for variance, modes in (
        depth_error(observation, *codes) for codes in ((plain, finer), (finer, linear)))]
    missed = np.abs([weights @ (other - finer) for other in others])
    assert np.all(missed < 2.0 * np.sqrt(sum(variances)))
    assert missed[1] > 2.0 * np.sqrt(variances[0])
