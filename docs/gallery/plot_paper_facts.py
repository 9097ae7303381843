"""
The paper's claims, model by model
==================================

Each row is a claim of Tubita et al. (2021) as `examples/paper.toml` states it, each symbol what a model of the rig
gives, in standard deviations of the claim: beyond the shaded band it is missed. A mark at an edge lies further out.
The contact is coarse; :doc:`/paper` tells what the rows mean.
"""

from pathlib import Path

import fretflow as ff
import matplotlib.pyplot as plt
import numpy as np
from fretflow.experiments.facts.experiment import FactsExperiment
from fretflow.experiments.facts.model import worn_test
from fretflow.experiments.facts.quantities import quantity_of
from fretflow.experiments.facts.run import case_of, model_of
from fretflow.experiments.rig.setup import ELEMENTS
from fretflow.experiments.rig.simulation import Hypothesis
from fretflow.pipeline.diagnose import kept_models, reduced_problem
from scipy.stats import norm

FARTHEST = 12.0  # standard deviations that are drawn
file = ff.read_recording("../../examples/paper.toml").file
coarse = case_of(file, ELEMENTS)
rig = model_of(file, reduced_problem(coarse, kept_models(Path("runs"))))
tests = FactsExperiment.of(file, rig).conditions

# %%
# The baseline with the masses and the K_w of `examples/test1.toml`; with a block of 18 kg; with a hundredth of that K_w
# besides; and with effects: springs that stiffen, debris, and faces whose corners stand proud by 4 µm.

effects = ff.catalogue()
hollow = effects["initial-gap"]().changed(tilt_x=0.0, crown=-4e-6)
models = {"10 kg": Hypothesis(), "18 kg": Hypothesis(mass=1.8), "18 kg, K_w / 100": Hypothesis(mass=1.8, wear=0.01)}
for name in ("contact-stiffness-evolution", "third-body"):
    models[f"18 kg, {name}"] = Hypothesis(mass=1.8, effects=(effects[name](),))
models["18 kg, K_w / 10, hollow faces"] = Hypothesis(mass=1.8, wear=0.1, effects=(hollow,))


def distance(fact, test):
    """Return the distance of a fact in standard deviations; nan where a model does not show it."""
    try:
        value = quantity_of(fact, file.cycles_of(fact), test)
    except ff.NonConvergenceError:  # no resonance in the range that is searched
        value = None
    return np.nan if value is None else fact.distance(value)


def distances(hypothesis):
    """Return the distances of all facts (facts,)."""
    shown = {one.key: worn_test(rig, hypothesis, one) for one in tests}
    return np.array([distance(fact, shown[file.condition_of(fact)]) for fact in file.facts])


figure, axes = plt.subplots(figsize=(9, 5), layout="constrained")
rows = np.arange(len(file.facts))[::-1]
band = norm.ppf(0.95)
for row, fact in zip(rows, file.facts, strict=True):  # a bound holds from its end on
    left, right = {1: (0.0, FARTHEST), -1: (-FARTHEST, 0.0), 0: (-band, band)}[fact.side]
    axes.fill_betweenx([row - 0.4, row + 0.4], left, right, color="0.9", linewidth=0)
for k, (label, hypothesis) in enumerate(models.items()):
    axes.plot(np.clip(distances(hypothesis), -FARTHEST, FARTHEST), rows + 0.06 * (2.5 - k), "osDv^P"[k], label=label)
axes.set(yticks=rows, yticklabels=[fact.label for fact in file.facts], xlim=(-1.05 * FARTHEST, 1.05 * FARTHEST),
         xlabel="found, in standard deviations above what the paper states")
figure.legend(loc="outside lower center", ncols=2)
plt.show()
