"""The measured half Brake-Reuss beam: what is found on some rows, and predicted on rows that were never fitted.

Run ``FRETFLOW_RECORDINGS=... python benchmarks/half_brake_reuss.py`` with the packages on the path; prints the tables
of ``half_brake_reuss.md``. With ``draw`` it draws what stands in them: the decay and the force at resonance. The mesh
is made from the drawing's dimensions; bolt load, friction and damping without the joint are found, and beside them what
a hypothesis adds. Fitted are the decay below 20 m/s^2, the responses with the force held, and the first two bending
modes of the hammer test; the other rows are predicted.
"""

from __future__ import annotations

import os
import sys
import tempfile
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import fretflow as ff
import numpy as np
from fretflow_meshes import LapBeam
from fretflow_post import style
from matplotlib.figure import Figure
from scipy.optimize import least_squares

RECORDINGS = Path(os.environ["FRETFLOW_RECORDINGS"])
RATIO = 1.2  # normal over tangential stiffness of asperities (Mindlin)
BASELINE = {"bolt_load": (500.0, 3e4), "friction": (0.05, 1.0), "damping": (1e-4, 5e-3)}
SPRINGS, HUMP, EXPONENT = (1e11, 1e14), (1e-6, 60e-6), (0.02, 1.0)
SPREAD, POWER = (0.02, 0.999), (0.5, 4.0)
HYPOTHESES = {  # those of more terms begin also from what those of fewer have found
    "plane faces": {},
    "asperity springs": {"springs": SPRINGS},
    "humped faces": {"hump": HUMP},
    "springs, spread of slip limits": {"springs": SPRINGS, "spread": SPREAD},
    "springs, power law of slip limits": {"springs": SPRINGS, "spread": SPREAD, "power": POWER},
    "humped, springs, spread of slip limits": {"hump": HUMP, "springs": SPRINGS, "spread": SPREAD},
    "springs stiffer under pressure": {"springs": SPRINGS, "exponent": EXPONENT},
    "humped faces, springs": {"hump": HUMP, "springs": SPRINGS},
}
LEAST = {"springs": SPRINGS[1], "spread": SPREAD[0], "hump": HUMP[0], "exponent": EXPONENT[0], "power": 1.0}  # none
DECAY_FITTED, DECAY_PREDICTED = np.array([2.5, 4.0, 7.0, 12.0, 20.0]), np.array([25.0, 32.0, 40.0, 50.0])
GRID = np.array([2.0, 4.0, 8.0, 14.0, 22.0, 32.0, 43.0, 55.0, 68.0, 84.0])  # m/s^2
FREQUENCY_SD, DAMPING_SD, FORCE_SD = 0.02, 0.05, 0.05  # Hz; relative; relative: what readings repeat to
HAMMER = np.array([80.47, 297.7, 580.7, 845.7])  # Hz
UNITS = {"bolt_load": (1e-3, "kN"), "friction": (1.0, ""), "damping": (100.0, "%"), "hump": (1e6, "um"),
         "springs": (1e-12, "N/um/mm2"), "spread": (1.0, ""), "exponent": (1.0, ""), "power": (1.0, "")}
DRAWN = ("springs, power law of slip limits", "asperity springs")  # the best fit, and the best that rises again


@cache
def structure():
    """Return the reduced beam; the accelerometer sits on an end."""
    beam = LapBeam(across=4)
    steel = ff.Material(youngs_modulus=205e9, poissons_ratio=0.29, density=7800.0)
    bolts = [ff.Bolt.round(f"head {k}", f"nut {k}", diameter=7.9e-3, grip=beam.thickness, mass=0.03) for k in (1, 2, 3)]
    with tempfile.TemporaryDirectory() as folder:
        mesh = beam.write(Path(folder) / "beam.msh")
        end = {"end": ((beam.length, 0.0, 0.0), (0.0, 0.0, 1.0))}
        return ff.reduce_structure(ff.structure_from_mesh(mesh, steel, [("upper lap", "lower lap")], bolts,
                                                          sensors=end), 20)


