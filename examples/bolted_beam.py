"""A bolted lap beam from its mesh: preload, frequency and damping over amplitude, responses, wear, and pictures.

Two bars of steel with the sizes of a half Brake-Reuss beam, free in space, held together by three bolts. The mesh is
coarse, so that all takes a minute. Run it: ``python examples/bolted_beam.py FOLDER``; ``bolted_beam.toml`` is the same
as a case.
"""

import sys
import tempfile
from pathlib import Path

import fretflow as ff
import numpy as np
from fretflow_meshes import LapBeam

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())
beam = LapBeam(across=2, stretch=2.0)
steel = ff.Material(youngs_modulus=205e9, poissons_ratio=0.29, density=7800.0)
bolts = [ff.Bolt.round(f"head {k}", f"nut {k}", diameter=7.9e-3, grip=beam.thickness, mass=0.03) for k in (1, 2, 3)]
mesh = beam.write(folder / "beam.msh")
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

on_contact, on_modes = structure.outputs["tip"]
shape = abs(float(on_contact @ mode.contact + on_modes @ mode.modes))  # motion of the tip over the modal amplitude
study = ff.study_joint(joint, np.geomspace(1e-5, 6e-4, 13) / shape, periodic=2, forces=[0.1, 0.3, 1.0], drive="tip",
                       wear=(ff.Archard(1e-14), 3e-4 / shape, 100_000_000), mesh=mesh, bolts=bolts,
                       title="Half Brake-Reuss beam, coarse mesh")
curve = study.curve
for k in range(0, 13, 2):
    print(f"tip {1e6 * abs(curve.outputs[k, 0]):7.1f} µm: {curve.frequency[k]:.2f} Hz, "
          f"{100.0 * curve.damping[k]:.2f} % damping, {curve.sliding[k]} points slide")
assert curve.frequency[-1] < mode.frequency
print(f"energy of a cycle goes with the amplitude to the power {study.slope:.1f}")
assert 1.0 < study.slope < 3.5  # 1: all slides; 3: micro-slip of an edge (Goodman and Klumpp)
for motion in study.motions:
    static = np.interp(motion.amplitude, curve.amplitude, curve.frequency)
    print(f"as a periodic motion: {motion.frequency:.2f} Hz, {100.0 * motion.damping:.2f} % damping")
    assert abs(motion.frequency / static - 1.0) < 2e-3

worn = study.worn
print(f"after {worn.cycles[-1]:,} cycles {1e9 * worn.volume[-1]:.3f} mm3 are worn off, "
      f"{1e6 * worn.depth[-1].max():.2f} µm at most")
assert abs(worn.volume[-1] * 0.6 / (1e-14 * worn.energy[-1]) - 1.0) < 0.05  # Archard: K_w / mu times the energy
for file in study.draw(folder):
    print(file)
