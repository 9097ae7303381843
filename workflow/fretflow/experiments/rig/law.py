"""What an unlisted effect does to the rig, from the data: what is left of a channel against the state behind it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fretflow.core.records import Array
from fretflow.experiments.laws import binned_law
from fretflow.experiments.loops import Strokes, smoothed
from fretflow.experiments.rig.observation import Observation, Piece
from fretflow.experiments.rig.views import level, loop_pieces
from fretflow.inference.verdict import ResidualLaw

CHANNELS = {"friction_force": "N", "displacement": "m"}
CYCLES, ENERGY = SLOW = ("cycles", "dissipated energy per cycle")  # over which a change is one along the motion


@dataclass(frozen=True)
class _State:
    """A state at all samples of all loops; one that changes from loop to loop only is asked along the motion."""

    name: str
    unit: str
    values: Array
    way: Array  # 1, or the direction of motion


def residual_law(observation: Observation, predicted: Array) -> ResidualLaw:
    """Return what a prediction (M,) leaves of force or displacement against the state that explains most of it.

    The explained share is that of the squares beyond noise which the means over bins of the state take up. The channel
    is the one that is further off; of states that explain as much, the plainest is taken.
    """
    loops = list(loop_pieces(observation).values())
    left = observation.values - level(observation, predicted)
    noise = observation.variance * observation.noise
    size = {name: float(np.mean([np.mean(left[one[name].place]**2 / noise[one[name].place]) for one in loops]))
            for name in CHANNELS}
    channel = max(size, key=lambda name: size[name])
    own, variance = (np.concatenate([vector[one[channel].place] for one in loops]) for vector in (left, noise))
    laws = [binned_law({"channel": channel, "state": state.name, "state_unit": state.unit,
                        "channel_unit": CHANNELS[channel]}, state.values, own * state.way, variance, len(own))
            for state in _states(observation, loops)]
    return max(laws, key=lambda law: law.explained)


def _states(observation: Observation, loops: list[dict[str, Piece]]) -> list[_State]:
    """Return the states of the measured motion."""
    made: dict[tuple[str, str], list[Array]] = {}
    ways = []
    for pieces in loops:
        x, force = (observation.values[pieces[name].place] for name in ("displacement", "friction_force"))
        strokes = Strokes.of(x, force)
        ways.append(strokes.way)
        piece = pieces["displacement"]
        cycles = piece.cycles if piece.condition is None else observation.counts[-1]
        for state, values in _of_loop(smoothed(x), smoothed(force), strokes, cycles).items():
            made.setdefault(state, []).append(values)
    way = np.concatenate(ways)
    return [_State(name, unit, np.concatenate(values), way if name in SLOW else np.ones_like(way))
            for (name, unit), values in made.items()]


def _of_loop(x: Array, force: Array, strokes: Strokes, cycles: int) -> dict[tuple[str, str], Array]:
    """Return the states (N,) of one loop by name and unit."""
    n, x = len(x), x - 0.5 * (x.max() + x.min())
    turning = 1j * np.arange(n // 2 + 1)
    v, a = (np.fft.irfft(turning**k * np.fft.rfft(x), n) for k in (1, 2))
    return {("displacement", "m"): x, ("velocity over the angular frequency", "m"): v,
            ("acceleration over the squared angular frequency", "m"): a, ("friction force", "N"): force,
            ("travel since the reversal, signed by its direction", "m"): strokes.since * strokes.way,
            ("share of the stroke, signed by its direction", "1"): (strokes.share + 1e-6) * strokes.way,
            ("phase of the excitation", "1"): np.arange(n) / n, (CYCLES, "1"): np.full(n, float(cycles)),
            (ENERGY, "J"): np.full(n, abs(float(np.mean(force * v))) * 2.0 * np.pi)}
