"""Recordings made for tests: a spring and slider in series, whose every reading is known in closed form."""

from dataclasses import dataclass, field

import numpy as np
import pytest

AMPLITUDE, STIFFNESS, LOAD, MU, FREQUENCY = 8e-6, 20e6, 60.0, 0.6, 100.0
LEAD = 0.3  # turns by which the excitation is ahead of the displacement
UNITS = {"time": ("time_s", "s", 1.0), "displacement": ("displacement_um", "um", 1e6),
         "friction_force": ("force_N", "N", 1.0), "excitation": ("excitation_N", "N", 1.0)}


def jenkins(turns, mu=MU, stiffness=STIFFNESS, amplitude=AMPLITUDE):
    """Return displacement and steady force at `turns` of ``x = A cos(2 pi turns)``, closed form."""
    x, limit = amplitude * np.cos(2.0 * np.pi * turns), mu * LOAD
    back = np.maximum(limit - stiffness * (amplitude - x), -limit)
    there = np.minimum(-limit + stiffness * (amplitude + x), limit)
    return x, np.where(turns % 1.0 < 0.5, back, there)


def exact_readings(mu=MU, stiffness=STIFFNESS, amplitude=AMPLITUDE):
    slide = 2.0 * (amplitude - mu * LOAD / stiffness)
    return {"friction_coefficient": mu, "tangential_stiffness": stiffness, "sliding_distance": slide,
            "dissipated_energy": 2.0 * mu * LOAD * slide, "peak_to_peak": 2.0 * amplitude}


@dataclass
class MadeRecording:
    """Rows of a recording in SI, to be spoilt by a test, and how it is written."""

    columns: dict
    test: dict = field(default_factory=lambda: {
        "kind": "fretting-rig", "excitation_frequency": "100 Hz", "excitation_amplitude": "50 N",
        "normal_load": "60 N", "cycles": 100000})
    extra: dict = field(default_factory=dict)  # keys of channels beside column and unit
    tables: str = ""

    def write(self, folder, name="loops.csv", block="loops"):
        folder.mkdir(parents=True, exist_ok=True)
        headings = {c: UNITS.get(c, (c, "", 1.0)) for c in self.columns}
        rows = np.column_stack([self.columns[c] * headings[c][2] for c in self.columns])
        formats = ["%d" if c in ("cycle", "repeat", "condition") else "%.12g" for c in self.columns]
        np.savetxt(folder / name, rows, delimiter=",", comments="", fmt=formats,
                   header=",".join(h for h, _, _ in headings.values()))
        lines = ['format = "fretflow-recording/1"', "[test]"]
        lines += [f"{key} = {toml(value)}" for key, value in self.test.items()]
        lines += [f"[{block}]", f'file = "{name}"', 'displacement_of = "contact-faces"']
        for channel, (heading, unit, _) in headings.items():
            keys = {"column": heading, **({"unit": unit} if unit else {}), **self.extra.get(channel, {})}
            lines.append(f"{channel} = {{ {', '.join(f'{k} = {toml(v)}' for k, v in keys.items())} }}")
        (folder / "recording.toml").write_text("\n".join(lines) + "\n" + self.tables)
        return folder


def toml(value):
    return f'"{value}"' if isinstance(value, str) else str(value)


def make_recording(cycles=(0, 1000), repeats=2, samples=200, periods=1.0, noise=(0.0, 0.0), gain=0.0, starts=None,
                   seed=1, excitation=True, mu=None, frequency=FREQUENCY, stiffness=STIFFNESS):
    """Make rows in order of cycle, repeat and time; `starts` are turns, one a loop; noise in m and N."""
    rng = np.random.default_rng(seed)
    count = round(samples * periods)
    time = np.arange(count) / (samples * frequency)
    parts = []
    for place, cycle in enumerate(cycles):
        for repeat in range(repeats):
            start = 0.0 if starts is None else starts[len(parts)]
            turns = start + time * frequency
            x, force = jenkins(turns, MU if mu is None else mu[place], stiffness)
            part = {"cycle": np.full(count, cycle), "repeat": np.full(count, repeat), "time": time,
                    "excitation": 50.0 * np.cos(2.0 * np.pi * (turns + LEAD)),
                    "displacement": x * (1.0 + gain * rng.standard_normal()) + noise[0] * rng.standard_normal(count),
                    "friction_force": force * (1.0 + gain * rng.standard_normal())
                    + noise[1] * rng.standard_normal(count)}
            parts.append(part)
    names = [name for name in parts[0] if excitation or name != "excitation"]
    return MadeRecording({name: np.concatenate([part[name] for part in parts]).astype(float) for name in names})


@pytest.fixture(scope="session")
def make():
    """Return the maker of recordings."""
    return make_recording


@pytest.fixture(scope="session")
def exact():
    """Return the closed form of the readings."""
    return exact_readings


@pytest.fixture(scope="session")
def spring_slider():
    """Return the closed form of the loop."""
    return jenkins