def joint_of(values):
    """Return the joint of a hypothesis' values, in SI."""
    own = structure()
    joint = ff.BoltedJoint(structure=own, law=ff.Coulomb(values["friction"]), bolt_load=values["bolt_load"],
                           modal_damping=values["damping"])
    known = ff.catalogue()
    if "exponent" in values:
        faces = known["contact-stiffness"]().changed(
            stiffness=values["springs"] * float(own.areas.sum()) / RATIO, exponent=values["exponent"], ratio=RATIO,
            reference_pressure=joint.bolted_pressure)
        joint = faces.bolted(joint)
    elif "springs" in values:
        soft = 1.0 / (values["springs"] * own.areas)
        joint = replace(joint, springs=np.column_stack([RATIO * soft, RATIO * soft, soft]).ravel())
    if "spread" in values:
        limits = {"spread": values["spread"], "power": values.get("power", 1.0)}
        joint = known["distributed-micro-slip"]().changed(**limits).bolted(joint)
    if "hump" in values:
        joint = known["initial-gap"].neutral().changed(cylinder=values["hump"]).bolted(joint)
    return joint


def backbone(values, at):
    """Return frequency (Hz) and damping ratio at accelerations `at` (m/s^2) of the end."""
    joint = joint_of(values)
    mode = joint.linear_modes(1)[0]
    on_contact, on_modes = joint.structure.outputs["end"]
    shape = abs(on_contact @ mode.contact + on_modes @ mode.modes)
    curve = ff.quasi_static_backbone(joint, mode, at / (2.0 * np.pi * HAMMER[0])**2 / shape)
    seen = np.abs(curve.outputs[:, 0]) * (2.0 * np.pi * curve.frequency)**2
    order = np.argsort(seen)
    return tuple(np.interp(np.log(at), np.log(seen[order]), one[order]) for one in (curve.frequency, curve.damping))


@dataclass
class Fit:
    """A fit of the values of a hypothesis, logarithms within bounds."""

    names: tuple[str, ...]
    low: np.ndarray
    high: np.ndarray

    @classmethod
    def of(cls, more):
        """Return the fit of the baseline and `more`."""
        ranges = BASELINE | more
        low, high = np.log(np.array(list(ranges.values()))).T
        return cls(tuple(ranges), low, high)

    def values(self, x):
        """Return the values at coordinates x."""
        return dict(zip(self.names, np.exp(x).tolist(), strict=True))

    def best(self, residual, known=()):
        """Return values and cost of the best of two starts, and of those from `known` values of fewer terms."""
        size = len(residual(self.values(0.5 * (self.low + self.high))))

        def safe(x):
            try:
                return residual(self.values(x))
            except ff.NonConvergenceError:
                return np.full(size, 100.0)

        starts = [self.low + share * (self.high - self.low) for share in (0.4, 0.6)]
        starts += [np.clip(np.log([one.get(name, LEAST.get(name)) for name in self.names]), self.low + 1e-6,
                           self.high - 1e-6) for one in known]
        fits = [least_squares(safe, start, bounds=(self.low, self.high),
                              diff_step=3e-3, max_nfev=12, loss="soft_l1", f_scale=3.0) for start in starts]
        best = min(fits, key=lambda one: one.cost)
        return self.values(best.x), 2.0 * best.cost


def decayed(name):
    """Return measured accelerations, rising, and frequency or damping at them."""
    table = np.genfromtxt(RECORDINGS / "hbrb_decay" / f"{name}.csv", delimiter=",", skip_header=1)
    return table[np.argsort(table[:, 0], kind="stable")].T


def decay():
    """Return measured frequency and damping at fitted and predicted accelerations."""
    at = np.r_[DECAY_FITTED, DECAY_PREDICTED]
    return [np.interp(at, *decayed(name)) for name in ("frequency", "damping")]


def responses(control):
    """Return frequency (Hz), force (N) and acceleration (m/s^2) of each level."""
    table = np.genfromtxt(RECORDINGS / "hbrb_forced" / "responses.csv", delimiter=",", skip_header=1, dtype=None,
                          encoding="utf-8")
    own = [row for row in table if row[0] == control]
    return [np.array([[row[2], row[3], row[4]] for row in own if row[1] == level]).T
            for level in sorted({row[1] for row in own})]


