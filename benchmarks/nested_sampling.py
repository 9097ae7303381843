"""The evidence of hypotheses, linear about their fits, against nested sampling of the whole of their ranges.

Usage: ``python benchmarks/nested_sampling.py RECORDING [EFFECT+EFFECT ...]``, of a joint that a measured motion drives;
without effects, of the baseline and the most probable sets. Needs ``pip install dynesty``, takes minutes a set. What
the discrepancies may be is that of the fit in both, averaged over their sizes; linear is what the parameters do alone.
J. S. Speagle, Mon. Not. R. Astron. Soc. 493 (2020) 3132-3158.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import dynesty
import numpy as np
from fretflow.core.errors import NonConvergenceError
from fretflow.experiments.driven.data import driven_data
from fretflow.experiments.driven.run import searched
from fretflow.inference.experiment import Point
from fretflow.inference.search import Names, Search
from fretflow.recordings.kinds import read_recording
from scipy.stats import norm

LIVE = 100
MOST = 3  # sets, the most probable


def sampled(search: Search, names: Names) -> tuple[float, float]:
    """Return the log evidence of a fitted set by nested sampling, and its error."""
    fit, prior = search.fits[names], search.prior(names)
    formed, chance = (search.formed(names) if names else None), search.by_chance(names)
    blind = replace(fit, jacobian=np.zeros_like(fit.jacobian))

    def log_density(z: np.ndarray) -> float:
        try:
            prediction = search.fitter.experiment.predict(Point(fit.parameters, z), fit.prediction)
        except NonConvergenceError:
            return -1e300
        return search.discrepancy.evidence(replace(blind, prediction=prediction), formed, chance).averaged(prior)

    sampler = dynesty.NestedSampler(log_density, norm.ppf, len(fit.z), nlive=LIVE, sample="rslice",
                                    rstate=np.random.default_rng(0))
    sampler.run_nested(dlogz=0.1, print_progress=False)
    cost = sum(search.experiment.choice(name) for name in names)  # of the laws that effects chose among
    return float(sampler.results.logz[-1]) - cost, float(sampler.results.logzerr[-1])


def main(recording: str, *sets: str) -> None:
    """Print both for the sets."""
    search = searched(driven_data(read_recording(Path(recording))), True, lambda share, text: None)
    asked = [frozenset(one.split("+")) for one in sets] or [
        frozenset(), *sorted(search.fits, key=lambda names: -search.log_evidence(names))[:MOST]]
    print("| set | parameters | linear | nested sampling | error |\n|---|---|---|---|---|")
    for names in dict.fromkeys(asked):
        value, error = sampled(search, names)
        print(f"| {' + '.join(sorted(names)) or 'none'} | {len(search.fits[names].z)} | "
              f"{search.log_evidence(names):.2f} | {value:.2f} | {error:.2f} |", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
