"""Effects of friction and of the load that the catalogue has, with laws of their own where `other` asks for one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from fretflow_trial.hidden import CATALOGUE, Draw, Facts, Hidden, decades, either, even
from fretflow_trial.joint import CONTACT_AREA, specimens
from fretflow_trial.physics import Instant, Physics, Slow

Array = NDArray[np.float64]

REFERENCE_PRESSURE = 60e6


def friction_run_in(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw mu from mu_0 to mu_inf with the dissipated energy; otherwise with cycles."""
    initial, final, energy = even(rng, 0.2, 0.5), even(rng, 0.6, 0.9), decades(rng, 5.0, 150.0)
    cycles = decades(rng, 0.03, 0.4) * facts.cycles

    def friction(slow: Slow) -> float:
        passed = slow.cycles / cycles if other else slow.energy / energy
        return final - (final - initial) * float(np.exp(-passed))

    def apply(physics: Physics) -> Physics:
        return replace(physics, friction=1.0, friction_over_test=(*physics.friction_over_test, friction))

    scale = {"cycles": cycles} if other else {"energy": energy}
    return Hidden("friction-run-in", True, "with cycles instead of energy" if other else CATALOGUE, ("contact",),
                  {"initial": initial, "final": final, **scale}, apply)


def contact_stiffness(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw asperity springs k (p / p_0)^m; otherwise 2 k p / (p + p_0), which saturates."""
    springs, parameters = _springs(rng, other, lambda slow: 1.0)
    return Hidden("contact-stiffness", True, "saturates with pressure" if other else CATALOGUE, ("contact",),
                  parameters, springs)


def contact_stiffness_evolution(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw those springs, stiffer with the dissipated energy; otherwise with the logarithm of cycles."""
    gain, energy = decades(rng, 0.5, 4.0), decades(rng, 5.0, 150.0)

    def growth(slow: Slow) -> float:
        if other:
            return 1.0 + gain * float(np.log1p(slow.cycles / 1e3) / np.log1p(facts.cycles / 1e3))
        return 1.0 + gain * float(1.0 - np.exp(-slow.energy / energy))

    springs, parameters = _springs(rng, False, growth)
    scale = {} if other else {"energy": energy}
    return Hidden("contact-stiffness-evolution", True, "with the logarithm of cycles" if other else CATALOGUE,
                  ("contact",), {**parameters, "gain": gain, **scale}, springs)


def _springs(rng: Generator, saturates: bool, growth: Callable[[Slow], float]
             ) -> tuple[Callable[[Physics], Physics], dict[str, float]]:
    """Return springs that follow each node's mean pressure; normal ones as secants of their curve."""
    stiffness, exponent, ratio = decades(rng, 15e6, 150e6), even(rng, 0.5, 0.95), even(rng, 1.0, 2.0)

    def springs(slow: Slow, pressure: Array) -> tuple[Array, Array]:
        share = np.maximum(pressure / REFERENCE_PRESSURE, 0.01)
        shape = 2.0 * share / (1.0 + share) if saturates else share**exponent
        sliding = stiffness / CONTACT_AREA * growth(slow) * shape
        return sliding, ratio * sliding * (0.5 if saturates else 1.0 - exponent)

    parameters = {"stiffness": stiffness} if saturates else {
        "stiffness": stiffness, "exponent": exponent, "ratio": ratio, "reference_pressure": REFERENCE_PRESSURE}
    return lambda physics: replace(physics, springs=springs), parameters


def velocity_dependent_friction(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw mu (1 + a exp(-|v| / v_s)); otherwise a rational or a Gaussian fall with the speed of the block."""
    strength, scale = even(rng, 0.05, 0.5), decades(rng, 0.5e-3, 8e-3)
    gaussian = bool(rng.random() < 0.5)

    def factor(instant: Instant) -> float:
        speed = abs(instant.block_velocity) / scale
        if not other:
            return float(1.0 + strength * np.exp(-speed))
        return float(1.0 + strength * (np.exp(-speed**2) if gaussian else 1.0 / (1.0 + speed**2)))

    law = CATALOGUE if not other else "Gaussian" if gaussian else "rational"
    return Hidden("velocity-dependent-friction", True, law, ("contact",),
                  {"strength": strength, "speed_scale": scale}, _at_instant(factor))


def load_dependent_friction(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw mu (p / p_0)^-b at each node; otherwise mu (1 - c ln(1 + p / p_0)), at p_0 as steep."""
    exponent = even(rng, 0.06, 0.33)

    def factor(instant: Instant) -> Array:
        share = np.maximum(instant.pressure / REFERENCE_PRESSURE, 1e-3)
        if other:
            return np.asarray(np.maximum(1.0 - 2.0 * exponent * np.log(0.5 * (1.0 + share)), 0.05))
        return np.asarray(share**-exponent)

    return Hidden("load-dependent-friction", True, "logarithm of the pressure" if other else CATALOGUE, ("contact",),
                  {"exponent": exponent, "reference_pressure": REFERENCE_PRESSURE}, _at_instant(factor))


def directional_friction(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw mu (1 + d) one way and mu (1 - d) the other."""
    difference = either(rng, even(rng, 0.01, 0.1))

    def over(instant: Instant) -> Array:
        return np.asarray(1.0 + difference * np.sign(instant.friction))

    return Hidden("directional-friction", True, CATALOGUE, ("contact",), {"difference": difference}, _at_instant(over))


def distributed_micro_slip(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw friction that differs from node to node as 1 - w + w (1 + b) q^b; otherwise log-normal."""
    joint = specimens()
    spread, power = even(rng, 0.2, 1.0), decades(rng, 0.5, 4.0)
    quantile = (rng.permutation(joint.size) + 0.5) / joint.size
    factors = 1.0 - spread + spread * (1.0 + power) * quantile**power
    if other:
        factors = np.exp(spread * rng.standard_normal(joint.size))
    factors = factors / (factors @ joint.share)
    return Hidden("distributed-micro-slip", True, "log-normal" if other else CATALOGUE, ("contact",),
                  {"spread": spread} if other else {"spread": spread, "power": power},
                  lambda physics: replace(physics, friction_of_node=factors))


def normal_load_coupling(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw N_0 + s x; otherwise N_0 + s x + s_2 x^2, a curved guide."""
    slope = either(rng, decades(rng, 0.05e6, 1.5e6))
    curve = 0.3 * slope / 10e-6 if other else 0.0

    def beside(load: float, turns: float, arm: float) -> float:
        return slope * arm + curve * arm**2

    return Hidden("normal-load-coupling", True, "curved guide" if other else CATALOGUE, ("contact",), {"slope": slope},
                  lambda physics: replace(physics, load_at_instant=(*physics.load_at_instant, beside)))


def normal_load_drift(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw N_0 (1 - a (1 - exp(-n / n_T))); otherwise linear in the cycles."""
    loss, settling = even(rng, 0.04, 0.3), decades(rng, 1e4, 1.5e5)

    def share(slow: Slow) -> float:
        return 1.0 - loss * (slow.elapsed if other else float(1.0 - np.exp(-slow.cycles / settling)))

    return Hidden("normal-load-drift", True, "linear" if other else CATALOGUE, ("contact", "rig"),
                  {"loss": loss} if other else {"loss": loss, "settling": settling},
                  lambda physics: replace(physics, load_over_test=(*physics.load_over_test, share)))


def _at_instant(factor: Callable[[Instant], float | Array]) -> Callable[[Physics], Physics]:
    return lambda physics: replace(physics, friction_at_instant=(*physics.friction_at_instant, factor))


DRAWS: dict[str, Draw] = {
    "friction-run-in": friction_run_in,
    "contact-stiffness": contact_stiffness,
    "contact-stiffness-evolution": contact_stiffness_evolution,
    "velocity-dependent-friction": velocity_dependent_friction,
    "load-dependent-friction": load_dependent_friction,
    "directional-friction": directional_friction,
    "distributed-micro-slip": distributed_micro_slip,
    "normal-load-coupling": normal_load_coupling,
    "normal-load-drift": normal_load_drift,
}
