"""Effects of friction and of the load that the catalogue has, with laws of their own where `other` asks for one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from fretflow_trial.hidden import CATALOGUE, Draw, Facts, Hidden, decades, either, even, form
from fretflow_trial.physics import Instant, Physics, Slow

Array = NDArray[np.float64]

REFERENCE_PRESSURE = 60e6


def friction_run_in(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw mu from mu_0 to mu_inf as exp(-E / E_0); otherwise by another law, or over cycles."""
    initial, final, energy = even(rng, 0.2, 0.5), even(rng, 0.6, 0.9), decades(rng, 5.0, 150.0)
    cycles = decades(rng, 0.03, 0.4) * facts.cycles
    law = form(rng, other, "exponential of cycles", "rational in energy", "rational in cycles", "tanh of cycles")
    by_cycles = law.endswith("cycles")

    def friction(slow: Slow) -> float:
        passed = slow.cycles / cycles if by_cycles else slow.energy / energy
        left = np.exp(-passed)
        if other and "exponential" not in law:
            left = 1.0 - np.tanh(passed) if "tanh" in law else 1.0 / (1.0 + passed)
        return final - (final - initial) * float(left)

    def apply(physics: Physics) -> Physics:
        return replace(physics, friction=1.0, friction_over_test=(*physics.friction_over_test, friction))

    scale = {"cycles": cycles} if by_cycles else {"energy": energy}
    return Hidden("friction-run-in", True, law, ("contact",),
                  {"initial": initial, "final": final, **scale}, apply)


