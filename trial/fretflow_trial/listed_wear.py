"""Effects of wear and of the faces' shape that the catalogue has, with laws of their own where `other` asks for one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from fretflow_trial.hidden import CATALOGUE, Draw, Facts, Hidden, decades, either, even, form
from fretflow_trial.physics import Channels, Layer, Slow, Worn

Array = NDArray[np.float64]

REFERENCE_PRESSURE, REFERENCE_PATH, REFERENCE_FREQUENCY = 60e6, 25e-6, 100.0
TYPICAL_POWER = 130e3  # W/m^2


def third_body(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw debris that closes the gap, slows wear and leaves soonest at the edges; otherwise alike everywhere."""
    retained, scale, residence = even(rng, 0.3, 0.95), decades(rng, 0.5e-6, 5e-6), decades(rng, 1e3, 1e6)
    edge = decades(rng, 0.02, 0.5)

    def layer(nodes: Array) -> Layer:
        inside = np.ones(len(nodes)) if other else edge + (1.0 - edge) * (1.0 - (nodes[:, 0] / facts.joint.half)**2)
        return Layer(retained, residence * inside,
                     lambda thickness: 1.0 / (1.0 + thickness / scale) if other else np.exp(-thickness / scale))

    parameters = {"retained_fraction": retained, "separating_thickness": scale, "residence": residence}
    return Hidden("third-body", True, "leaves alike everywhere, wear falls as 1 / (1 + h_d / h_0)" if other
                  else CATALOGUE, ("wear",), parameters if other else {**parameters, "edge_residence": edge},
                  lambda physics: replace(physics, layer=layer))


