"""
Diagnosing a recording
======================

A diagnosis says whether the model explains a recording and, if not, where they part and which physics is left out.
Here are two recordings of one joint that a measured motion drives: a slider of 50 N behind 28 N/µm, and the same with
a play of 2 µm before it. Both have 2 % of noise. The rig's recordings are diagnosed in the same way, with a full model
behind them.
"""

from pathlib import Path

import fretflow as ff
import numpy as np

LIMIT, STIFFNESS, PLAY = 50.0, 28e6, 2e-6  # N, N/m, m


def make_recording(folder: Path, play: float) -> Path:
    """Write a recording with a `play` in m before the slider, and return its folder."""
    folder.mkdir(parents=True, exist_ok=True)
    time = np.arange(1320) / 20_000.0
    x = -7e-6 * np.cos(2.0 * np.pi * 100.0 * time)
    reach = 0.5 * play + LIMIT / STIFFNESS
    stretch, force = -reach, []  # of play and spring together
    for step in np.diff(x, prepend=x[0]):
        stretch = min(max(stretch + step, -reach), reach)
        force.append(STIFFNESS * (stretch - min(max(stretch, -0.5 * play), 0.5 * play)))
    noise = np.random.default_rng(2).standard_normal((2, len(time)))
    columns = [time, 1e6 * x + 7e-3 * noise[0], np.array(force) + 0.02 * LIMIT * noise[1]]
    np.savetxt(folder / "series.csv", np.column_stack(columns), delimiter=",", header="time_s,x_um,force_N",
               comments="")
    (folder / "recording.toml").write_text("""
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
    return folder


# %%
# The first is explained by the baseline, whose own stiffness and friction limit are found first: a wrong value is no
# missing physics.

plain = ff.diagnose(make_recording(Path("runs/plain"), 0.0))
print(plain.verdict)

# %%
# The second is not, and the play is named, with its size and a 90 % interval.

diagnosis = ff.diagnose(make_recording(Path("runs/loose"), PLAY))
print(diagnosis.verdict, *diagnosis.effects, f"at probability {diagnosis.probability:.3f}")
for one in diagnosis.parameters:
    print(f"{one.name:24} {one.value:10.3g}  ({one.low:.3g} to {one.high:.3g}) {one.unit}")

# %%
# What was held out, measured and predicted with and without it:

diagnosis.plot()

# %%
# What is read off the loops, cycle by cycle. Readings scatter with the noise, which the models' loops have not: the
# sliding distance by half a micrometre, as ``./fretflow loops runs/loose`` tells.

diagnosis.plot("evolution")

# %%
# And the posterior of the parameters: a stiffer spring with more play explains nearly the same, so that the two are
# known together better than each alone.

diagnosis.plot("parameters")

# %%
# The report holds all of it on one page, the JSON the same as numbers.

diagnosis.to_html("runs/report.html")
diagnosis.to_json("runs/diagnosis.json")
print(*(f"{file}: {Path(file).stat().st_size // 1000} kB" for file in ("runs/report.html", "runs/diagnosis.json")))

# %%
# On a terminal: ``./fretflow diagnose runs/loose``. How the verdict is found, and how far to trust it, stands under
# `diagnosis <../../diagnosis.html>`_; what would confirm the play, on :doc:`its page </_made/effects/backlash>`.
