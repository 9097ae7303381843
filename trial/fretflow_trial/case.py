"""Concealed cases: what is hidden in each, drawn from a seed, and the recording that comes of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.random import Generator, SeedSequence

from fretflow_trial import listed_contact, listed_rig, listed_wear, unlisted
from fretflow_trial.campaign import Outcome, Test
from fretflow_trial.contact import UnsettledContactError
from fretflow_trial.hidden import CATALOGUE, Draw, Facts, Hidden
from fretflow_trial.physics import Channels, Physics
from fretflow_trial.signal import Signal, Slopes, signal_of, slopes
from fretflow_trial.world import WORLDS, Setting, drawn, standing

LISTED: Mapping[str, Draw] = {**listed_contact.DRAWS, **listed_wear.DRAWS, **listed_rig.DRAWS}
UNLISTED: Mapping[str, Draw] = unlisted.DRAWS
NOTHING, SINGLE, PAIR, UNKNOWN = "nothing", "single", "pair", "unlisted"
SHARES = {NOTHING: 0.2, UNKNOWN: 0.2, PAIR: 0.2, SINGLE: 0.4}
STROKES = (1e-6, 70e-6)  # of the arm, peak to peak
MOST_DRAWS = 20
# Effects that replace the same part of the model.
APART = ({"contact-stiffness", "contact-stiffness-evolution"},)


@dataclass(frozen=True)
class Case(Setting):
    """What is set before anything is simulated."""

    kind: str
    world: int
    hidden: tuple[Hidden, ...]
    seed: SeedSequence  # of the noise

    @property
    def seen(self) -> tuple[str, ...]:
        """Return all channels in which an effect may be seen."""
        return (*self.channels, "excitation") if self.drive_recorded else self.channels

    def recordable(self, loop: Channels) -> bool:
        """Return whether the joint slides, and no further than the sensors reach."""
        slip, stroke = float(np.ptp(loop.displacement)), float(np.ptp(loop.arm))
        return slip > self.least_slip and STROKES[0] < stroke < STROKES[1]

    def with_effects(self) -> Physics:
        """Return the physics with what is hidden."""
        physics = self.physics
        for one in sorted(self.hidden, key=lambda one: one.stage):
            physics = one.apply(physics)
        return physics


@dataclass(frozen=True)
class Simulated:
    """A case, what ideal sensors show of it, and how much of what is hidden can be seen."""

    case: Case
    outcome: Outcome
    rates: Slopes  # of the case without (one of) what is hidden
    signals: Mapping[str, Signal]  # by effect; of a pair, what each adds to the other


def kinds(cases: int) -> list[str]:
    """Return the kind of each of `cases` cases, in the shares of the composition, not shuffled."""
    whole = {kind: share * cases for kind, share in SHARES.items()}
    counts = {kind: int(value) for kind, value in whole.items()}
    for kind in sorted(whole, key=lambda kind: counts[kind] - whole[kind])[:cases - sum(counts.values())]:
        counts[kind] += 1
    return [kind for kind in SHARES for _ in range(counts[kind])]


def compose(cases: int, seed: int, world: int | None = None) -> list[tuple[str, tuple[str, ...], SeedSequence, int]]:
    """Return kind, names of what is hidden, seed and world of every case.

    Names come round before one comes again, and so do the worlds unless all cases are in `world`.
    """
    sequence = SeedSequence(seed)
    rng = np.random.default_rng(sequence.spawn(1)[0])
    drawn = list(rng.permutation(kinds(cases)))
    singles, pairs, unknowns = (_round(rng, list(names)) for names in (LISTED, LISTED, UNLISTED))
    worlds = {kind: _round(rng, list(WORLDS) if world is None else [world]) for kind in SHARES}
    composed = []
    for kind, own in zip(drawn, sequence.spawn(cases), strict=True):
        names: tuple[str, ...] = ()
        if kind == SINGLE:
            names = (next(singles),)
        elif kind == UNKNOWN:
            names = (next(unknowns),)
        elif kind == PAIR:
            first = second = next(pairs)
            while second == first or any({first, second} == one for one in APART):
                second = next(pairs)
            names = tuple(sorted((first, second)))
        composed.append((str(kind), names, own, next(worlds[kind])))
    return composed


def _round(rng: Generator, members: Sequence[Any]) -> Iterator[Any]:
    while True:
        yield from (members[k] for k in rng.permutation(len(members)))


def draw(kind: str, names: Sequence[str], seed: SeedSequence, world: int = 1) -> Case:
    """Return a case that hides the effects `names` in a world, everything else drawn from `seed`."""
    own, noise_seed = seed.spawn(2)
    rng = np.random.default_rng(own)
    setting = drawn(rng) if WORLDS[world].anew else standing(rng)
    main = setting.plan.main
    facts = Facts(setting.plan.cycles[-1], main.amplitude, main.load, setting.physics.rig.hinge, setting.joint)
    hidden = tuple({**LISTED, **UNLISTED}[name](rng, WORLDS[world].other_laws, facts) for name in names)
    return Case(**vars(setting), kind=kind, world=world, hidden=hidden, seed=noise_seed)


def simulate(kind: str, names: Sequence[str], seed: SeedSequence, world: int = 1, least: float = 0.0) -> Simulated:
    """Draw a case and run its test; then see what it shows.

    It is drawn again if the joint would stick, run wild or not repeat, or if an effect's signal-to-noise is under
    `least`.

    Raises
    ------
    RuntimeError
        If no draw gives a motion that can be recorded, and shows enough.
    """
    weak = 0
    for own in seed.spawn(MOST_DRAWS):
        case = draw(kind, names, own, world)
        try:
            simulated = _seen(case, Test(case.joint, case.with_effects(), case.plan).run(case.recordable))
        except UnsettledContactError:
            continue
        if all(one.rms >= least for one in simulated.signals.values()):
            return simulated
        weak += 1
    raise RuntimeError(f"{', '.join(names) or 'nothing'}: of {MOST_DRAWS} draws {MOST_DRAWS - weak} have no motion "
                       f"that repeats, and {weak} show less than {least:g} times the noise; take another seed")


def _seen(case: Case, outcome: Outcome) -> Simulated:
    """Return the case with what each hidden effect shows beside the others."""
    joint, signals, rates = case.joint, {}, None
    for one in case.hidden:
        rest = replace(case, hidden=tuple(other for other in case.hidden if other is not one)).with_effects()
        signals[one.id], rates = signal_of(joint, outcome, rest, case.plan, case.noise, case.seen, case.repeats)
    if rates is None:
        rates = slopes(joint, case.physics, case.plan, outcome, case.seen)
    return Simulated(case, outcome, rates, signals)


def key(simulated: Simulated) -> dict[str, Any]:
    """Return the answer of a case, in SI."""
    case, physics = simulated.case, simulated.case.physics
    seen = simulated.signals
    return {
        "kind": case.kind,
        "world": case.world,
        "effects": [one.id for one in case.hidden if one.listed],
        "hidden": [{"id": one.id, "listed": one.listed, "law": one.law, "blocks": list(one.blocks),
                    "parameters": {name: float(value) for name, value in one.parameters.items()},
                    "cycles": None if one.cycles is None else list(one.cycles),
                    "signal_to_noise": seen[one.id].rms, "total_signal_to_noise": seen[one.id].total,
                    "absorbed": seen[one.id].absorbed, "by_channel": dict(seen[one.id].by_channel)}
                   for one in case.hidden],
        "catalogue_laws": all(one.listed and one.law == CATALOGUE for one in case.hidden),
        "baseline": {"friction_coefficient": physics.friction, "wear_coefficient": physics.wear,
                     "moving_mass": physics.rig.block_mass, "stated_moving_mass": case.stated_mass},
        "channels": list(case.channels), "drive_recorded": case.drive_recorded, "cycle_counts": list(case.plan.cycles),
        "noise": {name: case.noise.sample[name] for name in case.channels},
        "made_by": {"nodes": case.joint.size, "integrator": case.plan.scheme.method, "steps": case.plan.steps,
                    "asperities": physics.rigid, "youngs_modulus": case.joint.specimen.youngs_modulus},
    }
