"""DLFT against solutions of other codes, in their own problems.

What carries the weight: their roots are roots of these equations. DOF order there is normal, t1, t2 with
compression positive along the normal; contacts are to ground; a load in Fourier terms; 3 harmonics, 128
samples, mu 0.3, omega 0.8.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from fretflow.contact.coulomb import Coulomb, return_mapping
from fretflow.solvers.dlft.equations import DenseStiffness, DlftEquations
from fretflow.solvers.dlft.solver import solve_equations

PEERS = Path(__file__).parents[1] / "data" / "peers"
CASES = [c for c in json.loads((PEERS / "coupled_dlft_3d.json").read_text())["B_dlft3d"] if c["N"] in (1, 10)]
HARMONICS, OMEGA = 3, 0.8


def permutation(nodes):
    """Return the map from their displacements to (x, y, z) = (t1, t2, -normal) per node."""
    return np.kron(np.eye(nodes), [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])


def equations_of(case):
    data, p = np.load(PEERS / f"problem_{case['N']}.npz"), permutation(case["N"])
    m, c, k = (p @ data[name] @ p.T for name in "MCK")
    stiffness = np.array([k - (h * OMEGA)**2 * m + 1j * h * OMEGA * c for h in range(HARMONICS + 1)])
    load = np.zeros((HARMONICS + 1, len(k)), dtype=complex)
    load[0], load[1] = p @ data["F0"], p @ (data["Fc"] - 1j * data["Fs"])
    return DlftEquations(stiffness=DenseStiffness(stiffness), load=load, gap=np.zeros(case["N"]), samples=128,
                         law=Coulomb(friction_coefficient=0.3), penalty=case["eps"])


def solved(case):
    equations, theirs = equations_of(case), np.array(case["X"]) @ permutation(case["N"]).T
    return solve_equations(equations, None, 1e-13, 60).unknowns, theirs


def name(case):
    return f"{case['N']} nodes, eps {case['eps']}"


def periodic(case):
    """Whether the peer's marching reached a repeating state: with ten nodes only at penalty 100."""
    return case["N"] == 1 or case["eps"] == 100.0


@pytest.mark.parametrize("case", [c for c in CASES if periodic(c)], ids=name)
def test_the_solution_from_zero_is_the_peers(case):
    ours, theirs = solved(case)
    assert ours == pytest.approx(theirs, abs=3e-12)


@pytest.mark.parametrize("case", [c for c in CASES if not periodic(c)], ids=name)
def test_a_peer_that_stopped_before_the_state_repeats_is_as_far_off_as_its_state(case):
    """Theirs is a root if the period is marched three times, and 1e-6 to 1e-3 away when the state repeats."""
    equations, theirs = equations_of(case), np.array(case["X"]) @ permutation(case["N"]).T
    at = equations.evaluate(theirs)
    drive = at.drive[:, :, 0] + 1j * at.drive[:, :, 1]
    state, force = drive[-1], np.empty_like(drive)
    for j in 3 * list(range(len(drive))):
        state = force[j] = return_mapping(state + drive[j] - drive[j - 1], at.limit[j])
    lacking = np.stack([force.real, force.imag, at.force[:, :, 2]], axis=2) - at.force
    residual = at.residual - equations.analysis @ lacking.reshape(128, -1)
    assert np.abs(residual).max() < 1e-13
    ours, _ = solved(case)
    assert 1e-6 < np.abs(ours - theirs).max() < 1e-3
