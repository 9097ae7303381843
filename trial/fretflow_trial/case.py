"""Concealed cases: what is hidden in each, drawn from a seed, and the recording that comes of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.random import Generator, SeedSequence

from fretflow_trial import listed_contact, listed_rig, listed_wear, unlisted
from fretflow_trial.campaign import Outcome, Plan, Test
from fretflow_trial.contact import UnsettledContactError
from fretflow_trial.hidden import CATALOGUE, Draw, Facts, Hidden, decades, even
from fretflow_trial.joint import specimens
from fretflow_trial.physics import Condition, Physics
from fretflow_trial.rig import Rig
from fretflow_trial.signal import Noise, Signal, Slopes, signal_of, slopes

LISTED: Mapping[str, Draw] = {**listed_contact.DRAWS, **listed_wear.DRAWS, **listed_rig.DRAWS}
UNLISTED: Mapping[str, Draw] = unlisted.DRAWS
NOTHING, SINGLE, PAIR, UNKNOWN = "nothing", "single", "pair", "unlisted"
SHARES = {NOTHING: 0.2, UNKNOWN: 0.2, PAIR: 0.2, SINGLE: 0.4}
OTHER_LAW = 0.35  # of the cases
ALL_CHANNELS = 0.75  # of the cases; the others lack normal force and approach
DRIVE_RECORDED = 0.85  # of the cases; in the others nothing tells the phase against the drive
STROKES = (1e-6, 70e-6)  # of the arm, peak to peak
LARGEST_UNREST = 1e-3
MOST_DRAWS = 20
# Effects that replace the same part of the model.
APART = ({"contact-stiffness", "contact-stiffness-evolution"},)
BASIC = ("displacement", "friction_force")
MORE = ("normal_force", "approach")


@dataclass(frozen=True)
class Case:
    """What is set before anything is simulated."""

    kind: str
    hidden: tuple[Hidden, ...]
    physics: Physics  # the baseline's, with its true parameters
    stated_mass: float  # kg, as the recording says
    plan: Plan
    noise: Noise
    channels: tuple[str, ...]
    repeats: int
    seed: SeedSequence  # of the noise
    drive_recorded: bool

    @property
    def seen(self) -> tuple[str, ...]:
        """Return all channels in which an effect may be seen."""
        return (*self.channels, "excitation") if self.drive_recorded else self.channels

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


def compose(cases: int, seed: int) -> list[tuple[str, tuple[str, ...], SeedSequence]]:
    """Return kind, names of what is hidden and seed of every case; names come round before one comes again."""
    sequence = SeedSequence(seed)
    rng = np.random.default_rng(sequence.spawn(1)[0])
    drawn = list(rng.permutation(kinds(cases)))
    singles, pairs, unknowns = (_round(rng, names) for names in (LISTED, LISTED, UNLISTED))
    found = []
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
        found.append((str(kind), names, own))
    return found


def _round(rng: Generator, names: Mapping[str, Draw]) -> Any:
    while True:
        yield from (str(name) for name in rng.permutation(list(names)))


def draw(kind: str, names: Sequence[str], seed: SeedSequence) -> Case:
    """Return a case that hides the effects `names`, everything else drawn from `seed`."""
    world, noise_seed = seed.spawn(2)
    rng = np.random.default_rng(world)
    cycles = int(round(decades(rng, 1.5e5, 6e5), -4))
    main = Condition(float(np.round(even(rng, 56.0, 70.0), 1)), float(np.round(even(rng, 54.0, 66.0), 1)), 100.0)
    stated = float(np.round(even(rng, 10.0, 11.0), 1))
    rig = Rig(block_mass=stated * even(rng, 0.97, 1.03))
    physics = Physics(rig=rig, friction=even(rng, 0.72, 0.92), wear=decades(rng, 0.6e-14, 2.2e-14))
    facts = Facts(cycles, main.amplitude, main.load, rig.hinge)
    hidden = []
    for name in names:
        other = bool(rng.random() < OTHER_LAW)
        hidden.append({**LISTED, **UNLISTED}[name](rng, other, facts))
    channels = BASIC + (MORE if rng.random() < ALL_CHANNELS else ())
    return Case(kind, tuple(hidden), physics, stated, _plan(rng, main, cycles), _noise(rng, main), channels, 3,
                noise_seed, bool(rng.random() < DRIVE_RECORDED))


def _plan(rng: Generator, main: Condition, cycles: int) -> Plan:
    shares = np.array([0.005, 0.03, 0.1, 0.2, 0.33, 0.5, 0.73, 1.0])
    more = rng.choice([0.015, 0.06, 0.15, 0.62, 0.87], size=int(rng.integers(0, 3)), replace=False)
    counts = [0] + [int(round(share * cycles, -2)) for share in sorted([*shares, *more])]
    sweep = (replace(main, amplitude=round(main.amplitude * 0.9, 1)),
             replace(main, amplitude=round(main.amplitude * 1.13, 1)),
             replace(main, amplitude=round(main.amplitude * 1.25, 1)),
             replace(main, load=round(main.load * 0.75, 1)), replace(main, frequency=80.0))
    return Plan(main, tuple(counts), sweep)


def _noise(rng: Generator, main: Condition) -> Noise:
    level = even(rng, 0.01, 0.02)
    sample = {"displacement": level * 12e-6, "friction_force": level * 0.85 * main.load,
              "normal_force": 0.5 * level * main.load, "approach": 0.05e-6,
              "excitation": 0.003 * main.amplitude}
    offset = {"displacement": 0.3e-6, "friction_force": 0.3, "normal_force": 0.1, "approach": 0.03e-6,
              "excitation": 0.001}
    return Noise(sample, 0.004, offset, even(rng, 0.002, 0.004), even(rng, 0.001, 0.003), 0.05e-6, 0.01)


def simulate(kind: str, names: Sequence[str], seed: SeedSequence) -> Simulated:
    """Draw a case and run its test, again if the joint would stick, run wild or not repeat; then see what it shows.

    Raises
    ------
    RuntimeError
        If no draw gives a motion that can be recorded.
    """
    for own in seed.spawn(MOST_DRAWS):
        case = draw(kind, names, own)
        try:
            outcome = Test(specimens(), case.with_effects(), case.plan).run()
        except UnsettledContactError:
            continue
        strokes = [float(np.ptp(loop.arm)) for loop in (*outcome.loops, *outcome.sweep)]
        if STROKES[0] < min(strokes) and max(strokes) < STROKES[1] and outcome.unrest < LARGEST_UNREST:
            return _seen(case, outcome)
    raise RuntimeError(f"{', '.join(names) or 'nothing'}: no motion that repeats in {MOST_DRAWS} draws; take another "
                       "seed")


def _seen(case: Case, outcome: Outcome) -> Simulated:
    """Return the case with what each hidden effect shows beside the others."""
    joint, found, rates = specimens(), {}, None
    for one in case.hidden:
        rest = replace(case, hidden=tuple(other for other in case.hidden if other is not one)).with_effects()
        found[one.id], rates = signal_of(joint, outcome, rest, case.plan, case.noise, case.seen, case.repeats)
    if rates is None:
        rates = slopes(joint, case.physics, case.plan, outcome, case.seen)
    return Simulated(case, outcome, rates, found)


def key(simulated: Simulated) -> dict[str, Any]:
    """Return the answer of a case, in SI."""
    case, physics = simulated.case, simulated.case.physics
    seen = simulated.signals
    return {
        "kind": case.kind,
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
    }
