"""A drive that is no pure cosine."""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np

from fretflow.effects.effect import Block, Effect, Sketch, parameter
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.wear.slow import SlowState


class ExcitationDistortion(Effect):
    """Harmonics of the shaker's force, and what its fundamental is off by, over what it is set to.

    The second is that of a drive with two unlike sides; the third and fifth are those of one that saturates.
    """

    id = "excitation-distortion"
    title = "a drive that is not the cosine it is set to"
    block = Block.EXCITATION
    equation = "F ((1 + a_1) cos wt + d(t)); d = sum of a_k cos(k wt + b_k), k = 2, 3, 5"
    formula = (r"F \left[(1 + a_1) \cos\omega t + a_2 \cos(2 \omega t + b_2) "
               r"+ a_3 \cos(3 \omega t + b_3) + a_5 \cos(5 \omega t + b_5)\right]")
    source = "G. R. Tomlinson, J. Sound Vib. 63 (1979), force distortion of electrodynamic exciters"
    told_by = "a record of the excitation force"
    told_from: ClassVar[Mapping[str, str]] = {
        "support-nonlinearity": "the excitation force itself, at several amplitudes,"}
    observables = ("harmonics of the excitation channel", "harmonics of the displacement")

    second: float = parameter(0.05, "a_2: second harmonic", 0.01, 0.25, ge=0.0, neutral=0.0)
    second_phase: float = parameter(0.0, "b_2: its phase in rad", -math.pi, math.pi, periodic=True)
    third: float = parameter(0.05, "a_3: third harmonic", 0.01, 0.25, ge=0.0, neutral=0.0)
    third_phase: float = parameter(0.0, "b_3: its phase in rad", -math.pi, math.pi, periodic=True)
    fifth: float = parameter(0.0, "a_5: fifth harmonic", 0.003, 0.1, ge=0.0, neutral=0.0)
    fifth_phase: float = parameter(0.0, "b_5: its phase in rad", -math.pi, math.pi, periodic=True)
    fundamental: float = parameter(0.0, "a_1: what an amplifier that saturates adds to the fundamental", -0.1, 0.1,
                                   gt=-1.0, logarithmic=False, neutral=0.0)

    def period(self, problem: PeriodicProblem, slow: SlowState) -> PeriodicProblem:
        """Add the harmonics."""
        drive = problem.excitation
        for order, share in self._shares().items():
            drive = drive.with_overtone(order, share) if share else drive
        return replace(problem, excitation=drive)

    def _shares(self) -> dict[int, complex]:
        """Return what is added at each harmonic, over what the drive is set to."""
        return {1: complex(self.fundamental), 2: cmath.rect(self.second, self.second_phase),
                3: cmath.rect(self.third, self.third_phase), 5: cmath.rect(self.fifth, self.fifth_phase)}

    def sketch(self) -> Sketch:
        """Return the force over a period."""
        t = np.linspace(0.0, 2.0 * np.pi, 201)
        pure = np.cos(t)
        force = pure + sum(np.real(share * np.exp(1j * order * t)) for order, share in self._shares().items())
        return Sketch("share of the period", "force over F", {"baseline": (t / (2.0 * np.pi), pure),
                                                               "effect": (t / (2.0 * np.pi), force)})