def scar_edge(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw ends of the stroke that harden with the square of the way into them; otherwise with another power.

    Beyond the end of the scar the force stays. A third form is a cubic spring that stiffens with the depth. The
    specimens exchange the force, so that it is measured with friction.
    """
    peak, width, scale = decades(rng, 3.0, 25.0), even(rng, 0.1, 0.6), decades(rng, 0.2e-6, 5e-6)
    law = form(rng, other, "cube", "linear", "cubic spring")
    share, power = facts.joint.share, {"cube": 3, "linear": 1}.get(law, 2)

    def edges(arm: Array, slow: Slow) -> Array:
        if slow.scar <= 0.0:
            return np.zeros_like(arm)
        if law == "cubic spring":
            return np.asarray(-peak * float(share @ slow.depth) / scale * (arm / slow.scar)**3)
        into = np.clip((np.abs(arm) / slow.scar - (1.0 - width)) / width, 0.0, 1.0)
        return np.asarray(-np.sign(arm) * peak * -np.expm1(-float(share @ slow.depth) / scale) * into**power)

    def force(rig: Array, slow: Slow) -> tuple[float, float]:
        return 0.0, float(edges(rig[1], slow))

    def sense(channels: Channels, slow: Slow) -> Channels:
        return replace(channels, friction_force=channels.friction_force - edges(channels.arm, slow))

    return Hidden("scar-edge", True, law, ("geometry", "rig"),
                  {"peak_force": peak, "width": width, "depth_scale": scale},
                  lambda physics: replace(physics, rig_forces=(*physics.rig_forces, force),
                                          sensors=(*physics.sensors, sense)))


def initial_gap(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw tilt, crown or cylinder; otherwise waviness, or edges rounded with the fourth power of the place."""
    sizes = dict.fromkeys(("tilt_x", "tilt_y", "crown", "cylinder"), 0.0)
    for name in rng.choice(list(sizes), size=int(rng.integers(1, 3)), replace=False):
        size = decades(rng, 0.3e-6, 4e-6)
        sizes[str(name)] = either(rng, size) if str(name).startswith("tilt") else size
    height, turns, turn = decades(rng, 0.3e-6, 4e-6), even(rng, 0.7, 1.6), even(rng, 0.0, np.pi)

    law = form(rng, other, "waviness", "rounded edges")

    def gap(nodes: Array) -> Array:
        x, y = (nodes / facts.joint.half).T
        if law == "rounded edges":
            return np.asarray(height * (x**4 + y**4))
        if other:
            along = x * np.cos(turn) + y * np.sin(turn)
            return np.asarray(0.5 * height * (1.0 - np.cos(np.pi * turns * along)))
        return np.asarray(0.5 * sizes["tilt_x"] * (1.0 + x) + 0.5 * sizes["tilt_y"] * (1.0 + y)
                          + 0.5 * sizes["crown"] * (x**2 + y**2) + sizes["cylinder"] * x**2)

    return Hidden("initial-gap", True, law, ("geometry",),
                  {"height": height} if other else sizes, lambda physics: replace(physics, gap=gap))


def wear_coefficient_evolution(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw K_w (x + (1 - x) exp(-n / n_K)); otherwise 1 / (1 + n / n_K) in place of the exponential, or a ramp."""
    final, settling = decades(rng, 0.2, 4.0), decades(rng, 0.03, 1.0) * facts.cycles

    law = form(rng, other, "rational", "ramp")

    def factor(worn: Worn, slow: Slow) -> Array:
        passed = slow.cycles / settling
        left = {"rational": 1.0 / (1.0 + passed), "ramp": max(1.0 - passed, 0.0)}.get(law, float(np.exp(-passed)))
        return np.full(len(worn.work), final + (1.0 - final) * left)

    return _wear("wear-coefficient-evolution", law, {"final_share": final, "settling": settling}, factor)


def wear_threshold(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw K_w sum p |du| (1 - q_th / q), q the frictional power; otherwise a threshold of pressure or of the path."""
    threshold = even(rng, 0.1, 0.6)
    law = form(rng, other, "of pressure", "of the path")

    def factor(worn: Worn, slow: Slow) -> Array:
        if law == "of the path":
            return np.asarray(np.maximum(1.0 - threshold * REFERENCE_PATH / np.maximum(worn.path, 1e-9), 0.0))
        if other:
            mean = np.divide(worn.work, worn.path, out=np.zeros_like(worn.work), where=worn.path > 0.0)
            return np.asarray(np.maximum(1.0 - threshold * REFERENCE_PRESSURE / np.maximum(mean, 1.0), 0.0))
        return np.asarray(np.maximum(1.0 - threshold * TYPICAL_POWER / np.maximum(worn.power, 1.0), 0.0))

    parameters = {"share": threshold} if other else {"power_density": threshold * TYPICAL_POWER}
    return _wear("wear-threshold", law, parameters, factor)


def wear_power_law(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw K_w (p / p_0)^a (s / s_0)^b (f / f_0)^c."""
    a, b, c = even(rng, -0.5, 0.5), even(rng, -0.5, 0.5), even(rng, -0.5, 0.2)

    def factor(worn: Worn, slow: Slow) -> Array:
        path = np.maximum(worn.path, 1e-9)
        pressure = np.maximum(worn.work / path, 1e3)
        return np.asarray((pressure / REFERENCE_PRESSURE)**a * (path / REFERENCE_PATH)**b
                          * (worn.frequency / REFERENCE_FREQUENCY)**c)

    return _wear("wear-power-law", CATALOGUE, {"pressure_exponent": a, "sliding_exponent": b, "frequency_exponent": c,
                                               "reference_pressure": REFERENCE_PRESSURE}, factor)


def _wear(name: str, law: str, parameters: dict[str, float], factor: Callable[[Worn, Slow], Array]) -> Hidden:
    return Hidden(name, True, law, ("wear",), parameters,
                  lambda physics: replace(physics, wear_factors=(*physics.wear_factors, factor)))


DRAWS: dict[str, Draw] = {
    "third-body": third_body,
    "scar-edge": scar_edge,
    "initial-gap": initial_gap,
    "wear-coefficient-evolution": wear_coefficient_evolution,
    "wear-threshold": wear_threshold,
    "wear-power-law": wear_power_law,
}
