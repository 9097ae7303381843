"""What a concealed recording may hide: an effect, how large it is and where it acts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from fretflow_trial.joint import Joint, specimens
from fretflow_trial.physics import Channels, Physics

Array = NDArray[np.float64]

CATALOGUE = "catalogue"  # the law is the one that the tested program has


@dataclass(frozen=True)
class Facts:
    """What is set before an effect is drawn."""

    cycles: int  # length of the test
    amplitude: float  # N
    load: float  # N
    hinge: float  # N/m
    joint: Joint = field(default_factory=specimens)


@dataclass(frozen=True)
class Hidden:
    """One effect as it acts in one recording."""

    id: str
    listed: bool  # whether the tested program's catalogue has it
    law: str  # CATALOGUE, or the form that it has instead
    blocks: tuple[str, ...]  # that are right as its location
    parameters: Mapping[str, float]  # SI, by the catalogue's names where the law is the catalogue's
    apply: Callable[[Physics], Physics]
    stage: int = 0  # of sensors, on the way from the joint to the recorder
    cycles: tuple[float, float] | None = None  # where it changes something, if not everywhere alike


Draw = Callable[[Generator, bool, Facts], Hidden]


def form(rng: Generator, other: bool, *forms: str) -> str:
    """Return the catalogue's law, or one of the `forms` of the same physics that the literature has beside it."""
    return str(rng.choice(forms)) if other else CATALOGUE


def even(rng: Generator, low: float, high: float) -> float:
    """Return a number drawn evenly."""
    return float(rng.uniform(low, high))


def decades(rng: Generator, low: float, high: float) -> float:
    """Return a number whose logarithm is drawn evenly."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def either(rng: Generator, value: float) -> float:
    """Return `value` with a drawn sign."""
    return float(value * rng.choice((-1.0, 1.0)))


def spectral(channels: Channels, values: Array, response: Callable[[Array], NDArray[np.complex128]]) -> Array:
    """Return a channel after a filter with the complex `response` at angular frequencies (rad/s)."""
    count = len(values)
    omega = 2.0 * np.pi * channels.frequency * np.arange(count // 2 + 1)
    spectrum = np.fft.rfft(values) * response(omega)
    if count % 2 == 0:
        spectrum[-1] = spectrum[-1].real
    return np.fft.irfft(spectrum, count)
