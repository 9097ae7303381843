"""Results that are doubtful say so: a reduction beyond its limit, a contact that no node resolves."""

import numpy as np
from fretflow.case.config import validate_case
from fretflow.core.store import write_record
from fretflow.pipeline.summary import _narrow, result_warnings
from fretflow.structure.reduction.reduced_specimen import ReducedSpecimen

CASE = validate_case({"format": "fretflow-case/1", "name": "x", "mesh": {"contact_elements": 4},
                      "test": {"excitation_amplitude": "53 N", "cycles": 1}})
GRID = 1e-3 * np.array([(x, y) for x in range(5) for y in range(5)]) / 4


def specimen(error):
    full = np.array([1e3, 2e3])
    return ReducedSpecimen(
        stiffness=np.eye(24), mass=np.eye(24), contact_nodes=np.zeros((4, 3)), contact_areas=np.ones(4),
        profile=np.zeros(4), observation_point=np.zeros(3), fixed_interface_frequencies=full, full_frequencies=full,
        reduced_frequencies=full * (1.0 + np.array([0.0, error])), rayleigh_mass=0.0, rayleigh_stiffness=0.0,
        full_dofs=20655)


def test_a_reduction_beyond_its_limit_is_warned_about_with_the_way_out(tmp_path):
    for side, error in (("upper", 9e-4), ("lower", 0.0496)):
        write_record(tmp_path / f"{side}.h5", specimen(error))
    assert result_warnings(CASE, {}) == []
    (warning,) = result_warnings(CASE, {"reduce": tmp_path})
    assert "lower specimen: the reduction is 4.96 % off the full model at mode 2" in warning
    assert "0.1 %" in warning
    assert "raise reduction.fixed_interface_modes" in warning


def test_a_line_contact_one_node_wide_is_warned_about():
    middle = GRID[:, 0] == 0.5e-3  # a cylinder along y on a flat face
    (warning,) = _narrow(CASE, GRID, middle)
    assert "one row of nodes (5 of 25), one node wide along x" in warning
    assert "raise mesh.contact_elements (now 4)" in warning
    (point,) = _narrow(CASE, GRID, middle & (GRID[:, 1] == 0.5e-3))  # crossed cylinders
    assert "along x and y" in point
    assert not _narrow(CASE, GRID, np.abs(GRID[:, 0] - 0.5e-3) < 0.3e-3)  # three nodes
