"""Made-up diagnoses for the tests of the report: all verdicts and kinds, and one of odd values."""

from __future__ import annotations

import base64
import gzip
import json
import math
from dataclasses import replace

import numpy as np
from fretflow.inference.verdict import (
    Candidate,
    Comparison,
    Detection,
    Diagnosis,
    Estimate,
    Evolution,
    HeldOut,
    Location,
    Place,
    ResidualLaw,
    ResidualMap,
    Verdict,
    WearMap,
)

NASTY = """</script><b>&"'é µ</b>"""
SAMPLES = 200
SWEPT = ("excitation 53 N", "excitation 68 N", "excitation 75 N", "load 45 N", "80 Hz")
CYCLES = (0, 2_000, 5_000, 10_000, 20_000, 40_000, 75_000, 120_000, 180_000, 240_000, 300_000)


def loop(amplitude: float, limit: float, stiffness: float = 28e6, shift: float = 0.0):
    """Return displacement and force of a spring and slider under a harmonic motion, m and N."""
    phase = 2.0 * np.pi * (np.arange(SAMPLES) / SAMPLES - shift)
    x = amplitude * np.cos(phase)
    force, forces = 0.0, []
    for _ in range(2):
        forces = []
        for step, at in zip(np.diff(x, prepend=x[-1]), x, strict=True):
            force = min(max(force + stiffness * step, -limit), limit)
            forces.append(force + 2e4 * at)
    return x, np.array(forces)


def comparison(label: str, limit: float, wrong: float, held_out: bool, amplitude: float = 9e-6,
               kind: str = "fretting-rig"):
    rng = np.random.default_rng(len(label))
    x, force = loop(amplitude, limit)
    old_x, old = loop(amplitude * (1.0 if kind == "imposed-displacement" else limit / wrong), wrong)
    new_x, new = loop(amplitude, limit * 1.01)
    noisy = x + 2e-8 * rng.standard_normal(SAMPLES)
    given = kind == "imposed-displacement"
    return Comparison(label=label, held_out=held_out, displacement=noisy,
                      force=force + 0.5 * rng.standard_normal(SAMPLES),
                      before_displacement=noisy if given else old_x, before_force=old,
                      after_displacement=noisy if given else new_x, after_force=new)


def rig_loops(kind: str = "fretting-rig"):
    limits = [53.0 - 33.0 * math.exp(-n / 40_000) for n in CYCLES]
    over_cycles = [comparison(f"{n:,} cycles", limit, 46.0, k in (3, 7), kind=kind)
                   for k, (n, limit) in enumerate(zip(CYCLES, limits, strict=True))]
    sizes = (6e-6, 12e-6, 15e-6, 11e-6, 8e-6)
    return (*over_cycles, *(comparison(name, 53.0, 46.0, k in (1, 3), size, kind)
                            for k, (name, size) in enumerate(zip(SWEPT, sizes, strict=True))))


def stretches():
    """Return two stretches of a lumped record, whose motion is predicted from its force."""
    t = np.linspace(0.0, 6.0, 3_000)
    force = 40.0 * np.sin(2.0 * np.pi * 0.5 * t) * (1.0 - np.exp(-t))
    rng = np.random.default_rng(4)
    parts = []
    for label, held_out in (("0 s to 6 s", False), ("6 s to 12 s", True)):
        x = 0.02 * np.tanh(1.6 * np.sin(2.0 * np.pi * 0.5 * t - 0.4)) * (1.0 - np.exp(-t))
        parts.append(Comparison(label=label, held_out=held_out, displacement=x + 1e-4 * rng.standard_normal(t.size),
                                force=force, before_displacement=0.018 * np.sin(2.0 * np.pi * 0.5 * t - 0.6),
                                before_force=force, after_displacement=1.005 * x, after_force=force, time=t))
    return tuple(parts)


def residual_map(channel: str, loops, after: bool = True):
    rng = np.random.default_rng(5)
    pick = "force" if "force" in channel else "displacement"
    sd = 0.8 if pick == "force" else 6e-8
    rows = [one.label for one in loops]
    old = np.array([getattr(one, pick) - getattr(one, f"before_{pick}") for one in loops]) / sd
    new = np.array([getattr(one, pick) - getattr(one, f"after_{pick}") for one in loops]) / sd
    new = np.clip(new, -3, 3) * 0.4 + 0.6 * rng.standard_normal(new.shape)
    return ResidualMap(channel=channel, rows=tuple(rows), phase=np.arange(old.shape[1]) / old.shape[1], before=old,
                       after=new if after else old)


