"""The meshes that recordings are fitted on, against the compliance that spectral elements give.

The trial's specimens come from a code of their own: third order, nodes of Gauss, Lobatto and Legendre.
"""

import numpy as np
import pytest
from fretflow.case.config import Reduction, validate_case
from fretflow.experiments.rig.setup import DEGREE, ELEMENTS, GROWTH
from fretflow.pipeline.diagnose import reduced_problem
from fretflow_trial.joint import specimens

pytestmark = pytest.mark.fem
SQUARE = {"body": "square", "body_width": "6 mm", "body_height": "5 mm", "contact_width": "1 mm",
          "ridge_height": "1 mm", "youngs_modulus": "193 GPa", "poissons_ratio": 0.29, "density": "8000 kg/m^3"}
TEST = {"excitation_amplitude": "60 N", "excitation_frequency": "100 Hz", "normal_load": "60 N", "cycles": 1000}


def compliance(folder, mesh):
    """Return the mean compliance under an even traction, sliding and normal, m/N, of both specimens together."""
    case = validate_case({"format": "fretflow-case/1", "name": "compliance", "mesh": mesh, "test": TEST,
                          "specimen": {"upper": SQUARE, "lower": SQUARE}})
    plain = case.model_copy(update={"reduction": Reduction(fixed_interface_modes=1, checked_frequencies=1)})
    problem = reduced_problem(plain, folder)
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
