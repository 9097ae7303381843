"""
An effect of one's own
======================

Physics that the catalogue lacks is one Python file with one class: what it is called, its equation, where it acts, its
parameters with their plausible ranges, and the method that changes what it acts on. It then stands in the list, in case
files and in diagnoses. This one is ``examples/own_effects/friction_bump.py``:
"""

from pathlib import Path

import fretflow as ff

folder = Path("../../examples/own_effects")
print(next(folder.glob("*.py")).read_text(encoding="utf-8"))

# %%
# The folder joins the catalogue for this process. On a terminal, the variable ``FRETFLOW_EFFECTS`` names such folders;
# their code is run, so name folders that you trust.

ff.add_effects(folder)
bump = ff.catalogue()["friction-bump"]
print(bump.id, "-", bump.title)
for name, prior in bump.priors().items():
    print(f"{name:8} plausible from {prior.low:g} to {prior.high:g}")

# %%
# A joint that has it: a slider of 50 N behind 28 N/µm, marched sample by sample, 30 % more friction in the middle of
# the stroke, 2 % of noise.

import numpy as np

LIMIT, STIFFNESS = 50.0, 28e6
time = np.arange(1320) / 20_000.0
x = -7e-6 * np.cos(2.0 * np.pi * 100.0 * time)
stretch, force = -LIMIT / STIFFNESS, []
for place, step in zip(x, np.diff(x, prepend=x[0]), strict=True):
    reach = LIMIT * (1.0 + 0.3 * np.exp(-((place / 1.5e-6) ** 2))) / STIFFNESS
    stretch = min(max(stretch + step, -reach), reach)
    force.append(STIFFNESS * stretch)
noise = np.random.default_rng(5).standard_normal((2, len(x)))
seen = np.column_stack([time, 1e6 * (x + 7e-9 * noise[0]), np.array(force) + noise[1]])

recording = Path("runs/bump")
recording.mkdir(parents=True, exist_ok=True)
np.savetxt(recording / "series.csv", seen, delimiter=",", header="time_s,x_um,force_N", comments="")
(recording / "recording.toml").write_text("""
format = "fretflow-recording/1"
[test]
kind = "imposed-displacement"
excitation_frequency = "100 Hz"
[series]
file = "series.csv"
time = { column = "time_s", unit = "s" }
displacement = { column = "x_um", unit = "um" }
force = { column = "force_N", unit = "N" }
""", encoding="utf-8")

# %%
# Its diagnosis names it; 0.3 and 1.5 µm were put in.

diagnosis = ff.diagnose(recording)
print(diagnosis.verdict, *diagnosis.effects, f"at probability {diagnosis.probability:.3f}")
for one in diagnosis.parameters:
    if one.name.startswith("friction-bump"):
        print(f"{one.name:22} {one.value:.3g}  ({one.low:.3g} to {one.high:.3g}) {one.unit}")

# %%
diagnosis.plot()

# %%
# An effect that acts in the rig overrides `period`, which returns a changed problem; one that acts over cycles `evolve`
# or `wear_factor`; one in the sensors `sense`. Each of the :doc:`catalogue's </effects>` is such a file, and with
# neutral parameters it leaves the baseline as it is. Derivatives need not be written.