def needed(curve, frequency, acceleration):
    """Return the modal force over the force (N kg^0.5...) that holds accelerations at frequencies."""
    natural, damping = (np.interp(np.log(acceleration), np.log(GRID), one) for one in curve)
    driven, natural = 2.0 * np.pi * frequency, 2.0 * np.pi * natural
    return acceleration / driven**2 * np.abs(natural**2 - driven**2 + 2j * damping * natural * driven)


def told(values):
    """Return values in words."""
    return ", ".join(f"{name.replace('_', ' ')} {value * UNITS[name][0]:.3g} {UNITS[name][1]}".strip()
                     for name, value in values.items())


def tabled(name):
    """Return the values that the two tables of the page have of a hypothesis: of the decay, of the responses."""
    rows = [line.split("|") for line in Path(__file__).with_suffix(".md").read_text().splitlines()]
    columns = []
    for cells in (row for row in rows if len(row) > 2 and row[1].strip() == name):
        values = {}
        for key, text in zip(BASELINE | HYPOTHESES[name], cells[-2].split(","), strict=False):
            number = next(float(word) for word in text.split() if word[0].isdigit())
            values[key] = number / UNITS[key][0]
        columns.append(values)
    return columns[:2]


def simpler(name, values_by_name):
    """Return the values found for hypotheses of fewer terms than `name`."""
    return [values for other, values in values_by_name.items() if set(HYPOTHESES[other]) < set(HYPOTHESES[name])]


def decay_row(name, known):
    """Print what the decay tells of a hypothesis, begun also from `known` values, and return what is found."""
    frequency, damping = decay()
    count = len(DECAY_FITTED)

    def residual(values):
        f, z = backbone(values, DECAY_FITTED)
        return np.r_[(f - frequency[:count]) / FREQUENCY_SD, np.log(z / damping[:count]) / DAMPING_SD]

    values, cost = Fit.of(HYPOTHESES[name]).best(residual, known)
    f, z = backbone(values, np.r_[DECAY_FITTED, DECAY_PREDICTED])
    miss = 100.0 * (f / frequency - 1.0)
    ratio = z / damping
    fitted, predicted = (float(np.abs(part).max()) for part in (miss[:count], miss[count:]))
    print(f"| {name} | {cost:.0f} | {fitted:.2f} | {predicted:.2f} "
          f"| {ratio[count:].min():.1f}-{ratio[count:].max():.1f} | {'yes' if f[-1] > f[count + 1] else 'no'} "
          f"| {told(values)} |", flush=True)
    return values


def scale(curve, held):
    """Return the logarithm of place of the shaker and gain of the accelerometer that the held forces tell."""
    return np.mean([np.mean(np.log(needed(curve, f, a) / force)) for f, force, a in held])


def resonances(values):
    """Return level (m/s^2), measured and predicted place (Hz) and force (N) of resonances with the response held."""
    curve = backbone(values, GRID)
    gain = np.exp(scale(curve, responses("force")))
    rows = []
    for frequency, force, acceleration in responses("response"):
        own = needed(curve, frequency, acceleration) / gain
        here, there = int(np.argmin(own)), int(np.argmin(force))
        rows.append((acceleration.mean(), frequency[there], frequency[here], force[there], own[here]))
    return np.array(rows).T


def forced_row(name, known):
    """Print what the responses tell of a hypothesis, begun also from `known` values, and return what is found."""
    held = responses("force")

    def residual(values):
        curve = backbone(values, GRID)
        gain = scale(curve, held)
        return np.concatenate([(np.log(needed(curve, f, a) / force) - gain) / FORCE_SD for f, force, a in held])

    values, cost = Fit.of(HYPOTHESES[name]).best(residual, known)
    _, there, here, measured, own = resonances(values)
    places, forces = 100.0 * (here / there - 1.0), 100.0 * (own / measured - 1.0)
    print(f"| {name} | {cost:.0f} | {np.abs(places).max():.2f} | {', '.join(f'{one:+.0f}' for one in forces)} "
          f"| {told(values)} |", flush=True)
    return values


