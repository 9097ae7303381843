"""
How tight a friction damper should be
=====================================

Two masses, and a damper between the second one and the ground that holds like a spring of 0.5 N/µm and slips at 0.5
times the load that presses it: a Jenkins element. All moves along x alone, so that the contact's y and z are two more
degrees of freedom, stiff, and the spring is the contact's compliance.

A loose damper takes little, a tight one never slips, and the peak is lowest in between. Dotted: both linear limits.
"""

import fretflow as ff
import matplotlib.pyplot as plt
import numpy as np
from scipy.linalg import block_diag, eigh

SPRING, FRICTION, FORCE, DAMPING = 5e5, 0.5, 20.0, 0.002
K, M = np.array([[2e6, -1e6], [-1e6, 1e6]]), np.diag([1.0, 0.5])
joint = ff.Joint.from_matrices(
    block_diag(K, 1e9 * np.eye(2)), block_diag(M, 1e-3 * np.eye(2)), contact_map=np.eye(4)[1:], modal_damping=DAMPING,
    observe={"first": 0, "second": 1}, contact_compliance=1.0 / SPRING)
point = ff.Interface(nodes=np.zeros((1, 2)), areas=np.array([1e-4]), gap=np.zeros(1))

figure, (response, peak) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained", sharey=True)
peaks = {}
for load in (2.0, 10.0, 30.0, 60.0, 200.0, 600.0):
    problem = ff.PeriodicProblem(joint, point, ff.Coulomb(FRICTION), ff.Harmonic(150.0, {"first": FORCE}),
                                 preload=ff.NormalLoad(load))
    curve = ff.continue_response(problem, 110.0, 170.0)
    amplitude = abs(curve.first_harmonic[:, curve.channels.index("second")])
    peaks[load] = amplitude.max()
    response.semilogy(curve.frequency, 1e6 * amplitude, label=f"{load:g} N")
peak.loglog(list(peaks), [1e6 * one for one in peaks.values()], "o-")

frequency = np.linspace(110.0, 170.0, 600)
for held in (0.0, SPRING):
    squares, shapes = eigh(K + np.diag([0.0, held]), M)
    omega, s = np.sqrt(squares), 2.0j * np.pi * frequency[:, None]
    linear = (shapes[0] * shapes[1] / (squares + 2.0 * DAMPING * omega * s + s**2)).sum(axis=1)
    response.semilogy(frequency, 1e6 * FORCE * abs(linear), "k:", linewidth=1)
    peak.axhline(1e6 * FORCE * abs(linear).max(), color="k", linestyle=":", linewidth=1)
response.set(xlabel="frequency in Hz", ylabel="amplitude of the second mass in µm")
response.legend(title="pressed with")
peak.set(xlabel="load in N", title="highest amplitude")
plt.show()
