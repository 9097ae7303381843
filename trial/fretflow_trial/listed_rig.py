"""Effects of rig, drive and sensors that the catalogue has, with laws of their own where `other` asks for one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from fretflow_trial.hidden import CATALOGUE, Draw, Facts, Hidden, decades, either, even, form, spectral
from fretflow_trial.physics import Channels, Physics, Slow

Array = NDArray[np.float64]
Sensor = Callable[[Channels, Slow], Channels]

TYPICAL_STROKE, TYPICAL_SPEED = 10e-6, 5e-3
IN_PATH, IN_CHANNEL = 1, 2


def parallel_stiffness(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw a spring k x beside the contact; otherwise one that hardens with x^3, or yields as tanh(x / x_0)."""
    stiffness = decades(rng, 0.05e6, 0.4e6)
    law = form(rng, other, "hardens", "yields")

    def hardening(arm: float | Array) -> float | Array:
        if law == "yields":
            return stiffness * (TYPICAL_STROKE * np.tanh(arm / TYPICAL_STROKE) - arm)
        return 0.5 * stiffness * arm * (arm / TYPICAL_STROKE)**2 if other else 0.0 * arm

    def sense(channels: Channels, slow: Slow) -> Channels:
        more = stiffness * channels.arm + np.asarray(hardening(channels.arm))
        return replace(channels, friction_force=channels.friction_force + more)

    def apply(physics: Physics) -> Physics:
        rig = replace(physics.rig, beside_stiffness=physics.rig.beside_stiffness + stiffness)
        forces = physics.rig_forces
        if other:
            forces = (*forces, lambda state, slow: (0.0, -float(hardening(float(state[1])))))
        return replace(physics, rig=rig, rig_forces=forces, sensors=(*physics.sensors, sense))

    return Hidden("parallel-stiffness", True, law, ("rig",), {"stiffness": stiffness}, apply)