def contact_stiffness(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw asperity springs k (p / p_0)^m; otherwise 2 k p / (p + p_0), which saturates, or k whatever the pressure."""
    law = form(rng, other, "saturates with pressure", "the same at all pressures")
    springs, parameters = _springs(rng, facts, law, lambda slow: 1.0)
    return Hidden("contact-stiffness", True, law, ("contact",), parameters, springs)


def contact_stiffness_evolution(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw those springs, stiffer with the dissipated energy; otherwise with cycles, by a logarithm or rationally."""
    gain, energy = decades(rng, 0.5, 4.0), decades(rng, 5.0, 150.0)

    cycles = decades(rng, 0.03, 0.4) * facts.cycles
    law = form(rng, other, "with the logarithm of cycles", "rational in cycles")

    def growth(slow: Slow) -> float:
        if "logarithm" in law:
            return 1.0 + gain * float(np.log1p(slow.cycles / 1e3) / np.log1p(facts.cycles / 1e3))
        reached = slow.cycles / (slow.cycles + cycles) if other else 1.0 - np.exp(-slow.energy / energy)
        return 1.0 + gain * float(reached)

    springs, parameters = _springs(rng, facts, CATALOGUE, growth)
    scale = {"gain": gain} if other else {"gain": gain, "energy": energy}
    return Hidden("contact-stiffness-evolution", True, law, ("contact",), {**parameters, **scale}, springs)


def _springs(rng: Generator, facts: Facts, law: str, growth: Callable[[Slow], float]
             ) -> tuple[Callable[[Physics], Physics], dict[str, float]]:
    """Return springs that follow each node's mean pressure; normal ones as secants of their curve."""
    stiffness, exponent, ratio = decades(rng, 15e6, 150e6), even(rng, 0.5, 0.95), even(rng, 1.0, 2.0)
    saturates, follows = law.startswith("saturates"), law == CATALOGUE
    area = float(facts.joint.areas.sum())

    def springs(slow: Slow, pressure: Array) -> tuple[Array, Array]:
        share = np.maximum(pressure / REFERENCE_PRESSURE, 0.01)
        shape = 2.0 * share / (1.0 + share) if saturates else share**exponent if follows else np.ones_like(share)
        sliding = stiffness / area * growth(slow) * shape
        return sliding, ratio * sliding * (0.5 if saturates else 1.0 - exponent if follows else 1.0)

    parameters = {"stiffness": stiffness} if not follows else {
        "stiffness": stiffness, "exponent": exponent, "ratio": ratio, "reference_pressure": REFERENCE_PRESSURE}
    return lambda physics: replace(physics, springs=springs), parameters


def velocity_dependent_friction(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw mu (1 + a exp(-|v| / v_s)), v the block's; otherwise a fall of another form."""
    strength, scale = even(rng, 0.05, 0.5), decades(rng, 0.5e-3, 8e-3)
    law = form(rng, other, "Gaussian", "rational", "linear fall", "exponential of the root")

    def factor(instant: Instant) -> float:
        speed = abs(instant.block_velocity) / scale
        fall = {CATALOGUE: np.exp(-speed), "Gaussian": np.exp(-speed**2), "rational": 1.0 / (1.0 + speed**2),
                "linear fall": max(1.0 - 0.5 * speed, 0.0), "exponential of the root": np.exp(-np.sqrt(speed))}[law]
        return float(1.0 + strength * fall)

    return Hidden("velocity-dependent-friction", True, law, ("contact",),
                  {"strength": strength, "speed_scale": scale}, _at_instant(factor))


def load_dependent_friction(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw mu (p / p_0)^-b at each node; otherwise by a logarithm, rationally, or with Hertz's power 1/3 of a share."""
    exponent = even(rng, 0.06, 0.33)
    law = form(rng, other, "logarithm of the pressure", "rational in the pressure", "Hertzian and a constant")

    def factor(instant: Instant) -> Array:
        share = np.maximum(instant.pressure / REFERENCE_PRESSURE, 1e-3)
        if law == CATALOGUE:
            return np.asarray(share**-exponent)
        if law.startswith("logarithm"):  # all as steep at p_0
            return np.asarray(np.maximum(1.0 - 2.0 * exponent * np.log(0.5 * (1.0 + share)), 0.05))
        if law.startswith("rational"):
            return np.asarray(1.0 / (1.0 + exponent * (share - 1.0)))
        return np.asarray(1.0 + 3.0 * exponent * (share**(-1.0 / 3.0) - 1.0))

    return Hidden("load-dependent-friction", True, law, ("contact",),
                  {"exponent": exponent, "reference_pressure": REFERENCE_PRESSURE}, _at_instant(factor))


def directional_friction(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw mu (1 + d) one way and mu (1 - d) the other; otherwise smoothly with the speed of the block."""
    difference, speed = either(rng, even(rng, 0.01, 0.2 if other else 0.1)), decades(rng, 0.2e-3, 2e-3)
    law = form(rng, other, "smooth in the speed")

    def over(instant: Instant) -> float | Array:
        if other:
            return float(1.0 + difference * np.tanh(instant.block_velocity / speed))
        return np.asarray(1.0 + difference * np.sign(instant.friction))

    return Hidden("directional-friction", True, law, ("contact",), {"difference": difference}, _at_instant(over))


def distributed_micro_slip(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw friction that differs by node as 1 - w + w (1 + b) q^b; otherwise log-normal, Weibull or of two kinds."""
    joint = facts.joint
    spread, power = even(rng, 0.2, 1.0), decades(rng, 0.5, 4.0)
    quantile = (rng.permutation(joint.size) + 0.5) / joint.size
    factors = 1.0 - spread + spread * (1.0 + power) * quantile**power
    law = form(rng, other, "log-normal", "Weibull", "two kinds of places")
    if law == "log-normal":
        factors = np.exp(spread * rng.standard_normal(joint.size))
    elif law == "Weibull":
        factors = rng.weibull(1.0 / spread, joint.size)
    elif other:
        factors = np.where(quantile < even(rng, 0.3, 0.7), 1.0 - 0.9 * spread, 1.0)
    factors = factors / (factors @ joint.share)
    return Hidden("distributed-micro-slip", True, law, ("contact",),
                  {"spread": spread} if other else {"spread": spread, "power": power},
                  lambda physics: replace(physics, friction_of_node=factors))


def normal_load_coupling(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw N_0 + s x; otherwise a curved guide, s x + s_2 x^2, or one that yields, s x_0 tanh(x / x_0)."""
    slope = either(rng, decades(rng, 0.05e6, 1.5e6))
    law = form(rng, other, "curved guide", "yielding guide")

    def beside(load: float, turns: float, arm: float) -> float:
        if law == "yielding guide":
            return float(slope * 10e-6 * np.tanh(arm / 10e-6))
        return slope * arm + (0.3 * slope * arm**2 / 10e-6 if other else 0.0)

    return Hidden("normal-load-coupling", True, law, ("contact",), {"slope": slope},
                  lambda physics: replace(physics, load_at_instant=(*physics.load_at_instant, beside)))


def normal_load_drift(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw N_0 (1 - a (1 - exp(-n / n_T))); otherwise linear or rational in the cycles, or with their logarithm."""
    loss, settling = even(rng, 0.04, 0.3), decades(rng, 1e4, 1.5e5)

    law = form(rng, other, "linear", "rational", "logarithm")

    def share(slow: Slow) -> float:
        settled = {CATALOGUE: 1.0 - np.exp(-slow.cycles / settling), "linear": slow.elapsed,
                   "rational": slow.cycles / (slow.cycles + settling),
                   "logarithm": np.log1p(slow.cycles / settling) / np.log1p(facts.cycles / settling)}[law]
        return 1.0 - loss * float(settled)

    return Hidden("normal-load-drift", True, law, ("contact", "rig"),
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