def wear():
    line = np.linspace(-0.5e-3, 0.5e-3, 11)
    x, y = (v.ravel() for v in np.meshgrid(line, line))
    shape = 1.0 + 2.2 * (np.abs(x) / 0.5e-3) ** 4 + 1.6 * (np.abs(y) / 0.5e-3) ** 4
    measured = 5e-6 * shape / shape.mean() * 1.4
    rng = np.random.default_rng(6)
    return WearMap(x=x, y=y, measured=measured + 5e-8 * rng.standard_normal(x.size), before=0.82 * measured,
                   after=1.01 * measured)


def evolved(loops):
    """Return readings of the loops at cycle counts, of friction alone where they are held out."""
    read = np.array([[(np.ptp(f) / 2.0, 28e6, abs(np.sum(f * np.gradient(x))), np.ptp(x)) for x, f in (
        (one.displacement, one.force), (one.before_displacement, one.before_force),
        (one.after_displacement, one.after_force))] for one in loops if one.label.endswith("cycles")])
    limit, stiffness, energy, sliding = np.moveaxis(read, 2, 0)
    return Evolution(cycles=np.array(CYCLES, float), friction_limit=limit.T, tangential_stiffness=stiffness.T,
                     dissipated_energy=energy.T, sliding_distance=sliding.T)


RANKING = tuple(Candidate(effects=effects, probability=p, explained=s, chi_squared=chi, degrees_of_freedom=5_200,
                          log_evidence=-chi / 2, converged=k < 3)
                for k, (effects, p, s, chi) in enumerate((
                    (("friction-run-in",), 0.962, 0.974, 5_420.0),
                    (("friction-run-in", "sensor-inertia"), 0.031, 0.975, 5_415.0),
                    (("normal-load-drift",), 0.006, 0.63, 22_000.0),
                    (("contact-stiffness-evolution",), 4e-4, 0.31, 43_000.0),
                    (("third-body",), 1e-5, 0.22, 48_000.0), (("velocity-dependent-friction",), 0.0, 0.12, 54_000.0),
                    (("wear-threshold",), 0.0, 0.08, 57_000.0), (("viscous",), 0.0, 0.05, 58_500.0),
                    (("channel-delay",), 0.0, 0.02, 60_000.0), (("extra-mode",), 0.0, 0.01, 61_000.0),
                    ((), 0.0, 0.0, 61_800.0))))

PLACES = tuple(Place(cut=cut, where=where, share=share, p_value=p) for cut, where, share, p in (
    ("block", "contact law", 0.81, 1e-30), ("channel", "friction force", 0.74, 2e-24),
    ("phase", "plateau", 0.69, 4e-15), ("cycles", "0 to 40,000", 0.88, 3e-19), ("harmonic", "1", 0.77, 1e-9),
    ("parity", "odd in displacement", 0.93, 2e-8), ("phase", "reversal", 0.12, 0.02),
    ("channel", "displacement", 0.26, 3e-5), ("condition", "load 45 N", 0.09, 0.41), ("zone", "edges", 0.31, 0.6),
    ("phase", "knee", 0.1, 0.7), ("harmonic", "3", 0.08, 0.2), ("harmonic", "5", 0.02, 1.0)))

NORMAL = np.random.default_rng(7).standard_normal((6, 500)) + 0.8 * np.random.default_rng(8).standard_normal(500)
PARAMETERS = tuple(Estimate(name=name, value=v, low=a, high=b, unit=u, meaning=m, draws=v + (b - a) / 4.2 * z)
                   for z, (name, v, a, b, u, m) in zip(NORMAL, (
    ("friction-run-in.initial", 0.334, 0.327, 0.341, "1", "mu_0: coefficient of the new faces"),
    ("friction-run-in.final", 0.882, 0.876, 0.889, "1", "friction coefficient after running in"),
    ("friction-run-in.energy", 42.1, 38.7, 46.0, "J", "dissipated energy that settles it"),
    ("contact.friction_coefficient", 0.74, 0.72, 0.76, "1", ""),
    ("wear.coefficient", 1.1e-14, 0.9e-14, 1.3e-14, "m^2/N", ""),
    ("displacement.gain", 1.0021, 0.9975, 1.0066, "1", "within its calibration")), strict=True))


