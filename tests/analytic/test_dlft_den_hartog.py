"""One node on the rig against Den Hartog's closed form of forced motion with Coulomb friction (no stops).

What carries the weight: the closed form is exact, so the DLFT amplitude must approach it as harmonics grow.
Den Hartog, Trans. ASME 53 (1931), APM-53-9: ``x0 = F/k sqrt(V^2 - (F_f / F)^2 U^2)``, ``V = 1 / (1 - b^2)``,
``U = sin(pi/b) / (b (1 + cos(pi/b)))``, b the frequency over the natural one.
"""

import numpy as np
import pytest
from fretflow.case.config import PeriodicMethod, Solver
from fretflow.contact.interface import Interface
from fretflow.pipeline.problem import rig_problem
from fretflow.solvers.dlft.solver import DlftSolver
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig

MASS, NATURAL, FREQUENCY, MU, LOAD = 10.5, 40.0, 100.0, 0.88, 60.0


def closed_form(force):
    b = FREQUENCY / NATURAL
    stiffness = MASS * (2 * np.pi * NATURAL)**2
    v, u = 1 / (1 - b**2), np.sin(np.pi / b) / (b * (1 + np.cos(np.pi / b)))
    return force / stiffness * np.sqrt(v**2 - (MU * LOAD / force)**2 * u**2)


def amplitude(force, harmonics, samples=512):
    rig = LumpedRig.from_modes(10.0, 0.5, NATURAL, 2e5, 0.0)  # hinge, contact and dashpots out of the way
    problem = rig_problem(
        joint=QuasiStaticJoint.from_stiffness(1e11 * np.eye(3), rig), frequency=FREQUENCY, excitation=force,
        interface=Interface(nodes=np.zeros((1, 2)), areas=np.array([1e-6]), gap=np.zeros(1)),
        friction_coefficient=MU, normal_load=LOAD)
    settings = Solver(method=PeriodicMethod.DLFT, harmonics=harmonics, samples=samples, penalty="1e9 N/m",
                      estimate_error=False)
    solution = DlftSolver(settings).solve(problem)
    assert solution.rig_displacement[:, 0] == pytest.approx(solution.displacement[:, 0, 0], abs=1e-8)
    return np.ptp(solution.displacement[:, 0, 0]) / 2


@pytest.mark.parametrize("force", [150.0, 250.0])
def test_amplitude_approaches_the_closed_form(force):
    """Slowly, about as the root of the harmonics: at reversals the tail of the displacement is lost."""
    errors = np.array([amplitude(force, h) / closed_form(force) - 1 for h in (1, 5, 25)])
    assert np.all(errors > 0.0)
    assert np.all(errors[1:] < 0.75 * errors[:-1])
    assert errors[-1] < 0.03