def hammer_row(name):
    """Print what modes 1 and 2 tell of modes 3 and 4; bolt load and friction stay where the joint is closed."""
    more = HYPOTHESES[name]

    def bending(values):
        joint = joint_of(values)
        on_contact, on_modes = joint.structure.outputs["end"]
        return np.array([one.frequency for one in joint.linear_modes(10)
                         if abs(on_contact @ one.contact + on_modes @ one.modes) > 0.3][:4])

    fixed = {"bolt_load": 8e3, "friction": 0.4, "damping": 1e-3}
    if not more:
        frequencies = bending(fixed)
    else:
        (key, (low, high)), = list(more.items())[:1]
        tried = [(value, bending(fixed | {key: value})) for value in np.geomspace(low, high, 25)]
        value, frequencies = min(tried, key=lambda one: np.sum((one[1][:2] / HAMMER[:2] - 1.0)**2))
        fixed |= {key: value}
    print(f"| {name} | {told({k: v for k, v in fixed.items() if k in more}) or '-'} | "
          + " | ".join(f"{f:.1f} ({100.0 * (f / m - 1.0):+.1f} %)" for f, m in zip(frequencies, HAMMER, strict=True))
          + " |", flush=True)


def draw(folder):
    """Draw decay and force at resonance, measured and by the tables' values of two hypotheses, into a folder."""
    tables = [(*style.curve_look(k), name, *tabled(name)) for k, name in enumerate(DRAWN)]
    at = np.geomspace(2.5, 50.0, 25)
    curves = [backbone(values, at) for *_, values, _ in tables]
    with style.styled():
        figure = Figure(figsize=(12.0, 8.0), layout="constrained")
        parts = (("frequency", 1.0, "natural frequency in Hz"), ("damping", 100.0, "damping ratio in %"))
        for k, (axes, (name, per, label)) in enumerate(zip(figure.subplots(2, 1, sharex=True), parts, strict=True)):
            where, measured = decayed(name)
            axes.plot(where, per * measured, ".", color=style.BLACK, markersize=4, label="measured")
            axes.axvspan(0.0, DECAY_FITTED[-1], color="0.93", zorder=0, label="fitted here")
            for (colour, line, hypothesis, *_), curve in zip(tables, curves, strict=True):
                axes.plot(at, per * curve[k], line, color=colour, label=hypothesis)
            axes.set(xlim=(0.0, at[-1]), ylabel=label)
        axes.set_xlabel("acceleration of the end in m/s²")
        axes.legend()
        style.save_figure(figure, folder / "half_brake_reuss_decay.png")
        figure = Figure(figsize=(12.0, 6.0), layout="constrained")
        axes = figure.subplots()
        for colour, line, hypothesis, _, values in tables:
            level, _, _, measured, own = resonances(values)
            axes.plot(level, own, line, color=colour, label=f"predicted: {hypothesis}")
        axes.plot(level, measured, "o", color=style.BLACK, label="measured")
        axes.set(xlabel="acceleration held, in m/s²", ylabel="force at resonance in N", xlim=(0.0, None),
                 ylim=(0.0, None))
        axes.legend()
        style.save_figure(figure, folder / "half_brake_reuss_force.png")


def main():
    """Print the three tables."""
    print("| faces | cost of 10 | fitted, % | predicted, % | damping | rises | found |\n|---|---|---|---|---|---|---|")
    decay_values, held = {}, {}
    for name in HYPOTHESES:
        decay_values[name] = decay_row(name, simpler(name, decay_values))
    print("\n| faces | cost of 164 | resonance, % | force, % | found |\n|---|---|---|---|---|")
    for name, values in decay_values.items():
        held[name] = forced_row(name, [values, *simpler(name, held)])
    print("\n| faces | found | mode 1 | mode 2 | mode 3, predicted | mode 4, predicted |\n|---|---|---|---|---|---|")
    for name in ("plane faces", "asperity springs", "humped faces"):
        hammer_row(name)


if __name__ == "__main__":
    if sys.argv[1:] == ["draw"]:
        draw(Path(__file__).parents[1] / "docs" / "pictures")
    else:
        main()
