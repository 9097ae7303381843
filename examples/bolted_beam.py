"""A bolted lap beam from its mesh: preload, contact, frequency and damping over amplitude, energy of a cycle.

Two bars of steel with the sizes of a half Brake-Reuss beam, free in space, held together by three bolts. The mesh is
coarse, so that all takes a minute. Run it: ``python examples/bolted_beam.py``.
"""

import tempfile
from pathlib import Path

import fretflow as ff
import numpy as np
from fretflow_meshes import LapBeam

beam = LapBeam(across=2, stretch=2.0)
steel = ff.Material(youngs_modulus=205e9, poissons_ratio=0.29, density=7800.0)
bolts = [ff.Bolt.round(f"head {k}", f"nut {k}", diameter=7.9e-3, grip=beam.thickness, mass=0.03) for k in (1, 2, 3)]
with tempfile.TemporaryDirectory() as folder:
    mesh = beam.write(Path(folder) / "beam.msh")
    matrices = ff.structure_from_mesh(mesh, steel, [("upper lap", "lower lap")], bolts,
                                      sensors={"tip": ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))})
structure = ff.reduce_structure(matrices, 20)
print(f"{matrices.size} DOF on {structure.contacts} contact points and {len(structure.eigenvalues)} modes; the "
      f"reduction changes the first frequencies by {100.0 * structure.error:.2g} %")
assert structure.error < 1e-3
tied = float(np.sqrt(structure.eigenvalues[0])) / (2.0 * np.pi)

joint = ff.BoltedJoint(structure=structure, law=ff.Coulomb(0.6), bolt_load=8e3, modal_damping=1e-3)
pressure = joint.preloaded.force[0, 2::3] / structure.areas
mode = joint.linear_modes(1)[0]
print(f"{joint.closed.sum()} of {structure.contacts} points touch, at {1e-6 * pressure.max():.0f} MPa at most")
print(f"first bending: {tied:.1f} Hz with the whole lap tied, {mode.frequency:.1f} Hz with what the bolts press")
assert 0.7 * tied < mode.frequency < 0.95 * tied  # measured beams: 80 Hz, tied 115

curve = ff.quasi_static_backbone(joint, mode, np.geomspace(1e-5, 1e-3, 13))
for k in range(0, 13, 2):
    print(f"tip {1e6 * abs(curve.outputs[k, 0]):7.1f} um: {curve.frequency[k]:.2f} Hz, "
          f"{100.0 * curve.damping[k]:.2f} % damping, {curve.sliding[k]} points slide")
assert curve.frequency[-1] < mode.frequency

slides = curve.dissipated > 1e-3 * curve.dissipated.max()
slope = np.polyfit(np.log(curve.amplitude[slides]), np.log(curve.dissipated[slides]), 1)[0]
print(f"energy of a cycle goes with the amplitude to the power {slope:.1f}")
assert 1.0 < slope < 3.5  # 1: all slides; 3: micro-slip of an edge (Goodman and Klumpp)

some = [4, 8]
for k, motion in zip(some, ff.follow_mode(joint, mode, curve.amplitude[some]), strict=True):
    print(f"as a periodic motion: {motion.frequency:.2f} Hz, {100.0 * motion.damping:.2f} % damping")
    assert abs(motion.frequency / curve.frequency[k] - 1.0) < 2e-3