def named(kind: str = "fretting-rig") -> Diagnosis:
    """Return a diagnosis that names running-in, of a recording of `kind`."""
    lumped = kind == "lumped"
    loops = stretches() if lumped else rig_loops(kind)
    maps = () if lumped else (residual_map("friction force", loops), *(
        (residual_map("relative displacement", loops),) if kind == "fretting-rig" else ()))
    effects = ("coulomb-friction", "force-offset") if lumped else ("friction-run-in",)
    ranking = (replace(RANKING[0], effects=effects), *RANKING[2:]) if lumped else RANKING
    return Diagnosis(
        title="Friction rig, flat-on-flat", recording="recordings/run_in", kind=kind, verdict=Verdict.NAMED,
        effects=effects, probability=0.962,
        sentence="The friction of the unworn faces starts low and settles with the dissipated energy: the model leaves "
                 "out friction-run-in, which explains 97 % of the difference.",
        ranking=ranking, detection=Detection(p_value=3e-31, statistic="global chi-squared", false_alarm_rate=0.05,
                                             tests={"global chi-squared": 1e-31, "loop harmonics by trend": 4e-28}),
        location=Location(block="contact law", channel="friction force", phase="plateau", cycles=(0, 40_000), zone="",
                          parity="odd in the displacement", places=PLACES,
                          text="The friction force on the plateau is up to 26 N lower than predicted over the first "
                               "40,000 cycles; after that model and recording agree."),
        parameters=PARAMETERS[:0] if lumped else PARAMETERS,
        held_out=HeldOut(what="loops at 10,000 and 120,000 cycles, excitation 68 N, load 45 N", before=8.4, after=1.06,
                         floor=1.0),
        separating_measurement="Loops at another amplitude in the first 10,000 cycles would tell a dependence on "
                               "sliding from one on energy.",
        smallest_visible={}, comparisons=loops, residual_maps=maps,
        evolution=None if lumped else evolved(loops), wear_map=wear() if kind == "fretting-rig" else None,
        warnings=("loops, displacement, rows 412-418: 7 values are missing and were left out",),
        case_file='format = "fretflow-case/1"\nname = "run_in"\n[test]\nexcitation_amplitude = "53 N"\n'
                  'cycles = 300000\n[effects.friction-run-in]\ninitial = 0.334\n',
        seconds=372.0)


def none(kind: str = "fretting-rig") -> Diagnosis:
    """Return a diagnosis that finds nothing."""
    diagnosis = named(kind)
    same = tuple(replace(one, before_displacement=one.after_displacement, before_force=one.after_force)
                 for one in diagnosis.comparisons)
    return replace(
        diagnosis, verdict=Verdict.NONE, effects=(), probability=0.97, comparisons=same,
        sentence="The baseline with its own parameters refitted explains the recording within its noise.", ranking=(),
        detection=replace(diagnosis.detection, p_value=0.41, tests={"global chi-squared": 0.41}),
        residual_maps=tuple(residual_map(one.channel, same, after=False) for one in diagnosis.residual_maps),
        location=Location(block="", channel="", phase="", cycles=(0, 0), zone=""), separating_measurement="",
        held_out=HeldOut(what="loops at 10,000 cycles", before=1.02, after=1.02, floor=1.0),
        smallest_visible={"friction-run-in": 0.03, "third-body": 0.44, "scar-edge": 1.7, "channel-delay": 0.004,
                          "wear-threshold": math.nan}, case_file="", warnings=(), fast=True, seconds=41.0)


def ambiguous(kind: str = "fretting-rig") -> Diagnosis:
    """Return a diagnosis that leaves two effects."""
    diagnosis = named(kind)
    pair = ("sensor-inertia", "parallel-stiffness")
    ranking = (replace(RANKING[0], effects=pair[:1], probability=0.52),
               replace(RANKING[0], effects=pair[1:], probability=0.45), *RANKING[2:])
    return replace(diagnosis, verdict=Verdict.AMBIGUOUS, effects=pair, probability=0.97, ranking=ranking,
                   after_model="baseline + sensor-inertia, one of the set",
                   sentence="Either a mass in front of the force sensor or a spring beside the contact: both tilt the "
                            "plateaus alike at one frequency.",
                   separating_measurement="A loop at 60 Hz or 140 Hz: a mass tilts it with the square of the "
                                          "frequency, a spring does not.")


def unknown(kind: str = "fretting-rig") -> Diagnosis:
    """Return a diagnosis whose effect is not in the catalogue."""
    diagnosis = named(kind)
    speed = np.linspace(-8e-3, 8e-3, 31)
    ranking = tuple(replace(one, explained=0.38 * one.explained) for one in RANKING)
    return replace(
        diagnosis, verdict=Verdict.UNKNOWN, effects=(), probability=0.99, ranking=ranking, case_file="", parameters=(),
        after_model="baseline + friction-run-in, the best of the catalogue",
        sentence="Something that is not in the catalogue acts on the friction force on the plateau.",
        residual_law=ResidualLaw(channel="friction force", state="sliding speed", state_unit="m/s", channel_unit="N",
                                 x=speed, y=6.0 * np.tanh(speed / 2e-3) ** 3, sd=np.full(31, 0.6), explained=0.71),
        held_out=HeldOut(what="load 45 N", before=8.4, after=5.2, floor=1.0))