def viscous(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw a dashpot c v beside the contact; otherwise c v_0 |v / v_0|^b sign(v), of a thinning or turbulent fluid."""
    damping, thinning = decades(rng, 50.0, 3e3), even(rng, 0.5, 0.8)
    law = form(rng, other, "thins with the speed", "square of the speed")
    power = 2.0 if law.startswith("square") else thinning

    def thick(velocity: Array) -> Array:
        return np.asarray(damping * TYPICAL_SPEED * np.sign(velocity) * np.abs(velocity / TYPICAL_SPEED)**power)

    def sense(channels: Channels, slow: Slow) -> Channels:
        more = thick(channels.velocity) if other else damping * channels.velocity
        return replace(channels, friction_force=channels.friction_force + more)

    def apply(physics: Physics) -> Physics:
        sensors = (*physics.sensors, sense)
        if other:
            return replace(physics, sensors=sensors, rig_forces=(
                *physics.rig_forces, lambda state, slow: (0.0, -float(thick(state[3])))))
        rig = replace(physics.rig, beside_damping=physics.rig.beside_damping + damping)
        return replace(physics, rig=rig, sensors=sensors)

    return Hidden("viscous", True, law, ("rig",), {"damping": damping}, apply)


def support_nonlinearity(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw k_3 x^3 between block and ground; otherwise another power of x."""
    stiffness = decades(rng, 2e14, 1e16)
    law = form(rng, other, "power 2", "power 2.5", "power 4")
    power = 3.0 if law == CATALOGUE else float(law.removeprefix("power "))

    def force(rig: Array, slow: Slow) -> tuple[float, float]:
        x = float(rig[0])
        return -stiffness * TYPICAL_STROKE**(3.0 - power) * abs(x)**(power - 1.0) * x, 0.0

    return _pull("support-nonlinearity", law, {"stiffness": stiffness}, force)


def force_offset(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw a constant force on the block."""
    size = either(rng, decades(rng, 1.0, 30.0))
    return _pull("force-offset", CATALOGUE, {"force_offset": size}, lambda rig, slow: (size, 0.0))


def backlash(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw a hinge that carries nothing within the play; otherwise with softened flanks or a soft bush in the play."""
    play, bush = decades(rng, 0.5e-6, 10e-6), even(rng, 0.02, 0.1)
    law = form(rng, other, "soft flanks", "rational flanks", "a bush within the play")

    def missing(rig: Array, slow: Slow) -> tuple[float, float]:
        apart, half = float(rig[1] - rig[0]), 0.5 * play
        flanks = {"soft flanks": half * np.tanh(apart / half), "rational flanks": apart / np.hypot(1.0, apart / half)}
        flank = flanks.get(law, min(max(apart, -half), half))
        force = facts.hinge * flank * (1.0 - bush if "bush" in law else 1.0)
        return -force, force

    return _pull("backlash", law, {"play": play}, missing)


def _pull(name: str, law: str, parameters: dict[str, float],
          force: Callable[[Array, Slow], tuple[float, float]]) -> Hidden:
    return Hidden(name, True, law, ("rig",), parameters,
                  lambda physics: replace(physics, rig_forces=(*physics.rig_forces, force)))


def excitation_distortion(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw second and third harmonic of the drive; otherwise an amplifier that saturates."""
    second, third = decades(rng, 0.01, 0.25), decades(rng, 0.01, 0.25)
    turns = even(rng, -np.pi, np.pi), even(rng, -np.pi, np.pi)

    law, drive = form(rng, other, "saturates"), decades(rng, 0.3, 1.5)

    def added(phase: Array) -> Array:
        if other:
            return np.asarray(np.tanh(drive * np.cos(phase)) / np.tanh(drive) - np.cos(phase))
        return np.asarray(second * np.cos(2.0 * phase + turns[0]) + third * np.cos(3.0 * phase + turns[1]))

    return Hidden("excitation-distortion", True, law, ("excitation",),
                  {"second": second, "second_phase": turns[0], "third": third, "third_phase": turns[1]},
                  lambda physics: replace(physics, excitation=(*physics.excitation, added)))


def sensor_path_compliance(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw x + c T; otherwise softer towards larger forces, or stiffer as Hertz's contact of a sensor's tip."""
    compliance = decades(rng, 6e-9, 6e-8)
    law = form(rng, other, "softens with force", "Hertzian")

    def sense(channels: Channels, slow: Slow) -> Channels:
        force = channels.friction_force
        shares = {"softens with force": 0.7 + 0.3 * np.abs(force) / 50.0,
                  "Hertzian": np.maximum(np.abs(force) / 50.0, 1e-6)**(-1.0 / 3.0)}
        bent = force * shares.get(law, 1.0)
        return replace(channels, displacement=channels.displacement + compliance * bent)

    return _sensor("sensor-path-compliance", law, {"compliance": compliance}, sense, 0)


def sensor_inertia(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw T + m a."""
    mass = decades(rng, 0.1, 3.0)
    return _sensor("sensor-inertia", CATALOGUE, {"mass": mass}, lambda channels, slow: replace(
        channels, friction_force=channels.friction_force + mass * channels.acceleration), IN_PATH)


def extra_mode(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw the force through one resonance."""
    natural, damping = 2.0 * np.pi * decades(rng, 250.0, 900.0), decades(rng, 0.01, 0.1)

    def response(omega: Array) -> NDArray[np.complex128]:
        ratio = omega / natural
        return np.asarray(1.0 / (1.0 - ratio**2 + 2j * damping * ratio))

    return _sensor("extra-mode", CATALOGUE, {"frequency": natural / (2.0 * np.pi), "damping_ratio": damping},
                   _filtered(response), IN_PATH)


def channel_delay(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw T(t - tau); otherwise a low-pass of first order or Bessel's of second, with that delay."""
    delay = decades(rng, 20e-6, 300e-6)
    law = form(rng, other, "low-pass of first order", "low-pass of second order")

    def response(omega: Array) -> NDArray[np.complex128]:
        turn = 1j * omega * delay
        return np.asarray({"low-pass of first order": 1.0 / (1.0 + turn),
                           "low-pass of second order": 3.0 / (3.0 + 3.0 * turn + turn**2)}.get(law, np.exp(-turn)))

    return _sensor("channel-delay", law, {"delay": delay}, _filtered(response), IN_CHANNEL)


def sensor_drift(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw T + d s, s the elapsed share of the test; otherwise settling within a third of it, or with its root."""
    drift, law = either(rng, decades(rng, 0.1, 3.0)), form(rng, other, "settles", "square root")

    def sense(channels: Channels, slow: Slow) -> Channels:
        share = {"settles": 1.0 - np.exp(-3.0 * slow.elapsed), "square root": slow.elapsed**0.5}.get(law, slow.elapsed)
        return replace(channels, friction_force=channels.friction_force + drift * share)

    return _sensor("sensor-drift", law, {"drift": drift}, sense, IN_CHANNEL)


def _filtered(response: Callable[[Array], NDArray[np.complex128]]) -> Sensor:
    return lambda channels, slow: replace(
        channels, friction_force=spectral(channels, channels.friction_force, response))


def _sensor(name: str, law: str, parameters: dict[str, float], sense: Sensor, stage: int) -> Hidden:
    return Hidden(name, True, law, ("sensor",), parameters,
                  lambda physics: replace(physics, sensors=(*physics.sensors, sense)), stage)


DRAWS: dict[str, Draw] = {
    "parallel-stiffness": parallel_stiffness,
    "viscous": viscous,
    "support-nonlinearity": support_nonlinearity,
    "force-offset": force_offset,
    "backlash": backlash,
    "excitation-distortion": excitation_distortion,
    "sensor-path-compliance": sensor_path_compliance,
    "sensor-inertia": sensor_inertia,
    "extra-mode": extra_mode,
    "channel-delay": channel_delay,
    "sensor-drift": sensor_drift,
}
