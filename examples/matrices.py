"""Joints given only by their matrices: both solvers, time integration, another code, a loop, energy and wear.

Two bars of six masses each overlap over three contact nodes, where 100 N press them together. The upper bar is held at
its left end, and a force at 60 Hz shakes the right end of the lower one. Then ten contacts to ground,
of which another code's solution is known. Run it: ``python examples/matrices.py``.
"""

import json
from pathlib import Path

import fretflow as ff
import numpy as np
from fretflow.solvers.audit import energy_balance
from fretflow.solvers.fourier import synthesis_matrix
from fretflow.solvers.time_integration import settle

MASSES, FACES = 6, 3

# a bar: springs along x, y, z between masses of three DOF each
spring = np.zeros((MASSES, MASSES))
for i in range(MASSES - 1):
    spring[i:i + 2, i:i + 2] += np.array([[1.0, -1.0], [-1.0, 1.0]])
K = np.kron(np.eye(2), np.kron(spring, np.diag([2e7, 6e6, 1e7])))  # N/m
K[:3, :3] += np.diag([2e7, 6e6, 1e7])
K[-3:, -3:] += np.diag([1e6, 1e6, 1e7])
M = 0.1 * np.eye(len(K))  # kg

# the last three masses of the upper bar rub on the first three of the lower one: upper minus lower, x, y and z
Q = np.zeros((3 * FACES, len(K)))
for dof in range(3 * FACES):
    above, below = 3 * (MASSES - FACES) + dof, 3 * MASSES + dof
    Q[dof, above], Q[dof, below] = 1.0, -1.0
    M[above, above] = M[below, below] = 2e-3

joint = ff.Joint.from_matrices(K, M, contact_map=Q, observe={"tip": 33}, modal_damping=0.02)
faces = ff.Interface(np.zeros((FACES, 2)), np.full(FACES, 1e-4), np.zeros(FACES))
problem = ff.PeriodicProblem(joint, faces, ff.Coulomb(0.4), ff.Harmonic(60.0, {"tip": 60.0}),
                             preload=ff.NormalLoad(100.0))

period = ff.solve_periodic(problem, harmonics=21, samples=512, tolerance=1e-8)
few = ff.solve_periodic(problem, "dlft", harmonics=31, samples=512)
history = settle(problem, period, (3, 20), 1024, 1e-4)  # no Fourier series in it
swing = np.ptp(history.of_period(history.outputs["tip"]))
for name, solution in (("quasi-static", period), ("DLFT", few)):
    moved = np.ptp(solution.output("tip"))
    print(f"{name}: tip moves {1e6 * moved:.2f} µm, {1e3 * solution.dissipated_energy:.3f} mJ a cycle")
    assert abs(moved / swing - 1.0) < 0.01
print(f"in time: tip moves {1e6 * swing:.2f} µm, {1e3 * history.dissipated_energy[-1]:.3f} mJ a cycle")

balance = energy_balance(problem, period)
assert balance.error < 1e-7  # the excitation's work is what friction and dashpots take
loop = ff.read_loop(period.hysteresis(), normal_load=100.0)
assert abs(loop.dissipated_energy / period.dissipated_energy - 1.0) < 0.3  # mean of three nodes that slide differently

wear = ff.march_wear(problem, ff.Archard(1e-13), cycles=100_000)
print(f"after {wear.cycles[-1]} cycles {1e9 * wear.volume[-1]:.4f} mm^3 are worn")
assert wear.volume[-1] > 0.0

# ten contacts to ground; a node's DOF there are the normal one, in compression, and two tangential ones
peers = Path(__file__).parents[1] / "tests" / "data" / "peers"
given = np.load(peers / "problem_10.npz")
theirs = next(case["X"] for case in json.loads((peers / "coupled_dlft_3d.json").read_text())["B_dlft3d"]
              if (case["N"], case["eps"]) == (10, 100.0))  # terms of the Fourier series up to the third harmonic
Q = np.kron(np.eye(10), [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
still, moving = (dict(zip(map(str, range(30)), own, strict=True))
                 for own in (given["F0"], given["Fc"] - 1j * given["Fs"]))
force = ff.Harmonic(0.8 / (2.0 * np.pi), moving, overtones=((0, still),))
faces = ff.Interface(np.zeros((10, 2)), np.ones(10), np.zeros(10))


def grounded(compliance: float) -> ff.PeriodicProblem:
    """Return the other code's problem; all its mass is at the contact, which `compliance` in m/N lets move."""
    held = ff.Joint.from_matrices(given["K"], given["M"], given["C"], contact_map=Q, contact_compliance=compliance,
                                  observe={str(k): k for k in range(30)})
    return ff.PeriodicProblem(held, faces, ff.Coulomb(0.3), force)


same = ff.solve_periodic(grounded(1e-10), "dlft", harmonics=3, samples=128, penalty="100 N/m", tolerance=1e-11)
expected = synthesis_matrix(3, 128) @ theirs @ Q.T  # m
away = np.abs(same.displacement.reshape(128, -1) - expected).max() / np.abs(expected).max()
print(f"ten contacts to ground: the other code's motion within {away:.1e} of its largest")
assert away < 1e-6

soft = grounded(0.02)
period, few = (ff.solve_periodic(soft, method, harmonics=15, samples=256, tolerance=1e-8)
               for method in ("quasi-static", "dlft"))
history = settle(soft, period, (2, 6), 512, 1e-4)
for name in ("0", "1", "2"):
    swing = np.ptp(history.of_period(history.outputs[name]))
    assert all(abs(np.ptp(solution.output(name)) / swing - 1.0) < 0.01 for solution in (period, few))
