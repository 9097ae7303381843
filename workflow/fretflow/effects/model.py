"""A model of the fretting rig: the baseline and a set of effects.

The effects are applied in the order of their ids, whatever the order in which they were given.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import InputError
from fretflow.core.records import record
from fretflow.effects.catalogue import check_together
from fretflow.effects.effect import Array, Effect, in_acting_order
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.structure.sensors import Signals, in_sensing_order
from fretflow.wear.cycle import CycleResponse
from fretflow.wear.slow import SlowState


@record
class EffectModel:
    """The unworn problem of the baseline and the effects, sorted by id."""

    baseline: PeriodicProblem
    effects: tuple[Effect, ...] = ()

    @classmethod
    def build(cls, baseline: PeriodicProblem, effects: Iterable[Effect] = ()) -> EffectModel:
        """Return the model of `baseline` and `effects`, in any order.

        Raises
        ------
        ConfigError
            If two of them do not work together.
        """
        chosen = tuple(sorted(effects, key=lambda effect: effect.id))
        check_together(chosen)
        return cls(baseline=baseline, effects=chosen)

    def problem(self, slow: SlowState) -> PeriodicProblem:
        """Return the problem of a period of the joint worn and changed as `slow` says."""
        face = self.baseline.interface
        problem = self.baseline
        if np.any(slow.depth):
            problem = replace(problem, interface=replace(face, gap=face.gap + slow.depth))
        for effect in in_acting_order(self.effects):
            try:
                problem = effect.period(problem, slow)
            except InputError as error:
                raise InputError(f"effects.{effect.id}: {error}") from error
        return problem

    def initial(self) -> SlowState:
        """Return the joint at the start of the test."""
        face, memory = self.baseline.interface, dict[str, Array]()
        for effect in self.effects:
            memory.update(effect.initial_memory(face))
        return replace(SlowState.unworn(face.size), memory=memory)

    def evolve(self, before: SlowState, cycles: float, worn: NDArray[np.float64], energy: float,
               response: CycleResponse) -> SlowState:
        """Return the joint after a jump; see `Effect.evolve`."""
        memory = dict(before.memory)
        for effect in self.effects:
            memory.update(effect.evolve(before, cycles, worn, energy, response))
        return SlowState(cycles=before.cycles + cycles, depth=before.depth + worn, energy=before.energy + energy,
                         memory=memory)

    @property
    def over_cycles(self) -> bool:
        """Tell whether a period follows cycles, energy or memory."""
        return any(effect.over_cycles for effect in self.effects)

    def wear_factor(self, response: CycleResponse, slow: SlowState) -> Array:
        """Return the factor on the wear rate (nodes,)."""
        factor = np.ones(self.baseline.interface.size)
        for effect in self.effects:
            factor = factor * effect.wear_factor(response, slow, self.baseline)
        return factor

    def opening_share(self, slow: SlowState, cycles: float) -> Array:
        """Return the share of a jump's wear that opens the gap (nodes,)."""
        share = np.ones(self.baseline.interface.size)
        for effect in self.effects:
            share = share * effect.opening_share(slow, cycles)
        return share

    def sense(self, signals: Signals) -> Signals:
        """Return what the sensors show of `signals`."""
        for effect in in_sensing_order(self.effects):
            signals = effect.sense(signals)
        return signals