def odd() -> Diagnosis:
    """Return a diagnosis of text that needs escaping and of numbers that are not known."""
    plain = named()
    gone = np.full(SAMPLES, np.nan)
    holes = np.where(np.arange(SAMPLES) % 17 < 3, np.nan, plain.comparisons[0].force)
    loops = (replace(plain.comparisons[0], label=NASTY, force=holes), replace(plain.comparisons[1], displacement=gone),
             replace(plain.comparisons[2], before_force=gone, after_force=gone),
             replace(plain.comparisons[3], displacement=np.zeros(SAMPLES), before_displacement=np.zeros(SAMPLES)))
    few = np.array([0.0, 1e-3, 2e-3])
    return replace(
        plain, title=NASTY, recording=NASTY, kind="some-kind", effects=(NASTY,), probability=math.nan, sentence=NASTY,
        ranking=(Candidate(effects=(NASTY,), probability=math.nan, explained=math.nan, chi_squared=math.inf,
                           degrees_of_freedom=0, log_evidence=-math.inf), *RANKING[1:]),
        detection=Detection(p_value=math.nan, statistic="", tests={}, false_alarm_rate=math.nan),
        location=Location(block=NASTY, channel="", phase="", cycles=(5, 5), zone="", text=NASTY, places=(
            Place(cut=NASTY, where="", share=math.nan, p_value=math.nan),)),
        parameters=(Estimate(name=NASTY, value=math.nan, low=-math.inf, high=math.inf, unit="?"),
                    Estimate(name="third-body.no_such", value=0.0, low=0.0, high=0.0, unit="N/m")),
        held_out=HeldOut(what=NASTY, before=math.nan, after=math.nan, floor=math.nan), separating_measurement=NASTY,
        smallest_visible={NASTY: math.nan}, comparisons=loops, notes=(NASTY,), seconds=math.nan, case_file=NASTY,
        residual_maps=(ResidualMap(channel=NASTY, rows=(NASTY, "b"), phase=few, after=np.full((2, 3), np.nan),
                                   before=np.array([[1.0, np.nan, -9.0]] * 2)),
                       ResidualMap(channel="nothing", rows=(), phase=few, before=np.zeros((0, 3)),
                                   after=np.zeros((0, 3)))),
        wear_map=WearMap(x=few, y=few**2, measured=np.array([0.0, np.nan, 0.0]), before=np.full(3, np.nan),
                         after=np.zeros(3)),
        residual_law=ResidualLaw(channel=NASTY, state=NASTY, state_unit="1", channel_unit="N", x=few,
                                 y=np.array([np.nan, 1.0, 2.0]), sd=np.full(3, np.nan), explained=math.nan))


def empty() -> Diagnosis:
    """Return a diagnosis with nothing but its verdict."""
    return Diagnosis(title="", recording="r", kind="lumped", verdict=Verdict.UNKNOWN, effects=(), probability=0.0,
                     sentence="Unlike anything in the catalogue.", ranking=(),
                     detection=Detection(p_value=0.0, statistic="", tests={}, false_alarm_rate=0.05),
                     location=Location(block="", channel="", phase="", cycles=(0, 0), zone=""), parameters=(),
                     held_out=None, separating_measurement="", smallest_visible={})


CASES = {f"{make.__name__}-{kind}": (make, kind) for make in (named, none, ambiguous, unknown)
         for kind in ("fretting-rig", "imposed-displacement", "lumped")}


def chart_of(text, description):
    """Return the first chart so described, as the library has it."""
    start = text.index('<script type="application/json">', text.index(f'aria-label="{description}'))
    return json.loads(text[text.index(">", start) + 1:text.index("</script>", start)])["doc"]["roots"][0]


def drawn(text, description):
    """Return what the first chart so described holds, by name: its columns."""
    figure, columns_of = chart_of(text, description), {}
    for one in figure["attributes"]["renderers"]:
        columns = dict(one["attributes"]["data_source"]["attributes"]["data"]["entries"])
        columns_of[one["attributes"].get("name")] = {key: [array(v) for v in values] if isinstance(values, list) else
                                                     array(values) for key, values in columns.items()}
    return columns_of


def array(value):
    if not isinstance(value, dict):
        return value
    content = gzip.decompress(base64.b64decode(value["array"]["data"]))
    return np.frombuffer(content, value["dtype"]).reshape(value["shape"])
